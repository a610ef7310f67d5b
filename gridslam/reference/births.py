"""Twins of the kernels that propose births, cast their paths, and let new surfaces join the belief."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief, give_birth, update
from gridslam.inference.beliefs.layout import AGENT, POSE, StateLayout
from gridslam.kernels import FAINTEST
from gridslam.reference.cells import cells_of
from gridslam.reference.gaussian import RISE, bend_of_bounce, clocked, late, tall
from gridslam.reference.messages import clutter, deviations, log_rician
from gridslam.reference.paths import lines_of
from gridslam.world.geometry import course, lean, level_of, line_between, mirror, trace, unit, wrap
from gridslam.world.radio import REFLECTION_BINS as BINS

Whole = NDArray[np.int32]
REACH, TRIALS = 4.0, 41
FAINT, EXPLAINED, USUAL, DOUBLE_SHARE, WIDEST = 1e-3, 1e-3, 0.7, 0.5, 2.5


def propose(
    state: Array, noise: Array, mean: Array, head: int, scan: Array, known: Whole, whose: Whole,
    places: Array, radio: Array, rate: float, measured: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Twin of `births.propose`: ratio (M, A H), and the lines (M, A H, 2), anchor by anchor."""
    own = [
        _proposed(state, noise, mean, head, scan, known, int(a), places, radio[a], rate, measured)
        for a in whose
    ]
    ratio, line = zip(*own, strict=True)
    return np.concatenate(ratio, 1), np.concatenate(line, 1)


def _proposed(
    state: Array, noise: Array, mean: Array, head: int, scan: Array, known: Whole, anchor: int,
    places: Array, radio: Array, rate: float, measured: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """What `propose` says of one anchor: ratio (M, H), lines (M, H, 2)."""
    place, explained, delta = places[anchor].copy(), measured[0], late(mean, head, anchor, places)
    place[3] = tall(mean, head, anchor, places)
    silent, double, length = scan[:, 6] < 0, (known >= 0).any(1), scan[:, 0] - delta
    usual = np.where(silent, 0.5 * radio[7] / np.maximum(length, 1e-3), scan[:, 6])
    std = deviations(np.maximum(usual, FAINTEST), scan[:, 1:3], radio, lean(length, place[3]))
    std = np.where(scan[:, 3:6] > 0, scan[:, 3:6], np.minimum(std, 1e9))
    std = np.where(scan[:, 3:6] < 0, 1e9, std)
    nodes = np.multiply.outer(radio[7] / np.maximum(length, 1e-3), np.outer([1.0, USUAL], BINS))
    density = np.exp(log_rician(np.where(silent, 1.0, scan[:, 6])[:, None, None], nodes, radio[8])).mean(2)
    level = np.where(silent[:, None], 1.0, density) / clutter(scan[:, 6], radio)[:, None]
    common, least = rate * length, np.maximum(FAINT, EXPLAINED * explained)
    most = common * (level.max(1) if len(known) > 1 else level[:, 0]) / np.sqrt(2 * np.pi)
    departs, arrives = scan[:, 4] >= 0, scan[:, 5] >= 0
    keep = most > least * np.where(arrives, np.minimum(std[:, 1], WIDEST), WIDEST)
    keep &= (scan[:, 3] >= 0) & (arrives | departs)
    keep &= length > abs(place[3])
    keep &= (scan[:, 9] < 0) | (scan[:, 9] == anchor)
    weight = np.zeros((len(scan), len(known)))
    late_by = len(state) - (head - AGENT) + anchor
    clock = state[late_by] if clocked(head, places) else np.zeros(state.shape[1])
    measurement = np.concatenate([scan[keep, :3], std[keep], arrives[keep, None]], 1)
    weight[keep] = likely(state[: len(state) - (head - AGENT)], clock, noise, measurement, known, place)
    ratio = common[:, None] * level[:, double.astype(int)] * weight * np.where(double, DOUBLE_SHARE, 1.0)
    lines, line = mean[head:].reshape(-1, 2), np.zeros((*ratio.shape, 2))
    for m, h in np.argwhere(ratio > least[:, None]):
        (near, far), ends, bearing = known[h], (mean[:2], place[:2]), mean[4] + scan[m, 2]
        if not arrives[m]:
            near, far, ends, bearing = far, near, ends[::-1], place[2] + scan[m, 1]
        image = ends[0] + level_of(length[m], place[3]) * unit(bearing)
        source = mirror(lines[far], ends[1]) if far >= 0 else ends[1]
        line[m, h] = line_between(source, mirror(lines[near], image) if near >= 0 else image)
    return np.where(ratio > least[:, None], ratio, 0.0), line


def likely(state: Array, clock: Array, noise: Array, scan: Array, known: Whole, place: Array) -> Array:
    """Mean of f(AoD) / span for measurements with deviations, (M, 6) and whether they have an AoA, (M, H)."""
    samples = min(state.shape[1], noise.shape[1])
    state, clock, noise = state[:, :samples], clock[:samples], noise[:, :samples]
    agent, weight = state[:3], np.zeros((len(scan), len(known)))
    surfaces, anchor = lines_of(state), np.broadcast_to(place[:2], (samples, 2))
    for m, (distance, departure, arrival, *std, arrives) in enumerate(scan):
        reach, ends = distance + std[0] * noise[0] - clock, [agent[:2].T, anchor]
        bearing = arrival + std[2] * noise[1] + agent[2]
        if not arrives:
            ends, bearing = ends[::-1], departure + std[1] * noise[1] + place[2]
        image = ends[0] + level_of(reach, place[3])[:, None] * unit(bearing)
        for h, (last, first) in enumerate(known):
            near, far = (last, first) if arrives else (first, last)
            end = mirror(surfaces[near], image) if near >= 0 else image
            source = mirror(surfaces[far], ends[1]) if far >= 0 else ends[1]
            span = np.linalg.norm(end - source, axis=1)
            normal = (end - source) / np.maximum(span, 1e-12)[:, None]
            fresh = np.stack(
                [np.arctan2(normal[:, 1], normal[:, 0]), 0.5 * (normal * (end + source)).sum(1)], -1
            )
            double = last >= 0 or first >= 0
            drawn = trace(
                agent[:2].T,
                anchor,
                surfaces[last] if last >= 0 else fresh,
                surfaces[first] if first >= 0 else fresh,
                np.full(samples, 2 if double else 1),
            )
            density = np.full(samples, 1 / (2 * np.pi))
            if arrives and std[1] < 1e6:
                gap = wrap(departure - (drawn.departure - place[2])) / std[1]
                density = np.exp(-0.5 * gap**2) / (std[1] * np.sqrt(2 * np.pi))
            good = drawn.valid & (span > 1e-2) & (reach > abs(place[3]))
            weight[m, h] = np.where(good, density / np.maximum(span, 1e-12), 0.0).mean()
    return weight


def weigh_by_visibility(
    mean: Array, head: int, places: Array, wide: int, occupied: Array, frame: Array, born: Whole,
    proposal: Array,
) -> Array:  # fmt: skip
    """Twin of `birth_visibility.weigh_by_visibility`: weighed births (B,)."""
    occupied = occupied.reshape(2, -1, wide)
    lines, worth = mean[head:].reshape(-1, 2), 0.3 * proposal[: born[0, 0], 2]
    for b, (_, last, first, anchor) in enumerate(born[1 : 1 + born[0, 0]]):
        place = places[anchor, :2]
        ends = [lines[n] if n >= 0 else proposal[b, :2] for n in (last, first)]
        count = 2 if last >= 0 or first >= 0 else 1
        drawn = trace(mean[None, :2], place[None], ends[0][None], ends[1][None], np.array([count]))
        if drawn.valid[0]:
            points = [drawn.first_point[0], drawn.last_point[0]][2 - count :]
            normals = unit(np.array([ends[1][0], ends[0][0]]))[2 - count :]
            corners = np.stack([place, *points, mean[:2]])
            crossed, met = cells_of(corners, normals, frame, occupied.shape[1:], frame[7])
            through = np.prod(1 - occupied[0][tuple(crossed.T)])
            bounce = [1 - np.prod(1 - occupied[1][tuple(c.T)]) if len(c) else frame[3] for c in met]
            worth[b] = proposal[b, 2] * through * np.prod(bounce)
    return worth


def initialise_surface(
    mean: Array, covariance: Array, head: int, anchor: int, places: Array, scan: Array, m: int, last: int,
    first: int, radio: Array,
) -> tuple[Array, Array, Array, float]:  # fmt: skip
    """Twin of `initialisation.initialise_surface`: mean, covariance, belief over the coefficient, and misfit.

    Lines are worked out at all inputs at once, and derivatives are differences.

    Parameters
    ----------
    head : int
        Entry of the mean where the lines begin.
    anchor, m : int
        Row of `places` and `radio`; row of `scan`.
    places, radio : (J, 6), (J, 12)
        As `blocks.Anchors` has them.
    scan : (M, 10)
        As `AnchorScan.table`.
    last, first : int
        Known surface hit last, first; -1 for the new one.

    Returns
    -------
    (mean, covariance, reflection, misfit)
        (N + 2,), (N + 2, N + 2), the new line last; (BINS,); float, in deviations.
    """
    amplitude, place, facing, radio = scan[m, 6], places[anchor, :2], places[anchor, 2], radio[anchor]
    value = scan[m, :3] - np.array([float(late(mean, head, anchor, places)), 0.0, 0.0])
    known, size, layout = max(last, first), len(mean), StateLayout.of_view(len(mean), head - AGENT)
    new, line_of = layout.surfaces, layout.line
    strength = amplitude if amplitude >= 0 else 0.5 * radio[7] / max(value[0], 1e-3)
    height = float(tall(mean, head, anchor, places))
    steep = lean(value[0], height)
    std = deviations(np.array([max(strength, FAINTEST)]), value[None, 1:], radio, steep)[0]
    std = np.where(scan[m, 3:6] > 0, scan[m, 3:6], std)
    known_line = mean[line_of(known)] if known >= 0 else np.zeros(2)
    arrives = scan[m, 5] >= 0
    seen = 2 if arrives else 1  # the angle that it is made of

    def lines_by(inputs: Array) -> Array:
        """Lines (n, 2) by x, y, heading, distance, angle, and the known line, (n, 7)."""
        other, bearing = inputs[:, 5:], inputs[:, 2] + inputs[:, 4]
        ends, near, far = [inputs[:, :2], np.broadcast_to(place, other.shape)], last, first
        if not arrives:
            ends, near, far, bearing = ends[::-1], first, last, facing + inputs[:, 4]
        image = ends[0] + level_of(inputs[:, 3], height)[:, None] * unit(bearing)
        source = mirror(other, ends[1]) if far >= 0 else ends[1]
        return line_between(source, mirror(other, image) if near >= 0 else image)

    def ends_over(lines: Array) -> tuple[Array, Array, Array, Array, NDArray[np.intp]]:
        agents, sources, others = (np.broadcast_to(x, (len(lines), 2)) for x in (mean[:2], place, known_line))
        bounces = np.full(len(lines), 1 if known < 0 else 2)
        return agents, sources, (others if last >= 0 else lines), (others if first >= 0 else lines), bounces

    inputs = np.concatenate([mean[POSE], value[[0, seen]], known_line])
    at, departs = inputs.copy(), arrives and scan[m, 4] >= 0 and std[1] < 1e6
    wide = np.hypot(std[2], np.sqrt(covariance[4, 4]))
    for reach in (REACH, 2 * REACH / TRIALS) if departs else ():
        trials = np.tile(at, (TRIALS, 1))
        trials[:, 4] += wide * np.linspace(-reach, reach, TRIALS)
        path = course(*ends_over(lines_by(trials)))
        misfit = np.square(wrap(trials[:, 4] - value[2]) / wide) + 1e3 * ~path.valid
        misfit += np.square(wrap(value[1] - path.departure + facing) / std[1])
        at[4] = trials[misfit.argmin(), 4]
    small = 1e-5 * np.eye(len(at))
    line, *around = np.split(lines_by(np.concatenate([at[None], at + small, at - small])), [1, 1 + len(at)])
    change = around[0] - around[1]
    derivative = np.stack([wrap(change[:, 0]), change[:, 1]]) / 2e-5
    by_state = np.zeros((2, size))
    by_state[:, POSE] = derivative[:, :3]
    if clocked(head, places):
        by_state[:, AGENT + anchor] = -derivative[:, 3]
    elif layout.clocks and places[anchor, RISE] >= 0:
        by_state[:, AGENT + int(places[anchor, RISE])] = -derivative[:, 3] * height / value[0]
    if known >= 0:
        by_state[:, line_of(known)] = derivative[:, 5:]
    back = derivative[:, 4] * wrap(inputs[4] - at[4])
    belief = Belief(mean, covariance, layout.clocks)
    fresh = give_birth(belief, line[0] + back, by_state, derivative[:, 3:5], np.square(std[[0, seen]]))
    if departs:
        traced, jacobian = trace(*ends_over(line)), np.zeros((1, size + 2))
        jacobian[0, :2] = traced.jacobian[0, 1, :2]
        jacobian[0, line_of(last if last >= 0 else new)] += traced.jacobian[0, 1, 3:5]
        jacobian[0, line_of(first if first >= 0 else new)] += traced.jacobian[0, 1, 5:7]
        predicted = traced.departure[0] - facing + jacobian[0, line_of(new)] @ back
        gap = wrap(np.array([[value[1] - predicted]]))
        fresh = update(fresh, jacobian, gap, np.array([[std[1] ** 2]]), np.ones(1))
    density = np.ones(len(BINS))
    if amplitude >= 0:
        level = radio[7] / max(value[0], 1e-3) * BINS * (1.0 if known < 0 else USUAL)
        density = np.exp(log_rician(np.full(len(BINS), amplitude), level, radio[8])) + 1e-6
    whole = np.concatenate([fresh.mean[head:].reshape(-1, 2), fresh.lines[-1:]])  # -1: the new one
    path = trace(
        fresh.mean[None, :2], place[None], whole[None, last], whole[None, first],
        np.array([1 if known < 0 else 2]), float(tall(fresh.mean, head, anchor, places)),
    )  # fmt: skip
    late_by = float(late(fresh.mean, head, anchor, places))
    missed = abs(scan[m, 0] - late_by - path.distance[0]) / std[0]
    angle = path.arrival[0] - fresh.mean[4] if arrives else path.departure[0] - facing
    missed = max(missed, abs(wrap(scan[m, seen] - angle)) / std[seen])
    if known < 0:
        rows, short = np.arange(size, size + 2), scan[m, 0] - late_by - path.distance[0]
        mean, covariance = fresh.mean.copy(), fresh.covariance.copy()
        tilt = float(tall(mean, head, anchor, places))
        bent, bend = bend_of_bounce(mean, covariance, rows, place, tilt)
        mean[rows] += derivative[:, 3] * (short - bent[0])
        covariance[np.ix_(rows, rows)] += bend[0, 0] * np.outer(derivative[:, 3], derivative[:, 3])
        fresh = replace(fresh, mean=mean, covariance=covariance)
    return fresh.mean, fresh.covariance, density / density.sum(), float(missed)
