"""Images in walls that other images show: where they are, and what is tied, settled, proposed or dropped."""

from dataclasses import replace

import numpy as np
import pytest
from delay_snapshots import BAND, received
from image_states import with_images

import gridslam as gs
from gridslam.inference.management.samples.image_merging import merge_images
from gridslam.inference.management.samples.image_ties import share_walls
from gridslam.inference.messages.samples.common_walls import TIE_M, places_by_walls
from gridslam.inference.messages.samples.image_births import (
    NewDistance,
    birth_rate,
    find_births,
)
from gridslam.inference.messages.samples.image_prediction import predict_paths
from gridslam.inference.messages.samples.image_proposals import (
    confirm_proposals,
    judge_proposals,
    propose_images,
    retire_substitutes,
)
from gridslam.inference.messages.samples.path_levels import update_levels
from gridslam.inference.messages.samples.ring_births import add_tentative
from gridslam.world.geometry import mirror

FLOOR, SIDE = np.array([-0.5 * np.pi, 0.0]), np.array([0.0, 9.0])  # y = 0, x = 9


@pytest.fixture(scope="module")
def model():
    scene = gs.Scene.load("overlap")
    return replace(scene.filter_model("agent1"), max_bounces=2)


def images_of(model, anchor):
    """In the floor, in the side wall, and over both."""
    position = model.anchor_positions[anchor]
    one, other = mirror(FLOOR, position), mirror(SIDE, position)
    return one, other, mirror(SIDE, one)


def test_a_wall_that_one_anchor_shows_mirrors_the_other_one(model):
    state = with_images(model, (0, images_of(model, 0)[0], 0))
    places = places_by_walls(state, 1, model)
    np.testing.assert_allclose(places.place, [images_of(model, 1)[0]], atol=1e-9)
    assert len(places_by_walls(state, 0, model)) == 0  # its own wall tells an anchor nothing


@pytest.mark.parametrize(("bounces", "count"), [(1, 1), (2, 0)])
def test_a_vague_wall_tells_where_paths_are_few(model, bounces, count):
    state = with_images(model, (0, images_of(model, 0)[0], 0), spread=0.3)
    assert len(places_by_walls(state, 1, replace(model, max_bounces=bounces))) == count


def test_the_farthest_of_three_places_is_the_double_bounce(model):
    floor, side, both = images_of(model, 1)
    places = places_by_walls(with_images(model, (1, floor, 0), (1, side, 0)), 1, model)
    np.testing.assert_allclose(places.place, [both], atol=1e-9)
    assert places.bounces.tolist() == [2]
    assert len(places_by_walls(with_images(model, (1, floor, 0), (1, both, 0)), 1, model)) == 0
    assert len(places_by_walls(with_images(model, (1, floor, 0), (1, side, 0)), 1, model, proven=True)) == 0
    single = replace(model, max_bounces=1)
    assert len(places_by_walls(with_images(model, (1, floor, 0), (1, side, 0)), 1, single)) == 0


def test_slopes_of_places_are_those_of_differences(model):
    state = with_images(model, (0, images_of(model, 0)[0], 0), (1, images_of(model, 1)[1], 0), spread=0.01)
    for anchor, count in ((0, 2), (1, 2)):
        places = places_by_walls(state, anchor, model)
        assert len(places) == count
        for entry in range(len(state.belief.mean)):
            ahead, back = (
                places_by_walls(
                    replace(state, belief=replace(state.belief, mean=state.belief.mean + step)), anchor, model
                ).place
                for step in (s * np.eye(len(state.belief.mean))[entry] for s in (1e-6, -1e-6))
            )
            np.testing.assert_allclose(places.slope[..., entry], (ahead - back) / 2e-6, atol=1e-5)


def test_images_in_one_wall_are_tied_once_and_narrow_each_other(model):
    here, there = images_of(model, 0)[0], images_of(model, 1)[0]
    state = with_images(model, (0, here, 0), (1, there + np.array([0.03, -0.04]), 0))
    tied = share_walls(state, model)
    assert tied.images.bounces.tolist() == [1, 1]
    gap = tied.places[1] - places_by_walls(tied, 1, model).place[0]
    assert np.linalg.norm(gap) < 2 * TIE_M
    before, after = (np.linalg.eigvalsh(s.place_covariances).max(-1) for s in (state, tied))
    assert (after < before).all()
    assert after[1] < 0.75 * before[1]
    for _ in range(3):  # as seen from the other anchor they may differ by more
        tied = share_walls(tied, model)
    assert share_walls(tied, model) is tied


@pytest.mark.parametrize(
    ("visible", "beside", "comes_back"), [(0.01, 0.0, True), (0.01, 0.6, False), (0.9, 0.0, False)]
)
def test_a_ring_where_an_image_was_heard_is_that_image_back_again(model, visible, beside, comes_back):
    place = np.array([12.0, 7.0])
    state = with_images(model, (1, place, 0))
    state = replace(
        state, images=replace(state.images, visible=np.full(1, visible), existence=np.full(1, 0.6))
    )
    away = float(np.linalg.norm(place - state.belief.mean[:2]))
    fresh = ring_at(state, model, 1, away + beside)
    assert len(share_walls(fresh, model).tentative) == 1  # it may be another wall's
    after = share_walls(leaning(fresh, place), model)
    assert len(after.tentative) == (0 if comes_back else 1)
    assert len(after.images) == 1
    if comes_back:
        assert (after.images.visible[0], after.images.intensity[0]) == (0.95, 50.0)
        assert after.images.existence[0] == pytest.approx(0.99)


def test_images_of_different_walls_are_not_tied(model):
    state = with_images(model, (0, images_of(model, 0)[0], 0), (1, images_of(model, 1)[0] + 0.4, 0))
    assert share_walls(state, model) is state


def ring_at(state, model, anchor, distance):
    return add_tentative(state, anchor, [NewDistance(0.99, distance, 0.01**2, 50.0)], model)


def leaning(state, place):
    """The state with its only ring within 1 m of a place."""
    rings = state.tentative.rings
    weight = (np.linalg.norm(rings.mean[:, :, 4:] - place, axis=-1) < 1.0).astype(float)
    rings = replace(rings, weight=weight / weight.sum())
    return replace(state, tentative=replace(state.tentative, rings=rings))


def test_a_ring_where_a_known_wall_puts_an_image_settles_there(model):
    state = with_images(model, (0, images_of(model, 0)[0], 0))
    place = images_of(model, 1)[0]
    away = float(np.linalg.norm(place - state.belief.mean[:2]))
    other = ring_at(state, model, 1, away + 0.6)
    assert len(share_walls(other, model).tentative) == 1
    # a fresh ring may be another wall's: it must lean towards the place
    settled = share_walls(leaning(ring_at(state, model, 1, away), place), model)
    assert len(settled.tentative) == 0
    assert settled.images.bounces.tolist() == [1, 1]
    np.testing.assert_allclose(settled.places[1], place, atol=1e-9)
    # its error is that of the image that showed the wall
    difference = settled.places[1] - places_by_walls(settled, 1, model).place[0]
    np.testing.assert_allclose(difference, 0, atol=1e-9)


def sampled(state, model, anchor, places, seed, snr_db=25.0):
    """Samples of line of sight and images, and what a step finds in them."""
    rng, start = np.random.default_rng(seed), model.start_mean[:2]
    span = [np.linalg.norm(start - p) for p in (model.anchor_positions[anchor], *places)]
    amplitude = 10 ** (snr_db / 20) * np.exp(2j * np.pi * rng.random(len(span)))
    samples = received(rng, span, amplitude)
    links = replace(state.links, intensity=np.full(2, 10 ** (snr_db / 10)), heard=np.full(2, 10.0))
    state = replace(state, links=links)
    paths = predict_paths(state, anchor, model)
    return state, paths, find_births(BAND, samples, paths.prior, 1.0, birth_rate(100, 2))


def test_an_image_is_proposed_where_its_path_is_heard_only(model):
    place = images_of(model, 1)[0]
    state = with_images(model, (0, images_of(model, 0)[0], 0))
    for places, count in (([place], 2), ([], 1), ([place - np.array([0.0, 2.0])], 1)):
        begun = propose_images(*sampled(state, model, 1, places, 1), model)
        assert len(begun.images) == count, places
    begun = propose_images(*sampled(state, model, 1, [place], 1), model)
    assert begun.images.bounces.tolist() == [0, -1]
    assert merge_images(begun) is begun


def test_a_proposed_image_is_judged_without_what_stands_in_for_it(model):
    """A loose image on the same path explains it; the proposed one is believed all the same, and stays."""
    place = images_of(model, 1)[0]
    state = with_images(model, (0, images_of(model, 0)[0], 0))
    state = propose_images(*sampled(state, model, 1, [place], 1), model)
    away = float(np.linalg.norm(place - state.belief.mean[:2]))
    state = ring_at(state, model, 1, away)
    state, paths, found = sampled(state, model, 1, [place], 2)
    plain = found.inverse.without(found.mode.distance)
    matched, own = judge_proposals(state, paths, found)
    assert matched[1] / own[1] > 5 * plain[0][1] / plain[1][1]
    assert matched[0] == plain[0][0]
    assert own[0] == plain[1][0]
    for seed in range(3, 6):
        state = update_levels(*sampled(state, model, 1, [place], seed))
        state = retire_substitutes(*sampled(state, model, 1, [place], seed))
    assert state.images.existence[1] > 0.9
    assert state.tentative.rings.existence[0] < 0.95
    assert confirm_proposals(state).images.bounces.tolist() == [0, -1]  # not heard for long yet
    long = replace(state, images=replace(state.images, heard=np.full(2, 20.0)))
    assert confirm_proposals(long).images.bounces.tolist() == [0, 1]


@pytest.mark.parametrize("crosses", [False, True])
def test_who_stays_in_a_sure_images_place_goes_and_who_crosses_it_stays(model, crosses):
    """As far away on another side: on the way to their middle both lengthen alike, across it they part."""
    place, start = images_of(model, 1)[0], model.start_mean[:2]
    away = place - start
    aside = np.array([-away[1], away[0]])
    stranger = start + np.cos(0.7) * away + np.sin(0.7) * aside
    state = with_images(model, (1, place, 1), (1, stranger, 0), spread=0.3)
    middle = away + stranger - start
    toward = middle if not crosses else np.array([-middle[1], middle[0]])
    mean = state.belief.mean.copy()
    mean[2:4] = 0.02 * toward / np.linalg.norm(toward)
    state = replace(state, belief=replace(state.belief, mean=mean))
    after = retire_substitutes(*sampled(state, model, 1, [place], 1))
    assert after.images.existence[0] == state.images.existence[0]
    assert (after.images.existence[1] < state.images.existence[1]) == (not crosses)


def test_a_proposed_image_without_a_path_is_given_up(model):
    state = with_images(model, (0, images_of(model, 0)[0], 0))
    state = propose_images(*sampled(state, model, 1, [images_of(model, 1)[0]], 1), model)
    for seed in range(10):
        state = update_levels(*sampled(state, model, 1, [], seed))
    assert state.images.existence[1] < 0.06
