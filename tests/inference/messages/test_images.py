"""Images of direct SLAM: joining, merging, coming back; the line of sight reclaimed; the mode by sampling."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from delay_snapshots import BAND, received, snapshot

import gridslam as gs
from gridslam.inference.beliefs.belief import append
from gridslam.inference.management.samples.image_merging import merge_images
from gridslam.inference.messages.samples import image_births
from gridslam.inference.messages.samples.distance_mode import Mode, PathPrior, joint_mode
from gridslam.inference.messages.samples.image_births import (
    NewDistance,
    birth_rate,
    find_births,
    with_sight,
)
from gridslam.inference.messages.samples.image_prediction import (
    AnchorPaths,
    image_distances,
    predict_paths,
    presence,
    update_state,
    weighed_by_presence,
)
from gridslam.inference.messages.samples.image_rings import forbid_own_place, join_straight_rings
from gridslam.inference.messages.samples.path_levels import reclaim_line_of_sight, update_levels
from gridslam.inference.messages.samples.ring_births import add_tentative
from gridslam.inference.messages.samples.signal_likelihood import log_densities
from gridslam.inference.state.samples.images import DirectState, Images
from gridslam.world.geometry import unit

RATE = birth_rate(100, 1)


@pytest.fixture(scope="module")
def model():
    return gs.Scene.load("overlap").filter_model("agent1")


def state_with(model, *places, spread=0.05):
    """A state with settled images of anchor 0 at given places, independent of each other."""
    state = DirectState.start(model.start_mean[:4], model.start_variance[:4], len(model.anchors))
    belief, images = state.belief, state.images
    for number, place in enumerate(places):
        away = np.asarray(place) - state.belief.mean[:2]
        span = np.hypot(*away)
        belief = append(
            belief, np.array([np.arctan2(away[1], away[0]), span]), spread**2 * np.diag([1 / span**2, 1])
        )
        one = np.array([1.0])
        images = images.joined(
            Images(np.array([number]), np.array([0]), belief.mean[None, :2], 0.9 * one, 0.8 * one,
                   50.0 * one, (10.0 - number) * one, np.array([20]), np.full((1, 2), np.nan),
                   np.zeros(1, np.int64))
        )  # fmt: skip
    return replace(state, belief=belief, images=images, next_identity=len(places))


def test_slopes_of_distances_are_those_of_differences(model):
    state = state_with(model, [9.0, 3.0], [1.0, -6.0])
    rows, position = np.arange(2), model.anchor_positions[0]
    sure = replace(state.belief, covariance=0 * state.belief.covariance)  # nothing bends then
    _, slope, _ = image_distances(replace(state, belief=sure), rows, position)
    for entry in range(8):
        ahead, back = (
            image_distances(replace(state, belief=replace(sure, mean=sure.mean + step)), rows, position)[0]
            for step in (1e-6 * np.eye(8)[entry], -1e-6 * np.eye(8)[entry])
        )
        np.testing.assert_allclose(slope[:, entry], (ahead - back) / 2e-6, atol=1e-6)


def test_two_images_of_one_place_become_one_between_them(model):
    state = state_with(model, [9.0, 3.0], [9.06, 3.0], [1.0, -6.0])
    merged = merge_images(state)
    assert merged.images.identity.tolist() == [0, 2]
    np.testing.assert_allclose(merged.places, [[9.03, 3.0], [1.0, -6.0]], atol=2e-3)
    np.testing.assert_allclose(merged.place_covariances[0], 0.5 * 0.05**2 * np.eye(2), atol=1e-4)
    apart = state_with(model, [9.0, 3.0], [9.4, 3.0])
    assert len(merge_images(apart).images) == 2


def test_a_ring_joins_where_it_is_once_its_arc_is_short(model):
    state = state_with(model)
    state = add_tentative(state, 0, [NewDistance(0.99, 6.0, 1e-4, 50.0)], model)
    assert len(join_straight_rings(state).images) == 0
    rings = state.tentative.rings
    away = rings.mean[0, :, 4:] - state.belief.mean[:2]
    bearing = np.arctan2(away[:, 1], away[:, 0])
    short = np.exp(-0.5 * ((bearing - 0.7) / 0.05) ** 2)
    short = replace(rings, weight=(short / short.sum())[None])
    joined = join_straight_rings(replace(state, tentative=replace(state.tentative, rings=short)))
    assert (len(joined.images), len(joined.tentative)) == (1, 0)
    np.testing.assert_allclose(joined.places[0], state.belief.mean[:2] + 6 * unit(0.7), atol=0.1)
    # the image hangs together with the agent: its distance is surer than the agent's place
    _, slope, _ = image_distances(joined, np.array([0]), model.anchor_positions[0])
    variance = slope[1] @ joined.belief.covariance @ slope[1]
    assert variance == pytest.approx(1e-4, rel=0.2)
    assert joined.belief.covariance[0, 0] > 10 * variance


def test_an_image_at_its_anchor_goes(model):
    state = state_with(model, model.anchor_positions[0] + [0.3, 0.0], [9.0, 3.0])
    assert forbid_own_place(state, model).images.identity.tolist() == [1]


@pytest.mark.slow
def test_the_line_of_sight_is_reclaimed_from_what_stands_in_its_place(model):
    agent, anchor = model.start_mean[:2], model.anchor_positions[0]
    far = np.linalg.norm(agent - anchor)
    state = state_with(model, agent + (far + 0.05) * unit(0.3), agent + 9 * unit(1.0))
    links = replace(state.links, visible=np.array([0.1, 0.9]), intensity=np.ones(2), noise=np.ones(2))
    state = replace(state, links=links)
    for _ in range(5):
        assert len(state.images) == 2
        paths = predict_paths(state, 0, model)
        mode = joint_mode(BAND, 20 * BAND.response(far), paths.prior, 1.0)
        state = reclaim_line_of_sight(state, paths, mode, model)
    assert state.images.identity.tolist() == [1]
    assert state.links.visible[0] == 0.9
    assert state.links.intensity[0] == 50.0


@pytest.mark.parametrize(("deviation", "stays"), [(0.4, False), (1.2, True)])
def test_an_agent_that_drifted_is_put_where_its_line_of_sight_says(model, deviation, stays):
    """The shortest path, 0.5 m farther than the anchor is believed to be; if that is known to c/B at all."""
    agent, anchor = model.start_mean[:2], model.anchor_positions[0]
    far = np.linalg.norm(agent - anchor)
    state = state_with(model, agent + (far + 0.5) * unit(0.3), agent + (far + 0.7) * unit(1.0))
    links = replace(state.links, visible=np.array([0.1, 0.9]), intensity=np.ones(2), noise=np.ones(2))
    covariance = state.belief.covariance.copy()
    covariance[:2, :2] = deviation**2 * np.eye(2)
    images = replace(state.images, existence=np.full(2, 0.99), visible=np.full(2, 0.99))
    state = replace(state, links=links, images=images)
    state = replace(state, belief=replace(state.belief, covariance=covariance))
    lengths = np.array([far, far + 0.5, far + 0.7])
    for _ in range(5):
        assert len(state.images) == 2
        paths = predict_paths(state, 0, model)
        mode = Mode(lengths, 1e-4 * np.eye(3), 0.0, BAND, BAND.response(far), paths.prior.weight, 1.0)
        state = reclaim_line_of_sight(state, paths, mode, model)
    if stays:
        assert len(state.images) == 2
        return
    assert state.images.identity.tolist() == [1]
    assert state.links.visible[0] == 0.9
    assert np.linalg.norm(state.belief.mean[:2] - anchor) == pytest.approx(far + 0.5, abs=0.03)
    assert state.belief.covariance[0, 0] + state.belief.covariance[1, 1] < 1.1 * deviation**2


@pytest.mark.slow
def test_mode_and_covariance_are_those_of_the_posterior():
    """Three overlapping paths, against importance sampling of their distances."""
    rng = np.random.default_rng(3)
    distance, weight = np.array([4.0, 4.45, 6.0]), np.array([400.0, 300.0, 100.0])
    amplitude = np.sqrt(weight) * np.exp(1j * np.array([0.3, 1.9, -2.0]))
    samples = received(rng, distance, amplitude)
    prior = PathPrior(distance + np.array([0.02, -0.01, 0.03]), np.diag([400.0, 400.0, 100.0]), weight)
    mode = joint_mode(BAND, samples, prior, 1.0)
    root = np.linalg.cholesky(2 * mode.covariance)
    drawn = rng.normal(size=(4_000, 3))
    tried = mode.distance + drawn @ root.T
    off = tried - prior.mean
    logs = log_densities(BAND, samples, tried, weight, 1.0) - 0.5 * ((off @ prior.precision) * off).sum(1)
    logs += 0.5 * (drawn**2).sum(1)
    share = np.exp(logs - logs.max())
    share /= share.sum()
    mean = share @ tried
    covariance = (share[:, None] * (tried - mean)).T @ (tried - mean)
    deviation = np.sqrt(np.diag(mode.covariance))
    assert (np.abs(mode.distance - mean) < 0.3 * deviation).all()
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), deviation, rtol=0.15)


def away(model, visible, existence=0.3):
    """A state with one image that has hardly been seen for long, and its anchor's paths."""
    state = state_with(model, model.start_mean[:2] + 6 * unit(1.5))
    images = replace(
        state.images,
        visible=np.array([visible]),
        existence=np.array([existence]),
        intensity=np.array([200.0]),
    )
    links = replace(state.links, visible=np.ones(2), intensity=np.full(2, 300.0), noise=np.ones(2))
    state = replace(state, images=images, links=links)
    return state, predict_paths(state, 0, model)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("off", [0.0, 0.05])
def test_a_path_that_is_back_is_its_images(model, seed, off):
    state, paths = away(model, 0.001)
    sight, image = paths.prior.mean
    found = find_births(BAND, snapshot(seed, (sight, 17), (image + off, 14)), paths.prior, 1.0, RATE)
    assert not found.new
    assert found.prior.weight[1] == 200.0
    assert found.mode.distance[1] == pytest.approx(image + off, abs=0.08)
    after = update_levels(state, paths, found).images
    assert after.visible[0] > 0.99
    assert after.existence[0] > 0.9


def test_a_path_elsewhere_is_new_and_the_image_stays_away(model):
    state, paths = away(model, 0.001)
    sight, image = paths.prior.mean
    found = find_births(BAND, snapshot(5, (sight, 17), (image + 1.5, 14)), paths.prior, 1.0, RATE)
    assert [new.distance for new in found.new] == pytest.approx([image + 1.5], abs=0.05)
    assert found.prior.weight[1] < 1.0
    assert update_levels(state, paths, found).images.visible[0] < 0.1


def test_nothing_is_solved_twice(monkeypatch):
    searches, solve = [], image_births.joint_mode

    def noted(band, samples, prior, noise):
        searches.append((prior.mean.tobytes(), prior.weight.tobytes()))
        return solve(band, samples, prior, noise)

    monkeypatch.setattr(image_births, "joint_mode", noted)
    prior = PathPrior(np.array([4.0]), np.array([[1e4]]), np.array([300.0]))
    samples = snapshot(3, (4.0, 17), (6.0, 4.0), (8.1, 3.5), (11.0, 3.0), (15.0, 2.8))
    found = find_births(BAND, samples, prior, 1.0, 0.5)
    assert len(found.new) > 2
    assert len(searches) > len(found.new)
    assert len(set(searches)) == len(searches)


def test_noise_brings_nothing_back(model):
    _, paths = away(model, 0.001)
    samples = (snapshot(seed, (paths.prior.mean[0], 17)) for seed in range(40))
    mine = [find_births(BAND, one, paths.prior, 1.0, RATE).prior.weight[1] for one in samples]
    assert max(mine) < 200.0


def test_a_path_tells_as_much_as_it_is_there(model):
    """All there: the mode; all away: the prediction; half there: something between."""
    _, paths = away(model, 0.5, existence=1.0)
    mode = joint_mode(BAND, snapshot(3, (paths.prior.mean[1] + 0.05, 30.0)), paths.prior, 1.0)
    for there, mean, covariance in (
        (np.ones(2), mode.distance, mode.covariance),
        (np.zeros(2), paths.prior.mean, paths.covariance),
    ):
        reached, spread = weighed_by_presence(paths, mode, there)
        np.testing.assert_allclose(reached, mean, rtol=1e-9)
        np.testing.assert_allclose(spread, covariance, rtol=1e-6, atol=1e-12)


def test_a_line_of_sight_that_is_there_by_a_quarter_tells_a_quarter():
    """By hand: deviation 2 m before and 1 m at the mode, so that 3/4 per m^2 is told; of it 3/16 enters."""
    one, four = np.ones((1, 1)), np.full((1, 1), 4.0)
    prior = PathPrior(np.zeros(1), one / 4, np.ones(1))
    paths = AnchorPaths(0, np.zeros(0, np.intp), np.zeros(0, np.intp), one, four, np.ones(1), prior)
    mode = Mode(np.ones(1), one, 0.0, BAND, np.zeros(41, complex), np.ones(1), 1.0)
    reached, spread = weighed_by_presence(paths, mode, np.array([0.25]))
    assert spread[0, 0] == pytest.approx(16 / 7)
    assert reached[0] == pytest.approx(4 / 7)


def test_the_line_of_sight_is_there_by_bayes_rule_and_images_tell_all_that_their_mode_does(model):
    """By hand: intensity 3 and g = 1 make the ratio exp(3/4 |y|^2) / 4, here 4; odds 1 : 4 become 1 : 1."""
    state, paths = away(model, 0.5)
    state = replace(state, links=replace(state.links, intensity=np.full(2, 3.0)))
    paths = replace(paths, prior=replace(paths.prior, chance=np.array([0.2, 0.2])))
    found = SimpleNamespace(apart=(np.full(2, 4 / 3 * np.log(16)), np.ones(2)))
    np.testing.assert_allclose(presence(state, paths, found), [0.5, 1.0])


def test_noise_tells_nothing_of_paths_that_are_away(model):
    """A strong line of sight that went is expected on average still; noise at its place isn't it."""
    state, _ = away(model, 0.0)
    state = replace(state, links=replace(state.links, visible=np.zeros(2)))
    for seed in range(20):
        paths = predict_paths(state, 0, model)
        found = find_births(BAND, snapshot(seed), paths.prior, 1.0, RATE)
        state = update_state(state, paths, found)
    start = model.start_variance[:2].sum()
    assert np.trace(state.belief.covariance[:2, :2]) > 0.9 * start
    np.testing.assert_allclose(state.belief.mean[:2], model.start_mean[:2], atol=0.03)


def test_images_that_are_seen_are_not_away(model):
    _, paths = away(model, 0.9)
    assert not paths.prior.away.any()
    prior = PathPrior(np.ones(2), np.eye(2), np.array([3.0, 0.1]), np.array([0.0, 4.0]))
    back = prior.back(1)
    assert (back.weight.tolist(), back.away.tolist()) == ([3.0, 4.0], [0.0, 0.0])
    assert prior.weight.tolist() == [3.0, 0.1]
    assert back.with_path(2.0, 1.0).away.tolist() == [0.0, 0.0, 0.0]


def test_a_path_that_is_back_is_there_for_sure():
    prior = PathPrior(
        np.array([5.0, 5.0]), np.eye(2), np.array([3.0, 0.1]), np.array([0.0, 4.0]), np.array([0.9, 0.2])
    )
    assert prior.back(1).chances.tolist() == [0.9, 1.0]
    assert prior.chances.tolist() == [0.9, 0.2]


def test_a_ring_is_there_by_its_existence_and_the_chance_that_a_path_stays(model):
    state = add_tentative(state_with(model), 0, [NewDistance(0.4, 6.0, 1e-4, 50.0)], model)
    rings = replace(state.tentative.rings, existence=np.array([0.4]))
    state = replace(state, tentative=replace(state.tentative, rings=rings))
    prior = predict_paths(state, 0, model).prior
    assert prior.chances[1] == pytest.approx(0.97 * 0.4)
    assert prior.weight[1] == pytest.approx(0.4 * 50.0)


@pytest.mark.parametrize(
    ("amplitude", "believed", "low", "high"),
    [(17.0, 5.0, 50.0, 150.0), (17.0, 300.0, 300.0, 300.0), (0.0, 5.0, 5.0, 5.0)],
)
def test_the_line_of_sight_may_be_louder_at_first_than_was_guessed(amplitude, believed, low, high):
    prior = PathPrior(np.array([5.0, 6.0]), np.diag([150.0, 10.0]), np.array([believed, 60.0]))
    found = with_sight(BAND, snapshot(3, (5.0, amplitude), (6.0, 8.0)), prior, 1.0)
    assert low <= found.weight[0] <= high
    assert found.weight[1] == 60.0


def test_a_faded_line_of_sight_keeps_its_place_at_first():
    prior = PathPrior(np.array([4.75, 5.4]), np.diag([150.0, 5.0]), np.array([4.0, 40.0]))
    samples = snapshot(1, (4.75, 12.0), (5.43, 6.0))
    taken, kept = (find_births(BAND, samples, prior, 1.0, 0.05, first).mode for first in (False, True))
    assert taken.distance[1] < 5.0  # the reflection stands in the line of sight's place
    assert kept.distance[:2] == pytest.approx([4.75, 5.43], abs=0.1)
