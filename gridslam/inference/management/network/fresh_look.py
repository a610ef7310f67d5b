"""A fresh look: where lines of sight alone put the agents of a network, whatever was mapped and set before.

A world in which poses, clocks and walls are wrong together fits itself, and no innovation tells. Lines of
sight do, once two anchors are in sight: their angles and amplitudes make a pose that owes nothing to map or
clocks. But what comes over one wall from anchors that lie in one line looks just so, (M546).
docs/model.md, (M492).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.inference.beliefs.streams import NETWORK_LOOK
from gridslam.inference.health.fresh_look import ANOTHER, BEYOND_ONE
from gridslam.inference.health.monitor import HealthMonitor
from gridslam.inference.management.network.recovery import FLOOR, Beacons, log_likelihood, placed_at
from gridslam.inference.management.poses.one_mirror import shown_by_mirror
from gridslam.inference.management.poses.pose_fix import COPIES, Fix, best_pose
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_scan
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import level_of, unit, wrap
from gridslam.world.network_model import NetworkModel
from gridslam.world.radio import RadioModel
from gridslam.world.scan import Scan

EVERY, BELIEVED = 5, 4.0
"""Steps from one look to the next, unless the latest left a doubt; deviations within which a pose is the
believed one."""
IN_SIGHT, UNKNOWN_M2 = 0.5, 1e4
"""Chance of a line of sight; variance of a clock of which nothing is believed."""
FAINTEST = 1.0
"""Amplitude below which none tells a distance."""


class Look(NamedTuple):
    """What lines of sight alone say at a step.

    Attributes
    ----------
    fix : Fix
        The best pose by them.
    square : float
        Its squared distance from the believed one, in deviations.
    nats : float
        Its log likelihood, above that of clutter alone.
    aside : float
        What of it remains without all anchors that one mirror may show there.
    """

    fix: Fix
    square: float
    nats: float
    aside: float

    @property
    def elsewhere(self) -> bool:
        """Whether several lines of sight, which no mirror shows together, put the agent elsewhere."""
        several = min(self.fix.gain, self.nats) >= BEYOND_ONE and self.aside >= ANOTHER
        return several and self.square >= BELIEVED**2


def look_afresh(
    state: NetworkState, scans: Sequence[Scan | None], model: NetworkModel, works: Sequence[Workspace]
) -> NetworkState:
    """Hold believed poses against lines of sight alone, and begin anew if all agents are elsewhere.

    An agent that is elsewhere while another isn't is called, and stays for `recover_agents` to find.
    """
    whole = {"aod", "aoa", "amplitude"} <= set(model.agents[0].radio.measures)
    if not (state.belief.clocks and len(model.anchor_names) > 1 and whole):
        return state
    fixes = dict[int, Fix]()
    for agent, scan in enumerate(scans):
        if scan is None:
            continue
        record = state.records[agent]
        look = record.monitor.look
        if len(scan) and (state.step % EVERY == 0 or look.agreed):
            found = _looked(state, agent, scan, model.agents[agent], work=works[agent])
            if found is not None:
                fix = found.fix
                if found.elsewhere:
                    look = look.elsewhere(fix.gain, float(fix.pose[0]), float(fix.pose[1]))
                    fixes[agent] = fix
                else:
                    look = look.here()
        state = state.recorded(agent, replace(record.monitor, look=look))
    here = [agent for agent, scan in enumerate(scans) if scan is not None]
    if state.clocks.framed:  # with no clock to go by, a look is right too seldom to act upon: health tells
        return state
    if fixes and all(agent in fixes and state.records[agent].monitor.look.called for agent in here):
        return begun_anew(state, fixes, model)
    return state


def begun_anew(state: NetworkState, fixes: dict[int, Fix], model: NetworkModel) -> NetworkState:
    """The state of a filter that begins at this step, with agents at their fixes: no map, all clocks open."""
    fresh = NetworkState.start(model)
    grid = None if state.grid is None else Grid.empty(model.agents[0].grid.shape)
    fresh = replace(
        fresh, step=state.step, time_s=state.time_s, here=state.here, labelled=state.labelled,
        next_identity=state.next_identity, grid=grid,
    )  # fmt: skip
    for agent, fix in fixes.items():
        fresh = placed_at(fresh, agent, fix, float(model.agents[agent].start_variance[2]))
        fresh = fresh.recorded(agent, HealthMonitor().found_again())
    return fresh


@timed("recovery")
def _looked(
    state: NetworkState, agent: int, scan: Scan, model: FilterModel, *, work: Workspace
) -> Look | None:  # fmt: skip
    """The best pose by lines of sight alone; None where nothing proposes any."""
    heard, part = work.once(whole_scan, scan, model), state.part(agent)
    radio, beacons = part.calibration.tuned(model.radio, 0), lines_of_sight(model)
    table, draw = detection_table(radio), np.random.default_rng([work.seed, state.step, agent, NETWORK_LOOK])

    def likelihood(poses: Array, senders: Beacons = beacons) -> Array:
        return log_likelihood(poses, senders, heard, table, radio)

    asked = sighted_poses(beacons, heard, radio, draw)
    asked = asked[model.grid.holds(asked[:, :2])]
    fix = best_pose(part.belief, part.belief, asked, likelihood, len(beacons) * len(heard), draw)
    if fix is None:
        return None
    nats = float(likelihood(fix.pose[None])[0])
    spread = float(np.sqrt(np.linalg.eigvalsh(fix.covariance[:2, :2])[-1]))
    shown = shown_by_mirror(beacons.place[:, :2], part.belief.mean[POSE], fix.pose, spread)
    alone = float(likelihood(fix.pose[None], beacons.only(shown))[0]) if shown.any() else 0.0
    gap = fix.pose - part.belief.mean[POSE]
    gap[2] = wrap(gap[2])
    own = part.belief.covariance[OF_POSE] + fix.covariance + FLOOR
    return Look(fix, float(gap @ np.linalg.solve(own, gap)), nats, nats - alone)


def lines_of_sight(model: FilterModel) -> Beacons:
    """All anchors, with clocks of which nothing is believed."""
    place = model.places[: model.senders, :4]
    count, none = len(place), np.zeros((len(place), 2))
    return Beacons(
        place[:, :2], none, np.ones(count), np.full(count, IN_SIGHT), np.arange(count), place,
        np.zeros(count), np.full(count, UNKNOWN_M2),
    )  # fmt: skip


def sighted_poses(beacons: Beacons, scan: AnchorScan, radio: RadioModel, draw: np.random.Generator) -> Array:
    """Poses (N, 3) that loud measurements stand for as lines of sight: distances by their amplitudes."""
    rows = np.flatnonzero(~np.isnan(scan.value).any(1) & scan.loud & np.isfinite(scan.amplitude))
    may = (scan.label[rows] < 0) | (scan.label[rows] == beacons.anchor[:, None])
    back = beacons.place[:, 2, None] + scan.value[rows, 1] + np.pi
    facing, poses = wrap(back - scan.value[rows, 2]), [np.zeros((0, 3))]
    for copy in range(COPIES):
        amplitude = scan.amplitude[rows] + (copy > 0) * np.sqrt(0.5) * draw.standard_normal(len(rows))
        length = radio.amplitude(1.0, 1.0) / np.maximum(amplitude, FAINTEST)
        level = level_of(np.broadcast_to(length, may.shape), beacons.place[:, 3, None])
        place = beacons.image[:, None] - level[..., None] * unit(back)
        poses.append(np.concatenate([place, facing[..., None]], -1)[may])
    return np.concatenate(poses)
