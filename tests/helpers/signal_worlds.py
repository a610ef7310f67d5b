"""Sampled signals of points, made by the reference's own sums."""

from typing import NamedTuple

import numpy as np

from gridslam.inference.messages.features.matched_outputs import (
    matched_outputs,
    pulse_correlation,
    rows_per_m,
)
from gridslam.kernels.messages.feature_ascent import climb_features
from gridslam.kernels.messages.feature_likelihood import differentiate_features, evaluate_features
from gridslam.kernels.messages.feature_responses import ARRAY, BLOCKS, LANES, SIDE
from gridslam.kernels.primitives.blocks import Ascent
from gridslam.reference.feature_likelihood import response
from gridslam.world.radio import SPEED_OF_LIGHT

SQUARE = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]) * np.pi / 2
LONGEST_M = 29.0


class SignalWorld(NamedTuple):
    """An anchor, features, particles, and the samples (N, M) that the first of these receives."""

    points: np.ndarray
    features: np.ndarray
    anchor: np.ndarray
    element: np.ndarray
    offset_hz: np.ndarray
    pulse: np.ndarray
    samples: np.ndarray

    @property
    def rate(self):
        return 2 * np.pi * self.offset_hz / SPEED_OF_LIGHT

    @property
    def known(self):
        """What the twins take."""
        return (
            self.points, self.features, self.anchor, self.element, self.pulse, self.rate, self.samples
        )  # fmt: skip

    @property
    def tables(self):
        return (
            matched_outputs(self.samples, self.offset_hz, self.pulse)[None],
            pulse_correlation(self.offset_hz, self.pulse), np.array([rows_per_m(self.offset_hz), LONGEST_M]),
        )  # fmt: skip

    def value(self):
        """A, |h_lo^H z|^2, |h_lo|^2 (P, 3) by the kernel."""
        out, many = np.full((len(self.points), 3), np.nan), len(self.features)
        step = np.zeros(len(self.points), np.int32)
        given = self.points, step, self.features, self.anchor, self.element
        evaluate_features(*given, *self.tables, *scratch(many, len(self.element)), out)
        return out

    def slopes(self, first=0):
        """Slopes (P, D, 4) and A (P,) by the kernel."""
        out, many = np.full((len(self.points), len(self.features) + 1, 4), np.nan), len(self.features)
        step = np.zeros(len(self.points), np.int32)
        given = self.points, step, self.features, self.anchor, self.element
        differentiate_features(*given, *self.tables, first, *scratch(many, len(self.element)), out)
        return out[:, :-1], out[:, -1, 0]

    def climb(self, kind, plan, launches):
        """Features (D, 4) at the end, the best (D, 4), A where each step began, by launches."""
        features, best, many = self.features.copy(), np.full_like(self.features, np.nan), len(self.features)
        slopes, highest, values = np.zeros((3, len(kind), 4)), np.full(1, -np.inf), []
        slopes[2] = np.nan
        step, room = np.zeros(len(self.points), np.int32), scratch(many, len(self.element))
        for steps in launches:
            now, value = np.array([sum(map(len, values)), *plan[1:]]), np.full(steps, np.nan)
            climb_features(
                self.points, step, features, self.anchor, self.element, *self.tables, kind, *room,
                Ascent(now, slopes, best, highest, value),
            )  # fmt: skip
            values.append(value)
        return features, best, np.concatenate(values)


def scratch(features, elements):
    return (
        np.full((LANES, features + 1, ARRAY + 3 * elements, SIDE), np.nan),
        np.full((LANES, BLOCKS * features, features, SIDE), np.nan),
    )


def signal_world(draw, features=3, particles=4, antennas=4, frequencies=41, noise=1e-3):
    """Any of them, with lengths below the one at which paths fold back."""
    offset = (np.arange(frequencies) - (frequencies - 1) / 2) * 1e7
    pulse = np.cos(np.pi * offset / (2.2 * offset[-1])).astype(complex)
    pulse /= np.linalg.norm(pulse)
    element = SQUARE if antennas == 4 else np.zeros((1, 2))
    points = np.column_stack(
        [
            draw.normal(size=(particles, 2)),
            draw.uniform(-4, 4, particles),
            noise * draw.uniform(1, 2, particles),
        ]
    )
    placed = draw.uniform([-8, -8, 0, 0.1], [8, 8, 3, 1.0], (features, 4))
    anchor, rate = draw.uniform(3, 5, 2), 2 * np.pi * offset / SPEED_OF_LIGHT
    z = response(points[0], anchor, 0.0, element, pulse, rate)
    for x, y, extra, power in placed:
        turn = np.sqrt(power) * np.exp(2j * np.pi * draw.uniform())
        z = z + turn * response(points[0], np.array([x, y]), extra, element, pulse, rate)
    z = z + np.sqrt(noise / 2) * (draw.normal(size=z.size) + 1j * draw.normal(size=z.size))
    return SignalWorld(points, placed, anchor, element, offset, pulse, z.reshape(len(element), -1))


def signal_model(start=(0.0, 0.0, 0.5, 0.0), spread=(0.3, 0.3, 0.5, 0.5), frequencies=41, **more):
    """What a filter knows: one anchor at (3, 4), 2 x 2 antennas, 400 MHz; `more` goes into the waveform."""
    from dataclasses import replace

    import gridslam as gs
    from gridslam.world.signal_model import SignalModel
    from gridslam.world.waveform import Waveform

    model = gs.Scene.load("room").filter_model()
    offset = (np.arange(frequencies) - (frequencies - 1) / 2) * 1e7
    pulse = np.cos(np.pi * offset / (2.2 * offset[-1])).astype(complex)
    wavelength = SPEED_OF_LIGHT / 7e9
    place = SQUARE * wavelength / (2 * np.pi)
    wave = {"anchor_element_m": np.zeros((1, 1, 2)), "agent_element_m": place, **more}
    model = replace(
        model, anchor_names=("A",), anchors=np.array([[3.0, 4.0, 0.0]]),
        start_mean=np.array([*start, 0.0]), start_variance=np.square([*spread, 0.1]),
        settings=model.settings.model_copy(update={"acceleration_mps2": 2.0, "particles": 500}),
    )  # fmt: skip
    return SignalModel.of(model, Waveform(7e9, offset, pulse, **wave))


def received(model, place, heading, points, powers, draw, noise=1.0):
    """Samples (1, N, M) of paths of constant modulus from `points` [x, y, b] with these powers at 1 m."""
    wave = model.waveform
    element, rate = (
        2 * np.pi / wave.wavelength_m * wave.agent_element_m,
        2 * np.pi * wave.offset_hz / SPEED_OF_LIGHT,
    )
    shape = len(element), len(rate)
    z = np.sqrt(noise / 2) * (draw.normal(size=shape) + 1j * draw.normal(size=shape))
    for (x, y, extra), power in zip(points, powers, strict=True):
        turn = np.sqrt(power) * np.exp(2j * np.pi * draw.uniform())
        at = np.array([x, y])
        z = z + turn * response(np.array([*place, heading]), at, extra, element, wave.pulse, rate).reshape(
            shape
        )
    return z[None]
