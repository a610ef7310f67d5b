"""Messages about the factors of antenna elements, and samples without them; docs/model.md, (M565).

Ours. Arrays are never as their drawing says: cables alone turn each element's phase. What that makes of a
strong path looks like fainter ones beside it, behind which walls would be born.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import replace, squared
from gridslam.inference.beliefs.element_gains import ElementGains
from gridslam.inference.messages.samples.array_likelihood import composed
from gridslam.inference.messages.samples.array_paths import Snapshot, SnapshotLikelihood
from gridslam.inference.state.state import State
from gridslam.world.signal_model import SignalModel


def learn_elements(
    state: State, snapshot: Snapshot, likelihood: SnapshotLikelihood, model: SignalModel
) -> State:
    """The state with what a snapshot says of the elements' factors, by the paths that are believed in.

    Not by new ones: these may be what the factors make of others.
    """
    samples = snapshot.samples if snapshot.factor is None else snapshot.samples * snapshot.factor[..., None]
    mode, known = likelihood.found.mode, len(likelihood.followed)
    if not known:
        return state
    believed = composed(snapshot.band, mode.path[:known], mode.paths.amplitude[:known])
    matched = np.einsum("abm,abm->ab", believed.conj(), samples) / snapshot.noise
    power = squared(believed).sum(-1) / snapshot.noise
    elements = state.elements or ElementGains.none(model.waveform)
    return replace(state, elements=elements.taken_in(snapshot.anchor, matched, power))
