"""Setting clocks: what all agents heard, as evidence about each open offset; docs/model.md, (M103)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.messages.network.clock_evidence import agent_evidence
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.network.belief import NetworkBelief
from gridslam.inference.state.network.clock_frames import frames_joined, set_nowhere, within_priors
from gridslam.inference.state.network.clock_search import NARROW_M, SET_VARIANCE, ClockSearch
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import tables
from gridslam.world.clocks import ClockModel
from gridslam.world.network_model import NetworkModel
from gridslam.world.scan import Scan

ASTRAY = 4.0
"""Deviations beyond its prior from which on a clock was set to something else."""
CHALLENGE_STEPS = 5
"""From one look at set clocks to the next; in as many first steps, each looks at them."""
EXPECTED, SILENT_SHARE, RECEIVED_SHARE, DOUBTED = 0.5, 0.2, 0.5, 12.0
"""Chance from which on a path is expected; shares of the expected paths that count as silence and as being
heard; nats of surprise by silence after which a clock is opened again."""
SURE_RAY, WITNESSES = 0.9, 2
"""Existence of a ray that was heard of late; links whose single bounces must be, of a surface that tells of
clocks where nothing says whose a measurement is."""


def set_clocks(
    state: NetworkState,
    scans: Sequence[Scan | None],
    model: NetworkModel,
    *,
    works: Sequence[Workspace],
) -> NetworkState:
    """Take in, before the agents' turns, what all of them heard about open clocks, and set the sure ones.

    An open clock stands in the belief by the moments of its histogram, independent of all else: its
    anchor's paths correct the agents by their angles.
    """
    state = challenge_clocks(state, scans, model, works=works)
    if not state.clocks.searched.any():
        return state
    search = state.clocks.updated(evidence_of(state, state.clocks.searched, scans, model, works=works))
    belief, first = state.belief, state.belief.layout.devices
    found = _possible(state, search, model.clocks).decided(tells_no_departure(scans))
    found = search.surest(found) if search.framed else found
    for row, offset in found:
        frame, anchor = divmod(row, search.anchors)
        if search.framed:  # in which agents' clocks and other frames hang together
            root = agent_clock(belief, frame)
            belief = belief.measured(int(first[anchor]), root, offset, search.mode_variance(row, offset))
            search = search.begun_anew(frame)
        else:
            belief = belief.independent(int(first[anchor]), offset, SET_VARIANCE)
        search = search.closed(row)
    state = without_turns_of(state, [row % search.anchors for row, _ in found])
    return loosened(replace(state, belief=belief, clocks=frames_joined(search)))


def without_turns_of(state: NetworkState, anchors: Sequence[int]) -> NetworkState:
    """With no turn of anchors whose clocks are set anew: it was learned by another clock, or by none."""
    if not anchors:
        return state
    known = np.isin(np.arange(state.clocks.anchors), anchors)
    return replace(
        state,
        records=tuple(
            replace(record, calibration=record.calibration.unturned(known)) for record in state.records
        ),
    )


def _possible(state: NetworkState, search: ClockSearch, clocks: ClockModel) -> ClockSearch:
    """A search without offsets that would take a clock of their frame beyond its prior, (M530)."""
    if not search.framed:
        return search
    mean, deviation = believed_offsets(state)
    room = clocks.half_width_m + ASTRAY * np.sqrt(_walked(_elapsed_s(state), clocks))
    return within_priors(search, room, mean, ASTRAY * deviation)


def agent_clock(belief: NetworkBelief, frame: int) -> int | None:
    """Entry of the clock whose frame it is; None for the common time."""
    return belief.layout.agent_clock(frame - 1) if frame else None


def tells_no_departure(scans: Sequence[Scan | None]) -> bool:
    """Whether something was heard, and no departure of it measured: then clocks have rival modes."""
    departures = [scan.aod_rad for scan in scans if scan is not None and len(scan)]
    return bool(departures) and not any(np.isfinite(angle).any() for angle in departures)


def challenge_clocks(
    state: NetworkState,
    scans: Sequence[Scan | None],
    model: NetworkModel,
    *,
    works: Sequence[Workspace],
) -> NetworkState:
    """Open a set clock again where measurements stand for another offset, as they do for an unknown one's.

    A clock that was set by too little fits itself: surfaces are born about it, and what contradicts it
    counts as clutter. One that has left its prior farther than it may have walked is opened anyhow, (M515).
    """
    fresh = ClockSearch.start(model.clocks)
    closed = fresh.unset & state.clocks.taken & ~state.clocks.unset
    later = state.step > CHALLENGE_STEPS and state.step % CHALLENGE_STEPS
    if later or not closed.any() or tells_no_departure(scans):  # rival modes are hypotheses then
        return state
    evidence = evidence_of(state, closed, scans, model, works=works)
    mean, deviation = believed_offsets(state)
    search = state.clocks.challenged(closed, evidence, mean, deviation)
    elapsed_s = _elapsed_s(state)
    for row in np.flatnonzero(closed & astray(fresh.half_widths, mean, deviation, elapsed_s, model.clocks)):
        search = search.opened(int(row), model.clocks)
    return replace(state, clocks=search)


def astray(
    half: Array, mean: Array, deviation: Array, elapsed_s: float, clocks: ClockModel
) -> NDArray[np.bool_]:
    """Which offsets are farther beyond their priors than belief and walk leave room for (R,); (M515).

    Parameters
    ----------
    half, mean, deviation : (R,) m
        Half widths of the priors; what is believed.
    elapsed_s : float
        Since the first step.
    """
    walked = _walked(elapsed_s, clocks)
    return np.asarray(np.abs(mean) - half > ASTRAY * np.sqrt(deviation**2 + walked))


def _elapsed_s(state: NetworkState) -> float:
    """Since the first step, s; infinite where nobody knows."""
    if state.time_s is None or state.began_s is None:
        return np.inf
    return state.time_s - state.began_s


def _walked(elapsed_s: float, clocks: ClockModel) -> float:
    """Variance by which a clock has walked, m^2."""
    if not np.isfinite(elapsed_s):
        return np.inf
    return clocks.walk_m**2 * elapsed_s + (clocks.drift_m * elapsed_s) ** 2


def believed_offsets(state: NetworkState) -> tuple[Array, Array]:
    """Means and deviations (R,) of the offsets of all rows, m."""
    belief, anchors = state.belief, state.clocks.anchors
    devices, means, deviations = belief.layout.devices[:anchors], list[Array](), list[Array]()
    for frame in range(1 + len(state.clocks.frame)):
        mean, variance = belief.mean[devices], np.diagonal(belief.covariance)[devices]
        root = agent_clock(belief, frame)
        if root is not None:
            both = belief.covariance[root]
            mean, variance = mean - belief.mean[root], variance + both[root] - 2 * both[devices]
        means.append(mean)
        deviations.append(np.sqrt(np.maximum(variance, 0.0)))
    return np.concatenate(means), np.concatenate(deviations)


def evidence_of(
    state: NetworkState,
    sought: NDArray[np.bool_],
    scans: Sequence[Scan | None],
    model: NetworkModel,
    *,
    works: Sequence[Workspace],
) -> Array:
    """Log evidence (R, C) of all agents' measurements about some rows' offsets (R,), as if unknown."""
    search, evidence = state.clocks, np.zeros_like(state.clocks.log)
    witnessed, mass = witnessed_surfaces(state), search.mass if search.framed else None
    for frame in range(1 + len(search.frame)):
        rows = search.rows(frame)
        own = sought[rows]
        members = [agent for agent in range(len(scans)) if search.frame_of(agent) == frame]
        if not (own.any() and members):
            continue
        whole = replace(state, belief=without_clocks(state.belief, own, agent_clock(state.belief, frame)))
        for agent in members:
            scan = scans[agent]
            if scan is not None and len(scan):
                evidence[rows] += agent_evidence(
                    whole.part_of(agent), state.part(agent), own, ~search.unset[rows], witnessed,
                    search.centre, scan, model.agents[agent], works[agent],
                    None if mass is None else np.where(own[:, None], mass[rows], 0.0),
                )  # fmt: skip
    return evidence


def without_clocks(belief: NetworkBelief, sought: NDArray[np.bool_], root: int | None) -> NetworkBelief:
    """The belief with some anchors' clocks (J,) at a frame's zero."""
    first = belief.layout.devices
    for anchor in np.flatnonzero(sought).tolist():
        entry = int(first[anchor])
        belief = belief.independent(entry, 0.0, 0.0) if root is None else belief.alike(entry, root)
    return belief


def witnessed_surfaces(state: NetworkState) -> NDArray[np.bool_]:
    """Which surfaces, (S,), are no phantoms that a path of an open clock's anchor made.

    Without labels, that path is taken for another anchor's over a wall that isn't there: one link hears it.
    """
    bank = state.surfaces
    if state.labelled or state.clocks.anchors == 1:
        return np.ones(len(bank), np.bool_)
    return np.asarray((bank.single > SURE_RAY).sum(0) >= WITNESSES)


def loosened(state: NetworkState) -> NetworkState:
    """The state with open clocks independent of all else, by the moments of their histograms, (M103)."""
    if not state.clocks.unset.any():
        return state
    belief, devices = state.belief, state.belief.layout.devices
    for anchor in np.flatnonzero(set_nowhere(state.clocks)):
        mean, variance = state.clocks.moments(int(anchor))
        belief = belief.independent(int(devices[anchor]), mean, variance)
    return replace(state, belief=belief)


def doubt_clocks(
    state: NetworkState, agent: int, exchanges: Sequence[Exchange], model: NetworkModel
) -> NetworkState:
    """Open a set clock again once all paths of its anchor fall silent to an agent, while others are heard.

    A clock that jumped is wrong while everything else looks right. What is summed is how unlikely such
    silence is by chance.
    """
    search = state.clocks
    rows = search.rows(search.frame_of(agent))
    wide = model.clocks.half_width_m[: model.clocks.anchors] > NARROW_M
    if not (wide & ~search.unset[rows]).any():
        return state
    expected, received, surprise = np.zeros((3, len(wide)))
    for exchange in exchanges:
        likely = exchange.odds[tables.THERE] > EXPECTED
        missed, sender = exchange.odds[tables.MISSED, likely], exchange.rays.anchor[likely]
        expected += np.bincount(sender, 1 - missed, len(wide))
        received += np.bincount(sender, exchange.responsible[likely].sum(1), len(wide))
        surprise += np.bincount(sender, -np.log(missed), len(wide))
    silent = (expected > 0) & (received < SILENT_SHARE * expected)
    others = received.sum() - received >= RECEIVED_SHARE * (expected.sum() - expected)
    doubt, unset = search.doubt.copy(), search.unset[rows]
    doubt[rows] = np.where(received > RECEIVED_SHARE * expected, 0.0, doubt[rows])
    doubt[rows] = np.where(silent & others & ~unset, doubt[rows] + surprise, doubt[rows])
    opened = rows.start + np.flatnonzero(wide & (doubt[rows] > DOUBTED))
    search = replace(search, doubt=doubt)
    for row in opened:
        search = search.opened(int(row), model.clocks)
    return loosened(replace(state, clocks=search))
