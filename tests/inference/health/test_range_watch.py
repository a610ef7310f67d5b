"""Offsets of distances, by lines of sight that cross: named with size, sign and anchor, and never falsely."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scene_samples import raised
from tables import late

import gridslam as gs
from gridslam.inference.health import reasons
from gridslam.inference.health.crossings import crossing_of
from gridslam.inference.health.range_fits import Crossing, errors_of, shift_of
from gridslam.inference.health.range_watch import LEAST_STEPS, RangeWatch
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.deviations import own_deviations

ROOM = gs.Scene.load("room").with_filter(particles=512)


def watched(scene, measurements):
    """What is told after every look, each third step."""
    return [watch.doubt for watch in looked(scene.filter_model("agent1"), measurements)]


def crossing_at(scan, model):
    """Where lines of sight of a scan cross."""
    scans = split_by_anchor(scan, model)
    return crossing_of(scans, own_deviations(scans, model.radio), model)


def looked(model, measurements):
    """What is known after every look."""
    watch, found = RangeWatch.start(model.senders), []
    for step in range(0, len(measurements), 3):
        crossing = crossing_at(measurements.scan(step), model)
        if crossing is not None:
            watch = watch.crossed(crossing, model)
            found.append(watch)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "metres", "anchor", "words"),
    [
        ("room", 1.5, None, r"all anchors seem 1\.[45]\d m \(5\.\d ns\) too long"),
        ("alcove", -0.8, 1, r"anchor B seem 0\.[78]\d m \(2\.\d ns\) too short"),
        ("canyon", 0.5, None, r"all anchors seem 0\.[45]\d m \(1\.\d ns\) too long"),
    ],
)
def test_an_offset_is_named_with_anchor_size_and_sign(name, metres, anchor, words):
    scene = gs.Scene.load(name)
    offsets = watched(scene, late(gs.simulate(scene, "agent1", 21), metres, anchor))
    assert re.search(words, offsets[-1])
    assert all(not one or re.search("seem .* too " + words.split()[-1], one) for one in offsets)


@pytest.mark.parametrize(("metres", "anchor"), [(1.5, None), (1.5, 0)])
def test_an_offset_is_named_among_what_explains_the_same_after_six_looks(metres, anchor):
    """It used to take 18 to 52 looks: the step of the largest gaps was taken for all that says so."""
    model, measurements = ROOM.filter_model("agent1"), late(gs.simulate(ROOM, "agent1", 25), metres, anchor)
    watch, said = RangeWatch.start(2), []
    for step in range(20):
        crossing = crossing_at(measurements.scan(step), model)
        watch = watch if crossing is None else watch.crossed(crossing, model)
        said += [] if crossing is None else [watch.doubt]
    assert not any(said[: LEAST_STEPS - 1])
    whose = "all anchors" if anchor is None else f"anchor {'AB'[anchor]}"
    found = re.search(rf"distances of {whose} seem ([\d.]+) m .*? too long", said[-1])
    assert float(found[1]) == pytest.approx(metres, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["room", "alcove", "hall", "facade", "ceiling", "pillars"])
def test_nothing_is_said_of_right_distances(name):
    scene = gs.Scene.load(name)
    assert not any(watched(scene, gs.simulate(scene, "agent1", 22)))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "shift"), [(31, (0.6, -0.5)), (32, (-0.9, 0.2)), (33, (0.1, 1.1))])
def test_an_anchor_of_three_that_stands_elsewhere_is_named_with_its_place(seed, shift):
    scene = gs.Scene.load("canyon")
    anchors = list(scene.anchors)
    true = np.array(anchors[1].position_m)
    anchors[1] = anchors[1].model_copy(update={"position_m": tuple(true - shift)})
    told = scene.model_copy(update={"anchors": tuple(anchors)})
    doubt = watched(told, gs.simulate(scene, "agent1", seed))[-1]
    found = re.search(r"anchor B stands near \((-?[\d.]+), (-?[\d.]+)\)", doubt)
    assert found, doubt
    np.testing.assert_allclose([float(found[1]), float(found[2])], true, atol=0.3)


def test_its_place_is_told_in_the_scenes_coordinates():
    """A filter that reckons about the middle of a region elsewhere says where anchors stand in the scene."""
    anchors = list(ROOM.anchors)
    x, y = anchors[0].position_m
    anchors[0] = anchors[0].model_copy(update={"position_m": (x + 0.7, y - 0.7)})
    model = ROOM.model_copy(update={"anchors": tuple(anchors)}).filter_model("agent1")
    heard, said = gs.simulate(ROOM, "agent1", 34), []
    for origin in (np.zeros(2), np.array([100.0, -50.0])):
        doubt = looked(replace(model, origin_m=origin), heard)[-1].doubt
        places = re.findall(r"stands near \((-?[\d.]+), (-?[\d.]+)\)", doubt)
        said.append(np.array(places, float) - origin)
    assert len(said[0]) == 2
    np.testing.assert_allclose(said[1], said[0], atol=0.11)  # each rounded to 0.1 m


def test_of_two_anchors_either_may_be_the_one_that_stands_elsewhere():
    anchors = list(ROOM.anchors)
    true = np.array([anchor.position_m for anchor in anchors])
    anchors[0] = anchors[0].model_copy(update={"position_m": (true[0][0] + 0.7, true[0][1] - 0.7)})
    told = ROOM.model_copy(update={"anchors": tuple(anchors)})
    doubt = watched(told, gs.simulate(ROOM, "agent1", 34))[-1]
    places = re.findall(r"anchor (\w) stands near \((-?[\d.]+), (-?[\d.]+)\)", doubt)
    assert sorted(name for name, _, _ in places) == ["A", "B"], doubt
    found = {name: np.array([float(x), float(y)]) for name, x, y in places}
    np.testing.assert_allclose(found["A"], true[0], atol=0.2)
    np.testing.assert_allclose(found["B"] - true[1], [0.7, -0.7], atol=0.2)


def test_one_stray_line_of_sight_of_an_anchor_is_no_offset():
    """Clutter whose heading happens to agree once, of an anchor that is never in sight otherwise."""
    slope = np.zeros((2, 2, errors_of(3)))
    slope[0, :, 0], slope[1, :, 1] = [1, 0], [0, 1]
    stray = np.zeros((2, 2, errors_of(3)))
    stray[0, :, 0], stray[1, :, 2] = [1, 0], [0, 1]
    model = gs.Scene.load("canyon").filter_model("agent1")
    assert model.senders == 3
    firm, watch = np.tile(400 * np.eye(2), (2, 1, 1)), RangeWatch.start(3)
    for step in range(30):
        if step == 2:
            watch = watch.crossed(Crossing(np.array([[0.0, 0.0], [0.0, 4.0]]), firm, stray), model)
        watch = watch.crossed(Crossing(np.zeros((2, 2)), firm, slope), model)
    assert watch.looks == (31, 30, 1)
    assert not watch.doubt


def test_one_path_over_a_wall_does_not_move_an_anchor_whose_bearing_is_told_badly():
    """Whatever a step says is explained by some place of the anchor; the steps beside it hardly doubt it."""
    model, watch = ROOM.filter_model("agent1"), RangeWatch.start(2)
    slope = np.zeros((2, 2, errors_of(2)))
    slope[0, :, 0], slope[1, :, 1] = [0, 1], [1, 0]
    for axis in (0, 1):
        slope[0, axis, shift_of(0, 2)[axis]] = slope[1, axis, shift_of(1, 2)[axis]] = -1
    for step in range(30):
        place, sharp = np.zeros((2, 2)), np.tile(np.diag([400.0, 0.1]), (2, 1, 1))
        sharp[0] = np.diag([400.0, 400.0])
        if step == 20:
            place[1], sharp[1] = [0.0, 2.0], np.diag([400.0, 100.0])
        watch = watch.crossed(Crossing(place, sharp, slope), model)
    assert watch.steps == 30
    assert watch.loudest[0].total == watch.total > 100
    assert not watch.doubt


@pytest.mark.parametrize("jumps_at", [24, 61])
def test_a_clock_that_jumps_in_mid_run_is_named_of_late(jumps_at):
    model, watch, said = ROOM.filter_model("agent1"), RangeWatch.start(2), []
    draw = np.random.default_rng(jumps_at)
    for step in range(jumps_at + 18):
        place = np.array([4 * np.cos(0.7 * step), 4 * np.sin(0.7 * step)])
        way = place - model.anchor_positions
        heading = np.arctan2(way[:, 1], way[:, 0])
        length = np.hypot(*way.T) + draw.normal(0, 0.02, 2) + [0.0, 2.0 * (step >= jumps_at)]
        scan = gs.Scan(
            0, 0.0, np.array([0, 1]), length, heading - model.anchor_orientations, heading + np.pi - 0.7,
            np.full(2, 30.0),
        )  # fmt: skip
        watch = watch.crossed(crossing_at(scan, model), model)
        said.append(watch.doubt)
    assert not any(said[:jumps_at])
    assert re.search(r"^of late distances of anchor B seem (1\.9|2\.0)\d m .* too long", said[-1])


def test_heights_that_a_scene_lacks_are_no_offset():
    tall = raised(ROOM, 1.9)
    offsets = watched(ROOM, gs.simulate(tall, "agent1", 23))
    assert all("above or below" in one for one in offsets if "too long" in one)
    assert "seem 2.0 m above or below" in offsets[-1]
    assert not any(watched(tall, gs.simulate(tall, "agent1", 23)))


def test_places_cross_at_the_agent_and_move_as_the_slopes_say():
    """Exact lines of sight of both anchors; then one distance is longer, and the other anchor is turned."""
    scene, pose = ROOM, np.array([0.4, -1.1, 0.7])
    model = scene.filter_model("agent1")

    def crossing(longer=0.0, turn=0.0, moved=0.0):
        away = pose[:2] - model.anchor_positions - np.array([[0.0, moved], [0.0, 0.0]])
        heading = np.arctan2(away[:, 1], away[:, 0])
        aod = heading - model.anchor_orientations - np.array([0.0, turn])
        scan = gs.Scan(
            0, 0.0, np.array([0, 1]), np.hypot(*away.T) + np.array([longer, 0.0]), aod,
            heading + np.pi - pose[2], np.full(2, 30.0),
        )  # fmt: skip
        return crossing_at(scan, model)

    exact = crossing()
    np.testing.assert_allclose(exact.place, [pose[:2]] * 2, atol=1e-9)
    np.testing.assert_allclose(
        crossing(longer=1e-4).place - exact.place, 1e-4 * exact.slope[..., 0], atol=1e-8
    )
    np.testing.assert_allclose(
        crossing(turn=-1e-4).place - exact.place, 1e-4 * exact.slope[..., 3], atol=1e-7
    )
    np.testing.assert_allclose(
        crossing(moved=1e-4).place - exact.place, 1e-4 * exact.slope[..., shift_of(0, 2)[1]], atol=1e-7
    )
    watch = RangeWatch.start(2).crossed(exact, model)
    assert (watch.count, watch.steps) == (2, 1)
    assert watch.total < 1e-12
    assert RangeWatch.start(2).crossed(crossing(longer=1.0), model).total > 100


def test_health_says_so_at_every_step_and_after_a_run_was_resumed(tmp_path):
    measurements, slam = late(gs.simulate(ROOM, "agent1", 24), 1.5, 0), gs.AdaptiveSlam(ROOM, seed=1)
    assert "distances" not in slam.step(measurements.scan(0)).health.why
    assert slam.population.ranges.steps == 1
    before = looked(ROOM.filter_model("agent1"), measurements)[-1]
    slam.now = slam.now._replace(believed=replace(slam.population, ranges=before))
    health = slam.step(measurements.scan(1)).health
    assert "distances of anchor A seem 1.5" in health.why
    assert not health.ok
    slam.save(tmp_path / "at.h5")
    again = gs.AdaptiveSlam.resume(tmp_path / "at.h5")
    assert again.step(measurements.scan(2)).health.why == slam.step(measurements.scan(2)).health.why
    held, kept = (one.population.ranges for one in (again, slam))
    np.testing.assert_array_equal(held.information, kept.information)
    np.testing.assert_array_equal(held.loudest[0].vector, before.loudest[0].vector)


@pytest.mark.parametrize(("metres", "anchor", "turned"), [(1.5, None, False), (1.5, 0, True)])
def test_no_anchor_is_called_turned_while_distances_of_all_are_wrong(metres, anchor, turned):
    measurements, slam = gs.simulate(ROOM, "agent1", 24), gs.AdaptiveSlam(ROOM, seed=1)
    slam.step(measurements.scan(0))
    told = slam.state.calibration.with_turn(1, 0.15, 1e6)
    state = replace(slam.state, calibration=told)
    doubt = reasons.offset("all anchors" if anchor is None else "anchor A", metres)
    ranges = replace(RangeWatch.start(2), doubt=doubt)
    slam.now = slam.now._replace(believed=replace(slam.population, states=(state,), ranges=ranges))
    health = slam.step(measurements.scan(1)).health
    assert doubt in health.why
    assert ("anchor B seems turned by" in health.why) == turned
    assert not health.ok


@pytest.mark.parametrize(("aside", "std", "named"), [(0.6, 0.3, False), (1.2, 0.1, True)])
def test_places_that_are_told_to_be_unsure_are_no_news_unless_they_are_much_farther_off(aside, std, named):
    data = ROOM.model_dump(exclude_none=True)
    x, y = data["anchors"][0]["position_m"]
    data["anchors"][0]["position_m"] = (x + aside, y)
    heard, model = gs.simulate(gs.Scene.checked(data, "room"), "agent1", 29), ROOM.filter_model("agent1")
    assert any(watch.doubt for watch in looked(model, heard))
    unsure = replace(model, mounting_std=np.array([[std, 0.0], [std, 0.0]]))
    assert any(watch.doubt for watch in looked(unsure, heard)) is named
