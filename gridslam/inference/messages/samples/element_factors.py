"""Messages about the factors of antenna elements, and samples without them; docs/model.md, (M565).

Ours. Arrays are never as their drawing says: cables alone turn each element's phase. What that makes of a
strong path looks like fainter ones beside it, behind which walls would be born.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import replace, squared
from gridslam.inference.beliefs.element_gains import ElementGains
from gridslam.inference.messages.samples.array_likelihood import composed
from gridslam.inference.messages.samples.array_paths import Snapshot, SnapshotLikelihood
from gridslam.inference.state.state import State
from gridslam.world.signal_model import SignalModel


def learn_elements(
    state: State, listened: Sequence[tuple[Snapshot, SnapshotLikelihood]], model: SignalModel
) -> State:
    """The state with what a step's snapshots say of the elements' factors, by paths that are believed in.

    Not by new ones: these may be what the factors make of others.
    """
    elements = state.elements or ElementGains.none(model.waveform)
    matched, power = np.zeros_like(elements.matched), np.zeros_like(elements.power)
    for snapshot, likelihood in listened:
        mode, known = likelihood.found.mode, len(likelihood.followed)
        believed = composed(snapshot.band, mode.path[:known], mode.paths.amplitude[:known])
        factor = 1.0 if snapshot.factor is None else snapshot.factor[..., None]
        received = np.einsum("abm,abm->ab", believed.conj(), factor * snapshot.samples)
        matched[snapshot.anchor] = received / snapshot.noise
        power[snapshot.anchor] = squared(believed).sum(-1) / snapshot.noise
    if not power.any():
        return state
    return replace(state, elements=elements.taken_in(matched, power, model.waveform))
