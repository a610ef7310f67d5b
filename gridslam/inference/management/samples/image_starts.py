"""Where an agent of one antenna starts, if its prior is wide against c/B: wherever lines of sight may be.

Such a place is a hypothesis, stepped by itself and weighed by its evidence; docs/model.md, (M91).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.health.reasons import NOT_FOUND, several_places
from gridslam.inference.management.mixture import SLACK, TOGETHER
from gridslam.inference.messages.samples.distance_mode import FREE_M
from gridslam.inference.messages.samples.image_births import FoundDistances, birth_rate
from gridslam.inference.messages.samples.image_prediction import predict_state
from gridslam.inference.messages.samples.noise_levels import median_noise
from gridslam.inference.messages.samples.open_distances import INTENSITIES_DB
from gridslam.inference.messages.samples.signal_likelihood import Band, Complex, Inverse, band_of
from gridslam.inference.state.population import Population
from gridslam.inference.state.rings import MOVING
from gridslam.inference.state.samples.images import DirectState, Tentative
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

Step = Callable[[DirectState, SignalScan, SignalModel], tuple[DirectState, Any]]
REACH = 2.2
"""Standard deviations to which a prior is searched: a uniform one's half width is 1.7 of them."""
SPACING, NARROW, APART = 1 / 6, 0.25, 0.5
"""In c/B: between places that are tried, deviation of a hypothesis' start, distance of two hypotheses."""
PEAKS, LOUD, BROAD_M, POINTS = 8, 12.0, 0.03, 1024
"""Peaks of an anchor's snapshot at most, log likelihood ratio of each at least, deviation that is left to
each, points of the folding range."""
FIRST, EARLIER = 96, 4.0
"""Hypotheses at first, and by how much a peak is less likely the line of sight for each one before it."""
HOPELESS = 30.0
"""Log weight behind the best at which a hypothesis is dropped: a world mirrored at the line through two
anchors says the same, but for errors of Laplace's approximation, which grow from step to step."""
ONE_PLACE_M, FOUND = 0.5, 0.5
"""Within which two images of an anchor are one; existence from which on an image needs its twin."""
SEVERAL = 3
"""Anchors that tell a place by their distances."""


def begun(state: DirectState, band: Band) -> Population[DirectState]:
    """The hypotheses before the first step: one; where its place is vague, it is searched for at first."""
    return Population.of(state, searching=state.spread_m > band.resolution_m)


def begun_anew(
    population: Population[DirectState], time_s: float, model: SignalModel
) -> Population[DirectState]:
    """The hypotheses to go on from at a time; after a silence that leaves no more of the agent's place than
    that it is in the region, it is searched for, (M570).

    Settled images stay as they were; rings hang on where the agent was. Two anchors alone don't tell on which
    side of them it is.
    """
    before = population.best
    if before.time_s is None:
        return population
    after = predict_state(before, time_s, 0, model)
    side = np.array(model.grid.shape[::-1]) * model.grid.cell_m
    variance = np.append(side**2 / 12, model.start_variance[2:MOVING] + after.belief.mean[2:MOVING] ** 2)
    if after.spread_m < np.sqrt(variance[:2].sum()) or population.searching:
        return population
    mean, covariance = after.belief.mean.copy(), after.belief.covariance.copy()
    mean[:2], mean[2:MOVING] = model.middle, 0.0
    covariance[:MOVING], covariance[:, :MOVING] = 0.0, 0.0
    covariance[:MOVING, :MOVING] = np.diag(variance)
    state = replace(
        before,
        belief=replace(after.belief, mean=mean, covariance=covariance),
        tentative=Tentative.empty(),
        one_sided=np.full_like(before.one_sided, len(before.one_sided) < SEVERAL),
        time_s=time_s,
    )
    return Population.of(state, searching=True)


def advance_population(
    population: Population[DirectState], scan: SignalScan, model: SignalModel, step: Step
) -> tuple[Population[DirectState], Any, str]:
    """One step of all hypotheses: these, what happened in the likeliest, and what is amiss with the start."""
    band = band_of(model.waveform)
    population = begun_anew(population, scan.time_s, model)
    if population.searching and scan.heard.any():
        population = _started(population.best, scan, model, band)
    stepped = [step(state, scan, model) for state in population.states]
    states, infos = tuple(state for state, _ in stepped), [info for _, info in stepped]
    if population.searching:
        return replace(population, states=states), infos[0], NOT_FOUND
    if len(population) == 1:
        return replace(population, states=states), infos[0], ""
    rate = birth_rate(0, model.max_bounces)
    log = np.array(population.log_weight) + [log_evidence(info.found, band, rate) for info in infos]
    likeliest = int(np.argmax(log))
    population = population.having(states, log)
    population = population.merged(is_one, among=population.likely(HOPELESS))
    several = len(population)
    return population, infos[likeliest], several_places(several) if several > 1 else ""


def log_evidence(found: Sequence[FoundDistances], band: Band, rate: float) -> float:
    """Log density of a step's samples given those before, by Laplace's approximation.

    A new path has anywhere to be, at a rate per delay cell, that of the first step: who needs more of them is
    less likely.
    """
    total = 0.0
    for one in found:
        prior, mode = one.prior, one.mode
        _, before = np.linalg.slogdet(prior.precision)
        _, after = np.linalg.slogdet(mode.covariance)
        new = len(prior.mean) - one.known
        cells = np.sqrt(2 * np.pi) * FREE_M / band.resolution_m
        total += mode.log_posterior + 0.5 * (before + after) + new * np.log(rate * cells)
    return total


def is_one(one: DirectState, other: DirectState) -> bool:
    """Whether two hypotheses have the agent at one place, and every image that either believes in."""
    gap = one.belief.mean[:2] - other.belief.mean[:2]
    pooled = 0.5 * (one.belief.covariance[:2, :2] + other.belief.covariance[:2, :2]) + np.diag(SLACK[:2])
    if gap @ np.linalg.solve(pooled, gap) > TOGETHER:
        return False
    for here, there in ((one, other), (other, one)):
        apart = np.linalg.norm(here.places[:, None] - there.places, axis=-1)
        apart[here.images.anchor[:, None] != there.images.anchor] = np.inf
        alone = apart.min(1, initial=np.inf) > ONE_PLACE_M
        if (alone & (here.images.existence > FOUND)).any():
            return False
    return True


def _started(state: DirectState, scan: SignalScan, model: SignalModel, band: Band) -> Population[DirectState]:
    """A hypothesis at each place where the lines of sight of a scan may be."""
    prior = predict_state(state, scan.time_s, 1, model)
    places = find_places(prior, scan, model, band)
    covariance = prior.belief.covariance.copy()
    covariance[:2], covariance[:, :2] = 0.0, 0.0
    covariance[[0, 1], [0, 1]] = (NARROW * band.resolution_m) ** 2
    states = []
    for place in places:
        mean = prior.belief.mean.copy()
        mean[:2] = place
        states.append(replace(state, belief=replace(state.belief, mean=mean, covariance=covariance)))
    return Population(tuple(states), (-float(np.log(len(states))),) * len(states), since=0)


def find_places(prior: DirectState, scan: SignalScan, model: SignalModel, band: Band) -> Array:
    """Places (K, 2) within a prior and the region at which lines of sight would make peaks, best first."""
    reach = REACH * np.sqrt(np.diagonal(prior.belief.covariance)[:2])
    edges = np.transpose([model.grid.x_m, model.grid.y_m])
    low, high = prior.belief.mean[:2] - reach, prior.belief.mean[:2] + reach
    low, high = np.clip(low, edges[0], edges[1]), np.clip(high, edges[0], edges[1])
    counts = np.maximum(np.ceil((high - low) / (SPACING * band.resolution_m)), 1).astype(int) + 1
    axes = [np.linspace(*ends) for ends in zip(low, high, counts, strict=True)]
    place = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    score = np.zeros(len(place))
    for anchor in np.flatnonzero(scan.heard).tolist():
        peaks = find_peaks(band, scan.samples[anchor, 0, 0], float(prior.links.noise[anchor]))
        away = np.linalg.norm(place - model.anchor_positions[anchor], axis=1)
        worth = -EARLIER * np.arange(len(peaks))
        off = (away[:, None] - np.sort(peaks)) / (NARROW * band.resolution_m)
        score += np.maximum((worth - 0.5 * off**2).max(1, initial=-np.inf), -EARLIER * PEAKS)
    chosen, order = list[int](), np.argsort(-score, kind="stable")
    while len(order) and len(chosen) < FIRST:
        chosen.append(int(order[0]))
        far = np.linalg.norm(place[order] - place[order[0]], axis=1) > APART * band.resolution_m
        order = order[far]
    return np.asarray(place[chosen])


def find_peaks(band: Band, samples: Complex, noise: float) -> Array:
    """Lengths (K,) m of the paths of a snapshot, roughly, one by one."""
    cells = band.folding_m / len(band) * np.arange(len(band))
    if noise <= 0:
        noise = median_noise(np.abs(np.conj(band.response(cells)) @ samples) ** 2)
    found, weight = np.zeros(0), np.zeros(0)
    levels = noise * 10 ** (INTENSITIES_DB / 10)
    for _ in range(PEAKS):
        inverse = Inverse.of(band, samples, weight, found, np.full(len(found), BROAD_M**2), noise)
        table = inverse.sweep(POINTS)
        logs = table.log_ratio(levels[:, None])
        peak = int(logs.max(0).argmax())
        if logs[:, peak].max() < LOUD:
            break
        power = float(np.abs(table.matched[peak]) ** 2 / table.self_power[peak] ** 2)
        found, weight = np.append(found, table.spacing_m * peak), np.append(weight, power)
    return found
