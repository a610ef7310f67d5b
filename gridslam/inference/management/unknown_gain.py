"""Steps at which lines of sight are fainter than the scene says, taken again: docs/model.md, (M563), (M564).

Lines of sight tell by how much a radio is fainter than stated. But one that is 3 dB fainter is taken for
none, another wall's image for what was heard, and the gain is never learned.
"""

from __future__ import annotations

import math

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import HEADING, OF_POSE
from gridslam.inference.health.monitor import SWAMPED
from gridslam.inference.management.jolts import Step
from gridslam.inference.management.poses.pose_recovery import crowd
from gridslam.inference.management.step_info import StepInfo, comparable
from gridslam.inference.messages.motion import predict_agent
from gridslam.inference.scans.anchor_measurements import AnchorScan, SplitScan, deviations, split_by_anchor
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import slant, wrap
from gridslam.world.scan import Scan

UNTOLD = 0.1
"""Deviation of the gain beyond which no line of sight has told it."""
FAINTER = 0.85
"""Gain from which on lines of sight are taken for what they are by themselves: 1.4 dB."""
NEAR = 4.0
"""Deviations of a line of sight's distance and angles within which it is one."""
KNOWN_M, KNOWN_RAD = 1.0, 0.5
"""Deviations of position and heading beyond which anything might be one."""
LIKELIER, SPREAD = 3.0, 0.5
"""Nats by which a step must be likelier with another gain; deviation of its logarithm beforehand."""
NOISE, BELIEVED = math.sqrt(0.5), 0.2
"""Deviation of an amplitude; share of the difference to 1 that the gain's deviation is at most, so that it is
believed, and used."""


NONE = 1.0, math.inf
"""Where nothing tells another gain."""


def with_gain(
    before: State, scan: Scan, model: FilterModel, work: Workspace, step: Step
) -> tuple[State, StepInfo]:
    """A step; taken again with the gain that lines of sight would have, if that explains more, (M564)."""
    state, info = step(before, scan, model, work)
    if state.calibration.loudness[1] < UNTOLD:
        return state, info
    scans = work.once(split_by_anchor, scan, model)
    gain, std = likeliest_gain(before, scan.time_s, scans, model)
    if gain > FAINTER or crowd(scans) > SWAMPED:
        return state, info
    told = replace(before, calibration=before.calibration.amplified(gain, min(std, BELIEVED * (1 - gain))))
    again, other = step(told, scan, model, work)
    more = comparable(other, again, model) - comparable(info, state, model)
    return (again, other) if more > LIKELIER + 0.5 * (math.log(gain) / SPREAD) ** 2 else (state, info)


def likeliest_gain(before: State, time_s: float, scans: SplitScan, model: FilterModel) -> tuple[float, float]:
    """Largest ratio of amplitude to what is stated, of all that may be lines of sight by their length and
    angles, and its deviation, (M563); 1 where there is none, or the pose isn't known well enough."""
    elapsed_s = 0.0 if before.time_s is None else time_s - before.time_s
    agent = predict_agent(before.belief, elapsed_s, model.settings)
    spread = agent.covariance
    if spread[0, 0] + spread[1, 1] > KNOWN_M**2 or spread[HEADING, HEADING] > KNOWN_RAD**2:
        return NONE
    return max((ratio for own in scans if len(own) for ratio in _ratios(agent, own, model)), default=NONE)


def _ratios(agent: Belief, scan: AnchorScan, model: FilterModel) -> list[tuple[float, float]]:
    """Amplitude over what is stated, and deviation, of all that may be an anchor's line of sight."""
    ahead = scan.position - agent.mean[:2]
    length = float(slant(np.hypot(*ahead), scan.height))
    if not length > 0 or not np.hypot(*ahead) > 0:
        return []
    bearing = math.atan2(ahead[1], ahead[0])
    expected = np.array([length, bearing + np.pi - scan.orientation, bearing - agent.mean[HEADING]])
    across = np.array([ahead[1], -ahead[0]]) / (ahead @ ahead)
    slope = np.array([[*(-ahead / length), 0.0], [*across, 0.0], [*across, -1.0]])
    gap = scan.value - expected
    gap[:, 1:] = wrap(gap[:, 1:])
    measured = np.isfinite(gap) & (scan.amplitude > 0)[:, None]
    rows = np.flatnonzero(measured[:, 0] & measured[:, 1:].any(1))
    noise = deviations(scan, rows, scan.amplitude[rows], scan.value[rows, 1:], model.radio)
    noise = np.where(measured[rows], noise, np.inf)
    gap = np.where(measured[rows], gap[rows], 0.0)
    spread = slope @ agent.covariance[OF_POSE] @ slope.T
    far = np.array([_squared(g, spread, std) for g, std in zip(gap, noise, strict=True)])
    rows = rows[far < NEAR**2]
    heard = np.sqrt(np.maximum(scan.amplitude[rows] ** 2 - NOISE**2, 0.0))
    unit = scan.value[rows, 0] / model.radio.amplitude_at_1m
    return list(zip((heard * unit).tolist(), (NOISE * unit).tolist(), strict=True))


def _squared(gap: Array, spread: Array, std: Array) -> float:
    """Squared distance of what was measured, of the three numbers, from what was expected."""
    known = np.isfinite(std)
    joint = spread[np.ix_(known, known)] + np.diag(std[known] ** 2)
    return float(gap[known] @ np.linalg.solve(joint, gap[known]))
