"""Setting clocks: what all agents heard, as evidence about each open offset; docs/model.md, (M103)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.likelihood import deviations
from gridslam.inference.messages.prediction import EVERY_ANCHOR, predict_paths
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.anchor_measurements import AnchorScan, of_all_anchors
from gridslam.inference.state.clock_search import CELL_M, NARROW_M, SET_VARIANCE
from gridslam.inference.state.network_state import NetworkState
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import tables
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import lean, wrap
from gridslam.world.network_model import NetworkModel
from gridslam.world.radio import REFLECTION_BINS, RadioModel
from gridslam.world.scan import Scan

TURN_DENSITY = 1 / (2 * np.pi)
UNMEASURED = 2 * np.pi
"""Variance of an angle of residual 0 whose normal density is that of any angle at all."""
SURE_SURFACE = 0.9
"""Existence from which on a surface's single bounces tell of clocks, too."""
EXPECTED, SILENT_SHARE, HEARD_SHARE, DOUBTED = 0.5, 0.2, 0.5, 12.0
"""Chance from which on a path is expected; shares of the expected paths that count as silence and as being
heard; nats of surprise by silence after which a clock is opened again."""


def clock_evidence(
    predicted: Array, spread: Array, chance: Array, measured: Array, std: Array, clutter: float, centre: Array
) -> Array:
    """Log evidence of one agent's measurements about the offset of one anchor's clock.

    Over its paths l and the measurements m, ``sum_l log(1 - c_l + sum_m c_l N(angles of m) N(distance of m;
    d_l + beta | angles) / (mu f))``, with c the probability that path l is there and detected. The angles
    recognise the path; what they say of the pose is taken into its length.

    Parameters
    ----------
    predicted : (L, 3)
        Distance (m, without the anchor's clock), AoD and AoA (rad) of the anchor's paths.
    spread : (L, 3, 3)
        Their covariance by the belief, without that clock.
    chance : (L,)
        c.
    measured : (M, 3)
        NaN where not measured.
    std : (L, M, 3)
        Deviations, if path l caused m.
    clutter : float
        mu f: density of clutter over distance and both angles, 1 / (m rad^2).
    centre : (C,) m
        Offsets beta.

    Returns
    -------
    (C,)
    """
    total = np.zeros(len(centre))
    heard = np.flatnonzero(np.isfinite(measured[:, 0]))
    for value, own, c, deviation in zip(predicted, spread, chance, std, strict=True):
        if not c:
            continue
        residual = measured[heard] - value
        residual[:, 1:] = wrap(residual[:, 1:])
        joint = np.broadcast_to(own, (len(heard), 3, 3)).copy()
        joint += np.square(deviation[heard])[:, :, None] * np.eye(3)
        for angle in (1, 2):
            missing = ~(np.isfinite(measured[heard, angle]) & np.isfinite(deviation[heard, angle]))
            joint[missing, angle], joint[missing, :, angle] = 0.0, 0.0
            joint[missing, angle, angle], residual[missing, angle] = UNMEASURED, 0.0
        inverse = np.linalg.inv(joint[:, 1:, 1:])
        cross = np.einsum("mi,mij->mj", joint[:, 0, 1:], inverse)
        shift = (cross * residual[:, 1:]).sum(1)
        variance = joint[:, 0, 0] - (cross * joint[:, 0, 1:]).sum(1) + CELL_M**2 / 12
        exponent = np.einsum("mi,mij,mj->m", residual[:, 1:], inverse, residual[:, 1:])
        weight = TURN_DENSITY * np.sqrt(np.linalg.det(inverse)) * np.exp(-0.5 * exponent)
        far = centre[:, None] - (residual[:, 0] - shift)
        density = np.exp(-0.5 * far**2 / variance) / np.sqrt(2 * np.pi * variance)
        total += np.log(1 - c + c * (density @ weight) / clutter)
    return total


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
    if not state.clocks.unset.any():
        return state
    search, first = state.clocks, state.belief.layout.devices
    bare = state.belief
    for anchor in np.flatnonzero(search.unset).tolist():
        bare = bare.independent(int(first[anchor]), 0.0, 0.0)
    whole, evidence = replace(state, belief=bare), np.zeros_like(search.log)
    for agent, scan in enumerate(scans):
        if scan is not None and len(scan):
            evidence += _evidence(whole, agent, scan, model.agents[agent], works[agent])
    search = search.heard(evidence)
    belief = state.belief
    for anchor, offset in search.decided():
        belief, search = belief.independent(int(first[anchor]), offset, SET_VARIANCE), search.closed(anchor)
    state = replace(state, belief=belief, clocks=search)
    return loosened(state)


def loosened(state: NetworkState) -> NetworkState:
    """The state with open clocks independent of all else, by the moments of their histograms."""
    belief, devices = state.belief, state.belief.layout.devices
    for anchor in np.flatnonzero(state.clocks.unset):
        mean, variance = state.clocks.moments(int(anchor))
        belief = belief.independent(int(devices[anchor]), mean, variance)
    return state if belief is state.belief else replace(state, belief=belief)


def _evidence(state: NetworkState, agent: int, scan: Scan, model: FilterModel, work: Workspace) -> Array:
    """Log evidence (J, C) of one agent's measurements about all open clocks."""
    part, search, radio = state.part(agent), state.clocks, model.radio
    paths = predict_paths(part, EVERY_ANCHOR, model, work=work)
    rays, length, predicted = paths.rays, paths.prediction.length, paths.prediction.value
    level = np.append(part.surfaces.reflection @ REFLECTION_BINS, 1.0)[rays.last]
    amplitude = radio.amplitude(length, level)
    chance = rays.existence * rays.surfaces * radio.detection_probability(amplitude)
    sure = (rays.bounces == 0) | ((rays.bounces == 1) & (rays.surfaces > SURE_SURFACE))
    heard, total = of_all_anchors(scan, radio.threshold), np.zeros_like(search.log)
    clutter = radio.false_alarms / (radio.span_m * 4 * np.pi**2)
    for anchor in np.flatnonzero(search.unset):
        mine = np.flatnonzero(sure & (rays.anchor == anchor))
        able = (heard.label < 0) | (heard.label == anchor)
        steep = lean(length, model.anchor_heights[anchor])
        std = [_deviations(heard, amplitude[n], predicted[n, 1:], steep[n], radio)[able] for n in mine]
        if len(mine):
            total[anchor] = clock_evidence(
                predicted[mine], paths.prediction.spread[mine], chance[mine], heard.value[able],
                np.array(std), clutter, search.centre,
            )  # fmt: skip
    return total


def _deviations(heard: AnchorScan, amplitude: float, angles: Array, steep: float, radio: RadioModel) -> Array:
    """Deviations (M, 3) of all measurements, if a path of this amplitude and these angles caused them."""
    count = len(heard)
    every = np.arange(count)
    return deviations(heard, every, np.full(count, amplitude), np.tile(angles, (count, 1)), radio, steep)


def doubt_clocks(state: NetworkState, exchanges: Sequence[Exchange], model: NetworkModel) -> NetworkState:
    """Open a set clock again once all paths of its anchor fall silent to an agent, while others are heard.

    A clock that jumped is wrong while everything else looks right. What is summed is how unlikely such
    silence is by chance.
    """
    search = state.clocks
    wide = model.clocks.half_width_m[: model.clocks.anchors] > NARROW_M
    if not (wide & ~search.unset).any():
        return state
    expected, received, surprise = np.zeros((3, len(wide)))
    for exchange in exchanges:
        there, missed = exchange.odds[tables.THERE], exchange.odds[tables.MISSED]
        likely = there > EXPECTED
        sender = exchange.rays.anchor[likely]
        np.add.at(expected, sender, 1 - missed[likely])
        np.add.at(received, sender, exchange.responsible[likely].sum(1))
        np.add.at(surprise, sender, -np.log(missed[likely]))
    silent = (expected > 0) & (received < SILENT_SHARE * expected)
    others = received.sum() - received >= HEARD_SHARE * (expected.sum() - expected)
    doubt = np.where(received > HEARD_SHARE * expected, 0.0, search.doubt)
    doubt = np.where(silent & others & ~search.unset, doubt + surprise, doubt)
    search = replace(search, doubt=doubt)
    for anchor in np.flatnonzero(wide & (doubt > DOUBTED)):
        search = search.opened(int(anchor), model.clocks)
    return loosened(replace(state, clocks=search))
