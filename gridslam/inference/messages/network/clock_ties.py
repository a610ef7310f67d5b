"""Agents' clocks that hang on others' are looked at again, by lines of sight alone; docs/model.md, (M531).

What ties an agent's clock to the others' may be a reflection that stood for the line of sight of an anchor
which is hidden. Then its clock, and those of the anchors that it alone hears, are wrong together: each fits
the others, and none looks wrong by itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.messages.network.clock_evidence import sights_evidence
from gridslam.inference.messages.network.clock_setting import (
    CHALLENGE_STEPS,
    agent_clock,
    believed_offsets,
    tells_no_departure,
    without_clocks,
)
from gridslam.inference.state.network.clock_search import (
    FORGETTING,
    NARROW_M,
    NEVER,
    SET_VARIANCE,
)
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.network_model import NetworkModel
from gridslam.world.scan import Scan

MOST = 25.0
"""Nats for another clock of an agent beyond which it is set there, and the most that one look may say."""
BESIDE = 3
"""Cells within which an agent's lines of sight have to agree on its clock."""
CERTAIN_M = 0.1
"""Least deviation of a set offset, as what it may have caused is told."""


def challenge_ties(
    state: NetworkState,
    scans: Sequence[Scan | None],
    model: NetworkModel,
    *,
    works: Sequence[Workspace],
) -> NetworkState:
    """Set an agent's clock elsewhere, with those of anchors that move with it, if lines of sight say so.

    Looked at as often as anchors' clocks are. Each anchor either stays, so that the agent hears it otherwise,
    or moves with the agent's clock, so that the others do.
    """
    search = state.clocks
    later = state.step > CHALLENGE_STEPS and state.step % CHALLENGE_STEPS
    if not search.framed or later or tells_no_departure(scans):
        return state
    means, deviations = believed_offsets(state)
    evidence = dict[int, Array]()
    for agent, scan in enumerate(scans):
        if scan is not None and len(scan) and (~search.open_to(agent)).any():
            evidence[agent] = _shifts(state, agent, scan, means, deviations, model, works[agent])
    moved = np.zeros((len(scans), len(search.centre)))
    if search.moved.shape == moved.shape:
        moved = FORGETTING * search.moved
    best, choice = 0.0, None
    for agent in evidence:
        frame = search.frame_of(agent)
        others = [
            one for other, one in evidence.items() if other != agent and search.frame_of(other) == frame
        ]
        if frame == 1 + agent and not others:  # nothing ties it yet
            continue
        stay, move = _worlds(state, agent, evidence[agent], others, model)
        gain = np.where(np.abs(search.centre) > NARROW_M, np.maximum(stay, move).sum(0), 0.0)
        moved[agent] = np.maximum(moved[agent] + np.clip(gain, -MOST, MOST), 0.0)
        gain[moved[agent] <= MOST] = 0.0
        cell = int(gain.argmax())
        if gain[cell] > best:
            along = np.flatnonzero(move[:, cell] > stay[:, cell])
            best, choice = float(gain[cell]), (agent, along, float(search.centre[cell]))
    belief = state.belief
    if choice is not None:
        agent, along, later_m = choice
        entries = belief.layout.devices[[search.anchors + agent, *along]].tolist()
        belief, moved = belief.together(entries, -later_m, SET_VARIANCE), np.zeros_like(moved)
        search = search.forgotten(search.frame_of(agent))
    return replace(state, belief=belief, clocks=replace(search, moved=moved))


def _worlds(
    state: NetworkState, agent: int, own: Array, others: Sequence[Array], model: NetworkModel
) -> tuple[Array, Array]:
    """What each anchor's lines of sight say if it stays while an agent's clock is earlier, or moves along.

    (J, C) each, against what is believed; of what would be beyond a prior, as little as can be.
    """
    anchors, centre = state.clocks.anchors, state.clocks.centre
    move = sum((other[:, ::-1] for other in others), np.zeros_like(own))
    if state.clocks.frame_of(agent):  # the common part of its clocks is anything
        return own, move
    half, at = model.clocks.half_width_m, state.belief.mean[state.belief.layout.devices]
    beyond = (np.abs(at[:, None] - centre) > half[:, None] + NARROW_M) | (half[:, None] == 0)
    never = beyond[anchors + agent]
    return np.where(never, NEVER, own), np.where(never | beyond[:anchors], NEVER, move)


def _shifts(
    state: NetworkState, agent: int, scan: Scan, means: Array, deviations: Array, model: NetworkModel,
    work: Workspace,
) -> Array:  # fmt: skip
    """What an agent's line of sight of each anchor says for offsets that differ from the believed, (J, C)."""
    from scipy.ndimage import maximum_filter1d

    search = state.clocks
    own, known = search.rows(1 + agent), ~search.open_to(agent)
    bare = replace(
        state, belief=without_clocks(state.belief, known, agent_clock(state.belief, 1 + agent))
    ).part_of(agent)
    centre, mean, std = search.centre, means[own], np.maximum(deviations[own], CERTAIN_M)
    mass = np.exp(-0.5 * ((centre - mean[:, None]) / std[:, None]) ** 2)
    mass /= np.maximum(mass.sum(1, keepdims=True), 1e-300)
    evidence = sights_evidence(bare, known, mass, centre, scan, model.agents[agent], work)
    shifts = np.zeros_like(evidence)
    for anchor in np.flatnonzero(known).tolist():
        near = maximum_filter1d(evidence[anchor], 2 * BESIDE + 1, mode="nearest")
        near = np.interp(centre + mean[anchor], centre, near)
        within = np.abs(centre - mean[anchor]) <= max(NARROW_M, 4 * std[anchor])
        shifts[anchor] = near - (evidence[anchor, within].max() if within.any() else near.min())
    return shifts
