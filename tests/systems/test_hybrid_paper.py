"""Learning as published: the networks' slopes, what they say at first, and that a run goes on bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import signal_model

import gridslam as gs
from gridslam.errors import InputError
from gridslam.inference.messages.features import network_learning
from gridslam.inference.messages.features.lessons import LEARN_EVERY
from gridslam.inference.messages.features.network_learning import moved, weight_slopes
from gridslam.inference.state.features.networks import FEATURES, PLACES_M, FeatureNetworks, Network
from gridslam.inference.state.features.sightings import Sightings
from gridslam.systems.published.hybrid_paper import PublishedHybridSlam, start

ANCHORS = np.array([[0.5, 5.0], [-3.0, 2.0]])


def network(outputs=4):
    draw = np.random.default_rng(3)
    return Network.drawn(draw, ANCHORS, draw.normal(size=(2, outputs)))


def test_networks_start_from_random_places():
    found = FeatureNetworks.drawn(ANCHORS, [1])
    place = found.places.at(ANCHORS).reshape(2, FEATURES, 3)
    assert np.abs(place[..., :2]).max() < PLACES_M
    assert np.abs(place[..., :2]).max() > 0.8 * PLACES_M
    np.testing.assert_allclose(found.powers.at(ANCHORS), 0.1)
    np.testing.assert_array_equal(
        place, FeatureNetworks.drawn(ANCHORS, [1]).places.at(ANCHORS).reshape(place.shape)
    )


def test_slopes_of_all_weights_are_differences():
    one, by = network(), np.random.default_rng(4).normal(size=(2, 4))
    found, step = weight_slopes(one, ANCHORS, by), 1e-6
    for layer, weights in enumerate(one.weights):
        assert found[layer].shape == weights.shape
        for at in list(np.ndindex(weights.shape))[:: max(1, weights.size // 7)]:
            ends = []
            for way in (step, -step):
                changed = weights.copy()
                changed[at] += way
                other = Network((*one.weights[:layer], changed, *one.weights[layer + 1 :]), (), (), 0)
                ends.append((by * other.at(ANCHORS)).sum())
            np.testing.assert_allclose(found[layer][at], (ends[0] - ends[1]) / (2 * step), atol=1e-5)


def test_steps_go_up_the_slope_and_each_weight_goes_as_far_at_first():
    one, by = network(), np.random.default_rng(4).normal(size=(2, 4))
    other = moved(one, ANCHORS, by, 1e-4)
    assert (by * other.at(ANCHORS)).sum() > (by * one.at(ANCHORS)).sum()
    assert other.moves == 1
    change = np.abs(other.weights[4] - one.weights[4])
    np.testing.assert_allclose(change[change > 0], 1e-4, rtol=1e-3)


@pytest.mark.parametrize("which", ["places", "powers"])
@pytest.mark.parametrize(
    ("part", "spoil"),
    [
        ("weights", lambda x: (*x[:4], x[4][:20], x[5])),
        ("weights", lambda x: x[:5]),
        ("first", lambda x: (x[0][:, :1], *x[1:])),
        ("second", lambda x: (*x[:4], x[4][:, :63], x[5])),
        ("second", lambda x: (*x[:4], x[4] - 1, x[5])),
        ("moves", lambda _: -1),
    ],
)
def test_networks_that_cannot_be_are_refused(which, part, spoil):
    model = signal_model()
    networks = FeatureNetworks.drawn(model.anchors[:, :2], [1])
    state = replace(start(model), networks=networks)
    PublishedHybridSlam.require_sound(state, model, "file")
    one = getattr(networks, which)
    broken = replace(networks, **{which: replace(one, **{part: spoil(getattr(one, part))})})
    with pytest.raises(InputError, match=f"file/networks/{which}/{part}"):
        PublishedHybridSlam.require_sound(replace(state, networks=broken), model, "file")


@pytest.mark.parametrize("place", [np.inf, np.nan])
def test_places_that_are_not_finite_are_refused(place):
    model = signal_model()
    state = start(model)
    seen = Sightings.none().add(np.array([-1]), np.array([0.0, place]))
    broken = replace(state, joint=replace(state.joint, sightings=seen))
    with pytest.raises(InputError, match="file/joint/sightings/agent_m"):
        PublishedHybridSlam.require_sound(broken, model, "file")


@pytest.mark.slow
def test_features_are_learned_at_the_segments_end_and_a_checkpoint_goes_on(tmp_path, monkeypatch):
    """With 20 steps of Adam in place of the 300 that are published, which took most of the time."""
    assert network_learning.ITERATIONS == 300
    monkeypatch.setattr(network_learning, "ITERATIONS", 20)
    scene = gs.Scene.load("screen").with_filter(particles=300)
    recording = gs.simulate(scene, "agent1", 2, what="signal")
    slam = PublishedHybridSlam(scene, seed=2, waveform=recording.waveform)
    for k in range(LEARN_EVERY + 3):
        slam.step(recording.scan(k))
        assert len(slam.state.joint.features) == (FEATURES if k >= LEARN_EVERY - 1 else 0)
    assert slam.state.networks.places.moves == 20
    slam.save(tmp_path / "on.h5")
    again = PublishedHybridSlam.resume(tmp_path / "on.h5")
    for k in range(LEARN_EVERY + 3, 2 * LEARN_EVERY + 1):
        one, other = slam.step(recording.scan(k)), again.step(recording.scan(k))
    np.testing.assert_array_equal(one.position_m, other.position_m)
    np.testing.assert_array_equal(slam.map().features.position_m, again.map().features.position_m)
    assert slam.state.networks.places.moves == 40
    assert slam.map().surfaces is None, "what the networks say isn't known to be a mirror"
