"""Lines of sight that aren't where they should be name clocks that jump and turned anchors, no more."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.calibration import Calibration
from gridslam.inference.health.range_fits import words
from gridslam.inference.health.sight_watch import LATE, LOOKS, TURNED, SightWatch, wrong
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.deviations import own_deviations

ROOM = gs.Scene.load("room")
MODEL = ROOM.filter_model("agent1")
HEADING = 0.7


def at(look):
    """Where the agent is at a look, on a circle."""
    return np.array([2 * np.cos(0.4 * look), 2 * np.sin(0.4 * look)])


def heard(look, draw, late=(0.0, 0.0), turned=(0.0, 0.0), amplitude=30.0, arriving=0.0, anchors=(0, 1)):
    """Lines of sight of both anchors with errors of their distances (m), and of directions (rad)."""
    way = at(look) - MODEL.anchor_positions
    direction, length = np.arctan2(way[:, 1], way[:, 0]), np.hypot(*way.T)
    scan = gs.Scan(
        look, float(look), np.array([0, 1]), length + late + draw.normal(0, 0.02, 2),
        direction - MODEL.anchor_orientations - turned + draw.normal(0, 0.01, 2),
        direction + np.pi - HEADING + arriving + draw.normal(0, 0.01, 2), np.full(2, amplitude),
    )  # fmt: skip
    rows = np.isin([0, 1], anchors)
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    return replace(scan, **{name: getattr(scan, name)[rows] for name in names})


def looked(watch, look, scan, std=0.02, calibration=None, model=MODEL):
    """The watch after a look from a place that is known so well."""
    scans = split_by_anchor(scan, model)
    belief = Belief(np.array([*at(look), 0.0, 0.0, HEADING]), np.diag([std**2, std**2, 1.0, 1.0, 0.01**2]))
    calibration = calibration or Calibration.start(model.senders)
    return watch.looked(scans, own_deviations(scans, model.radio), belief, calibration, model)


def after(looks, begin=0, watch=None, std=0.02, **errors):
    """The watch after so many looks."""
    draw, watch = np.random.default_rng(looks), watch or SightWatch.start(MODEL.senders)
    for look in range(begin, begin + looks):
        watch = looked(watch, look, heard(look, draw, **errors), std)
    return watch


@pytest.mark.parametrize(("metres", "words_"), [(2.0, "2.0"), (0.7, "0."), (-1.5, "1.")])
def test_a_clock_that_jumps_is_named_by_its_own_line_of_sight(metres, words_):
    right = after(10)
    assert not right.doubt
    assert not right.looks.any()
    watch = after(LOOKS - 1, 10, right, late=(0.0, metres))
    assert not watch.doubt  # too few looks
    watch = after(1, 10 + LOOKS, watch, late=(0.0, metres))
    assert watch.doubt.startswith(f"of late distances of anchor B seem {words_}")
    assert ("too long" if metres > 0 else "too short") in watch.doubt
    stray = after(1, 30, watch, late=(0.0, 5.0))
    assert stray.doubt == watch.doubt  # one path of another kind doesn't make it right
    assert not after(1, 31, stray).doubt  # the line of sight where it should be does


def test_an_offset_from_the_first_look_on_is_left_to_whoever_crosses_lines_of_sight():
    """Nobody knows then whether the start was told wrong."""
    watch = after(3 * LOOKS, late=(0.0, 2.0))
    assert watch.beyond_doubt(LATE).tolist() == [1]
    assert not watch.doubt


def test_a_place_of_the_anchor_that_explains_as_much_is_told_beside_its_clock():
    draw, watch = np.random.default_rng(1), after(10)
    for _ in range(10):  # from one side alone
        watch = looked(watch, 4, heard(4, draw, late=(0.0, 1.0)))
    assert "or anchor B stands near" in watch.doubt
    offset, place = watch._readings(1, 2)
    assert np.hypot(*place.size) == pytest.approx(1.0, abs=0.1)
    assert words([offset], MODEL) in watch.doubt


@pytest.mark.parametrize("degrees", [10.0, -8.0, 100.0])
def test_a_turn_that_no_line_of_sight_was_taken_for_is_told_to_the_calibration(degrees):
    watch = after(LOOKS, turned=(0.0, np.radians(degrees)))
    begun = Calibration.start(2)
    watch, calibration = watch.turns_told(begun)
    np.testing.assert_allclose(np.degrees(calibration.turned), [0.0, degrees], atol=0.7)
    assert not watch.looks.any()
    assert watch.turns_told(calibration) == (watch, calibration)
    right = looked(watch, 3, heard(3, np.random.default_rng(3), turned=(0.0, np.radians(degrees))),
                   calibration=calibration)  # fmt: skip
    assert not right.looks.any()
    assert right.right[1] == watch.right[1] + 1


@pytest.mark.parametrize(
    "errors",
    [
        {"late": (0.0, 2.0), "anchors": (1,)},  # no other line of sight says that the place is right
        {"late": (2.0, 2.0)},
        {"late": (0.0, 2.0), "std": 0.3},  # nobody knows the place
        {"late": (0.0, 2.0), "arriving": np.array([0.0, 0.5])},  # over a wall
        {"late": (0.0, 2.0), "turned": (0.0, 0.5)},
        {"late": (0.0, 2.0), "amplitude": np.array([30.0, 2.5])},  # as faint as clutter
        {"late": (0.0, 0.1)},
        {"turned": (0.0, 0.02)},
    ],
)
def test_nothing_is_said_where_it_may_be_something_else(errors):
    watch = after(10)
    watch = after(20, 10, watch, **errors)
    assert not watch.doubt
    assert not watch.beyond_doubt(TURNED).size
    assert watch.turns_told(Calibration.start(2))[1].turned.tolist() == [0.0, 0.0]


def test_a_line_of_sight_is_the_loudest_and_as_loud_as_one_without_a_bounce():
    scan = split_by_anchor(heard(0, np.random.default_rng(2), amplitude=10.0), MODEL)[1]
    late, std = np.array([[30.0, 1.0, 1.0]]), np.full((1, 3), 0.02)
    assert wrong(scan, late, std, np.array([12.0])) == (LATE, 0)
    assert wrong(scan, late, std, np.array([13.0])) is None
    assert wrong(scan, late[:, ::-1], std, np.array([12.0])) is None
    assert wrong(scan, late[:, [1, 0, 2]], std, np.array([12.0])) == (TURNED, 0)
    assert wrong(scan, late, 10 * std, np.array([12.0])) is None  # angles that tell nothing


def test_errors_that_differ_from_look_to_look_are_nobodys_clock():
    watch, draw = after(10), np.random.default_rng(5)
    for look in range(10, 60):
        watch = looked(watch, look, heard(look, draw, late=(0.0, draw.uniform(0.5, 6))))
        assert not watch.doubt


@pytest.mark.slow
def test_an_anchor_that_comes_into_sight_late_and_turned_is_named_in_a_run():
    slam, said = gs.AdaptiveSlam(ROOM.with_filter(particles=200), seed=1), []
    for scan in list(gs.simulate(ROOM, "agent1", 25))[:60]:
        if scan.step < 20:
            rows = scan.anchor == 0
            names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
            scan = replace(scan, **{name: getattr(scan, name)[rows] for name in names})
        scan = replace(scan, aod_rad=scan.aod_rad - np.radians(12.0) * (scan.anchor == 1))
        said.append(slam.step(scan).health.why)
    assert not any("turned" in why for why in said[:20])
    assert "anchor B seems turned by 1" in said[-1]
    assert slam.state.calibration.turned[1] == pytest.approx(np.radians(12.0), abs=0.02)
