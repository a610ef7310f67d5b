"""Births: the new surface that each measurement would need (paper 002, section V-B); owner of that kernel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.geometry import PathGeometry, line_between, mirror, trace, unit, wrap
from gridslam.inference.belief import Belief, birth_line, give_birth, slots, update
from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import deviations
from gridslam.inference.particles import Cloud, at_mean
from gridslam.inference.rays import Rays
from gridslam.inference.surfaces import Bank
from gridslam.signal import REFLECTION_BINS, SignalModel

Array = NDArray[np.float64]
CONVERGED_STD_M = 0.3
USUAL_REFLECTION = 0.7
DOUBLE_SHARE = 0.5
"""Births by each kind of double bounce over births by single bounces."""
EXPLAINED = 1e-3
"""A birth this many times less likely than the measurement's known causes isn't looked at."""
FAINT = 1e-3
"""Ratio to clutter below which a hypothesis is dropped."""
RIVAL = 0.2
"""Share of a measurement's births from which on the second likeliest is followed, too."""
SAMPLES = 256
REACH, TRIALS = 4.0, 41
"""Deviations and number of directions of arrival that are tried for a new line, coarse and then fine."""


@dataclass(frozen=True)
class Births:
    """Hypotheses of new surfaces, one or more per measurement.

    Attributes
    ----------
    measurement : (B,) int
    last, first : (B,) int
        Known surface hit last or first on a double bounce; -1 for the new one.
    line : (B, 2)
    ratio : (B,)
        I: mean number of such births over that of clutter.
    """

    measurement: NDArray[np.intp]
    last: NDArray[np.intp]
    first: NDArray[np.intp]
    line: Array
    ratio: Array

    def __len__(self) -> int:
        return len(self.ratio)

    def weighed(self, validity: Array) -> Births:
        """The same with every hypothesis weighed by the validity (B,) of its path in the grid."""
        return replace(self, ratio=self.ratio * validity)

    def per_measurement(self, count: int) -> Array:
        """I_m, the sum over the hypotheses of each of `count` measurements."""
        return np.bincount(self.measurement, self.ratio, count).astype(np.float64)

    def chosen(self, claimed: Array, least: float) -> list[tuple[int, float]]:
        """Hypotheses to follow and the existence of each new surface, surest measurement first.

        A measurement's likeliest hypothesis, and a rival that has a fair share of it: the steps to come tell
        which of the two was right.

        Parameters
        ----------
        claimed : (M,)
            What the known paths send to each measurement.
        least : float
            Probability of being new below which a measurement bears nothing.
        """
        followed = []
        born = self.per_measurement(len(claimed))
        chance = born / (1 + born + claimed)
        for row in np.argsort(-chance, kind="stable"):
            if chance[row] < least:
                break
            own = np.flatnonzero(self.measurement == row)
            first, *rest = own[np.argsort(-self.ratio[own], kind="stable")].tolist()
            rival = [one for one in rest[:1] if self.ratio[one] >= RIVAL * born[row]]
            followed += [(one, float(chance[row] * self.ratio[one] / born[row])) for one in (first, *rival)]
        return followed


def partners(bank: Bank, belief: Belief, most_bounces: int) -> NDArray[np.intp]:
    """Pairs (last, first) of known surfaces with which a new one may form a path, -1 for the new, (H, 2)."""
    if most_bounces < 1:
        return np.zeros((0, 2), np.intp)
    index = slots(np.arange(len(bank)))
    variance = belief.covariance[index[:, 1], index[:, 1]]
    known = np.flatnonzero((bank.existence > 0.9) & (bank.seen >= 3) & (variance < CONVERGED_STD_M**2))
    pairs: list[tuple[int, int]] = [(-1, -1)]
    if most_bounces >= 2:
        pairs += [pair for s in known.tolist() for pair in ((-1, s), (s, -1))]
    return np.asarray(pairs, dtype=np.intp)


def propose(
    heard: Heard, belief: Belief, bank: Bank, cloud: Cloud, explained: Array, signal: SignalModel,
    births: float, radius_m: float, most_bounces: int,
) -> Births:  # fmt: skip
    """All birth hypotheses worth a look, of the measurements that carry distance and AoA.

    Surfaces are born uniformly over all lines that cross the region (angle and offset), at `births` per
    anchor and step; that measure doesn't depend on the frame. The mean over agent, distance and AoA is
    taken in a kernel; amplitude and clutter are the same for all samples.

    Parameters
    ----------
    explained : (M,)
        Ratio to clutter of the measurement's known causes.
    radius_m : float
        Of the region.
    """
    runtime.start()
    from gridslam.kernels.births import propose as launch

    known = partners(bank, belief, most_bounces)
    rows = np.flatnonzero(~np.isnan(heard.value[:, [0, 2]]).any(1))
    strength = np.where(
        np.isnan(heard.amplitude[rows]), signal.amplitude(heard.value[rows, 0], 0.5), heard.amplitude[rows]
    )
    std = deviations(heard, rows, strength, np.nan_to_num(heard.value[rows, 1:]), signal)
    # what a hypothesis could be worth at most: the AoD right on, the image next to the anchor
    level = _amplitude_factor(heard, rows, known, signal)
    common = births / (4 * np.pi * radius_m) * heard.value[rows, 0]
    most = common * level.max(1, initial=0.0) / np.sqrt(2 * np.pi) / np.minimum(std[:, 1], 2.5)
    keep = most > np.maximum(FAINT, EXPLAINED * explained[rows])
    rows, std, level, common = rows[keep], std[keep], level[keep], common[keep]
    weight = np.zeros((len(rows), len(known)))
    if weight.size:
        value = np.concatenate([np.nan_to_num(heard.value[rows]), np.minimum(std, 1e9)], 1)
        launch(
            cloud.state,
            _noise(len(known)),
            np.ascontiguousarray(value),
            known.astype(np.int32),
            np.array([*heard.place, heard.facing]),
            weight,
        )
    share = np.where((known >= 0).any(1), DOUBLE_SHARE, 1.0)
    ratio = common[:, None] * level * weight * share
    row, hypothesis = np.nonzero(ratio > np.maximum(FAINT, EXPLAINED * explained[rows])[:, None])
    measurement, last, first = rows[row], known[hypothesis, 0], known[hypothesis, 1]
    return Births(
        measurement, last, first, _lines(heard, belief, measurement, last, first), ratio[row, hypothesis]
    )


@cache
def _noise(seed: int) -> Array:
    """Standard normal noise of distance and AoA, (2, SAMPLES)."""
    return np.random.default_rng(seed).standard_normal((2, SAMPLES))


def _amplitude_factor(
    heard: Heard, rows: NDArray[np.intp], known: NDArray[np.intp], signal: SignalModel
) -> Array:
    """Amplitude's density, averaged over the unknown coefficient, over that of clutter, (M, H)."""
    factor = np.ones((len(rows), len(known)))
    loud = ~np.isnan(heard.amplitude[rows])
    for other in (1.0, USUAL_REFLECTION):
        chosen = (known >= 0).any(1) == (other < 1)
        level = signal.amplitude(heard.value[rows, :1], REFLECTION_BINS * other)
        said = np.exp(signal.log_rician(np.nan_to_num(heard.amplitude[rows], nan=1.0)[:, None], level)).mean(
            1
        )
        factor[:, chosen] = np.where(loud, said, 1.0)[:, None]
    clutter = np.log(signal.false_alarms) + signal.log_clutter(heard.amplitude[rows])
    return np.asarray(factor * np.exp(-clutter)[:, None])


def _lines(
    heard: Heard, belief: Belief, rows: NDArray[np.intp], last: NDArray[np.intp], first: NDArray[np.intp]
) -> Array:
    """Lines of the new surfaces that would explain measurements `rows`, (B, 2)."""
    lines = np.concatenate([belief.lines, np.zeros((1, 2))])
    source = np.where((first >= 0)[:, None], mirror(lines[first], heard.place), heard.place)
    image = belief.mean[:2] + heard.value[rows, :1] * unit(belief.mean[4] + heard.value[rows, 2])
    image = np.where((last >= 0)[:, None], mirror(lines[last], image), image)
    return line_between(source, image)


def draw_births(births: Births, belief: Belief, anchor: int) -> tuple[Rays, Cloud]:
    """The paths of all hypotheses at the mean of the belief, to be cast through the grid."""
    count, known = len(births), len(belief.lines)
    own = known + np.arange(count)
    rays = Rays(
        np.full(count, anchor),
        np.where((births.last >= 0) | (births.first >= 0), 2, 1),
        np.where(births.last >= 0, births.last, own),
        np.where(births.first >= 0, births.first, own),
        births.ratio,
        births.ratio,
    )
    return rays, at_mean(replace(belief, mean=np.concatenate([belief.mean, births.line.ravel()])))


def bear(births: Births, number: int, heard: Heard, belief: Belief, signal: SignalModel) -> Belief:
    """Belief with one hypothesis' surface appended, correlated with the agent, and corrected by the AoD.

    The line bends much within what an AoA of some ten degrees allows, so it is linearised at the direction of
    arrival that explains AoA and AoD best, not at the one that was measured.
    """
    row, last, first = int(births.measurement[number]), int(births.last[number]), int(births.first[number])
    known, new = max(last, first), len(belief.lines)
    value, amplitude = heard.value[row], heard.amplitude[row]
    strength = signal.amplitude(value[0], 0.5) if np.isnan(amplitude) else amplitude
    angles = np.nan_to_num(value[None, 1:])
    std = deviations(heard, np.array([row]), np.array([strength]), angles, signal)[0]
    known_line = belief.lines[known] if known >= 0 else np.zeros(2)

    def lines_of(inputs: Array, arrival: Array) -> Array:
        other = inputs[5:]
        source = mirror(other, heard.place) if first >= 0 else heard.place
        return birth_line(inputs[:3], inputs[3], arrival, source, other if last >= 0 else None)

    def line_of(inputs: Array) -> Array:
        return lines_of(inputs, inputs[4])

    def paths_over(lines: Array) -> PathGeometry:
        agents, places, others = (
            np.broadcast_to(x, (len(lines), 2)) for x in (belief.mean[:2], heard.place, known_line)
        )
        bounces = np.full(len(lines), 1 if known < 0 else 2)
        ends = (others if last >= 0 else lines), (others if first >= 0 else lines)
        return trace(agents, places, *ends, bounces)

    inputs = np.concatenate([belief.mean[[0, 1, 4]], value[[0, 2]], known_line])
    at, heard_aod = inputs.copy(), np.isfinite(std[1])
    wide = np.hypot(std[2], np.sqrt(belief.covariance[4, 4]))
    for reach in (REACH, 2 * REACH / TRIALS) if heard_aod else ():
        trials = at[4] + wide * np.linspace(-reach, reach, TRIALS)
        path = paths_over(lines_of(inputs, trials))
        misfit = np.square(wrap(trials - value[2]) / wide) + 1e3 * ~path.valid
        misfit += np.square(wrap(value[1] - path.departure + heard.facing) / std[1])
        at[4] = trials[misfit.argmin()]
    line, derivative = line_of(at), np.zeros((2, len(at)))
    for column, small in enumerate(1e-5 * np.eye(len(at))):
        change = line_of(at + small) - line_of(at - small)
        derivative[:, column] = np.array([wrap(change[0]), change[1]]) / 2e-5
    by_state = np.zeros((2, len(belief.mean)))
    by_state[:, [0, 1, 4]] = derivative[:, :3]
    if known >= 0:
        by_state[:, slots(known)] = derivative[:, 5:]
    back = derivative[:, 4] * wrap(inputs[4] - at[4])
    fresh = give_birth(belief, line + back, by_state, derivative[:, 3:5], np.square(std[[0, 2]]))
    if not heard_aod:
        return fresh
    path, jacobian = paths_over(line[None]), np.zeros((1, len(fresh.mean)))
    jacobian[0, :2] = path.jacobian[0, 1, :2]
    jacobian[0, slots(last if last >= 0 else new)] += path.jacobian[0, 1, 3:5]
    jacobian[0, slots(first if first >= 0 else new)] += path.jacobian[0, 1, 5:7]
    predicted = path.departure[0] - heard.facing + jacobian[0, slots(new)] @ back
    gap = wrap(np.array([[value[1] - predicted]]))
    return update(fresh, jacobian, gap, np.array([[std[1] ** 2]]), np.ones(1))


def birth_reflection(births: Births, number: int, heard: Heard, signal: SignalModel) -> Array:
    """First belief over the new surface's coefficient, from the amplitude alone, (BINS,)."""
    row = births.measurement[number]
    if np.isnan(heard.amplitude[row]):
        return np.full(len(REFLECTION_BINS), 1 / len(REFLECTION_BINS))
    double = births.last[number] >= 0 or births.first[number] >= 0
    other = USUAL_REFLECTION if double else 1.0
    level = signal.amplitude(heard.value[row, 0], REFLECTION_BINS * other)
    density = np.exp(signal.log_rician(heard.amplitude[None, row], level)) + 1e-6
    return np.asarray(density / density.sum())
