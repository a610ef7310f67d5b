"""Which error in the distances explains lines of sight best: least squares at every step, no motion model.

Each step has a pose of its own, so only what several anchors say of the same pose tells of an error. Rivals
are compared by their misfit with the scale unknown, hence by its ratio.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.scene.range_errors import RangeError
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.world.geometry import level_of, slant
from gridslam.world.scene import Scene

DISTANCE_STD_M, ANGLE_STD_RAD = 0.05, 0.03
OUTLIER = 5.0
"""Standard deviations beyond which a residual counts no further."""
ROUNDS, COARSE_M = 6, 0.5
"""Of Gauss-Newton; first steps in which sizes are tried."""
DAMPING = 0.1
"""Of what no anchor tells of a pose, in the normal equations."""
HEIGHT_ROUNDS = 4
"""Over all anchors: a height that is found moves the others."""


@dataclass(frozen=True)
class RangeFit:
    """How well an error in the distances explains the lines of sight.

    Attributes
    ----------
    error : RangeError or None
        None for no error at all.
    size_m : float
    misfit : float
        Sum of squared, normalised residuals, each of at most `OUTLIER` standard deviations.
    count : int
        Residuals more than unknowns.
    """

    error: RangeError | None
    size_m: float
    misfit: float
    count: int

    def gain(self, other: RangeFit) -> float:
        """Log likelihood ratio of this one over another one, nats."""
        return 0.5 * self.count * float(np.log(max(other.misfit, 1e-9) / max(self.misfit, 1e-9)))


def fits(
    columns: Mapping[str, NDArray],
    sight: Sight,
    scene: Scene,
    errors: list[RangeError],
    agent: str | None = None,
) -> list[RangeFit]:
    """Fit no error and each of `errors` to the lines of sight of a table.

    Parameters
    ----------
    columns : dict of (K,) arrays
        As of `gridslam.checks.sights.line_of_sight_filter.explain`.
    sight : Sight
        Which of the rows are lines of sight.
    scene : Scene
        For its anchors.
    errors : list of RangeError
    agent : str, optional
        Above which the anchors stand; default: the first.

    Returns
    -------
    list of RangeFit
        The first without an error; empty if the anchors don't say more than the poses take.
    """
    sights = _sight_measurements(columns, sight, scene)
    if sights is None:
        return []
    places = np.column_stack([scene.anchor_positions, scene.heights(agent)])
    count = int(np.isfinite(sights).sum() - 3 * len(sights))
    found = [RangeFit(None, 0.0, float(_misfit(sights, places, None, np.zeros(1))[0]), count)]
    for error in errors:
        size, misfit = _best_size(sights, places, error)
        found.append(RangeFit(error, size, misfit, count))
    return found


def without_twins(found: list[RangeFit]) -> list[RangeFit]:
    """Fits of errors, without a height of all anchors of next to none: as lengths in the plan have it."""
    plans = [fit.error.anchors for fit in found if fit.error is not None and fit.error.kind == "plan"]
    twins = [
        fit
        for fit in found
        if fit.error is not None and fit.error.kind == "slant" and fit.size_m < fit.error.least_m
    ]
    return [fit for fit in found if fit not in twins or fit.error is None or fit.error.anchors not in plans]


def fit_heights(columns: Mapping[str, NDArray], sight: Sight, scene: Scene) -> tuple[Array, RangeFit] | None:
    """Fit a height of its own to each anchor, one after the other; None where no several anchors tell.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    sight : Sight
        Which of the rows are lines of sight.

    Returns
    -------
    heights : (J,) m
        Above or below the agent; 0 of an anchor that tells nothing.
    fit : RangeFit
        Without an error of one size.
    """
    sights = _sight_measurements(columns, sight, scene)
    if sights is None:
        return None
    places = np.column_stack([scene.anchor_positions, np.full(len(scene.anchors), COARSE_M)])
    misfit = np.inf
    for _ in range(HEIGHT_ROUNDS):
        for number in range(len(places)):
            places[number, 2], misfit = _best_size(sights, places, RangeError("slant", (number,)))
    return places[:, 2], RangeFit(None, 0.0, misfit, int(np.isfinite(sights).sum() - 3 * len(sights)))


def _best_size(sights: Array, places: Array, error: RangeError) -> tuple[float, float]:
    """The size of an error that leaves the least misfit, and that; finer and finer about the best so far."""
    least, most = error.bounds_m
    sizes = np.arange(least, most + COARSE_M, COARSE_M)
    size = cost = 0.0
    for spread in (COARSE_M, 0.2 * COARSE_M, 0.04 * COARSE_M):
        costs = _misfit(sights, places, error, sizes)
        size, cost = float(sizes[np.argmin(costs)]), float(costs.min())
        sizes = np.clip(size + spread * np.linspace(-1, 1, 11), least, most)
    return size, cost


def steps_to_judge_by(columns: Mapping[str, NDArray], sight: Sight, scene: Scene) -> int:
    """At how many steps several anchors tell of the agent's pose.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    sight : Sight
        Which of the rows are lines of sight.
    """
    sights = _sight_measurements(columns, sight, scene)
    return 0 if sights is None else len(sights)


def _sight_measurements(columns: Mapping[str, NDArray], sight: Sight, scene: Scene) -> Array | None:
    """Distance, direction from the anchor in the world, AoA (N, J, 3), where several anchors tell."""
    rows = sight.row[sight.sure]
    if not len(rows) or "distance_m" not in columns:
        return None
    step, anchor = columns["step"][rows], columns["anchor"][rows]
    place = np.unique(step, return_inverse=True)[1]
    value = np.full((place.max() + 1, len(scene.anchors), 3), np.nan)
    value[place, anchor, 0] = columns["distance_m"][rows]
    if "aod_rad" in columns:
        value[place, anchor, 1] = columns["aod_rad"][rows] + scene.anchor_orientations[anchor]
    if "aoa_rad" in columns:
        value[place, anchor, 2] = columns["aoa_rad"][rows]
    measured = np.isfinite(value)
    enough = (measured.sum((1, 2)) > 3) & (measured[:, :, 0].sum(1) > 1) & measured[:, :, 1:].any((1, 2))
    return value[enough] if enough.sum() >= 5 else None


def _misfit(sights: Array, places: Array, error: RangeError | None, sizes: Array) -> Array:
    """Sums of squared residuals (S,), one for each size of the error; `places` (J, 3) with heights.

    The poses are those that make them least, by Gauss-Newton with weights. Anchors come first, before sizes
    and steps, and quantities before anchors: sums over a short last axis take several times as long.
    """
    places, heights = places[:, :2], places[:, 2]
    pose = np.tile(_first(sights, places, heights).T[:, None], (1, len(sizes), 1))
    sights = np.ascontiguousarray(sights.transpose(2, 1, 0))
    values = np.nan_to_num(sights)[:, :, None]
    stds = np.array([DISTANCE_STD_M, ANGLE_STD_RAD, ANGLE_STD_RAD])
    precision = np.isfinite(sights) / stds[:, None, None]
    for last in range(ROUNDS + 1):
        x, y = (pose[axis] - places[:, axis, None, None] for axis in (0, 1))
        flat = np.maximum(np.hypot(x, y), 1e-3)
        direction = np.arctan2(y, x)
        predicted = slant(flat, heights[:, None, None])
        slope = flat / predicted
        for number in error.anchors if error is not None else ():
            assert error is not None
            height = float(heights[number])
            predicted[number] = error.spoilt(flat[number], sizes[:, None], number, height)
            if error.kind != "offset":
                slope[number] = flat[number] / predicted[number]
        behind = direction + np.pi - pose[2]
        gap = values - np.stack([predicted, direction, behind])
        gap[1:] -= 2 * np.pi * np.rint(gap[1:] / (2 * np.pi))
        gap *= precision[:, :, None]
        if last == ROUNDS:
            break
        along = slope / flat
        change = _change(gap, precision, (along * x, along * y), (-y / flat**2, x / flat**2))
        pose = pose + np.clip(change, -1, 1)
    return np.asarray(np.minimum(gap**2, OUTLIER**2).sum((0, 1, 3)))


def _change(gap: Array, precision: Array, toward: tuple[Array, Array], across: tuple[Array, Array]) -> Array:
    """What Gauss-Newton changes poses (3, S, N) by.

    Each has three unknowns: the heading is eliminated, and two equations are left, which takes half as
    long as solving so many small systems one by one.

    Parameters
    ----------
    gap : (3, J, S, N)
        Of distance, direction and AoA, in deviations.
    precision : (3, J, N)
        0 of what wasn't measured.
    toward, across : two of (J, S, N)
        Slopes of distance and direction by position.
    """
    known, damped = precision[:, :, None], 1 + (gap / OUTLIER) ** 2
    pull, weight = known * gap / damped, known**2 / damped
    both, turn = weight[1] + weight[2], pull[1] + pull[2]
    xx, xy, yy = (
        (weight[0] * toward[i] * toward[k] + both * across[i] * across[k]).sum(0) + DAMPING * (i == k)
        for i, k in ((0, 0), (0, 1), (1, 1))
    )
    xh, yh = (-(weight[2] * slope).sum(0) for slope in across)
    hh, h = weight[2].sum(0) + DAMPING, -pull[2].sum(0)
    x, y = ((pull[0] * one + turn * other).sum(0) for one, other in zip(toward, across, strict=True))
    xx, xy, yy = xx - xh * xh / hh, xy - xh * yh / hh, yy - yh * yh / hh
    x, y = x - xh * h / hh, y - yh * h / hh
    own = xx * yy - xy * xy
    right, up = (yy * x - xy * y) / own, (xx * y - xy * x) / own
    return np.stack([right, up, (h - xh * right - yh * up) / hh])


def _first(sights: Array, places: Array, heights: Array) -> Array:
    """Poses (N, 3) to begin with: the middle of where each anchor alone would put the agent."""
    toward = sights[..., 1]
    spots = places + level_of(sights[..., 0], heights)[..., None] * np.stack(
        [np.cos(toward), np.sin(toward)], -1
    )
    spot = np.where(np.isfinite(spots).all(-1).any(1)[:, None], _mean(spots), places.mean(0))
    away = spot[:, None] - places
    facing = np.arctan2(away[..., 1], away[..., 0]) + np.pi - sights[..., 2]
    turned = _mean(np.stack([np.cos(facing), np.sin(facing)], -1))
    return np.column_stack([spot, np.arctan2(turned[:, 1], turned[:, 0])])


def _mean(values: Array) -> Array:
    """Means (N, 2) over the anchors of (N, J, 2), those without a number left out; 0 of none."""
    measured = np.isfinite(values).all(-1, keepdims=True)
    return np.where(measured, values, 0).sum(1) / np.maximum(measured.sum(1), 1)
