"""Trajectories and their TUM files."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gridslam.errors import InputError
from gridslam.world.geometry import wrap
from gridslam.world.trajectory import Trajectory
from gridslam.world.waypoints import TightCorner, smooth_track

NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)


def circle(count=20):
    angle = np.linspace(-3, 3, count)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return Trajectory(0.1 * np.arange(count), 5 * way, way[:, ::-1], angle)


@given(
    position=arrays(float, (7, 2), elements=NUMBERS),
    heading=arrays(float, 7, elements=st.floats(-10, 10, allow_subnormal=False)),
    gaps=arrays(float, 7, elements=st.floats(1e-3, 1e3, allow_subnormal=False)),
)
@settings(max_examples=40, deadline=None)
def test_tum_keeps_every_digit_of_time_and_place(tmp_path_factory, position, heading, gaps):
    path = tmp_path_factory.mktemp("tum") / "a.tum"
    written = Trajectory(np.cumsum(gaps), position, np.zeros((7, 2)), heading)
    written.to_tum(path)
    read = Trajectory.from_tum(path)
    np.testing.assert_array_equal(read.time_s, written.time_s)
    np.testing.assert_array_equal(read.position_m, written.position_m)
    assert np.abs(wrap(read.heading_rad - written.heading_rad)).max() < 1e-12


def test_tum_lines_are_what_other_tools_expect(tmp_path):
    path = tmp_path / "a.tum"
    Trajectory([0.5], [[1.0, -2.0]], [[0, 0]], [np.pi / 2]).to_tum(path)
    header, line = path.read_text().splitlines()
    assert header == "# timestamp tx ty tz qx qy qz qw"
    values = [float(word) for word in line.split()]
    np.testing.assert_allclose(values, [0.5, 1, -2, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5)])


def test_heights_are_the_third_coordinate(tmp_path):
    low = Trajectory([0.5, 1.0], [[1.0, -2.0], [1.5, -2.0]], np.zeros((2, 2)), [0.0, 0.1])
    high = replace(low, height_m=[1.25, 1.3])
    high.to_tum(tmp_path / "high.tum")
    assert [line.split()[3] for line in (tmp_path / "high.tum").read_text().splitlines()[1:]] == [
        "1.25",
        "1.3",
    ]
    assert Trajectory.from_tum(tmp_path / "high.tum").height_m.tolist() == [1.25, 1.3]
    low.to_tum(tmp_path / "low.tum")
    assert Trajectory.from_tum(tmp_path / "low.tum").height_m is None
    assert low != high
    for wrong in ([1.0], [1.0, np.nan]):
        with pytest.raises(InputError, match="height_m"):
            replace(low, height_m=wrong)


def test_velocity_is_recovered_by_differences(tmp_path):
    time = np.array([0.0, 1.0, 1.5, 4.0])  # uneven on purpose
    motion = np.array([0.3, -0.2])
    Trajectory(time, time[:, None] * motion, np.zeros((4, 2)), np.zeros(4)).to_tum(tmp_path / "a.tum")
    read = Trajectory.from_tum(tmp_path / "a.tum")
    np.testing.assert_allclose(read.velocity_mps, np.tile(motion, (4, 1)), atol=1e-12)


def test_single_pose_stands_still(tmp_path):
    (tmp_path / "a.tum").write_text("\n# made by hand\n7 1 2 0.5 0 0 0 -1 # turned by 2 pi\n")
    read = Trajectory.from_tum(tmp_path / "a.tum")
    assert len(read) == 1
    np.testing.assert_array_equal(read.velocity_mps, [[0, 0]])
    assert np.abs(read.heading_rad[0]) < 1e-12


@pytest.mark.parametrize(
    ("text", "where", "allowed"),
    [
        ("", "", "timestamp tx"),
        ("# nothing\n", "", "timestamp tx"),
        ("0 1 2 0 0 0 0 1\n1 1 2 0 0 0 1\n", ": line 2", "eight finite"),
        ("0 1 2 0 0 0 x 1\n", ": line 1", "eight finite"),
        ("0 1 nan 0 0 0 0 1\n", ": line 1", "eight finite"),
        ("0 1 inf 0 0 0 0 1\n", ": line 1", "eight finite"),
        ("0 1 2 0 0.5 0 0 1\n", ": line 1: qx qy", "rotation in the plane"),
        ("0 1 2 0 0 0 0 0\n", ": line 1: qz qw", "unit quaternion"),
        ("0 1 2 0 0 0 0 1\n\n0 1 2 0 0 0 0 1\n", ": line 3: timestamp", "more than 0.0"),
    ],
)
def test_faulty_tum_line_is_named(tmp_path, text, where, allowed):
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Trajectory.from_tum(path)
    assert caught.value.where == f"{path}{where}"
    assert allowed in caught.value.allowed
    assert "\n" not in str(caught.value)


def test_file_that_cannot_be_read_is_named(tmp_path):
    (tmp_path / "b.tum").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "none.tum", tmp_path, tmp_path / "b.tum"):
        with pytest.raises(InputError, match=str(path)):
            Trajectory.from_tum(path)


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.tum"
    circle().to_tum(path)
    before = path.read_bytes()
    monkeypatch.setattr(
        "os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device"))
    )
    with pytest.raises(InputError, match="No space left"):
        circle(3).to_tum(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_trajectory_refuses_what_is_none():
    good = circle()
    with pytest.raises(InputError, match=r"position_m: found shape \(3, 2\)"):
        Trajectory(good.time_s, good.position_m[:3], good.velocity_mps, good.heading_rad)
    with pytest.raises(InputError, match="heading_rad: found NaN"):
        Trajectory(good.time_s, good.position_m, good.velocity_mps, good.heading_rad * np.nan)
    with pytest.raises(InputError, match="time_s"):
        Trajectory(good.time_s[::-1], good.position_m, good.velocity_mps, good.heading_rad)


def test_trajectory_is_its_own_and_read_only():
    position = np.zeros((2, 2))
    track = Trajectory([0, 1], position, np.zeros((2, 2)), [4.0, -np.pi])
    position[:] = 7
    assert track.position_m.max() == 0
    assert not track.position_m.flags.writeable
    np.testing.assert_allclose(track.heading_rad, [4 - 2 * np.pi, np.pi])


def test_equality_compares_every_column():
    assert circle() == circle()
    assert circle() != circle(19)
    good = circle()
    assert good != Trajectory(good.time_s, good.position_m, good.velocity_mps + 1, good.heading_rad)
    assert good != "circle"


# ---- the smooth way through waypoints


def test_right_angle_is_an_arc_of_sixteen_steps_radius():
    track = smooth_track(np.array([[0.0, 0.0], [4, 0], [4, 4]]), 0.05, 1.0, 0.03)
    centre = np.array([3.2, 0.8])
    turning = (track.position_m[:, 0] > 3.2) & (track.position_m[:, 1] < 0.8)
    np.testing.assert_allclose(np.linalg.norm(track.position_m[turning] - centre, axis=1), 0.8)
    assert turning.sum() in (25, 26)  # a quarter circle of 1.257 m
    length = 3.2 + 0.8 * np.pi / 2 + 3.2
    assert len(track) == int(length / 0.05) + 1


@given(
    bend=st.floats(-110, 110, allow_subnormal=False),
    first=st.floats(3, 5),
    step=st.sampled_from([0.03, 0.05, 0.1]),
)
@settings(max_examples=40, deadline=None)
def test_any_bend_is_walked_without_jumps(bend, first, step):
    turn = np.radians(bend)
    far = np.array([first + 4 * np.cos(turn), 4 * np.sin(turn)])
    points = np.array([[0.0, 0.0], [first, 0.0], far])
    track = smooth_track(points, step, 0.5, 1.0)
    strides = np.diff(track.position_m, axis=0)
    lengths = np.linalg.norm(strides, axis=1)
    assert lengths.max() <= step * (1 + 1e-9)
    assert lengths.min() > 0.99 * step
    turns = wrap(np.diff(track.heading_rad))
    assert np.abs(turns).max() <= 1 / 8 + 1e-9
    assert turns.sum() == pytest.approx(turn, abs=1e-9)
    assert np.linalg.norm(track.position_m[-1] - far) < step + 1e-9


def test_straight_waypoint_is_no_corner():
    points = np.array([[0.0, 0.0], [0.3, 0.0], [1.0, 0.0]])  # legs too short for any arc
    track = smooth_track(points, 0.05, 1.0, 0.03)
    np.testing.assert_allclose(
        track.position_m, np.stack([0.05 * np.arange(21), np.zeros(21)], axis=-1), atol=1e-12
    )


def test_turning_back_on_the_spot_is_refused():
    with pytest.raises(TightCorner) as caught:
        smooth_track(np.array([[0.0, 0.0], [2, 0], [4, 0], [2, 0]]), 0.05, 1.0, 0.03)
    assert caught.value.index == 1
    assert caught.value.step == pytest.approx(0)


def test_the_tightest_corner_is_told_with_the_longest_step_that_all_corners_have_room_for():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [1.3, 0.5], [1.3, 2.0]])
    with pytest.raises(TightCorner) as caught:
        smooth_track(points, 0.05, 1.0, 0.03)
    assert (caught.value.index, caught.value.radius) == (1, pytest.approx(0.15))
    smooth_track(points, caught.value.step, 1.0, 0.03)
    with pytest.raises(TightCorner):
        smooth_track(points, 1.001 * caught.value.step, 1.0, 0.03)
    with pytest.raises(TightCorner) as caught:  # sideways: the square of the speed over the acceleration
        smooth_track(points, 0.05, 0.1, 0.03)
    smooth_track(points, caught.value.step, 0.1, 0.03)


def test_pauses_hold_the_pose_at_the_middle_of_each_corner_and_nothing_else_changes():
    points = np.array([[0.0, 0.0], [4, 0], [4, 4]])
    plain = smooth_track(points, 0.05, 0.5, 0.03)
    track = smooth_track(points, 0.05, 0.5, 0.03, np.array([1.0, 10.0, 2.5]))
    assert len(track) == len(plain) + 2 + 20 + 5
    still = (track.velocity_mps == 0).all(axis=1)
    assert np.flatnonzero(still)[:2].tolist() == [1, 2]
    np.testing.assert_array_equal(still[-5:], True)
    for name in ("position_m", "velocity_mps", "heading_rad"):
        np.testing.assert_array_equal(getattr(track, name)[~still], getattr(plain, name))
    np.testing.assert_array_equal(np.diff(track.position_m, axis=0)[still[1:]], 0)
    np.testing.assert_allclose(track.time_s, 0.5 * np.arange(len(track)))
    (corner,) = np.unique(np.round(track.position_m[still][2:-5], 9), axis=0)
    middle = np.array([3.2, 0.8]) + 0.8 * np.array([1, -1]) / np.sqrt(2)  # of the arc
    assert np.linalg.norm(corner - middle) < 0.05
    same = smooth_track(points, 0.05, 0.5, 0.03, np.zeros(3))
    assert same == plain


def test_velocities_and_headings_of_poses_are_those_of_motion():
    time = [0.0, 1.0, 3.0, 4.0, 5.0]
    stands = [[0, 0], [2, 0], [6, 0], [6, 0], [6, 0]]  # 2 m/s along x, then still
    track = Trajectory.of_poses(time, stands)
    np.testing.assert_allclose(track.velocity_mps[:2], [[2, 0], [2, 0]])
    assert not track.heading_rad.any()
    north = Trajectory.of_poses(time, np.array(stands)[::-1, ::-1])  # still, then 6 m down
    np.testing.assert_allclose(north.heading_rad, -np.pi / 2)
    told = Trajectory.of_poses(time, stands, heading_rad=[0, 1, 2, 3, 3], height_m=np.ones(5))
    assert told.heading_rad[2] == 2
    assert told.height_m.tolist() == [1.0] * 5
    still = Trajectory.of_poses([0.0], [[1, 2]])
    assert not still.velocity_mps.any()
    assert not still.heading_rad.any()


@pytest.mark.parametrize(
    ("time", "place", "where"),
    [
        ([0, 1], np.zeros((3, 2)), "position_m"),
        ([1, 1], np.zeros((2, 2)), "time_s"),
        ([0, np.nan], np.zeros((2, 2)), "time_s"),
        ([0, 1], [[0, 0], [np.nan, 0]], "position_m"),
    ],
)
def test_poses_that_cannot_be_are_refused(time, place, where):
    with pytest.raises(InputError, match=where):
        Trajectory.of_poses(time, place)


def test_long_pauses_of_a_track_are_holes_also_between_steps_and_through_files(tmp_path):
    time = np.concatenate([np.arange(0, 4, 0.1), np.arange(22, 26, 0.1)]) + 1.7e9
    track = Trajectory.of_poses(time, np.stack([time - 1.7e9, np.zeros(80)], -1))
    steps = 1.7e9 + np.arange(0.05, 25.9, 0.1)
    known = track.at(steps)
    for one in (track, known, known.at(steps)):
        np.testing.assert_allclose(one.holes() - 1.7e9, [[3.9, 22.0]], atol=1e-6)
        np.testing.assert_array_equal(one.in_hole(steps), (steps > 1.7e9 + 3.9) & (steps < 1.7e9 + 22))
    known.to_tum(tmp_path / "a.tum")
    again = Trajectory.from_tum(tmp_path / "a.tum")
    assert again == replace(known, velocity_mps=again.velocity_mps, heading_rad=again.heading_rad)
    np.testing.assert_array_equal(again.in_hole(steps), known.in_hole(steps))
    every_two = Trajectory.of_poses(np.arange(0, 20, 2.0), np.zeros((10, 2)))
    assert not len(every_two.holes())
    assert every_two.at(np.arange(0, 18, 0.1)).holes_s is None


def test_a_line_of_a_track_is_broken_at_its_holes():
    time = np.concatenate([np.arange(0, 4, 0.1), np.arange(22, 26, 0.1)])
    track = Trajectory.of_poses(time, np.stack([time, -time], -1))
    for one in (track, track.at(np.arange(0.0, 25.9, 0.5)), track.at(np.array([3.0, 3.5, 23.0, 23.5]))):
        line = one.line_m()
        there = np.isfinite(line[:, 0])
        assert not ((line[there, 0] > 3.95) & (line[there, 0] < 21.95)).any()
        (first,) = np.flatnonzero(there[:-1] & ~there[1:])
        assert there[: first + 1].all()
        np.testing.assert_array_equal(line[there], one.position_m[~one.in_hole(one.time_s)])
    assert len(track.line_m(2.05)) == 21
    assert np.isfinite(track.line_m(3.95)).all()
    whole = Trajectory.of_poses(time[:40], np.stack([time[:40]] * 2, -1))
    np.testing.assert_array_equal(whole.line_m(), whole.position_m)


def test_who_stands_unnoted_and_a_track_of_corners_have_no_holes():
    time = np.concatenate([np.arange(0, 40, 0.1), np.arange(60, 100, 0.1)])
    way = np.where(time < 60, time, time - 20.05)
    assert not len(Trajectory.of_poses(time, np.stack([way, 0 * way], -1)).holes())
    assert len(Trajectory.of_poses(time, np.stack([time, 0 * time], -1)).holes()) == 1
    corners = np.concatenate([20 * k + np.arange(0, 1, 0.2) for k in range(5)])
    assert not len(Trajectory.of_poses(corners, np.stack([corners, 0 * corners], -1)).holes())
