"""Paths that no feature stands for yet, close to one that is followed; docs/model.md, (M526).

One that overlaps the line of sight bends by ten degrees and more where that seems to come from, until it has
been learned. So what a step's samples hold beside the paths that are known is taken for a path of that step,
wherever it may lead, and forgotten after it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.arrivals import COST
from gridslam.inference.messages.features.joint_update import update
from gridslam.inference.messages.features.path_products import paths_at
from gridslam.inference.messages.features.regaining import responses, spectra, steering
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]
SURPRISE = 30.0
"""Nats by which a step's evidence is below what its noise lets expect where a path is looked for."""
MOST = 2
"""Times that paths are looked for."""
BESIDE_M, APART_M, DIRECTIONS = 1.2, 0.1, 36
"""How far from the lengths of known paths they are looked for, how close to each other, and in how many
directions."""
LENGTH_STD_M, DIRECTION_STD_RAD, EXTRA_STD_M = 0.3, 0.5, 0.01
"""Of a path found on that grid."""
LEAST_SHARE, LEAST_ROWS = 1e-3, 3
"""Of a response that known paths have to leave of it; shorter paths than so many rows aren't tried."""
FIRST = 10**9
"""Numbers of such paths: no feature has any so large."""


class Stranger(NamedTuple):
    """A path of an anchor that nobody knows: length (m), direction in the world (rad), power at 1 m."""

    length: float
    direction: float
    power: float


def update_beside_strangers(
    belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float, model: SignalModel,
    step: int, start: Array | None = None, hidden: NDArray[np.bool_] | None = None,
) -> tuple[JointBelief, float]:  # fmt: skip
    """As `joint_update.update`, beside paths of this step alone, where evidence asks for any; (M526).

    Arguments are those of `beside_strangers`; the number of paths is left out.
    """
    found, evidence, _ = beside_strangers(belief, samples, audible, heading_rad, model, step, start, hidden)
    return found, evidence


def beside_strangers(
    belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float, model: SignalModel,
    step: int, start: Array | None = None, hidden: NDArray[np.bool_] | None = None,
) -> tuple[JointBelief, float, int]:  # fmt: skip
    """The belief after one step's samples, the log of their evidence, and beside how many strangers; (M526).

    What strangers tell is kept, they themselves are not.

    Parameters
    ----------
    belief : JointBelief
        As predicted.
    samples : (J, N, M)
    audible : (J,) bool
        Anchors that are heard.
    heading_rad : float
        As measured.
    step : int
        Number of the step.
    start, hidden : (4,), (J,) bool, optional
        As of `joint_update.update`.
    """
    found, evidence = update(belief, samples, audible, heading_rad, model, step, start, hidden)
    heard, wider, known = np.flatnonzero(audible), belief, len(belief.features)
    usual = -sum(samples[0].size * (1 + np.log(np.pi * found.noise[j])) for j in heard)
    for _ in range(MOST):
        if evidence > usual - SURPRISE:
            break
        rivals = []
        for at in (wider, found):  # a wrong maximum hides what lies beside the right one
            beside = _with_strangers(wider, at, samples, heard, heading_rad, model, step)
            more = len(beside.features) - len(wider.features)
            if more:
                after, its = update(
                    beside, samples, audible, heading_rad, model, step, at.mean[:MOVING], hidden
                )
                if its - evidence > COST * more:
                    rivals.append((its, after, beside))
        if not rivals:
            break
        evidence, found, wider = max(rivals, key=lambda one: one[0])
    strangers = len(found.features) - known
    return found.keep(np.arange(len(found.features)) < known), evidence, strangers


def _with_strangers(
    belief: JointBelief, at: JointBelief, samples: Complex, heard: Indices, heading_rad: float,
    model: SignalModel, step: int,
) -> JointBelief:  # fmt: skip
    """The belief with the strongest path of each anchor that is left where another belief has all others."""
    spread = np.diag(np.square([LENGTH_STD_M, DIRECTION_STD_RAD, EXTRA_STD_M]))
    for j in heard:
        one = stranger(at, samples[j], int(j), heading_rad, model)
        if one is not None:
            entry, name = np.array([one.length, one.direction, 0.0]), FIRST + len(belief.features)
            belief = belief.with_feature(int(j), entry, spread, at.mean[:2].copy(), one.power, name, step)
    return belief


def stranger(
    belief: JointBelief, samples: Complex, anchor: int, heading_rad: float, model: SignalModel
) -> Stranger | None:
    """The strongest path beside those that are heard of an anchor, if any is worth its cost.

    Parameters
    ----------
    belief : JointBelief
        Where the agent and all known paths are.
    samples : (N, M)
    """
    paths, noise = paths_at(belief.mean, belief, anchor, heading_rad, model), belief.noise[anchor]
    there = np.append(belief.existence[anchor], belief.features.presence[paths.rows]) > 0.5
    if not there.any():
        return None
    power = np.append(belief.los_power[anchor], belief.features.power[paths.rows])[there]
    length, angle = paths.numbers.reshape(2, -1)[:, there]
    known = np.sqrt(power)[:, None] * responses(length, angle, model)
    root = np.linalg.cholesky(noise * np.eye(len(known)) + known.conj() @ known.T)
    half = np.linalg.solve(root, known.conj())
    rest = samples.ravel() - half.conj().T @ (half @ samples.ravel())
    offsets = np.arange(-BESIDE_M, BESIDE_M, APART_M)
    rows = np.unique(np.round((length[:, None] + offsets) / APART_M))
    tried_m = APART_M * rows[rows > LEAST_ROWS]
    tried_rad: Array = 2 * np.pi / DIRECTIONS * np.arange(DIRECTIONS, dtype=np.float64)
    antennas, spectrum = steering(tried_rad, model).conj(), spectra(tried_m, model).conj()

    def matched(what: Complex) -> Array:
        """Squares of what directions and lengths match, added up over rows (n, N M)."""
        each = antennas @ (what.reshape(len(what), *samples.shape) @ spectrum.T)
        squares: Array = (np.abs(each) ** 2).sum(0)
        return squares

    size = len(samples) * (np.abs(spectrum) ** 2).sum(1)
    left = np.maximum(size - matched(half.conj()), LEAST_SHARE * size)
    match = matched(rest[None]) / left
    best = np.unravel_index(int(np.argmax(match)), match.shape)
    level = max(match[best] / noise, 1.0)
    if level - 1 - np.log(level) < COST:
        return None
    turned, far = tried_rad[best[0]] + heading_rad, tried_m[best[1]]
    return Stranger(float(far), float(turned), float(match[best] / left[best]))
