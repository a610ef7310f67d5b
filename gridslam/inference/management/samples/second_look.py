"""A second look at all that was received, with the images that have been found since; docs/model.md, (M441).

Where walls reflect twice, many paths lie within the resolution, and what they are becomes clear when images
settle, late. Until then each may have been taken for another one, and images and agent are off by more than
they say. Gone through again with the images known roughly, the same samples are told apart from the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.health.reasons import several_places
from gridslam.inference.management.samples import image_starts
from gridslam.inference.management.samples.image_starts import ONE_PLACE_M, Step, is_one, log_evidence
from gridslam.inference.messages.samples.image_births import birth_rate
from gridslam.inference.messages.samples.signal_likelihood import band_of
from gridslam.inference.state.past import Past
from gridslam.inference.state.population import Population
from gridslam.inference.state.samples.images import DirectState, Images
from gridslam.world.geometry import direction
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

EVERY, LAST = 16, 128
"""Steps from one look to the next, and after which there is none any more."""
FEWEST = 10
"""Known images without which nothing would be seen that wasn't seen before."""
EXISTS, KNOWN_M = 0.5, 0.6
"""Existence and deviation (root of the trace) of the place from which on an image is known."""
LOOSE_M = 0.3
"""Deviation of a known image's place at the start of a look: its samples tell of it once more."""
EXISTENCE, VISIBLE, STEPS_HEARD = 0.9, 0.5, 5.0
"""Of an image at the start of a look; `STEPS_HEARD` as in `Images`."""
COST = 6.0
"""What an image that is known beforehand costs in log evidence: its place would have had to be guessed."""
MOST, HOPELESS = 2, 15.0
"""Hypotheses that are followed, and the log weight behind the best at which one is dropped."""


def begun(state: DirectState, model: SignalModel) -> Population[DirectState]:
    """What is believed before the first step; where walls reflect twice, what is received is kept."""
    population = image_starts.begun(state, band_of(model.waveform))
    if population.searching or model.max_bounces < 2:
        return population
    return replace(population, past=Past(state))


def advance_population(
    population: Population[DirectState], scan: SignalScan, model: SignalModel, step: Step
) -> tuple[Population[DirectState], Any, str]:
    """One step of all hypotheses: these, what happened in the likeliest, and what is amiss with them."""
    past = population.past
    if past is None:
        return image_starts.advance_population(population, scan, model, step)
    stepped = [_stepped(state, scan, model, step) for state in population.states]
    log = np.array(population.log_weight) + [evidence for _, _, evidence in stepped]
    info = stepped[int(np.argmax(log))][1]
    past = past.with_scan(scan, float(np.logaddexp.reduce(log)))
    late = population.best.step >= LAST
    population = population.having([state for state, _, _ in stepped], log)
    population = replace(population, past=past.forgotten() if late else past)
    population = population.merged(is_one, among=population.likely(HOPELESS, MOST))
    if is_due(population):
        population = looked_again(population, model, step)
    apart = _places(population.states)
    return population, info, several_places(apart) if apart > 1 else ""


def is_due(population: Population[DirectState]) -> bool:
    """Whether it is time for a look, and enough images are known."""
    count = 0 if population.past is None else len(population.past.scans)
    return count > 0 and count % EVERY == 0 and len(_known(population.best)) >= FEWEST


def looked_again(
    population: Population[DirectState], model: SignalModel, step: Step
) -> Population[DirectState]:
    """The hypotheses, and one that has gone through all scans with the likeliest one's images (M442)."""
    past = population.past
    if past is None:
        return population
    state = with_images_of(past.start, population.best)
    log = -COST * len(state.images) - past.log_evidence
    for scan in past.scans:
        state, _, evidence = _stepped(state, scan, model, step)
        log += evidence
    population = replace(
        population.having((*population.states, state), [*population.log_weight, log]),
        past=replace(past, log_evidence=past.log_evidence + float(np.logaddexp(0.0, log))),
    )
    return population.merged(is_one, among=population.likely(HOPELESS, MOST))


def with_images_of(start: DirectState, later: DirectState) -> DirectState:
    """The state before the first step with the images that are known later, each roughly (M441)."""
    rows = _known(later)
    place, origin = later.places[rows], start.belief.mean[:2]
    span = np.linalg.norm(place - origin, axis=1)
    polar = np.stack([direction(origin, place), span], 1)
    variance = np.stack([(LOOSE_M / span) ** 2, np.full(len(rows), LOOSE_M**2)], 1)
    before, size = start.belief.covariance, len(start.belief.mean)
    covariance = np.diag(np.concatenate([np.zeros(size), variance.ravel()]))
    covariance[:size, :size] = before
    count, known = len(rows), later.images.take(rows)
    images = Images(
        np.arange(count), known.anchor, np.repeat(origin[None], count, 0), np.full(count, EXISTENCE),
        np.full(count, VISIBLE), known.intensity, np.full(count, STEPS_HEARD), np.zeros(count, np.int64),
        np.full((count, 2), np.nan), np.zeros(count, np.int64),
    )  # fmt: skip
    belief = Belief(np.concatenate([start.belief.mean, polar.ravel()]), covariance)
    return replace(start, belief=belief, images=images, next_identity=count)


def _known(state: DirectState) -> np.ndarray:
    """Rows of the images that are there, at a place that is known roughly."""
    images, spread = state.images, np.trace(state.place_covariances, axis1=1, axis2=2)
    return np.flatnonzero((images.existence > EXISTS) & (spread < KNOWN_M**2) & ~images.proposed)


def _stepped(
    state: DirectState, scan: SignalScan, model: SignalModel, step: Step
) -> tuple[DirectState, Any, float]:
    """A step of one hypothesis, what happened, and the log density of the scan."""
    after, info = step(state, scan, model)
    rate = birth_rate(state.step, model.max_bounces)
    return after, info, log_evidence(info.found, band_of(model.waveform), rate)


def _places(states: Sequence[DirectState]) -> int:
    """At how many places hypotheses have the agent."""
    apart = list[np.ndarray]()
    for state in states:
        here = state.belief.mean[:2]
        if all(np.linalg.norm(here - other) > ONE_PLACE_M for other in apart):
            apart.append(here)
    return len(apart)
