"""Kernels on learned features for growing numbers of them, against twins that take all samples together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gridslam import reference
from gridslam.bench.kernels import KernelSpeed, race
from gridslam.inference.messages.features.feature_likelihood import STEPS, Front
from gridslam.inference.messages.features.seeding import FAINTEST, FREE, POWERS, RATES
from gridslam.wording import counted
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene

NAMES = ("back_project", "climb_features", "differentiate_features", "evaluate_features")
SEGMENT = 25
"""Points that features climb by."""
TWIN_POINTS = 2
"""Points that a twin is given; its time is that for all of the kernel's in proportion."""


def feature_speeds(
    counts: Sequence[int], particles: int, seconds: float, scene: str = "screen"
) -> tuple[KernelSpeed, ...]:
    """Times of the kernels on `particles` points, for each number of features, by a scene's radio.

    Parameters
    ----------
    seconds : float
        At least so long for each kernel; it runs three times or more, its twin once.
    """
    return tuple(speed for count in counts for speed in _speeds(count, particles, seconds, scene))


def _speeds(count: int, particles: int, seconds: float, scene: str) -> Iterator[KernelSpeed]:
    wave, draw = Scene.load(scene).waveform(), np.random.default_rng(count)
    front, shape = Front(wave), (len(wave.agent_element_m), len(wave.offset_hz))
    points = np.column_stack(
        [draw.normal(size=(particles, 2)), draw.uniform(-3, 3, particles), np.ones(particles)]
    )
    features = draw.uniform([-12, -12, 0, 100], [12, 12, 2, 2000], (count, 4))
    samples = draw.normal(size=shape) + 1j * draw.normal(size=shape)
    anchor, tables, coarse = np.array([0.5, 5.0]), front.tables(samples[None]), front.coarse(samples[None])
    few, step = points[:TWIN_POINTS], np.zeros(particles, np.int32)
    rate = 2 * np.pi * wave.offset_hz / SPEED_OF_LIGHT
    known = few, features, anchor, front.element, wave.pulse, rate, samples
    where = f"{scene}, {counted(count, 'feature')}"
    share = particles / len(few)
    yield race(
        "evaluate_features", where, "particle", particles, seconds, share,
        lambda: front.ratios(points, features, anchor, tables),
        lambda: front.ratios(points[:1], features, anchor, tables),
        lambda: reference.evaluate_features(*known),
    )  # fmt: skip
    yield race(
        "differentiate_features", where, "particle", particles, seconds, share,
        lambda: front.slopes(points, step, features, anchor, tables),
        lambda: front.slopes(points[:1], step[:1], features, anchor, tables),
        lambda: reference.differentiate_features(*known),
    )  # fmt: skip
    plan, kind = np.array([0.0, 100.0, FAINTEST, *RATES]), np.full(count, FREE)
    own, which = points[:SEGMENT], step[:SEGMENT]
    yield race(
        "climb_features", where, "particle-step", len(own) * STEPS, seconds, len(own) / len(few),
        lambda: front.climb(own, which, features, anchor, tables, kind, plan, STEPS - 1),
        lambda: front.climb(own[:1], which[:1], features, anchor, tables, kind, plan, 0),
        lambda: reference.climb_features(*known, kind, plan, STEPS),
    )  # fmt: skip
    places = np.tile(features[:, :3], (particles // count + 1, 1))[:particles]
    one, powers = points[:1], 100.0 * POWERS
    yield race(
        "back_project", where, "place", particles, seconds, share,
        lambda: front.gains(places, one, coarse, powers),
        lambda: front.gains(places[:1], one, coarse, powers),
        lambda: reference.back_project(
            places[:TWIN_POINTS], one, front.element, wave.pulse, rate, samples, powers
        ),
    )  # fmt: skip
