"""Numbers as users hand them over: what only looks like what was asked for is refused, or understood."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.errors import InputError
from gridslam.world.given import finite, numbers, require_radians, time_of, whole_numbers

DATES = np.array(["2026-01-01T00:00:00", "2026-01-01T00:00:01"], "datetime64[ns]")


@pytest.fixture(scope="module")
def heard():
    """Two steps, one anchor."""
    return gs.Measurements.from_arrays({"A": [[5.0], [6.0]]}, {"A": [[0.1], [0.2]]})


def test_masked_numbers_are_missing():
    assert numbers(np.ma.masked_array([1, 2], [False, True]), "x").tolist()[:1] == [1.0]
    assert np.isnan(numbers(np.ma.masked_array([1, 2], [False, True]), "x")[1])
    assert numbers(np.ma.masked_array([1.0, 2.0]), "x").tolist() == [1.0, 2.0]


def test_empty_columns_have_no_kind_and_whole_numbers_an_end():
    assert numbers(np.array([], "U1"), "x").shape == numbers(np.array([], bool), "x").shape == (0,)
    with pytest.raises(InputError, match="found 1e"):
        whole_numbers([1e300], "x", "whole")


def test_rows_of_masked_arrays_and_masked_flags(heard):
    rows = [np.ma.masked_array([1.0, 2.0], [0, 1]), np.ma.masked_array([3.0, 4.0], [0, 0])]
    np.testing.assert_array_equal(numbers(rows, "x"), [[1.0, np.nan], [3.0, 4.0]])
    whose = np.ma.masked_array([0], [True])
    assert replace(heard.scan(0), anchor=whose).checked(1, unlabelled=True).anchor.tolist() == [-1]
    with pytest.raises(InputError, match=r"anchor\[0\]: found -1"):
        replace(heard.scan(0), anchor=whose).checked(1)
    there = np.ma.masked_array([[True], [True]], [[False], [True]])
    samples, offset = 1j * np.ones((2, 1, 8)), 1e7 * np.arange(8)
    received = gs.Recording.from_arrays(samples, 6e9, offset, ["A"], heard=there)
    assert received.heard.tolist() == [[True], [False]]
    assert replace(received, heard=there).heard.tolist() == [[True], [False]]


def test_masked_paths_are_padding_and_masked_angles_not_measured(heard):
    padded = np.ma.masked_array([[5.0, 99.0], [5.1, 6.9]], [[0, 1], [0, 0]])
    assert gs.Measurements.from_arrays({"A": padded}).distance_m.tolist() == [5.0, 5.1, 6.9]
    hidden = np.ma.masked_array([0.5], [True])
    assert np.isnan(replace(heard.scan(0), aod_rad=hidden).checked(1).aod_rad).all()
    assert np.isnan(replace(heard, aod_rad=np.ma.masked_array([0.1, 0.2], [0, 1])).aod_rad).tolist() == [
        False,
        True,
    ]


def test_masked_samples_are_none():
    samples = np.ma.masked_array(np.ones((2, 1, 8), complex) * (1 + 1j), False)
    samples[1, 0, 3] = np.ma.masked
    with pytest.raises(InputError, match=r"samples\[1, 0\]: found NaN"):
        gs.Recording.from_arrays(samples, 6e9, 1e7 * np.arange(8), ["A"])
    there = np.array([[True], [False]])
    kept = gs.Recording.from_arrays(samples, 6e9, 1e7 * np.arange(8), ["A"], heard=there)
    assert not kept.samples[1].any()


@pytest.mark.parametrize(
    "call",
    [
        lambda heard: gs.Measurements.from_arrays({"A": [[5.0], [6.0]]}, time_s=DATES),
        lambda heard: replace(heard, time_s=DATES),
        lambda heard: gs.Recording.from_arrays(
            1j * np.ones((2, 1, 8)), 6e9, 1e7 * np.arange(8), ["A"], time_s=DATES
        ),
        lambda heard: gs.Trajectory(DATES, np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2)),
        lambda heard: replace(heard.scan(0), time_s=DATES[0]).checked(1),
        lambda heard: time_of(DATES[:1], "signal"),
    ],
)
def test_dates_are_no_seconds_and_how_they_become_some_is_said(heard, call):
    with pytest.raises(InputError, match=r"time_s: found dates .*allowed: seconds.*timedelta64"):
        call(heard)


@pytest.mark.parametrize(
    "given",
    [["1", "2"], [True, False], [1j, 2.0], object(), [[1], [1, 2]], np.timedelta64(5, "s"),
     np.array([1.0, "2"], object), np.array([True, 2.0], object), np.array([DATES[0], None], object)],
)  # fmt: skip
def test_what_only_looks_like_numbers_is_refused(given):
    with pytest.raises(InputError, match="field: found"):
        numbers(given, "field")


@pytest.mark.parametrize("given", [[0.5, 1.0], [np.nan, 0.0], [np.inf], ["north"]])
@pytest.mark.parametrize("column", ["step", "anchor"])
def test_steps_and_anchors_are_counted(heard, column, given):
    with pytest.raises(InputError, match=f"measurements: {column}: found .*whole numbers"):
        replace(heard, **{column: given})
    assert whole_numbers([0.0, 3.0], "x", "whole").tolist() == [0, 3]


def test_infinite_numbers_and_several_times_are_refused():
    for call in (lambda: finite([1.0, np.inf], "map"), lambda: time_of([1.0, 2.0], "scan")):
        with pytest.raises(InputError, match=r"allowed: (finite numbers|one number)"):
            call()


def test_degrees_are_no_radians_at_any_door():
    scene = gs.Scene.load("room")
    scan = next(iter(gs.simulate(gs.Scene.load("screen"), "agent1", seed=1, what="signal")))
    track = scene.track("agent1")
    slam = gs.GridSlam(scene)
    for call in (
        lambda: slam.start_at([2.0, 2.0], 90.0),
        lambda: replace(scan, heading_rad=90.0).checked(1),
        lambda: replace(track, heading_rad=np.full(len(track), 90.0)),
    ):
        with pytest.raises(InputError, match="heading_rad: found 90; allowed: radians"):
            call()
    require_radians(np.zeros(0), "nobody's")
    require_radians(-25.0, "after four turns")


def test_headings_that_are_added_up_over_many_turns_are_radians():
    turns = np.linspace(0, 12 * np.pi, 400)
    seconds, place = 0.1 * np.arange(400), np.stack([np.cos(turns), np.sin(turns)], -1)
    track = gs.Trajectory(seconds, place, np.zeros((400, 2)), turns)
    between = track.at(seconds[1:-1] + 0.05)
    np.testing.assert_allclose(np.cos(between.heading_rad), np.cos(turns[1:-1] + 6 * np.pi / 399), atol=1e-3)
    scan = next(iter(gs.simulate(gs.Scene.load("screen"), "agent1", seed=1, what="signal")))
    assert abs(gs.Estimate.of_pose(scan, [0.0, 0.0], 20.0, np.eye(3)).heading_rad) <= np.pi
    with pytest.raises(gs.InputError, match=r"heading_rad: found 90; allowed: radians, four turns .* sum"):
        gs.Estimate.of_pose(scan, [0.0, 0.0], 90.0, np.eye(3))  # one alone may be of no walk


@pytest.mark.parametrize(
    ("position", "heading"),
    [([2.0, 2.0, 0.0], 0.0), ("ab", 0.0), (None, 0.0), ([2.0, np.nan], 0.0), ([2.0, 2.0], [0.0])],
)
def test_a_start_is_two_numbers_and_one(position, heading):
    slam = gs.GridSlam(gs.Scene.load("room"))
    before = slam.state.belief.mean.tolist()
    with pytest.raises(InputError, match="start"):
        slam.start_at(position, heading)
    assert slam.state.belief.mean.tolist() == before


def test_a_misspelt_quantity_is_named():
    with pytest.raises(InputError, match=r"found 'aoa_deg'; allowed: .*aoa_rad"):
        gs.Measurements.from_arrays({"A": [[5.0]]}, aoa_deg={"A": [[5.0]]})
