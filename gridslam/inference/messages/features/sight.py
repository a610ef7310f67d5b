"""Particles of agent and noise; visibility and power of the lines of sight; docs/model.md, (M133)-(M136).

[HybridSlam], section III. The power is integrated out over a grid, so that it needs no particles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from gridslam.arrays import Array
from gridslam.inference.messages.features.arrivals import COST, Arrivals
from gridslam.inference.messages.features.feature_likelihood import Front, Tables
from gridslam.inference.messages.features.presence import APPEARS, STAYS
from gridslam.inference.messages.samples.noise_levels import median_noise
from gridslam.inference.state.features.features import MOVING, places
from gridslam.inference.state.features.hybrid_state import JointBelief, ParticleBelief
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
NODES, DECADES_BELOW, DECADES_ABOVE = 16, 1.5, 0.5
"""Of the grid over the line of sight's power, about that of the loudest path, at 1 m: none is louder."""
SHAPE = 100.0
"""Of the gamma densities by which powers drift: a tenth per step."""
NOISE_WITHIN = 3.0
BLUR_S = 0.1
"""Time of motion by which the agent's covariance is blurred: a particle stands for its surroundings."""
START, MOVE, RESAMPLE, NARROW = 1, 2, 3, 4
"""Purposes of random numbers."""
ENOUGH, KEPT, NARROWED, WIDER = 0.03, 0.1, 12, 1.5
"""Share of the particles that has to count; of those that do when others are drawn about them; how many times
at most; and their variance, in that of the ones that count."""
LEAST_VARIANCE, HALVINGS = 1e-8, 30
"""Of a Gaussian of particles, m^2; rounds in which a power of weights is found."""


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
        noise[j] = max(median_noise(_squares(tables[j])), 1e-300)
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
    level, power = belief.noise, np.ones(anchors)
    for j in np.flatnonzero(audible):
        square = _squares(tables[j])
        over = square.mean(0) / level[j]
        heard = len(square) * (over - 1 - np.log(np.maximum(over, 1))) > COST
        distance = np.linspace(0, model.waveform.folding_m, square.shape[1])
        power[j] = level[j] * (over * distance**2)[heard].max(initial=1.0)
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
    bounded: bool = False, before: Sequence[Complex | None] = (),
) -> tuple[ParticleBelief, Moments]:  # fmt: skip
    """Particles after the samples (J, N, M) of a step, with the features as they stand, (M134)-(M136).

    Parameters
    ----------
    bounded : bool
        Whether lines of sight of anchors without features are told from other paths, see `arrivals`, and
        particles are drawn again where too few carry the weight; the references do neither.
    before : sequence of J (N, M), optional
        Samples of the step before; None of an anchor that wasn't heard.
    """
    heard = [int(j) for j in np.flatnonzero(audible)]
    came = {j: Arrivals.of(samples[j], front, before[j] if before else None) for j in heard if bounded}

    def evaluate(cloud: ParticleBelief) -> list[Received]:
        return [
            _received(cloud, j, belief, samples[j], tables[j], heading_rad, front, model, came.get(j))
            for j in heard
        ]

    if bounded:
        particles, base, found = concentrated(particles, heard, evaluate, seed, step)
    else:
        base, found = np.zeros(len(particles.agent)), evaluate(particles)
    agent = particles.agent
    existence, weight, noise = particles.existence.copy(), particles.weight.copy(), particles.noise.copy()
    draw, count = np.random.default_rng([seed, step, RESAMPLE]), len(agent)
    total = base + sum(one.log_own for one in found)
    share = _tempered(total, ENOUGH * count) if bounded else np.exp(total - logsumexp(total))
    mean = share @ agent
    off = agent - mean
    chosen = agent[_resample(share, draw)]
    for j, one in zip(heard, found, strict=True):
        own = base + one.log_own
        existence[j] = np.exp(logsumexp(base + one.log_seen) - logsumexp(own)).clip(1e-12, 1 - 1e-12)
        nodes = one.gain + (base + one.absent)[:, None]
        nodes = np.exp(nodes - nodes.max()).sum(0)
        weight[j] = nodes / nodes.sum()
        noise[j] = draw.permutation(noise[j][_resample(np.exp(own - logsumexp(own)), draw)])
    evidence = float(logsumexp(total) - np.log(count))
    jolt = BLUR_S * model.settings.acceleration_mps2
    blur = np.square([0.5 * BLUR_S * jolt] * 2 + [jolt] * 2)
    covariance = (share[:, None] * off).T @ off + np.diag(blur)
    moments = Moments(mean, covariance, evidence, float(1 / (share @ share)))
    return ParticleBelief(chosen, noise, existence, particles.node, weight), moments


@dataclass(frozen=True, eq=False)
class Received:
    """What one anchor's samples say of every particle.

    Attributes
    ----------
    absent : (P,)
        Log density of the samples without a line of sight.
    gain : (P, G)
        What one of each power adds, and its weight.
    log_seen, log_own : (P,)
        Log density with a line of sight, times its probability, and with or without one.
    """

    absent: Array
    gain: Array
    log_seen: Array
    log_own: Array


def _received(
    particles: ParticleBelief, anchor: int, belief: JointBelief, samples: Complex, table: Tables,
    heading_rad: float, front: Front, model: SignalModel, came: Arrivals | None,
) -> Received:  # fmt: skip
    """What one anchor's samples (N, M) say of every particle, with and without a line of sight."""
    agent, noise, node = particles.agent, particles.noise[anchor], particles.node[anchor]
    points = np.column_stack([agent[:, :2], np.full(len(agent), heading_rad), noise])
    known = feature_table(belief, anchor)
    ratio, square, energy = front.ratios(points, known, model.anchors[anchor, :2], table).T
    absent = ratio - np.vdot(samples, samples).real / noise - samples.size * np.log(np.pi * noise)
    p = particles.existence[anchor]
    if came is not None and not len(known):
        way = np.hypot(*(model.anchors[anchor, :2] - agent[:, :2]).T)
        absent -= came.against(way)
        gain = came.seen(way, square / energy, node * energy[:, None], p < 0.5)
    else:
        with_noise = noise[:, None] + node * energy[:, None]
        gain = square[:, None] * node / (noise[:, None] * with_noise)
        gain -= np.log(with_noise / noise[:, None])  # (P, G)
    gain += np.log(np.maximum(particles.weight[anchor], 1e-300))
    there = absent + logsumexp(gain, axis=1)
    seen = np.log(p) + there
    return Received(absent, gain, seen, np.logaddexp(seen, np.log1p(-p) + absent))


def concentrated(
    particles: ParticleBelief, heard: list[int], evaluate: Callable[[ParticleBelief], list[Received]],
    seed: int, step: int,
) -> tuple[ParticleBelief, Array, list[Received]]:  # fmt: skip
    """Particles of which enough carry the weight, their importance (P,), and what is received there, (M528).

    Where few of those that are predicted do, others are drawn from a Gaussian about them, which narrows by as
    much as leaves enough [Cappe2004population]. Their prior is that of the predicted ones' moments then, and
    noise is as the samples have it.

    Parameters
    ----------
    heard : list of int
        Anchors, in the order of what `evaluate` returns: what each one's samples say of given particles.
    seed, step : int
        Of the random numbers.
    """
    agent, found = particles.agent, evaluate(particles)
    kept, base = KEPT * len(agent), np.zeros(len(agent))
    mean, covariance = agent.mean(0), np.cov(agent.T) + LEAST_VARIANCE * np.eye(MOVING)
    draw = np.random.default_rng([seed, step, NARROW])
    for _ in range(NARROWED):
        total = base + sum(one.log_own for one in found)
        if _effective(total) >= ENOUGH * len(agent):
            break
        share = _tempered(total, kept)
        centre = share @ agent
        off = agent - centre
        spread = WIDER * (share[:, None] * off).T @ off + LEAST_VARIANCE * np.eye(MOVING)
        agent = centre + draw.standard_normal(agent.shape) @ np.linalg.cholesky(spread).T
        noise = particles.noise.copy()
        for j, one in zip(heard, found, strict=True):
            chosen = noise[j][_resample(_tempered(base + one.log_own, kept), draw)]
            noise[j] = draw.permutation(chosen) * draw.gamma(SHAPE, 1 / SHAPE, len(agent))
        particles = replace(particles, agent=agent, noise=noise)
        base = _log_normal(agent, mean, covariance) - _log_normal(agent, centre, spread)
        found = evaluate(particles)
    return particles, base, found


def _effective(log: Array) -> float:
    """How many of a weighted set count."""
    weight = np.exp(log - log.max())
    return float(weight.sum() ** 2 / (weight @ weight))


def _tempered(log: Array, least: float) -> Array:
    """Weights, to the largest power up to 1 by which so many count."""
    low, high = float(_effective(log) >= least), 1.0
    for _ in range(HALVINGS if low < high else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _effective(middle * log) >= least else (low, middle)
    share: Array = np.exp(low * log - logsumexp(low * log))
    return share


def _log_normal(points: Array, mean: Array, covariance: Array) -> Array:
    """Log density, (P,)."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, (points - mean).T)
    density: Array = (
        -0.5 * (white**2).sum(0) - np.log(np.diagonal(root)).sum() - 0.5 * len(mean) * np.log(2 * np.pi)
    )
    return density


def los_power(particles: ParticleBelief) -> Array:
    """Mean power of the lines of sight, (J,)."""
    return (particles.node * particles.weight).sum(1)


def _resample(share: Array, draw: np.random.Generator) -> NDArray[np.intp]:
    """Systematic: indices by weights that sum to 1."""
    count = len(share)
    edges = np.cumsum(share)
    edges[-1] = 1.0
    return np.searchsorted(edges, (np.arange(count) + draw.uniform()) / count).clip(max=count - 1)
