"""Disturbed cases: what changes is what should, and the unusual paths obey closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gridslam as gs
from gridslam.simulation import disturbances, unusual_paths
from gridslam.simulation.image_source import true_paths
from gridslam.world import geometry
from gridslam.world.columns import KEYS, VALUES

CASE = disturbances.undisturbed(gs.Scene.load("room"), seed=1)


@pytest.fixture(scope="module")
def room():
    return CASE


def rows(measurements, keep):
    return [getattr(measurements, name)[keep] for name in (*KEYS, *VALUES)]


def test_the_filter_is_told_neither_walls_nor_way(room):
    assert room.believed.walls == ()
    assert all(agent.waypoints_m is None for agent in room.believed.agents)
    assert room.scene.walls


def test_silence_removes_its_steps_and_nothing_else(room):
    quiet = disturbances.silence(room, 60, 30)
    gone = (room.measurements.step >= 60) & (room.measurements.step < 90)
    assert len(quiet.measurements) == len(room.measurements)
    for one, two in zip(rows(quiet.measurements, slice(None)), rows(room.measurements, ~gone), strict=True):
        np.testing.assert_array_equal(one, two)
    assert not ((quiet.paths.step >= 60) & (quiet.paths.step < 90)).any()


@pytest.mark.parametrize("steps", [(-1, 5), (149, 2), (10, 0)])
def test_a_disturbance_beyond_the_way_is_refused(room, steps):
    with pytest.raises(gs.InputError):
        disturbances.silence(room, *steps)


def test_a_burst_adds_clutter_of_the_right_number_and_leaves_the_rest(room):
    burst = disturbances.clutter_burst(room, 60, 20, times=10)
    before, inside = room.measurements, (burst.measurements.step >= 60) & (burst.measurements.step < 80)
    for one, two in zip(
        rows(burst.measurements, ~inside), rows(before, (before.step < 60) | (before.step >= 80)), strict=True
    ):
        np.testing.assert_array_equal(one, two)
    added = len(burst.measurements.step) - len(before.step)
    mean = 9 * 2.0 * 2 * 20  # nine times two more at two anchors for twenty steps
    assert abs(added - mean) < 5 * np.sqrt(mean)
    assert (burst.measurements.amplitude >= 10 ** (6 / 20)).all()


def test_wrong_numbers_change_what_is_told_and_not_what_is_heard(room):
    clutter = disturbances.stated_clutter(room, 2.0)
    snr = disturbances.stated_snr(room, 0.5)
    assert clutter.believed.radio.false_alarms == 2 * room.scene.radio.false_alarms
    assert snr.believed.radio.snr_at_1m_db == pytest.approx(room.scene.radio.snr_at_1m_db - 3.0103)
    for case in (clutter, snr):
        assert case.measurements is room.measurements
        assert (case.first, case.last) == (0, len(room.track))


def test_a_turned_anchor_is_turned_in_what_is_told_alone(room):
    case = disturbances.stated_orientation(room, 2.0)
    turn = case.believed.anchor_orientations - room.scene.anchor_orientations
    np.testing.assert_allclose(np.degrees(turn), [2.0, 0.0], atol=1e-9)
    np.testing.assert_array_equal(case.measurements.aod_rad, room.measurements.aod_rad)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_a_vague_start_lies_within_what_is_told(seed):
    scene = gs.Scene.load("room")
    case = disturbances.vague_start(replace(CASE, seed=seed), 2.0, 30.0)
    own = case.believed.agents[0]
    assert (np.abs(np.array(own.start_m) - CASE.track.position_m[0]) <= 2.0 + 1e-9).all()
    assert scene.grid.holds(np.array(own.start_m))
    assert abs(own.start_heading_deg - np.degrees(CASE.track.heading_rad[0])) <= 30.0 + 1e-9
    assert (own.prior.position_m, own.prior.heading_deg) == (2.0, 30.0)


def test_triple_bounces_of_a_rectangle_are_its_lattice_of_images(room):
    paths = unusual_paths.triple_bounces(room.scene, room.agent, room.track)
    i, j = np.array([(i, j) for i in range(-3, 4) for j in range(-3, 4) if abs(i) + abs(j) == 3]).T
    for step in (0, 77):
        for anchor, (x, y) in enumerate(room.scene.anchor_positions):
            # the room is 8 x 6 m about the origin: image (i, j) of an anchor
            image = np.stack([8 * i + (-1.0) ** i * x, 6 * j + (-1.0) ** j * y], -1)
            expected = np.linalg.norm(image - room.track.position_m[step], axis=1)
            own = (paths.step == step) & (paths.anchor == anchor)
            np.testing.assert_allclose(np.sort(paths.distance_m[own]), np.sort(expected), rtol=1e-9)
            gain = paths.amplitude[own] * paths.distance_m[own] / 10**1.5
            np.testing.assert_allclose(gain, 0.7**3, rtol=1e-9)


def test_triple_bounces_leave_as_seen_from_the_other_end(room):
    """Agent and anchor swapped, the path is the same, so departures are the other way's arrivals."""
    paths = unusual_paths.triple_bounces(room.scene, room.agent, room.track)
    first = paths.take((paths.step == 0) & (paths.anchor == 0))
    here, there = room.track.position_m[0], room.scene.anchor_positions[0]
    back = gs.Trajectory(np.zeros(1), there[None], np.zeros((1, 2)), np.zeros(1))
    data = room.scene.model_dump(exclude_none=True)
    data["anchors"][0].update(position_m=here.tolist(), orientation_deg=0.0)
    mirrored = unusual_paths.triple_bounces(gs.Scene.checked(data, "room"), room.agent, back)
    own = mirrored.take(mirrored.anchor == 0)
    np.testing.assert_allclose(np.sort(own.distance_m), np.sort(first.distance_m), rtol=1e-9)
    away = first.aod_rad + room.scene.anchor_orientations[0]
    order, other = np.argsort(first.distance_m), np.argsort(own.distance_m)
    gap = geometry.wrap(own.aoa_rad[other] - away[order])
    np.testing.assert_allclose(gap, 0, atol=1e-9)


def test_grazing_coefficients_rise_from_the_normal_one_to_one():
    cosine = np.linspace(1, 0, 50)
    value = unusual_paths.fresnel(np.full(50, 0.39), cosine)
    assert value[0] == pytest.approx(0.39)
    assert value[-1] == pytest.approx(1.0)
    assert (np.diff(value) > 0).all()
    assert unusual_paths.fresnel(np.array(0.39), np.cos(np.radians(86.0))) == pytest.approx(0.93, abs=0.01)


def test_grazing_leaves_the_line_of_sight_and_the_geometry(room):
    changed = unusual_paths.grazing(room.scene, room.paths, 0.56)
    direct = room.paths.bounces == 0
    np.testing.assert_array_equal(changed.amplitude[direct], room.paths.amplitude[direct])
    np.testing.assert_array_equal(changed.distance_m, room.paths.distance_m)
    single = room.paths.bounces == 1
    ratio = changed.amplitude[single] / room.paths.amplitude[single]
    assert ratio.min() >= 0.56 * (1 - 1e-9)
    assert ratio.max() < 1 / 0.7


def test_diffuse_points_lie_on_both_legs(room):
    draw = np.random.default_rng(3)
    paths = unusual_paths.diffuse_points(room.scene, room.agent, room.track, 1, 0.8, draw)
    assert set(paths.anchor) == {0, 1}
    assert set(np.bincount(paths.step)) == {2}  # a convex room hides nothing
    place = np.random.default_rng(3).uniform([-4.8, -3.8], [4.8, 3.8])
    legs = [np.linalg.norm(place - p) for p in (room.scene.anchor_positions[0], room.track.position_m[5])]
    own = (paths.step == 5) & (paths.anchor == 0)
    assert paths.distance_m[own] == pytest.approx(sum(legs))
    assert paths.amplitude[own] == pytest.approx(10**1.5 * 0.8 / (legs[0] * legs[1]))


def test_strides_are_long_and_their_paths_belong_to_them(room):
    case = disturbances.strides(room, times=10, steps=40)
    lengths = np.linalg.norm(np.diff(case.track.position_m, axis=0), axis=1)
    assert len(case.track) == 40
    assert (lengths <= 0.5 + 1e-9).all()
    assert lengths.max() > 0.49
    again = true_paths(case.scene, case.agent, case.track)
    np.testing.assert_array_equal(again.distance_m, case.paths.distance_m)
    slow = disturbances.strides(room, times=10, steps=40, pause=True)
    assert slow.measurements.interval_s == 10 * case.measurements.interval_s
    speed = np.linalg.norm(slow.track.velocity_mps, axis=1)
    np.testing.assert_allclose(speed, 0.05)


def test_a_way_that_can_not_be_gone_round_is_refused():
    with pytest.raises(gs.InputError, match="round and round"):
        disturbances.strides(disturbances.undisturbed(gs.Scene.load("alcove")))


def test_a_disturbance_repeats_with_its_seed_and_differs_with_another(room):
    one, same = (disturbances.clutter_burst(room, 60, 20) for _ in range(2))
    other = disturbances.clutter_burst(replace(room, seed=2), 60, 20)
    np.testing.assert_array_equal(one.measurements.distance_m, same.measurements.distance_m)
    assert (
        len(one.measurements.step) != len(other.measurements.step)
        or (one.measurements.aod_rad != other.measurements.aod_rad).any()
    )
