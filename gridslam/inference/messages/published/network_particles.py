"""Messages of network SLAM as published: motion, association, updates.

Every agent, clock and virtual anchor by itself; likelihoods are in `network_particle_ratios`, new virtual
anchors in `network_particle_births`.

[Venus2025network], sections IV and V, with the slips mended that docs/differences.md lists; docs/model.md,
(M143) to (M145). Equations without a key are that paper's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.association import associate
from gridslam.inference.messages.published.image_particles import SUREST
from gridslam.inference.messages.published.network_particle_ratios import (
    GIVEN,
    NetworkRatios,
    blurred,
    pose_moments,
)
from gridslam.inference.messages.published.sampling import moved_agents, resampled
from gridslam.inference.state.published.network_particles import CLOCK, NetworkParticleState
from gridslam.world.geometry import wrap
from gridslam.world.network_model import NetworkModel
from gridslam.world.scan import Scan

FEW = 1e-3
"""Existence below which a virtual anchor is dropped, section VI."""


@dataclass(frozen=True, eq=False)
class NetworkMarginals:
    """What one agent's association says.

    Attributes
    ----------
    nu : (F, M)
        Messages from measurements to features.
    bracket : (F, P)
        sum_m nu_m g_m + 1 - p_d of every feature.
    claimed : (M,)
        What the features send to each measurement.
    given : (M,) int
        The anchor that each measurement is believed to be of; -1 for clutter and doubt.
    """

    nu: Array
    bracket: Array
    claimed: Array
    given: NDArray[np.intp]


def move_network(
    state: NetworkParticleState, time_s: float, scans: Sequence[Scan | None], model: NetworkModel,
    draw: np.random.Generator,
) -> NetworkParticleState:  # fmt: skip
    """Move all particles, and let virtual anchors fade, (12), (13)."""
    here = np.array([scan is not None for scan in scans])
    if state.time_s is None:
        return replace(state, time_s=time_s, here=here)
    dt, settings = time_s - state.time_s, model.settings
    agents, walk = state.agents.copy(), model.clocks.walk_m * np.sqrt(dt)
    for number, own in enumerate(model.agents):
        if here[number] and state.here[number]:
            agents[number, :, :CLOCK] = moved_agents(agents[number, :, :CLOCK], dt, own, draw)
    free = ~model.clocks.known
    anchors = len(state.clocks)
    clocks = state.clocks + walk * free[:anchors, None] * draw.standard_normal(state.clocks.shape)
    agents[:, :, CLOCK] += walk * free[anchors:, None] * draw.standard_normal(agents.shape[:2])
    known = state.features
    position = known.position + 2 * settings.surface_m * draw.standard_normal(known.position.shape)
    existence = np.minimum(settings.survival * known.existence, SUREST)
    features = replace(known, position=position, existence=existence)
    return replace(state, agents=agents, clocks=clocks, features=features, time_s=time_s, here=here)


def associate_network(seen: NetworkRatios, born: Array) -> NetworkMarginals:
    """One loopy belief propagation over all anchors' features and all measurements, (21).

    Parameters
    ----------
    born : (M, J)
        I_mj, in ratio to clutter.
    """
    beta = seen.existence[:, None] * seen.ratio.mean(-1)
    missed = np.maximum(1 - seen.existence * (1 - seen.missed), 1e-9)
    nu, claimed = associate(beta, missed, 1 + born.sum(1))
    bracket = np.einsum("fm,fmp->fp", nu, seen.ratio) + seen.missed
    share = beta * nu / (missed + (beta * nu).sum(1))[:, None]
    given = np.full(share.shape[1], -1, np.intp)
    if share.size:
        by_anchor = np.zeros((int(seen.anchor.max()) + 1, share.shape[1]))
        np.add.at(by_anchor, seen.anchor, share)
        given = np.where(by_anchor.max(0) > GIVEN, by_anchor.argmax(0), -1).astype(np.intp)
    return NetworkMarginals(nu, bracket, claimed, given)


def update_network(
    state: NetworkParticleState, agent: int, seen: NetworkRatios, found: NetworkMarginals,
    draw: np.random.Generator,
) -> NetworkParticleState:  # fmt: skip
    """Agent, clocks and virtual anchors after an agent's association, each with the others integrated out."""
    anchors, exists = len(state.clocks), seen.existence[:, None]
    agents = state.agents.copy()
    logs = np.log(exists * found.bracket + 1 - exists).sum(0)
    agents[agent] = regularised(agents[agent][resampled(logs, draw)], draw)
    clocks = state.clocks.copy()
    clock_logs = clock_messages(state, seen, found)
    for j in range(anchors):
        if np.ptp(clock_logs[j]) > 0 and np.ptp(clocks[j]) > 0:
            clocks[j] = clocks[j][draw.permutation(resampled(clock_logs[j], draw))]
    known, odds = state.features, state.features.existence * found.bracket[anchors:].mean(-1)
    own = np.einsum("fm,fmp->fp", found.nu[anchors:], seen.by_place) + seen.missed
    position = known.position.copy()
    for row in range(len(known)):
        if np.ptp(own[row]) > 0:
            position[row] = position[row][draw.permutation(resampled(np.log(own[row]), draw))]
    features = replace(known, position=position, existence=odds / (odds + 1 - known.existence))
    return replace(state, agents=agents, clocks=clocks, features=features)


def regularised(particles: Array, draw: np.random.Generator) -> Array:
    """Particles (P, D) of an agent moved apart by a Gaussian kernel, with the same mean and covariance.

    Copies of one particle would stay together where an agent's motion is all but known.
    """
    mean, covariance = pose_moments(particles)
    share = len(particles) ** (-2 / (particles.shape[1] + 4))
    off = particles - mean
    off[:, 4] = wrap(off[:, 4])
    root = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(mean)))
    return mean + np.sqrt(1 - share) * off + np.sqrt(share) * draw.standard_normal(off.shape) @ root.T


def clock_messages(state: NetworkParticleState, seen: NetworkRatios, found: NetworkMarginals) -> Array:
    """Logs of the messages to the anchors' clocks, (J, P): agent and virtual anchors integrated out."""
    count = state.clocks.shape[1]
    bracket = np.full((len(seen.anchor), count), seen.missed)
    for pair in seen.pairs:
        nu = found.nu[pair.feature, pair.measurement]
        beta = state.clocks[seen.anchor[pair.feature]]
        # the particles whose angles don't fit count in the mean, with weight 0
        mean = blurred(pair.late, pair.weight, beta, pair.std) * len(pair.at) / count
        bracket[pair.feature] += nu * mean
    exists = seen.existence[:, None]
    logs = np.zeros(state.clocks.shape)
    np.add.at(logs, seen.anchor, np.log(exists * bracket + 1 - exists))
    return logs
