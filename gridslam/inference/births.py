"""Births: the new surface that each measurement would need (paper 002, section V-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import mirror, trace, unit, wrap
from gridslam.inference.belief import Belief, birth_line, give_birth, slots, update
from gridslam.inference.surfaces import Bank
from gridslam.measurements import Scan
from gridslam.signal import REFLECTION_BINS, SignalModel

Array = NDArray[np.float64]
CONVERGED_STD_M = 0.3


@dataclass(frozen=True)
class Candidate:
    """A new surface that would explain one measurement.

    Attributes
    ----------
    measurement : int
        Row of the scan.
    last, first : int
        Known surface hit last or first on a double bounce; -1 for the new one.
    line : (2,)
    ratio : float
        I_m: mean number of such births over that of clutter.
    corners : (4, 2) m
        Anchor, interaction points, agent of the path; the agent repeats after a single bounce.
    """

    measurement: int
    last: int
    first: int
    line: Array
    ratio: float
    corners: Array


def birth_ratios(
    scan: Scan, rows: NDArray[np.intp], belief: Belief, bank: Bank, anchor: int, place: Array, facing: float,
    signal: SignalModel, births: float, region_m2: float, most_bounces: int,
) -> list[list[Candidate]]:  # fmt: skip
    """All birth hypotheses of the measurements `rows` that carry distance and AoA, per measurement."""
    hypotheses: list[tuple[int, int]] = [(-1, -1)] if most_bounces >= 1 else []
    index = slots(np.arange(len(bank)))
    variance = belief.covariance[index[:, 1], index[:, 1]] if len(bank) else np.zeros(0)
    known = np.flatnonzero((bank.existence > 0.9) & (bank.seen >= 3) & (variance < CONVERGED_STD_M**2))
    if most_bounces >= 2:
        hypotheses += [pair for s in known for pair in ((-1, int(s)), (int(s), -1))]
    result = []
    for row in rows:
        found = []
        if not (np.isnan(scan.distance_m[row]) or np.isnan(scan.aoa_rad[row])):
            for last, first in hypotheses:
                candidate = _candidate(
                    scan, int(row), last, first, belief, anchor, place, facing, signal, births, region_m2
                )
                if candidate is not None:
                    found.append(candidate)
        result.append(found)
    return result


def _candidate(
    scan: Scan, row: int, last: int, first: int, belief: Belief, anchor: int, place: Array, facing: float,
    signal: SignalModel, births: float, region_m2: float,
) -> Candidate | None:  # fmt: skip
    agent, lines = belief.mean[[0, 1, 4]], belief.lines
    distance, arrival = scan.distance_m[row], scan.aoa_rad[row]
    source = mirror(lines[first], place) if first >= 0 else place
    after = lines[last] if last >= 0 else None
    line = birth_line(agent, distance, arrival, source, after)
    bounces = 2 if max(last, first) >= 0 else 1
    path = trace(
        agent[None, :2],
        place[None],
        (after if after is not None else line)[None],
        (lines[first] if first >= 0 else line)[None],
        np.array([bounces]),
    )
    if not path.valid[0]:
        return None
    amplitude = scan.amplitude[row]
    known = not np.isnan(amplitude)
    strength = amplitude if known else signal.amplitude(distance, 0.5)
    bound = signal.amplitude(distance, REFLECTION_BINS * (_mean(last) * _mean(first)))
    level = np.exp(signal.log_rician(np.full(len(bound), amplitude), bound)).mean() if known else 1.0
    std = signal.angle_std(np.array([strength]), path.arrival - agent[2], signal.agent_aperture)[0]
    log = -signal.log_clutter(np.array([amplitude]))[0] - np.log(signal.false_alarms)
    if not np.isnan(scan.aod_rad[row]):
        aod_std = signal.angle_std(
            np.array([strength]), path.departure - facing, signal.anchor_aperture[anchor]
        )[0]
        # the AoD predicted from the birth's own AoA: that error, and the heading's, enter with it
        total = aod_std**2 + (2 * std) ** 2 + belief.covariance[4, 4]
        gap = wrap(scan.aod_rad[row] - (path.departure[0] - facing))
        log += -0.5 * gap**2 / total - 0.5 * np.log(2 * np.pi * total)
    else:
        log -= np.log(2 * np.pi)
    image = agent[:2] + distance * unit(agent[2] + arrival)
    if after is not None:
        image = mirror(after, image)
    span = max(float(np.linalg.norm(image - source)), 1e-2)
    height = max(2 * abs(float(line[1])), 0.5)
    density = births / (4 * region_m2) * height / span  # of the image point, per m^2
    ratio = density * distance * level * float(np.exp(min(log, 600.0)))
    corners = np.stack(
        [place, path.first_point[0], path.last_point[0] if bounces == 2 else agent[:2], agent[:2]]
    )
    return Candidate(row, last, first, line, ratio if bounces == 1 else 0.5 * ratio, corners)


def _mean(surface: int) -> float:
    return 1.0 if surface < 0 else 0.7


def bear(
    candidate: Candidate,
    scan: Scan,
    belief: Belief,
    place: Array,
    facing: float,
    anchor: int,
    signal: SignalModel,
) -> Belief:
    """Belief with the candidate's surface appended, correlated with the agent, and corrected by the AoD."""
    row, known = candidate.measurement, max(candidate.last, candidate.first)
    base = np.concatenate([belief.mean[[0, 1, 4]], [scan.distance_m[row], scan.aoa_rad[row]]])
    known_line = belief.lines[known] if known >= 0 else np.zeros(2)

    def line_of(inputs: Array) -> Array:
        other = inputs[5:]
        source = mirror(other, place) if candidate.first >= 0 else place
        return birth_line(inputs[:3], inputs[3], inputs[4], source, other if candidate.last >= 0 else None)

    inputs = np.concatenate([base, known_line])
    line = line_of(inputs)
    derivative = np.zeros((2, len(inputs)))
    for column in range(len(inputs)):
        step = np.zeros(len(inputs))
        step[column] = 1e-5
        high, low = line_of(inputs + step), line_of(inputs - step)
        change = high - low
        change[0] = wrap(change[0])
        derivative[:, column] = change / 2e-5
    by_state = np.zeros((2, len(belief.mean)))
    by_state[:, [0, 1, 4]] = derivative[:, :3]
    if known >= 0:
        by_state[:, slots(known)] = derivative[:, 5:]
    amplitude = scan.amplitude[row]
    strength = np.array(
        [amplitude if not np.isnan(amplitude) else signal.amplitude(scan.distance_m[row], 0.5)]
    )
    own = [scan.distance_std_m, scan.aoa_std_rad, scan.aod_std_rad]
    fisher = [
        signal.distance_std(strength)[0],
        signal.angle_std(strength, np.array([scan.aoa_rad[row]]), signal.agent_aperture)[0],
        signal.angle_std(
            strength, np.array([np.nan_to_num(scan.aod_rad[row])]), signal.anchor_aperture[anchor]
        )[0],
    ]
    std = [f if o is None or np.isnan(o[row]) else o[row] for f, o in zip(fisher, own, strict=True)]
    belief = give_birth(belief, line, by_state, derivative[:, 3:5], np.square(std[:2]))
    if np.isnan(scan.aod_rad[row]):
        return belief
    lines, new = belief.lines, len(belief.lines) - 1
    last = candidate.last if candidate.last >= 0 else new
    first = candidate.first if candidate.first >= 0 else new
    bounces = np.array([1 if last == first else 2])
    path = trace(belief.mean[None, :2], place[None], lines[last][None], lines[first][None], bounces)
    jacobian = np.zeros((1, len(belief.mean)))
    jacobian[0, :2] = path.jacobian[0, 1, :2]
    jacobian[0, slots(last)] += path.jacobian[0, 1, 3:5]
    jacobian[0, slots(first)] += path.jacobian[0, 1, 5:7]
    gap = wrap(np.array([[scan.aod_rad[row] - (path.departure[0] - facing)]]))
    return update(belief, jacobian, gap, np.array([[std[2] ** 2]]), np.ones(1))


def birth_reflection(candidate: Candidate, scan: Scan, signal: SignalModel) -> Array:
    """First belief over the new surface's coefficient, from the amplitude alone, (BINS,)."""
    row = candidate.measurement
    amplitude = scan.amplitude[row]
    if np.isnan(amplitude):
        return np.full(len(REFLECTION_BINS), 1 / len(REFLECTION_BINS))
    level = signal.amplitude(
        scan.distance_m[row], REFLECTION_BINS * _mean(candidate.last) * _mean(candidate.first)
    )
    density = np.exp(signal.log_rician(np.full(len(level), amplitude), level)) + 1e-6
    return density / density.sum()
