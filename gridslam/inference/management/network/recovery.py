"""Finding an agent of a network again, where clocks are unknown or nothing says whose a measurement is.

As `pose_recovery`, but that each measurement may be of any anchor whose clock is set, and its distance is as
much longer as that clock is believed to be ahead of the agent's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.layout import AGENT, POSE
from gridslam.inference.beliefs.streams import POSE_RECOVERY
from gridslam.inference.health.early_watch import EARLY
from gridslam.inference.management.poses.pose_fix import COPIES, Fix, best_pose, known_sources
from gridslam.inference.management.poses.pose_recovery import (
    freed,
    is_vague,
    near_any_path,
    near_paths,
)
from gridslam.inference.management.poses.scan_terms import ScanTerms, loudest_rows
from gridslam.inference.messages.amplitudes import DetectionTable, detection_table
from gridslam.inference.messages.mirrors import unweighed_bank
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_scan
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives.tables import AOA
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import direction, level_of, slant, unit, wrap
from gridslam.world.network_model import NetworkModel
from gridslam.world.radio import RadioModel
from gridslam.world.scan import Scan

FLOOR = np.diag([0.05**2, 0.05**2, 0.03**2])
"""What is added to a fix's covariance: the scan is used once more in the step."""
BLUR = 3.0
"""Widening of a fix."""


@dataclass(frozen=True, eq=False)
class Beacons:
    """Where the paths of all anchors with set clocks seem to come from, L of them.

    Attributes
    ----------
    image, line : (L, 2)
        As of `Sources`.
    level, chance : (L,)
    anchor : (L,) int
    place : (L, 4)
        Of the anchor: x, y (m), orientation (rad), height (m).
    shift, variance : (L,) m, m^2
        By which its distances are longer than they should be, as believed.
    """

    image: Array
    line: Array
    level: Array
    chance: Array
    anchor: NDArray[np.intp]
    place: Array
    shift: Array
    variance: Array

    @classmethod
    def of(cls, state: State, unset: NDArray[np.bool_], model: FilterModel, work: Workspace) -> Beacons:
        """Lines of sight and single bounces, by an agent's view."""
        known = known_sources(state, model, work=work)
        anchor = np.repeat(np.arange(len(known)), [len(own.image) for own in known])
        image, line, level, chance = (
            np.concatenate([getattr(own, name) for own in known])
            for name in ("image", "line", "level", "chance")
        )
        late, doubt = np.zeros(len(known)), np.zeros(len(known))
        if state.belief.clocks:
            clocks = slice(AGENT, AGENT + state.belief.clocks)
            late, doubt = state.belief.mean[clocks], np.diagonal(state.belief.covariance)[clocks]
        keep = ~unset[anchor]
        anchor = anchor[keep]
        return cls(
            image[keep], line[keep], level[keep], chance[keep], anchor, model.places[anchor, :4],
            late[anchor], doubt[anchor],
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.anchor)

    def only(self, keep: NDArray[np.bool_]) -> Beacons:
        """Some of them, (L,) bool."""
        return Beacons(**{field.name: getattr(self, field.name)[keep] for field in fields(self)})

    @property
    def straight(self) -> NDArray[np.bool_]:
        """Which are lines of sight, (L,) bool."""
        return np.asarray((self.image == self.place[:, :2]).all(1))


def recover_agents(
    state: NetworkState, scans: Sequence[Scan | None], earlier_s: float | None, model: NetworkModel,
    works: Sequence[Workspace],
) -> NetworkState:  # fmt: skip
    """Find agents again that can't be followed from the last step on, by what all others have mapped.

    With known clocks and labels each does so in its own turn, see `pose_recovery`.
    """
    if state.labelled and not state.belief.clocks:
        return state
    for agent, scan in enumerate(scans):
        if scan is not None and len(scan):
            state = _recovered(state, agent, scan, earlier_s, model.agents[agent], work=works[agent])
    return state


@timed("recovery")
def _recovered(
    state: NetworkState, agent: int, scan: Scan, earlier_s: float | None, model: FilterModel, *,
    work: Workspace,
) -> NetworkState:  # fmt: skip
    anchor_scan, part = work.once(whole_scan, scan, model), state.part(agent)
    count, near = int(np.count_nonzero(anchor_scan.loud)), near_paths([anchor_scan], part, model)
    if part.monitor.is_lost(count, near):
        near = near_any_path([anchor_scan], part, model, work=work)
    vague = is_vague(part.belief, bool(anchor_scan.measured[:, AOA].any()))
    lost = part.monitor.is_lost(count, near) or part.monitor.early > EARLY  # (M532)
    if not lost:
        part = replace(part, monitor=part.monitor.followed(count, near))
        if not vague:
            return state.recorded(agent, part.monitor)
    beacons = Beacons.of(part, state.clocks.open_to(agent), model, work)
    unfound = part.monitor.still_lost() if lost else part.monitor
    if len(np.unique(beacons.anchor)) < min(2, state.clocks.anchors):
        return state.recorded(agent, unfound)
    belief, now_s = part.belief, part.time_s
    if lost:
        elapsed = 0.0 if earlier_s is None or now_s is None else now_s - earlier_s
        belief = freed(belief, elapsed, model.settings.acceleration_mps2)
    radio = part.calibration.tuned(model.radio, 0)
    table, draw = detection_table(radio), np.random.default_rng([work.seed, state.step, agent, POSE_RECOVERY])
    asked = proposed_poses(beacons, anchor_scan, radio, draw)
    asked = asked[model.grid.holds(asked[:, :2])]
    fix = best_pose(
        belief, part.belief, asked,
        lambda poses: log_likelihood(poses, beacons, anchor_scan, table, radio),
        len(beacons) * len(anchor_scan), draw,
    )  # fmt: skip
    if fix is None or not fix.clear or not (fix.better or not lost):
        return state.recorded(agent, unfound)
    state = state.recorded(agent, part.monitor.found_again() if lost else part.monitor)
    if lost:
        state = replace(state, surfaces=unweighed_bank(state.surfaces))
    return placed_at(state, agent, fix, float(model.start_variance[2]))


def placed_at(state: NetworkState, agent: int, fix: Fix, velocity: float) -> NetworkState:
    """The state with an agent at a fix, independent of all else: what it believed teaches nothing.

    Parameters
    ----------
    velocity : float
        Variance of each component, m^2/s^2.
    """
    belief = state.belief
    rows = belief.layout.pose(agent).start + np.arange(AGENT)
    blurred = BLUR**2 * fix.covariance + FLOOR
    for row, value, variance in zip(rows.tolist(), (*fix.pose[:2], 0.0, 0.0, wrap(fix.pose[2])),
                                    (1.0, 1.0, velocity, velocity, 1.0), strict=True):  # fmt: skip
        belief = belief.independent(row, float(value), variance)
    covariance = belief.covariance.copy()
    covariance[np.ix_(rows[POSE], rows[POSE])] = blurred
    return replace(state, belief=replace(belief, covariance=covariance))


def proposed_poses(beacons: Beacons, scan: AnchorScan, radio: RadioModel, draw: np.random.Generator) -> Array:
    """Poses (N, 3) that the loud measurements stand for, had they come from any of the beacons."""
    rows, std = loudest_rows(scan, radio)
    if not len(rows) or not len(beacons):
        return np.zeros((0, 3))
    may = (scan.label[rows] < 0) | (scan.label[rows] == beacons.anchor[:, None])
    poses = []
    for copy in range(COPIES):
        value = scan.value[rows] + (copy > 0) * std * draw.standard_normal((len(rows), 3))
        leaving = beacons.place[:, 2, None] + value[:, 1]
        turned = 2 * beacons.line[:, 0, None] - leaving
        back = np.where(beacons.straight[:, None], leaving + np.pi, turned)
        length = value[:, 0] - beacons.shift[:, None]
        allowed = may & (length > 0)
        level = level_of(np.maximum(length, 0.0), beacons.place[:, 3, None])
        place = beacons.image[:, None] - level[..., None] * unit(back)
        poses.append(np.concatenate([place, wrap(back - value[:, 2])[..., None]], -1)[allowed])
    return np.concatenate(poses)


def log_likelihood(
    poses: Array, beacons: Beacons, scan: AnchorScan, table: DetectionTable, radio: RadioModel
) -> Array:
    """Log-likelihood (N,) of all measurements at poses (N, 3), relative to clutter alone."""
    straight, (place, facing, height) = beacons.straight, (beacons.place[:, :2], *beacons.place[:, 2:].T)
    back = direction(poses[:, None, :2], beacons.image[None])
    apart = np.linalg.norm(poses[:, None, :2] - beacons.image[None], axis=-1)
    distance = slant(apart, height)
    leaving = np.where(straight, back + np.pi, 2 * beacons.line[:, 0] - back) - facing
    normal, offset = unit(beacons.line[:, 0]), beacons.line[:, 1]
    sides = (poses[:, :2] @ normal.T - offset) * ((normal * place).sum(1) - offset)
    there = beacons.chance * (straight | (sides > 0))
    strength = radio.amplitude(distance, beacons.level)
    log = -(there * table(strength)).sum(1)
    terms = ScanTerms.of(scan, radio)
    measured, flat = terms.measured, terms.flat
    wide = terms.variance[None] + beacons.variance[:, None, None] * np.array([1.0, 0.0, 0.0])
    square = np.where(measured, -2 * np.log(flat / np.sqrt(2 * np.pi * wide)), 0.0).sum(-1)[None]
    predicted = (distance + beacons.shift, leaving, back - poses[:, 2, None])
    for axis, value in enumerate(predicted):
        gap = scan.value[:, axis] - value[..., None]
        gap = gap if axis == 0 else wrap(gap)
        square = square + np.where(measured[:, axis], gap**2 / wide[..., axis], 0.0)
    square = square + terms.misfit(strength)
    ratio = np.exp(np.minimum(terms.tail - np.log(radio.false_alarms) - 0.5 * square, 60.0))
    may = (scan.label < 0) | (scan.label == beacons.anchor[:, None])
    return np.asarray(log + np.log1p((there[..., None] * may * ratio).sum(1)).sum(1))
