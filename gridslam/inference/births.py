"""Births: the new surfaces that measurements need, and how they join the belief (paper 002, section V-B)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import course, mirror, trace, wrap
from gridslam.inference.belief import Belief, birth_line, give_birth, slots, update
from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import deviations
from gridslam.kernels import USUAL_REFLECTION
from gridslam.signal import REFLECTION_BINS, SignalModel

Array = NDArray[np.float64]
RIVAL = 0.2
"""Share of a measurement's births from which on the second likeliest is followed, too."""
REACH, TRIALS = 4.0, 41
"""Deviations and number of directions of arrival that are tried for a new line, coarse and then fine."""


@dataclass(frozen=True)
class Births:
    """Hypotheses of new surfaces, one or more per measurement.

    Attributes
    ----------
    measurement : (B,) int32
    hit : (B, 2) int32
        Known surface hit last or first on a double bounce; -1 for the new one.
    line : (B, 2)
    ratio : (B,)
        I: mean number of such births over that of clutter, weighed by V of their paths.
    """

    measurement: NDArray[np.int32]
    hit: NDArray[np.int32]
    line: Array
    ratio: Array

    def __len__(self) -> int:
        return len(self.ratio)

    @classmethod
    @cache
    def none(cls) -> Births:
        """No hypotheses."""
        return cls(np.zeros(0, np.int32), np.zeros((0, 2), np.int32), np.zeros((0, 2)), np.zeros(0))

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
        followed: list[tuple[int, float]] = []
        if not len(self):
            return followed
        own: dict[int, list[tuple[float, int]]] = {}
        for one, (m, ratio) in enumerate(zip(self.measurement.tolist(), self.ratio.tolist(), strict=True)):
            own.setdefault(m, []).append((ratio, one))
        claims, ranked = claimed.tolist(), []
        for m, those in own.items():
            born = sum(ratio for ratio, _ in those)
            ranked.append((born / (1 + born + claims[m]), born, those))
        for chance, born, those in sorted(ranked, key=lambda row: -row[0]):
            if chance < least or not born:
                break
            likeliest = sorted(those, key=lambda pair: -pair[0])[:2]
            followed += [
                (one, chance * ratio / born)
                for place, (ratio, one) in enumerate(likeliest)
                if place == 0 or ratio >= RIVAL * born
            ]
        return followed


def bear(births: Births, number: int, heard: Heard, belief: Belief, signal: SignalModel) -> Belief:
    """Belief with one hypothesis' surface appended, correlated with the agent, and corrected by the AoD.

    The line bends much within what an AoA of some ten degrees allows, so it is linearised at the direction of
    arrival that explains AoA and AoD best, not at the one that was measured.
    """
    row, (last, first) = int(births.measurement[number]), births.hit[number].tolist()
    known, new = max(last, first), len(belief.lines)
    value, amplitude = heard.value[row], heard.amplitude[row]
    strength = signal.amplitude(value[0], 0.5) if np.isnan(amplitude) else amplitude
    angles = np.nan_to_num(value[None, 1:])
    std = deviations(heard, np.array([row]), np.array([strength]), angles, signal)[0]
    known_line = belief.lines[known] if known >= 0 else np.zeros(2)

    def lines_of(inputs: Array) -> Array:
        """Lines (n, 2) by x, y, heading, distance, AoA, and the known line, (n, 7)."""
        other = inputs[:, 5:]
        source = mirror(other, heard.place) if first >= 0 else np.broadcast_to(heard.place, other.shape)
        after = other if last >= 0 else None
        return birth_line(inputs[:, :3], inputs[:, 3], inputs[:, 4], source, after)

    def ends_over(lines: Array) -> tuple[Array, Array, Array, Array, NDArray[np.intp]]:
        agents, places, others = (
            np.broadcast_to(x, (len(lines), 2)) for x in (belief.mean[:2], heard.place, known_line)
        )
        bounces = np.full(len(lines), 1 if known < 0 else 2)
        return agents, places, (others if last >= 0 else lines), (others if first >= 0 else lines), bounces

    inputs = np.concatenate([belief.mean[[0, 1, 4]], value[[0, 2]], known_line])
    at, heard_aod = inputs.copy(), np.isfinite(std[1])
    wide = np.hypot(std[2], np.sqrt(belief.covariance[4, 4]))
    for reach in (REACH, 2 * REACH / TRIALS) if heard_aod else ():
        trials = np.tile(at, (TRIALS, 1))
        trials[:, 4] += wide * np.linspace(-reach, reach, TRIALS)
        path = course(*ends_over(lines_of(trials)))
        misfit = np.square(wrap(trials[:, 4] - value[2]) / wide) + 1e3 * ~path.valid
        misfit += np.square(wrap(value[1] - path.departure + heard.facing) / std[1])
        at[4] = trials[misfit.argmin(), 4]
    small = 1e-5 * np.eye(len(at))
    line, *around = np.split(lines_of(np.concatenate([at[None], at + small, at - small])), [1, 1 + len(at)])
    change = around[0] - around[1]
    derivative = np.stack([wrap(change[:, 0]), change[:, 1]]) / 2e-5
    by_state = np.zeros((2, len(belief.mean)))
    by_state[:, [0, 1, 4]] = derivative[:, :3]
    if known >= 0:
        by_state[:, slots(known)] = derivative[:, 5:]
    back = derivative[:, 4] * wrap(inputs[4] - at[4])
    fresh = give_birth(belief, line[0] + back, by_state, derivative[:, 3:5], np.square(std[[0, 2]]))
    if not heard_aod:
        return fresh
    traced, jacobian = trace(*ends_over(line)), np.zeros((1, len(fresh.mean)))
    jacobian[0, :2] = traced.jacobian[0, 1, :2]
    jacobian[0, slots(last if last >= 0 else new)] += traced.jacobian[0, 1, 3:5]
    jacobian[0, slots(first if first >= 0 else new)] += traced.jacobian[0, 1, 5:7]
    predicted = traced.departure[0] - heard.facing + jacobian[0, slots(new)] @ back
    gap = wrap(np.array([[value[1] - predicted]]))
    return update(fresh, jacobian, gap, np.array([[std[1] ** 2]]), np.ones(1))


def birth_reflection(births: Births, number: int, heard: Heard, signal: SignalModel) -> Array:
    """First belief over the new surface's coefficient, from the amplitude alone, (BINS,)."""
    row = births.measurement[number]
    if np.isnan(heard.amplitude[row]):
        return np.full(len(REFLECTION_BINS), 1 / len(REFLECTION_BINS))
    other = USUAL_REFLECTION if births.hit[number].max() >= 0 else 1.0
    level = signal.amplitude(heard.value[row, 0], REFLECTION_BINS * other)
    density = np.exp(signal.log_rician(heard.amplitude[None, row], level)) + 1e-6
    return np.asarray(density / density.sum())
