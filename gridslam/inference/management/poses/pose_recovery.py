"""Finding the agent again where the belief can't be followed; owner of the kernel that says whether it can.

A Gaussian belief follows what it can linearise. After a long silence, from a vague start, or after a turn
that the motion model doesn't know, it can't; then `pose_fix` looks for a pose that explains the scan.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT, HEADING, OF_POSE, POSE
from gridslam.inference.beliefs.streams import POSE_RECOVERY
from gridslam.inference.health.monitor import ENOUGH, MOST_LOUD, SWAMPED
from gridslam.inference.management.poses.pose_fix import Fix, find_pose, known_sources
from gridslam.inference.management.poses.scan_terms import MAP_M
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.mirrors import unweighed
from gridslam.inference.messages.path_prediction import predict_every_path
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_of
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives.tables import AOA
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap

VAGUE_M, VAGUE_RAD = 0.6, 0.4
"""Standard deviations of position and heading from which on a pose is searched for."""
FREEDOM, FREE_TURN = 10.0, 1.0
"""Times the usual acceleration, and turn in rad, that a lost agent may have made."""
BLUR, TOO_FAR = 3.0, 5.0
"""Widening of a fix; standard deviations at which it counts as a jump."""
GATE = 4.0
"""Deviations within which a measurement lies where a path is predicted."""


@timed("recovery")
def recover_pose(
    state: State, scans: Sequence[AnchorScan], earlier_s: float | None, model: FilterModel, *, work: Workspace
) -> State:
    """Where the belief can't be followed from the last step on, find the agent by the map, (M576).

    Parameters
    ----------
    earlier_s : float or None
        Time of the step before, if there was one.
    """
    count = int(np.count_nonzero(whole_of(scans).loud))
    vague = is_vague(state.belief, bool(whole_of(scans).measured[:, AOA].any()))
    if not work.recovers or state.samples is not None or (count < ENOUGH and not vague):
        return state
    if crowd(scans) > SWAMPED:  # health says so, whether the agent is looked for or not
        state = replace(state, monitor=replace(state.monitor, crowd=crowd(scans)))
    near = near_paths(scans, state, model)
    if state.monitor.is_lost(count, near):
        near = near_any_path(scans, state, model, work=work)
    lost = state.monitor.is_lost(count, near)
    if not lost:
        state = replace(state, monitor=state.monitor.followed(count, near))
    if not (lost or vague):
        return state
    images = known_sources(state, model, work=work)
    belief, now_s = state.belief, state.time_s
    if lost:
        elapsed = 0.0 if earlier_s is None or now_s is None else now_s - earlier_s
        belief = freed(belief, elapsed, model.settings.acceleration_mps2)
    state = replace(state, monitor=replace(state.monitor, crowd=crowd(scans)))
    fix = find_pose(
        belief, state.belief, images, scans, detection_table(model.radio),
        state.calibration.tuned(model.radio, 0), [work.seed, state.step, len(scans), POSE_RECOVERY],
        model.grid,
    )  # fmt: skip
    if fix is None or not fix.clear or not (fix.better or not lost):
        return replace(state, monitor=state.monitor.still_lost()) if lost else state
    monitor = state.monitor.found_again() if lost else state.monitor
    monitor = monitor.leapt(leap(belief, fix.pose, blurred(fix.covariance)))
    # anchors that aren't where they are told lead a fix astray: a belief that is as good as none isn't asked
    afresh = vague and state.mountings is not None
    after = moved(belief, fix, float(model.start_variance[2]), afresh)
    state = replace(unweighed(state) if lost else state, monitor=monitor)
    if not after.covariance[:AGENT, AGENT:].any():  # put elsewhere
        return state.placed(after)
    return state.believing(after, belief)


def near_paths(scans: Sequence[AnchorScan], state: State, model: FilterModel) -> int:
    """How many loud measurements lie where their anchor's line of sight or a single bounce is predicted."""
    belief, bank = state.belief, state.surfaces
    bank.check(belief, len(model.anchors), len(state.los))
    table = whole_of(scans).table
    claimed = np.empty(len(table), np.int32)
    _claiming()(
        belief.mean, belief.covariance, belief.layout.head, model.places, bank.existence, bank.owner, table,
        model.radio.numbers, claimed,
    )  # fmt: skip
    return int(claimed.sum())


def near_any_path(scans: Sequence[AnchorScan], state: State, model: FilterModel, *, work: Workspace) -> int:
    """As `near_paths`, and where a double bounce is predicted: some places hear little else."""
    paths = predict_every_path(state, model, work=work)
    value, spread, sender = paths.prediction.value, paths.prediction.spread, paths.rays.anchor
    variance = np.diagonal(spread, axis1=1, axis2=2)[:, None]
    claimed = 0
    for scan in scans:
        rows = np.flatnonzero(scan.loud)
        amplitude = np.nan_to_num(scan.amplitude[rows], nan=model.radio.threshold)
        std = deviations(scan, rows, amplitude, np.nan_to_num(scan.value[rows, 1:]), model.radio)
        gap = scan.value[rows] - value[:, None]
        gap[..., 1:] = wrap(gap[..., 1:])
        off = np.where(np.isfinite(std), gap**2 / (variance + np.minimum(std, 1e6) ** 2), 0.0).sum(-1)
        may = (scan.label[rows] < 0) | (scan.label[rows] == sender[:, None])
        claimed += int(np.count_nonzero((may & (off < GATE**2)).any(0)))
    return claimed


def is_vague(belief: Belief, arrives: bool) -> bool:
    """Whether the pose is known too badly to linearise paths about it.

    Parameters
    ----------
    arrives : bool
        Whether the scan has arrivals: without, nothing hangs on the heading.
    """
    x, y, _, _, heading = belief.covariance.diagonal()[:AGENT].tolist()
    return bool(x + y > VAGUE_M**2 or (arrives and heading > VAGUE_RAD**2))


def freed(belief: Belief, elapsed: float, acceleration: float) -> Belief:
    """The belief with room for a turn and a push that the motion model doesn't allow for."""
    covariance = belief.covariance.copy()
    push = np.array([0.5 * elapsed**2, elapsed])
    for axis in range(2):
        entry = np.array([axis, axis + 2])
        covariance[np.ix_(entry, entry)] += (FREEDOM * acceleration) ** 2 * np.outer(push, push)
        covariance[axis, axis] += MAP_M**2
    covariance[HEADING, HEADING] += FREE_TURN**2
    return replace(belief, covariance=covariance)


def moved(belief: Belief, fix: Fix, velocity: float, afresh: bool = False) -> Belief:
    """The belief with the agent at the fix; widened, since the scan is used once more in the step.

    Parameters
    ----------
    velocity : float
        Variance of each component (m^2/s^2) where the fix is too far off for the motion to lead there.
    afresh : bool
        Whether the motion doesn't count anyhow.
    """
    wide = blurred(fix.covariance)
    gap = fix.pose - belief.mean[POSE]
    gap[2] = wrap(gap[2])
    own = belief.covariance[OF_POSE] + wide
    if not afresh and gap @ np.linalg.solve(own, gap) < TOO_FAR**2:
        select = np.zeros((3, len(belief.mean)))
        select[range(3), POSE] = 1.0
        gain = belief.covariance @ select.T @ np.linalg.inv(own)
        mean = belief.mean + gain @ gap
        rest = np.eye(len(mean)) - gain @ select
        covariance = rest @ belief.covariance @ rest.T + gain @ wide @ gain.T
    else:
        mean, covariance = belief.mean.copy(), belief.covariance.copy()
        mean[POSE], mean[2:4] = fix.pose, 0.0
        covariance[:AGENT], covariance[:, :AGENT] = 0.0, 0.0
        covariance[OF_POSE] = wide
        covariance[2, 2] = covariance[3, 3] = velocity
    mean[HEADING] = wrap(mean[HEADING])
    return replace(belief, mean=mean, covariance=0.5 * (covariance + covariance.T))


def blurred(covariance: Array) -> Array:
    """Covariance (3, 3) of a pose that a scan told which is used once more in the step."""
    return BLUR**2 * covariance + np.diag([0.02**2, 0.02**2, 0.02**2])


def leap(belief: Belief, pose: Array, covariance: Array) -> float:
    """How far a pose (3,) is from where a belief puts the agent (m), where that is too far; else 0, (M512).

    Parameters
    ----------
    belief : Belief
        At the time of the pose, with room for what its motion may have been.
    covariance : (3, 3)
        Of the pose.
    """
    gap = pose[:2] - belief.mean[:2]
    own = belief.covariance[:2, :2] + covariance[:2, :2]
    return float(np.hypot(*gap)) if gap @ np.linalg.solve(own, gap) > TOO_FAR**2 else 0.0


def crowd(scans: Sequence[AnchorScan]) -> int:
    """Loud measurements of the anchor with most of them, if too many for all to propose poses; else 0."""
    if all(len(scan) <= MOST_LOUD for scan in scans):
        return 0
    most = max((int(np.count_nonzero(scan.loud)) for scan in scans), default=0)
    return most if most > MOST_LOUD else 0


@runtime.once_started
def _claiming() -> Any:
    """The kernel that says which measurements lie where paths are predicted."""
    from gridslam.kernels.propagation.rays import near

    return near
