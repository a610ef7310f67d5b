"""Posterior Cramer-Rao bound of several agents, their clocks and the surfaces that they share.

The recursion of `bounds` over the joint state of [Venus2025network]'s problem: all agents, all clocks that
aren't known, all lines; docs/model.md, (M105). Labels and associations count as known. Only differences of
clocks are observed, so bounds of clocks are those of apparent biases, and of offsets without what all clocks
have in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.evaluation.bounds import (
    AGENT,
    JITTER_SHARE,
    TURN_LEVER_M,
    agent_prior,
    estimable_covariance,
    predict_information,
)
from gridslam.evaluation.path_slopes import follow_hits, hit_surfaces, surface_lines, whitened_jacobian
from gridslam.simulation.network import NetworkTruth
from gridslam.world.clocks import LEAST_WALK_M, ClockModel
from gridslam.world.network_scene import clock_model
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene


@dataclass(frozen=True, eq=False)
class NetworkBound:
    """Root mean square errors that can't be beaten, over N steps.

    Attributes
    ----------
    position_m, heading_rad : (N, I)
        NaN where an agent isn't there.
    apparent_bias_s : (N,) s
        Of the differences between anchors' and agents' clocks, over all pairs.
    bias_s : (N,) s
        Of all clocks, without what they have in common.
    """

    position_m: Array
    heading_rad: Array
    apparent_bias_s: Array
    bias_s: Array


def network_bound(
    scene: Scene, truth: NetworkTruth, clocks: ClockModel | None = None, map_known: bool = False
) -> NetworkBound:
    """Bound of agents that find map and clocks as they go.

    Parameters
    ----------
    scene : Scene
    truth : NetworkTruth
    clocks : ClockModel, optional
        Another belief about the clocks than the scene's; known clocks are no part of the state.
    map_known : bool
        Whether the walls are known.
    """
    names = list(truth.agents)
    clocks = clock_model(scene, names) if clocks is None else clocks
    surface = _surfaces(scene, truth)
    state = _State(len(names), ~clocks.known, 0 if map_known else len(surface))
    times = truth.clocks.time_s
    gained = np.zeros((len(times), state.size, state.size))
    for number, name in enumerate(names):
        _add_information(gained, scene, truth, number, name, surface, state, clocks.anchors)
    information = np.zeros((state.size, state.size))
    for number, name in enumerate(names):
        own = slice(AGENT * number, AGENT * (number + 1))
        information[own, own] = agent_prior(scene, name)
    for device, entry in enumerate(state.clock):
        if entry >= 0:
            information[entry, entry] = 1 / clocks.variance[device]

    feet, line = np.zeros(len(surface)), surface_lines(scene)[surface]
    jitter = JITTER_SHARE * scene.filter.surface_m
    position, heading = np.full((2, len(times), len(names)), np.nan)
    apparent, bias = np.zeros((2, len(times)))
    there = np.array([
        (np.arange(len(times)) >= truth.first[name])
        & (np.arange(len(times)) < truth.first[name] + len(truth.agents[name].trajectory))
        for name in names
    ])  # fmt: skip
    for step in range(len(times)):
        if step:
            dt = float(times[step] - times[step - 1])
            moved = there[:, step] & there[:, step - 1]
            information = predict_information(
                information, *_motion(scene, state, dt, moved, max(clocks.walk_m, LEAST_WALK_M), jitter, feet)
            )
        information = information + gained[step]
        covariance = estimable_covariance(information)
        for number in np.flatnonzero(there[:, step]).tolist():
            x = AGENT * number
            position[step, number] = np.sqrt(covariance[x, x] + covariance[x + 1, x + 1])
            heading[step, number] = np.sqrt(covariance[x + 4, x + 4])
        apparent[step], bias[step] = _clock_bounds(covariance, state, clocks.anchors)
        for name in names:
            paths = truth.agents[name].paths
            follow_hits(feet, scene, paths.at(step - truth.first[name]), surface, line)
    return NetworkBound(position, heading, apparent, bias)


class _State:
    """Where things stand: agents, clocks that aren't known, lines."""

    def __init__(self, agents: int, unknown: NDArray[np.bool_], surfaces: int) -> None:
        self.clock = np.where(unknown, AGENT * agents + np.cumsum(unknown) - 1, -1)
        self.agents, self.surfaces = agents, surfaces
        self.lines = AGENT * agents + int(unknown.sum())
        self.size = self.lines + 2 * surfaces


def _surfaces(scene: Scene, truth: NetworkTruth) -> NDArray[np.intp]:
    """All that some agent's path hits, rising."""
    each = [hit_surfaces(scene, one.paths) for one in truth.agents.values()]
    return np.unique(np.concatenate(each))


def _add_information(
    gained: Array, scene: Scene, truth: NetworkTruth, number: int, name: str, surface: NDArray[np.intp],
    state: _State, anchors: int,
) -> None:  # fmt: skip
    """Add what each step's paths of one agent tell, to (N, state, state)."""
    paths, signal = truth.agents[name].paths, scene.signal_model(name)
    rows = whitened_jacobian(scene, name, paths, surface, truth.agents[name].trajectory)
    whole = np.zeros((len(paths), 3, state.size))
    whole[:, :, AGENT * number : AGENT * (number + 1)] = rows[:, :, :AGENT]
    if state.surfaces:
        whole[:, :, state.lines :] = rows[:, :, AGENT:]
    weight = 1 / signal.distance_std(paths.amplitude)
    sender, own = state.clock[paths.anchor], state.clock[anchors + number]
    known = np.flatnonzero(sender >= 0)
    whole[known, 0, sender[known]] = weight[known]
    if own >= 0:
        whole[:, 0, own] = -weight
    chance = signal.detection_probability(paths.amplitude)
    for row, step, share in zip(whole, paths.step + truth.first[name], chance, strict=True):
        gained[step] += share * row.T @ row


def _motion(
    scene: Scene, state: _State, dt: float, moved: NDArray[np.bool_], walk: float, jitter: float, feet: Array
) -> tuple[Array, Array, Array]:
    """Inverse transition, noise inputs and their variances; see `predict_information`."""
    backward, columns = np.eye(state.size), list[tuple[Array, float]]()

    def push(variance: float, *moves: tuple[int, float]) -> None:
        column = np.zeros(state.size)
        for entry, share in moves:
            column[entry] = share
        columns.append((column, variance))

    for number in np.flatnonzero(moved).tolist():
        x = AGENT * number
        backward[x, x + 2] = backward[x + 1, x + 3] = -dt
        for axis in (0, 1):
            push(scene.filter.acceleration_mps2**2, (x + axis, 0.5 * dt**2), (x + axis + 2, dt))
        push(float(np.radians(scene.filter.heading_deg)) ** 2, (x + 4, 1.0))
    for entry in state.clock[state.clock >= 0]:
        push(walk**2 * dt, (int(entry), 1.0))
    for s in range(state.surfaces if jitter > 0 else 0):
        angle = state.lines + 2 * s
        push((jitter / TURN_LEVER_M) ** 2, (angle, 1.0), (angle + 1, float(feet[s])))
        push(jitter**2, (angle + 1, 1.0))
    return backward, np.stack([column for column, _ in columns], 1), np.array([v for _, v in columns])


def _clock_bounds(covariance: Array, state: _State, anchors: int) -> tuple[float, float]:
    """Bounds of apparent biases and of offsets without their common part, s."""
    devices = len(state.clock)
    whole, unknown = np.zeros((devices, devices)), np.flatnonzero(state.clock >= 0)
    entries = state.clock[unknown]
    whole[np.ix_(unknown, unknown)] = covariance[np.ix_(entries, entries)]
    if not np.isfinite(whole).all():
        return np.inf, np.inf
    own = np.diag(whole)
    pairs = own[:anchors, None] + own[anchors:] - 2 * whole[:anchors, anchors:]
    rest = np.eye(devices) - 1 / devices
    mean = np.trace(rest @ whole @ rest) / devices
    return float(np.sqrt(pairs.mean())) / SPEED_OF_LIGHT, float(np.sqrt(mean)) / SPEED_OF_LIGHT
