"""Steps at which lines of sight are fainter than the scene says, taken again: docs/model.md, (M563), (M564).

Lines of sight tell by how much a radio is fainter than stated. But one that is 3 dB fainter is taken for
none, another wall's image for what was heard, and the gain is never learned.
"""

from __future__ import annotations

import math

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.calibration import BEYOND_DOUBT, LEAST_GAIN, Calibration
from gridslam.inference.beliefs.layout import HEADING, OF_POSE
from gridslam.inference.health.monitor import SWAMPED
from gridslam.inference.management.jolts import Step
from gridslam.inference.management.poses.pose_recovery import crowd
from gridslam.inference.management.step_info import StepInfo, comparable
from gridslam.inference.messages.motion import predict_agent
from gridslam.inference.scans.anchor_measurements import AnchorScan, SplitScan, split_by_anchor
from gridslam.inference.scans.deviations import deviations
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
"""Deviations of position (over both axes) and heading beyond which anything might be one."""
LIKELIER, SPREAD = 3.0, 0.5
"""Nats by which a step must be likelier with another gain; deviation of its logarithm beforehand."""
NOISE = math.sqrt(0.5)
"""Deviation of an amplitude."""
BELIEVED = 0.9 / BEYOND_DOUBT
"""Share of its difference to 1 that a gain's deviation is at most: one that is in doubt isn't used."""
LEAST_M, NOT_MEASURED = 1e-3, 1e12
"""Distance from an anchor below which it has no direction; variance of a number that wasn't measured."""
NONE = 1.0, math.inf
"""A gain and its deviation where nothing tells another one."""


def with_likeliest_gain(
    before: State, scan: Scan, model: FilterModel, work: Workspace, step: Step
) -> tuple[State, StepInfo]:
    """A step; taken again with the gain that lines of sight would have, if that explains more, (M564)."""
    state, info = step(before, scan, model, work)
    if is_told(state.calibration):
        return state, info
    scans = work.once(split_by_anchor, scan, model)
    gain, std = likeliest_gain(before, scan.time_s, scans, model)
    if gain > FAINTER or crowd(scans) > SWAMPED:
        return state, info
    told = replace(before, calibration=before.calibration.amplified(gain, min(std, BELIEVED * (1 - gain))))
    again, other = step(told, scan, model, work)
    more = comparable(other, again, model) - comparable(info, state, model)
    return (again, other) if more > LIKELIER + 0.5 * (math.log(gain) / SPREAD) ** 2 else (state, info)


def is_told(calibration: Calibration) -> bool:
    """Whether lines of sight have told the gain: one that was half believed may leave it in doubt."""
    ratio, std = calibration.loudness
    return std < UNTOLD and (calibration.gain != 1 or ratio > FAINTER)


def likeliest_gain(before: State, time_s: float, scans: SplitScan, model: FilterModel) -> tuple[float, float]:
    """Largest ratio of amplitude to what is stated, of all that may be lines of sight by their length and
    angles, and its deviation, (M563); `NONE` where there is none, or the pose isn't known well enough."""
    if not (scans.whole.amplitude > 0).any():
        return NONE
    elapsed_s = 0.0 if before.time_s is None else time_s - before.time_s
    agent = predict_agent(before.belief, elapsed_s, model.settings)
    known = agent.covariance
    if known[0, 0] + known[1, 1] > KNOWN_M**2 or known[HEADING, HEADING] > KNOWN_RAD**2:
        return NONE
    return max((ratio for own in scans if len(own) for ratio in _ratios(agent, own, model)), default=NONE)


def _ratios(agent: Belief, scan: AnchorScan, model: FilterModel) -> list[tuple[float, float]]:
    """Amplitude over what is stated, and deviation, of all that may be an anchor's line of sight."""
    ahead = scan.position - agent.mean[:2]
    length = float(slant(np.hypot(*ahead), scan.height))
    if np.hypot(*ahead) < LEAST_M:
        return []
    bearing = math.atan2(ahead[1], ahead[0])
    expected = np.array([length, bearing + np.pi - scan.orientation, bearing - agent.mean[HEADING]])
    across = np.array([ahead[1], -ahead[0]]) / (ahead @ ahead)
    slope = np.array([[*(-ahead / length), 0.0], [*across, 0.0], [*across, -1.0]])
    gap = scan.value - expected
    gap[:, 1:] = wrap(gap[:, 1:])
    measured = np.isfinite(gap)
    heard = np.where(scan.amplitude > NOISE, scan.amplitude, 0.0)
    unit = scan.value[:, 0] / model.radio.amplitude_at_1m
    ratio = np.sqrt(np.maximum(heard**2 - NOISE**2, 0.0)) * unit
    rows = np.flatnonzero(measured[:, 0] & measured[:, 1:].any(1) & (ratio > LEAST_GAIN))
    noise = deviations(scan, rows, scan.amplitude[rows], scan.value[rows, 1:], model.radio)
    variance = np.where(measured[rows] & np.isfinite(noise), noise**2, NOT_MEASURED)
    gap = np.where(variance < NOT_MEASURED, gap[rows], 0.0)
    joint = slope @ agent.covariance[OF_POSE] @ slope.T + variance[:, :, None] * np.eye(3)
    squared = (gap * np.linalg.solve(joint, gap[:, :, None])[:, :, 0]).sum(1)
    near = rows[squared < NEAR**2]
    return list(zip(ratio[near].tolist(), (NOISE * unit[near]).tolist(), strict=True))
