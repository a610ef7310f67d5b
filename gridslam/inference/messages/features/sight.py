"""Particles of agent and noise; visibility and power of the lines of sight; docs/model.md, (M133)-(M136).

[HybridSlam], section III. The power is integrated out over a grid, so that it needs no particles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from gridslam.arrays import Array
from gridslam.inference.messages.features.arrivals import Arrivals
from gridslam.inference.messages.features.feature_likelihood import Front, Tables
from gridslam.inference.messages.features.presence import APPEARS, STAYS
from gridslam.inference.state.features.features import MOVING, places
from gridslam.inference.state.features.hybrid_state import JointBelief, ParticleBelief
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
NODES, DECADES_BELOW, DECADES_ABOVE = 16, 1.5, 0.5
"""Of the grid over the line of sight's power, about what is received near the start."""
SHAPE = 100.0
"""Of the gamma densities by which powers drift: a tenth per step."""
NOISE_WITHIN = 3.0
BLUR_S = 0.1
"""Time of motion by which the agent's covariance is blurred: a particle stands for its surroundings."""
START, MOVE, RESAMPLE = 1, 2, 3
"""Purposes of random numbers."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean (4,) and covariance (4, 4) of the agent's x, y, vx, vy, and the log of the step's evidence."""

    mean: Array
    covariance: Array
    log_evidence: float
    effective: float


def rescaled(belief: JointBelief, tables: list[Tables], audible: NDArray[np.bool_]) -> JointBelief:
    """The belief before the first step in units of these samples, by the noise's power."""
    noise, bank = belief.noise.copy(), belief.features
    for j in np.flatnonzero(audible):
        noise[j] = max(np.median(_squares(tables[j])) / np.log(2), 1e-300)
    power = bank.power * (noise / belief.noise)[bank.anchor]
    return replace(belief, noise=noise, features=replace(bank, power=power))


def _squares(table: Tables) -> Array:
    """Squared matched outputs (N, T); of noise alone, they are exponential."""
    squares: Array = (table[0, :, :, :2].astype(np.float64) ** 2).sum(-1)
    return squares


def start_particles(
    belief: JointBelief, tables: list[Tables], audible: NDArray[np.bool_], model: SignalModel, seed: int
) -> ParticleBelief:
    """Particles of the prior; noise and power about what is received."""
    draw = np.random.default_rng([seed, 0, START])
    count, anchors = model.settings.particles, len(model.anchors)
    root = np.linalg.cholesky(belief.agent_covariance)
    agent = belief.mean[:MOVING] + draw.standard_normal((count, MOVING)) @ root.T
    reach = 3 * np.sqrt(np.trace(belief.agent_covariance[:2, :2]) / 2)
    level, power = belief.noise, np.ones(anchors)
    for j in np.flatnonzero(audible):
        square = _squares(tables[j])
        distance = np.linspace(0, model.waveform.folding_m, square.shape[1])
        near = np.abs(distance - np.hypot(*(model.anchors[j, :2] - belief.mean[:2]))) < reach
        power[j] = max((square.mean(0) * distance**2)[near].max(initial=0.0), level[j])
    span = np.log(NOISE_WITHIN)
    noise = level[:, None] * np.exp(draw.uniform(-span, span, (anchors, count)))
    node = power[:, None] * np.logspace(-DECADES_BELOW, DECADES_ABOVE, NODES)
    return ParticleBelief(agent, noise, np.full(anchors, 0.5), node, np.full((anchors, NODES), 1 / NODES))


def predict_particles(
    particles: ParticleBelief, seconds: float, acceleration_mps2: float, seed: int, step: int
) -> ParticleBelief:
    """Motion with white acceleration; noise and power drift, sight comes and goes, (M133)."""
    draw = np.random.default_rng([seed, step, MOVE])
    count = len(particles.agent)
    jolt = acceleration_mps2 * draw.standard_normal((count, 2))
    agent = particles.agent.copy()
    agent[:, :2] += seconds * agent[:, 2:] + 0.5 * seconds**2 * jolt
    agent[:, 2:] += seconds * jolt
    noise = particles.noise * draw.gamma(SHAPE, 1 / SHAPE, particles.noise.shape)
    there = STAYS * particles.existence
    existence = there + APPEARS * (1 - particles.existence)
    spacing = np.log(particles.node[:, 1] / particles.node[:, 0])[:, None]
    step_share = 0.5 / SHAPE / spacing**2  # a random walk over the nodes of the gamma's variance
    weight = particles.weight
    padded = np.pad(weight, ((0, 0), (1, 1)), mode="edge")
    drifted = weight + step_share * (padded[:, :-2] + padded[:, 2:] - 2 * weight)
    fresh = np.full_like(weight, 1 / weight.shape[1])
    share = (there / existence)[:, None]
    return replace(
        particles, agent=agent, noise=noise, existence=existence, weight=share * drifted + (1 - share) * fresh
    )


def feature_table(belief: JointBelief, anchor: int) -> Array:
    """Features of an anchor as kernels take them, (D, 4): x, y, extra length (m), power."""
    bank = belief.features
    rows = bank.anchor == anchor
    return np.column_stack([places(belief.mean, bank.origin_m), bank.power])[rows]


def update_particles(
    particles: ParticleBelief, belief: JointBelief, samples: Complex, tables: list[Tables],
    audible: NDArray[np.bool_], heading_rad: float, front: Front, model: SignalModel, seed: int, step: int,
    bounded: bool = False,
) -> tuple[ParticleBelief, Moments]:  # fmt: skip
    """Particles after the samples (J, N, M) of a step, with the features as they stand, (M134)-(M136).

    Parameters
    ----------
    bounded : bool
        Whether lines of sight of anchors without features are told from other paths, see `arrivals`.
    """
    count, anchors = len(particles.agent), len(audible)
    existence, weight = particles.existence.copy(), particles.weight.copy()
    log_own = np.zeros((anchors, count))
    for j in np.flatnonzero(audible):
        noise = particles.noise[j]
        points = np.column_stack([particles.agent[:, :2], np.full(count, heading_rad), noise])
        known = feature_table(belief, int(j))
        ratio, square, energy = front.ratios(points, known, model.anchors[j, :2], tables[j]).T
        absent = (
            ratio - np.vdot(samples[j], samples[j]).real / noise - samples[j].size * np.log(np.pi * noise)
        )
        if bounded and not len(known):
            came = Arrivals.of(samples[j], front)
            way = np.hypot(*(model.anchors[j, :2] - particles.agent[:, :2]).T)
            absent -= came.against(way)
            gain = came.seen(way, square / energy, particles.node[j] * energy[:, None])
        else:
            with_noise = noise[:, None] + particles.node[j] * energy[:, None]
            gain = square[:, None] * particles.node[j] / (noise[:, None] * with_noise)
            gain -= np.log(with_noise / noise[:, None])  # (P, G)
        gain += np.log(np.maximum(weight[j], 1e-300))
        seen = logsumexp(gain, axis=1)
        p = existence[j]
        log_own[j] = absent + np.logaddexp(np.log(p) + seen, np.log1p(-p))
        top = log_own[j].max()
        there = p * np.exp(absent + seen - top)
        existence[j] = np.clip(there.sum() / np.exp(log_own[j] - top).sum(), 1e-12, 1 - 1e-12)
        nodes = np.exp(gain + (absent - (absent + seen).max())[:, None]).sum(0)
        weight[j] = nodes / nodes.sum()
    total = log_own.sum(0)
    share = np.exp(total - logsumexp(total))
    mean = share @ particles.agent
    off = particles.agent - mean
    draw = np.random.default_rng([seed, step, RESAMPLE])
    agent = particles.agent[_resample(share, draw)]
    noise = particles.noise.copy()
    for j in np.flatnonzero(audible):
        own = np.exp(log_own[j] - logsumexp(log_own[j]))
        noise[j] = draw.permutation(noise[j][_resample(own, draw)])
    evidence = float(logsumexp(total) - np.log(count))
    jolt = BLUR_S * model.settings.acceleration_mps2
    blur = np.square([0.5 * BLUR_S * jolt] * 2 + [jolt] * 2)
    covariance = (share[:, None] * off).T @ off + np.diag(blur)
    moments = Moments(mean, covariance, evidence, float(1 / (share @ share)))
    return ParticleBelief(agent, noise, existence, particles.node, weight), moments


def los_power(particles: ParticleBelief) -> Array:
    """Mean power of the lines of sight, (J,)."""
    return (particles.node * particles.weight).sum(1)


def _resample(share: Array, draw: np.random.Generator) -> NDArray[np.intp]:
    """Systematic: indices by weights that sum to 1."""
    count = len(share)
    edges = np.cumsum(share)
    edges[-1] = 1.0
    return np.searchsorted(edges, (np.arange(count) + draw.uniform()) / count).clip(max=count - 1)
