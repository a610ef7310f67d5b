"""What a Gaussian belief of distances leaves out: their curvature, and paths within the resolution."""

from dataclasses import replace

import numpy as np
import pytest
from delay_snapshots import BAND, received

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief, append
from gridslam.inference.messages.samples.distance_mode import PathPrior
from gridslam.inference.messages.samples.image_births import birth_rate, find_births
from gridslam.inference.messages.samples.image_prediction import image_distances
from gridslam.inference.state.samples.images import DirectState, Images


@pytest.fixture(scope="module")
def model():
    return gs.Scene.load("overlap").filter_model("agent1")


def with_image(state, distance, spread):
    """A state with one settled image of anchor 0 more, at a bearing of 1 rad."""
    belief = append(state.belief, np.array([1.0, distance]), spread**2 * np.diag([1 / distance**2, 1]))
    one = np.ones(1)
    image = Images(
        np.array([len(state.images)]), np.array([0]), belief.mean[None, :2], 0.99 * one, 0.9 * one, 50 * one,
        50 * one, np.array([20]), np.full((1, 2), np.nan), np.zeros(1, np.int64),
    )  # fmt: skip
    return replace(state, belief=belief, images=state.images.joined(image))


def settled(model, *images):
    state = DirectState.start(model.start_mean[:4], model.start_variance[:4], len(model.anchors), np.ones(2))
    for distance, spread in images:
        state = with_image(state, distance, spread)
    return state


def snapshot(rng, distance, snr_db):
    """Steady paths in noise of power 1."""
    turn = 2 * np.pi * rng.random(len(distance))
    amplitude = 10 ** (np.asarray(snr_db) / 20) * np.exp(1j * turn)
    return received(rng, distance, amplitude)


@pytest.mark.slow
def test_moments_of_curved_distances_are_those_of_samples(model):
    state = settled(model, (6.0, 0.4), (11.0, 0.8))
    rng, size = np.random.default_rng(1), len(state.belief.mean)
    root = rng.normal(size=(size, size)) * np.array([0.3, 0.3, 0.01, 0.01, 0.06, 0.02, 0.06, 0.02])[:, None]
    state = replace(state, belief=Belief(state.belief.mean, root @ root.T / 4))
    rows, position = np.arange(2), model.anchor_positions[0]
    drawn = rng.normal(size=(2_000, size)) @ root.T / 2

    def distances(off):  # of a state that is known exactly nothing bends
        sure = Belief(state.belief.mean + off, 0 * state.belief.covariance)
        return image_distances(replace(state, belief=sure), rows, position)

    mean, slope, _ = distances(np.zeros(size))
    bent = np.array([distances(off)[0] for off in drawn]) - mean - drawn @ slope.T
    whole, _, covariance = image_distances(state, rows, position)
    farther, doubt = whole - mean, covariance - slope @ state.belief.covariance @ slope.T
    assert np.abs(farther).max() > 0.005
    np.testing.assert_allclose(farther, bent.mean(0), atol=0.1 * np.abs(farther).max())
    np.testing.assert_allclose(doubt, np.cov(bent.T), atol=0.2 * doubt.max())


@pytest.mark.parametrize("seed", [16, 21])
def test_a_known_path_does_not_stand_in_for_two(seed):
    """At the mode it may, 10 deviations off; beside its prediction the other one shows."""
    rng, prior = (
        np.random.default_rng(seed),
        PathPrior(np.array([5.95]), np.array([[400.0]]), np.array([1500.0])),
    )
    for _ in range(6):
        samples = snapshot(rng, [5.85, 6.15], [32.0, 28.0])
        mode = find_births(BAND, samples, prior, 1.0, birth_rate(1, 1)).mode
        assert np.abs(mode.distance[0] - 5.85) < 4 * np.sqrt(mode.variance[0])
