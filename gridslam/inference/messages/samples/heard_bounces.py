"""What snapshots of arrays say of single bounces by themselves, and what follows of their surfaces.

docs/model.md, (M562). Ours. Walls' bounces leave as off a mirror, corners' don't; points' don't stay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.mirrors import weigh_heard_angles
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.samples.array_likelihood import ArrayBand
from gridslam.inference.messages.samples.array_paths import Snapshot, SnapshotLikelihood
from gridslam.inference.messages.samples.matched_power import widths_apart
from gridslam.inference.messages.samples.state_mode import FREE, StateMode
from gridslam.inference.messages.scatterers import undecided, weigh_heard
from gridslam.inference.state.state import State
from gridslam.kernels import UNMEASURED
from gridslam.world.signal_model import SignalModel

LOUD = 6.0
"""Squared amplitude from which on a path is heard; noise is as loud at its place once in 400 snapshots."""
CLOSE = 0.5
"""Turn of phase (rms, rad) within which two paths share what is heard, as no variance tells."""


@dataclass(frozen=True, eq=False)
class HeardBounces:
    """D single bounces that a snapshot holds, clear of the noise and of other paths.

    Attributes
    ----------
    row : (D,)
        Which of the snapshot's paths.
    surface, anchor : (D,)
    rows : (D, 6)
        Distance (m), AoD and AoA (rad), and their variances; `UNMEASURED` for none.
    """

    row: NDArray[np.intp]
    surface: NDArray[np.intp]
    anchor: NDArray[np.intp]
    rows: Array

    @classmethod
    def of(cls, snapshot: Snapshot, likelihood: SnapshotLikelihood) -> HeardBounces:
        """Those of a snapshot."""
        followed, found = likelihood.followed, likelihood.found
        bounces, surface, _, anchor = snapshot.rays.table[followed].T.astype(np.intp)
        loud = (likelihood.matched / np.maximum(likelihood.own, 1e-300))[followed] > LOUD
        heard = np.flatnonzero(loud & (bounces == 1))
        heard = heard[lie_alone(snapshot.band, found.mode.path, found.prior.weight > snapshot.noise, heard)]
        if not len(heard):
            none = np.zeros(0, np.intp)
            return cls(none, none, none, np.zeros((0, 6)))
        rows = np.hstack(measured(found.mode))[heard]
        return cls(followed[heard], surface[heard], anchor[heard], rows)


def lie_alone(
    band: ArrayBand, path: Array, matters: NDArray[np.bool_], asked: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Which paths (D,) of N have no other one close to them that matters (N,)."""
    close = (widths_apart(band, path[:, None], path[asked]) < CLOSE) & matters[:, None]
    close[asked, np.arange(len(asked))] = False
    return np.asarray(~close.any(0))


def measured(mode: StateMode) -> tuple[Array, Array]:
    """What a snapshot alone says of a mode's paths, (N, 3) m, rad, rad, and its variances; (M562).

    One step from the mode to where the likelihood is highest over all paths at once, with no state behind
    them, less what arrays are believed to turn them by; what is unsure of that isn't in the variances.
    """
    information, free = mode.paths.information, np.tile(FREE**2, len(mode.path))
    spread = np.linalg.inv(information + np.diag(free))
    step = spread @ mode.paths.gradient.reshape(-1)
    told = information.diagonal() > free
    variance = np.where(told, spread.diagonal(), UNMEASURED)
    return mode.path - mode.turned + step.reshape(-1, 3), variance.reshape(-1, 3)


def weigh_angles(state: State, paths: PredictedPaths, heard: HeardBounces) -> State:
    """The state with the angles of its single bounces weighed, as they were predicted; (M517), (M547)."""
    return weigh_heard_angles(state, paths, heard.row, heard.rows)


def weigh_forms(state: State, heard: HeardBounces, model: SignalModel) -> State:
    """The state with both forms of its surfaces fitted to its single bounces; (M559)."""
    if state.monitor.astray or not len(heard.row):
        return state
    open_ = undecided(state.surfaces)[heard.surface]
    return weigh_heard(state, heard.surface[open_], heard.anchor[open_], heard.rows[open_], model)
