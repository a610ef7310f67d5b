"""Likelihoods of network SLAM as published: measurements against lines of sight and virtual anchors.

[Venus2025network], section IV; docs/model.md, (M143). Equations without a key are that paper's. A message to
an agent integrates over a virtual anchor by its moments, one to a virtual anchor over the agent by that
one's; over a clock, which is one number and may have several modes, by a histogram.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.published.image_particles import GATE, SUREST, path_values
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.published.network_particles import CLOCK, NetworkParticleState
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap
from gridslam.world.radio import RadioModel

CELLS = 10.0
"""Cells of a clock's histogram per deviation of a measured distance."""
GIVEN = 0.5
"""Probability from which on a measurement counts as one anchor's."""


@dataclass(frozen=True, eq=False)
class CompatiblePair:
    """A pair of a feature and a measurement whose angles fit: particles of one belief, and what they say.

    Attributes
    ----------
    feature, measurement : int
    at : (N,) int
        Particles whose angles fit.
    weight : (N,)
        p_d times the density of the angles over that of clutter, at these.
    late : (N,) m
        What is left of the measured distance, given the angles: the clock offset if all else is right.
    std : float, m
        Its deviation.
    """

    feature: int
    measurement: int
    at: NDArray[np.intp]
    weight: Array
    late: Array
    std: float


@dataclass(frozen=True, eq=False)
class NetworkRatios:
    """All anchors' lines of sight and virtual anchors, F of them, at all particles of one agent.

    Attributes
    ----------
    anchor : (F,) int
        Whose each is; the first J are lines of sight.
    existence : (F,)
        1 for lines of sight.
    missed : float
        1 - p_d.
    pairs : sequence of CompatiblePair
        By the agent's particles.
    ratio : (F, M, P)
        Likelihood ratios (17), (18) at the agent's particles, all else integrated out.
    by_place : (F - J, M, P)
        The same at the virtual anchors' particles.
    """

    anchor: NDArray[np.int64]
    existence: Array
    missed: float
    pairs: Sequence[CompatiblePair]
    ratio: Array
    by_place: Array


def evaluate_network(
    state: NetworkParticleState, agent: int, scan: AnchorScan, model: FilterModel
) -> NetworkRatios:
    """All features of all anchors at one agent's particles and at their own, (3) to (7), (17), (18)."""
    known, own, radio = state.features, state.agents[agent], model.radio
    anchors, count, several = len(model.anchors), len(own), len(scan)
    whose = np.concatenate([np.arange(anchors), known.anchor])
    existence = np.concatenate([np.ones(anchors), known.existence])
    missed, std = max(1 - detection(radio), 1 - SUREST), measured_deviations(scan, radio)
    base = np.log1p(-missed) - log_clutter(scan, radio)
    ratio, pairs = np.zeros((len(whose), several, count)), list[CompatiblePair]()
    by_place = np.zeros((len(known), several, count))
    pose, doubt = pose_moments(own)
    for f, anchor in enumerate(whose.tolist()):
        sight, clock = f < anchors, state.clocks[anchor]
        place = model.anchor_positions[anchor][None] if sight else known.position[f - anchors]
        rows = np.flatnonzero((scan.label < 0) | (scan.label == anchor))
        middle, spread = place.mean(0), np.cov(place.T, bias=True) if len(place) > 1 else np.zeros((2, 2))
        slopes = _slopes(pose, middle, sight, model.anchors[anchor])
        values = _values(own, middle[None], sight, model.anchors[anchor])
        for pair in _pairs(f, values, slopes[:, 6:] @ spread @ slopes[:, 6:].T, scan, rows, std, base):
            ratio[f, pair.measurement, pair.at] = pair.weight * blurred(clock, None, pair.late, pair.std)
            pairs.append(pair)
        if sight:
            continue
        values = _values(pose[None], place, sight, model.anchors[anchor])
        for pair in _pairs(f, values, slopes[:, :6] @ doubt @ slopes[:, :6].T, scan, rows, std, base):
            weight = pair.weight * blurred(clock, None, pair.late, pair.std)
            by_place[f - anchors, pair.measurement, pair.at] = weight
    return NetworkRatios(whose, existence, missed, pairs, ratio, by_place)


def pose_moments(agent: Array) -> tuple[Array, Array]:
    """Mean (6,) and covariance (6, 6) of an agent's particles, whose heading turns."""
    heading = np.angle(np.exp(1j * agent[:, 4]).mean())
    whole = agent.copy()
    whole[:, 4] = heading + wrap(agent[:, 4] - heading)
    return whole.mean(0), np.cov(whole.T, bias=True)


def _values(agent: Array, place: Array, sight: bool, anchor: Array) -> Array:
    """Distance less the agent's clock, AoD and AoA, (3, P), of agents (P or 1, 6) and places (P or 1, 2)."""
    count = max(len(agent), len(place))
    places = np.broadcast_to(place, (count, 2))[None]
    poses = np.broadcast_to(agent, (count, agent.shape[1]))
    values = path_values(poses[:, :CLOCK], places, np.array([sight]), anchor)[:, 0]
    values[0] -= poses[:, CLOCK]
    return values


def _slopes(pose: Array, place: Array, sight: bool, anchor: Array) -> Array:
    """Derivatives of `_values` by agent (6) and place (2), (3, 8), by differences."""
    step = 1e-5
    ends = np.concatenate([pose, place]) + step * np.vstack([np.eye(8), -np.eye(8)])
    values = _values(ends[:, :6], ends[:, 6:], sight, anchor)
    change = values[:, :8] - values[:, 8:]
    change[1:] = wrap(change[1:])
    return change / (2 * step)


def _pairs(
    feature: int, values: Array, extra: Array, scan: AnchorScan, rows: NDArray[np.intp], std: Array,
    base: Array,
) -> list[CompatiblePair]:  # fmt: skip
    """Measurements near what particles predict.

    Parameters
    ----------
    values : (3, P)
    extra : (3, 3)
        Covariance from what is integrated out.
    rows : (N,) int
        Measurements.
    std, base : (M, 3), (M,)
        Their deviations, and log of p_d over clutter.
    """
    middle = np.angle(np.exp(1j * values[1:]).mean(-1))
    off = wrap(values[1:] - middle[:, None])
    farthest, pairs = np.abs(off).max(1), []
    for m in rows.tolist():
        kinds = np.flatnonzero(np.isfinite(std[m, 1:]))
        whole = extra + np.diag(np.where(np.isfinite(std[m]), std[m], 0.0) ** 2)
        angles = whole[1:, 1:][np.ix_(kinds, kinds)]
        reach, turn = GATE * np.sqrt(np.diagonal(angles)), wrap(scan.value[m, 1:] - middle)[kinds]
        if (np.abs(turn) > farthest[kinds] + reach).any():
            continue
        gap = turn[:, None] - off[kinds]
        if (np.abs(turn) + farthest[kinds] > np.pi).any():
            gap = wrap(gap)
        at = np.flatnonzero((np.abs(gap) < reach[:, None]).all(0))
        if not len(at):
            continue
        gap, inverse = gap[:, at], np.linalg.inv(angles)
        gain = whole[0, 1:][kinds] @ inverse
        logs = base[m] - 0.5 * np.einsum("ap,ab,bp->p", gap, inverse, gap)
        logs = logs - np.log(2 * np.pi) * (2 - 0.5 * len(kinds)) - 0.5 * np.linalg.slogdet(angles)[1]
        late = scan.value[m, 0] - values[0, at] - gain @ gap
        left = float(np.sqrt(whole[0, 0] - gain @ whole[1:, 0][kinds]))
        pairs.append(CompatiblePair(feature, m, at, np.exp(logs), late, left))
    return pairs


def blurred(at: Array, weight: Array | None, where: Array, std: float) -> Array:
    """Mean over all points (N,) of weight times a Gaussian about each, where asked (K,): by a fine histogram.

    Parameters
    ----------
    weight : (N,), optional
        1 if it isn't given.
    """
    reach, cell = GATE * std, std / CELLS
    near = (at > where.min() - reach) & (at < where.max() + reach)
    inside = at[near]
    if not len(inside):
        return np.zeros(len(where))
    own = np.ones(len(inside)) if weight is None else weight[near]
    first = inside.min() - reach - 2 * cell
    size = int((inside.max() + reach - first) / cell) + 3
    place = (inside - first) / cell
    low = place.astype(np.int64)
    share = place - low
    table = np.bincount(low, own * (1 - share), size) + np.bincount(low + 1, own * share, size)
    taps = np.arange(-int(GATE * CELLS), int(GATE * CELLS) + 1) / CELLS
    kernel = np.exp(-0.5 * taps**2) / (std * np.sqrt(2 * np.pi))
    smooth = (
        np.convolve(table, kernel, mode="same") if size >= len(kernel) else np.convolve(kernel, table, "same")
    )
    grid = first + cell * np.arange(len(smooth))
    return np.interp(where, grid, smooth, 0.0, 0.0) / len(at)


def detection(radio: RadioModel) -> float:
    """p_d of every path: given, or that of a path of 10 m ([Venus2025network] has one for all)."""
    return float(radio.detection_probability(np.asarray(radio.amplitude(10.0))))


def measured_deviations(scan: AnchorScan, radio: RadioModel) -> Array:
    """Deviations (M, 3) that came with the measurements, or by measured amplitudes; infinite for none."""
    level = np.where(np.isnan(scan.amplitude), radio.amplitude(10.0), scan.amplitude)
    return deviations(scan, np.arange(len(scan)), level, scan.value[:, 1:], radio)


def log_clutter(scan: AnchorScan, radio: RadioModel) -> Array:
    """Log of mu_fp f_fp over distance and angles, (M,)."""
    return np.log(radio.false_alarms) + radio.log_clutter(np.full(len(scan), np.nan))
