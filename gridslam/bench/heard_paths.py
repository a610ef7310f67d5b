"""Kernels on the paths of learned features at one step, against twins that make all responses in full."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gridslam import reference
from gridslam.arrays import Array
from gridslam.bench.kernels import KernelSpeed, race
from gridslam.inference.messages.features.heard_paths import HeardPaths
from gridslam.inference.state.features.features import ENTRIES, MOVING, FeatureBank
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.wording import counted
from gridslam.world.scene import Scene
from gridslam.world.signal_model import SignalModel

NAMES = ("multiply_paths", "place_paths", "slope_paths")
OWN = (0.04, 0.01)
"""Variances of lengths (m^2) and angles (rad^2) of features about what their places say."""


def heard_path_speeds(
    counts: Sequence[int], seconds: float, scene: str = "screen"
) -> tuple[KernelSpeed, ...]:
    """Times of the kernels on a line of sight and each number of features, by a scene's radio.

    Parameters
    ----------
    seconds : float
        At least so long for each kernel; it runs three times or more, its twin once.
    """
    world = Scene.load(scene)
    model = SignalModel.of(world.filter_model(), world.waveform())
    return tuple(speed for count in counts for speed in _speeds(count, model, seconds, scene))


def _speeds(count: int, model: SignalModel, seconds: float, scene: str) -> Iterator[KernelSpeed]:
    draw, wave = np.random.default_rng(count), model.waveform
    samples = draw.normal(size=(2, 1, len(wave.agent_element_m), len(wave.offset_hz)))
    heard = samples[0] + 1j * samples[1]
    belief, one = _believed(draw, count), _believed(draw, 0)
    many, alone = (HeardPaths(own, heard, np.array([True]), 0.0, model, OWN) for own in (belief, one))
    (state, prior), (first, narrow) = _at(belief), _at(one)
    power, where = draw.uniform(1, 50, 1 + count), f"{scene}, {counted(count, 'feature')}"
    many.place(state, prior)
    alone.place(first, narrow)
    (known,), _ = many.multiply(), alone.multiply()
    rest = known.energy, known.size
    yield race(
        "place_paths", where, "path", 1 + count, seconds, 1.0, lambda: many.place(state, prior),
        lambda: alone.place(first, narrow),
        lambda: reference.place_paths(state, prior, belief, 0, 0.0, model),
    )  # fmt: skip
    yield race(
        "multiply_paths", where, "path", 1 + count, seconds, 1.0, many.multiply, alone.multiply,
        lambda: reference.multiply_paths(many.numbers, heard[0], wave),
    )  # fmt: skip
    yield race(
        "slope_paths", where, "path", 1 + count, seconds, 1.0, lambda: many.slopes(power),
        lambda: alone.slopes(power[:1]),
        lambda: reference.slope_paths(known.gram, known.matched, power, 1.0, *rest),
    )  # fmt: skip


def _believed(draw: np.random.Generator, count: int) -> JointBelief:
    """A belief in an agent and so many features of one anchor, drawn about its place."""
    none, own = np.zeros(count, int), draw.uniform([3, -np.pi, 0], [15, np.pi, 2], (count, ENTRIES))
    bank = FeatureBank(
        np.arange(count), none, np.zeros((count, 2)), np.ones(count), none, none, np.ones(count)
    )
    mean = np.concatenate([np.zeros(MOVING), own.ravel()])
    one = np.ones(1)
    return JointBelief(mean, 0.01 * np.eye(len(mean)), bank, one, one, one, OWN[0] ** 0.5)


def _at(belief: JointBelief) -> tuple[Array, Array]:
    """The joint state and the prior's mean (2, n + 1), and its covariance, with an error of the heading."""
    state = np.append(belief.mean, 0.0)
    return np.stack([state, state]), 0.01 * np.eye(len(state))
