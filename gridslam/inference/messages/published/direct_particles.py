"""Messages of the published form of direct SLAM, moment-matched ([LiangDirect], eqs. (5) to (8))."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.published.sampling import resampled
from gridslam.inference.messages.samples.noise_levels import median_noise
from gridslam.inference.messages.samples.open_distances import INTENSITIES_DB
from gridslam.inference.messages.samples.response_series import ResponseSeries
from gridslam.inference.messages.samples.signal_likelihood import Band, Inverse, log_ratio
from gridslam.inference.state.published.feature_particles import Features, ParticleState
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit

Complex = NDArray[np.complex128]
SPACES = 4096
"""Of the folding range, into which distances of particles are sorted."""
WALK_M, INTENSITY_WALK, NOISE_SHAPE = 1e-4, 0.02, 200.0
"""Random walks per step: features' places, intensities (relative), and shape of the noise's Gamma walk."""
BIRTHS, FIRST_BIRTHS, FIRST_STEPS = 1e-4, 0.05, 8.0
LEAST_EXISTENCE = 0.01
STACKED_M, STACKED_EXISTENCE = 0.4, 0.3
"""Features known better than this enter the agent's message particle by particle, others by their mean."""
NEAR_M = 0.05


def predict_particles(
    state: ParticleState, time_s: float, model: FilterModel, draw: np.random.Generator
) -> ParticleState:
    """Move all particles ([LiangDirect], section II-B)."""
    if state.time_s is None:
        return replace(state, time_s=time_s)
    dt = time_s - state.time_s
    agent = state.agent.copy()
    push = model.settings.acceleration_mps2 * draw.standard_normal((len(agent), 2))
    agent[:, :2] += dt * agent[:, 2:] + 0.5 * dt**2 * push
    agent[:, 2:] += dt * push
    known = state.features
    free = np.where(known.fixed, 0.0, WALK_M)[:, None, None]
    position = known.position + free * draw.standard_normal(known.position.shape)
    intensity = known.intensity * np.exp(INTENSITY_WALK * draw.standard_normal(known.intensity.shape))
    existence = np.minimum(model.settings.survival * known.existence, 1 - 1e-7)
    noise = state.noise * draw.gamma(NOISE_SHAPE, 1 / NOISE_SHAPE, state.noise.shape)
    features = replace(known, position=position, intensity=intensity, existence=existence)
    return replace(state, agent=agent, noise=noise, features=features, time_s=time_s)


def start_particles(state: ParticleState, anchor: int, band: Band, samples: Complex) -> ParticleState:
    """Noise and the line of sight's intensity, where nothing was heard yet."""
    if state.noise[anchor, 0] > 0:
        return state
    cells = band.folding_m / len(band) * np.arange(len(band))
    power = np.abs(np.conj(band.response(cells)) @ samples) ** 2
    noise = state.noise.copy()
    noise[anchor] = median_noise(power)
    row = np.flatnonzero((state.features.anchor == anchor) & state.features.fixed)
    intensity = state.features.intensity.copy()
    spread = np.geomspace(0.1, 2.0, intensity.shape[1])
    intensity[row] = np.maximum(spread * power.max(), 2 * noise[anchor, 0])
    return replace(state, noise=noise, features=replace(state.features, intensity=intensity))


@dataclass(frozen=True, eq=False)
class Expected:
    """Mean covariances of one anchor's features over agent and feature, and what follows from them.

    Attributes
    ----------
    rows : (N,) int
        The anchor's features.
    distance : (N, P) m
        Of paired particles.
    terms : (N, M, M)
        pi_n E[gamma h h^H].
    noise : float
        Mean of the noise.
    """

    rows: NDArray[np.intp]
    distance: Array
    terms: Complex
    noise: float

    def covariance(self, left_out: int | None = None) -> Complex:
        """Of the samples, without one feature if so asked."""
        used = np.arange(len(self.rows)) != left_out
        size = self.terms.shape[-1]
        return np.asarray(self.noise * np.eye(size) + self.terms[used].sum(0))


def expect(state: ParticleState, anchor: int, band: Band) -> Expected:
    """Moment matching: every mean of gamma h h^H is a weighted histogram of distances, transformed (M88)."""
    rows = np.flatnonzero(state.features.anchor == anchor)
    own = state.features.take(rows)
    distance = np.linalg.norm(own.position - state.agent[:, :2], axis=-1)
    at = distance / band.folding_m * SPACES
    low = np.floor(at).astype(np.int64)
    share, weight = at - low, own.existence[:, None] * own.intensity / distance.shape[1]
    size = len(band)
    terms = np.empty((len(rows), size, size), np.complex128)
    lag = np.arange(size)
    shape = np.outer(band.pulse, np.conj(band.pulse))
    for n in range(len(rows)):
        histogram = np.bincount(low[n] % SPACES, weight[n] * (1 - share[n]), SPACES)
        histogram += np.bincount((low[n] + 1) % SPACES, weight[n] * share[n], SPACES)
        column = np.fft.fft(histogram)[:size]
        whole = np.concatenate([np.conj(column[:0:-1]), column])
        terms[n] = whole[size - 1 + lag[:, None] - lag] * shape
    return Expected(rows, distance, terms, float(state.noise[anchor].mean()))


def agent_message(state: ParticleState, expected: Expected, band: Band, samples: Complex) -> Array:
    """Log of iota (P,), eq. (5), (M381): one particle of each well-known feature for each of the agent's."""
    existence = state.features.existence[expected.rows]
    sharp = existence > STACKED_EXISTENCE
    sharp[sharp] = expected.distance[sharp].std(-1) < STACKED_M
    if not sharp.any():
        return np.zeros(len(state.agent))
    series = ResponseSeries.of(band, samples, expected.terms[~sharp].sum(0), expected.noise)
    power = state.features.intensity[expected.rows[sharp]]
    power *= existence[sharp, None] / expected.noise
    return series.log_densities(expected.distance[sharp], power)


def noise_message(state: ParticleState, anchor: int, expected: Expected, samples: Complex) -> Array:
    """Log of nu (P,), eq. (6), (M88)."""
    value, vector = np.linalg.eigh(expected.terms.sum(0))
    level = state.noise[anchor][:, None] + np.maximum(value, 0)
    return np.asarray(-(np.log(level) + np.abs(np.conj(vector).T @ samples) ** 2 / level).sum(-1))


def feature_messages(
    state: ParticleState, expected: Expected, band: Band, samples: Complex, draw: np.random.Generator
) -> Features:
    """Features of an anchor after kappa, eqs. (7), (8), (M89), (M90): existence, particles drawn anew."""
    own = state.features.take(expected.rows)
    existence, picks = own.existence.copy(), np.empty(own.intensity.shape, np.int64)
    nothing = np.zeros(0)
    for n in range(len(own)):
        inverse = np.linalg.inv(expected.covariance(n)).astype(np.complex128)
        table = Inverse(band, samples, inverse, np.zeros((0, 3, len(band)), np.complex128),
                        nothing.reshape(0, 3)).sweep(SPACES)  # fmt: skip
        at = np.rint(expected.distance[n] / table.spacing_m).astype(np.int64) % SPACES
        logs = log_ratio(np.abs(table.matched[at]) ** 2, table.self_power[at], own.intensity[n])
        top = max(float(logs.max()), 0.0)
        mean = float(np.exp(logs - top).mean())
        odds = existence[n] * mean
        existence[n] = odds / (odds + (1 - existence[n]) * np.exp(-top))
        picks[n] = draw.permutation(resampled(logs, draw))
    every = np.arange(len(own))[:, None]
    return replace(
        own, existence=existence, position=own.position[every, picks], intensity=own.intensity[every, picks]
    )


def new_features(
    state: ParticleState, anchor: int, expected: Expected, band: Band, samples: Complex, position: Array,
    draw: np.random.Generator,
) -> Features:  # fmt: skip
    """New features, one per delay cell at most, each a ring about the agent: [LiangDirect], section II-B.

    Parameters
    ----------
    anchor : int
        Index of the anchor.
    expected : Expected
        What its features let expect.
    samples : (M,)
        Of one antenna.
    position : (2,) m
        Of the anchor.

    Returns
    -------
    Features
        At most M, of P particles each, numbered from `state.next_identity` on.
    """
    rate = max(BIRTHS, FIRST_BIRTHS * float(np.exp(-state.step / FIRST_STEPS)))
    inverse = np.linalg.inv(expected.covariance()).astype(np.complex128)
    blank = np.zeros((0, 3, len(band)), np.complex128)
    table = Inverse(band, samples, inverse, blank, np.zeros((0, 3))).sweep(SPACES)
    levels = expected.noise * 10 ** (INTENSITIES_DB / 10)
    logs = table.log_ratio(levels[:, None])
    sight = np.linalg.norm(state.agent[:, :2] - position, axis=-1)
    nearest = float(sight.mean()) + NEAR_M + 2 * float(sight.std())
    grid = table.spacing_m * np.arange(SPACES)
    grid = grid + band.folding_m * (grid < nearest)
    open_ = grid < nearest + band.folding_m - band.resolution_m
    cell = (np.arange(SPACES) * len(band)) // SPACES
    count, made = state.agent.shape[0], []
    for number in range(len(band)):
        rows = np.flatnonzero((cell == number) & open_)
        if not len(rows):
            continue
        ratio = np.exp(np.minimum(logs[:, rows], 300.0))
        odds = rate * float(ratio.mean())
        existence = odds / (odds + 1 - rate)
        if existence <= LEAST_EXISTENCE:
            continue
        flat = draw.choice(ratio.size, count, p=(ratio / ratio.sum()).ravel())
        level, where = np.divmod(flat, len(rows))
        far = grid[rows[where]] + table.spacing_m * (draw.random(count) - 0.5)
        place = state.agent[:, :2] + far[:, None] * unit(draw.uniform(-np.pi, np.pi, count))
        made.append((existence, place, levels[level] * 10 ** (0.5 * (draw.random(count) - 0.5))))
    size = len(made)
    return Features(
        state.next_identity + np.arange(size), np.full(size, anchor, np.int64), np.zeros(size, bool),
        np.array([one[0] for one in made]), np.array([one[1] for one in made]).reshape(size, count, 2),
        np.array([one[2] for one in made]).reshape(size, count),
    )  # fmt: skip
