"""Scans at a filter's door: what makes no sense is refused in one line, and the filter stays as it was."""

import math
import tracemalloc
from dataclasses import replace
from functools import cache

import h5py
import numpy as np
import pytest

import gridslam as gs
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.inference.management.poses import pose_fix
from gridslam.io.hdf5_guard import seal
from gridslam.systems.registry import METHODS, method_class

SCENE = gs.Scene.load("room").with_filter(particles=128)
SCANS = list(gs.simulate(SCENE, "agent1", 1))


def changed(name, row, value):
    def change(scan):
        column = getattr(scan, name)
        column = np.full(len(scan), 0.1) if column is None else column.copy()
        column[row] = value
        return replace(scan, **{name: column})

    return change


BAD = {
    "time goes back": (lambda scan: replace(scan, time_s=1.0), r"time_s: found 1\.0; allowed: later than 2"),
    "same scan again": (lambda _: SCANS[2], r"time_s: found 2\.0; allowed: later than 2\.0, .*one scan"),
    "same time again": (lambda scan: replace(scan, time_s=2.0), r"time_s: found 2\.0; allowed: later than"),
    "step is text": (lambda scan: replace(scan, step="four"), "step: found 'four'; allowed: a whole number"),
    "half a step": (lambda scan: replace(scan, step=3.5), r"scan: step: found 3\.5; allowed: a whole number"),
    "no step": (lambda scan: replace(scan, step=math.nan), "scan: step: found nan; allowed: a whole number"),
    "steps that go back": (lambda scan: replace(scan, step=0), "scan: step: found 0; allowed: 2 or above"),
    "no time": (lambda scan: replace(scan, time_s=np.nan), "scan: time_s: found nan; allowed: a finite"),
    "time is text": (lambda scan: replace(scan, time_s="soon"), "scan: time_s: found text; allowed: seconds"),
    "short column": (lambda scan: replace(scan, aod_rad=scan.aod_rad[:-1]), r"scan: aod_rad: found shape \("),
    "table for a column": (lambda scan: replace(scan, amplitude=np.ones((2, 2))), "amplitude: found shape"),
    "anchors by name": (lambda scan: replace(scan, anchor=["A"] * len(scan)), "anchor: found .*A.*whole"),
    "unknown anchor": (changed("anchor", 1, 7), r"scan: anchor\[1\]: found 7; allowed: 0 to 1"),
    "anchor below 0": (changed("anchor", 0, -1), r"scan: anchor\[0\]: found -1"),
    "infinite distance": (changed("distance_m", 2, np.inf), r"scan: distance_m\[2\]: found inf"),
    "negative distance": (changed("distance_m", 0, -1.0), r"distance_m\[0\]: found -1\.0; allowed: a number"),
    "infinite angle": (changed("aoa_rad", 0, -np.inf), r"scan: aoa_rad\[0\]"),
    "degrees": (changed("aoa_rad", 0, 90.0), r"scan: aoa_rad\[0\]: found 90\.0; allowed: radians"),
    "no amplitude": (changed("amplitude", 0, 0.0), r"scan: amplitude\[0\]"),
    "deviation of 0": (changed("distance_std_m", 0, 0.0), r"scan: distance_std_m\[0\]: found 0\.0"),
    "negative deviation": (changed("aod_std_rad", 1, -1.0), r"scan: aod_std_rad\[1\]: found -1\.0"),
}  # fmt: skip


@cache
def begun(method):
    """A filter, where it stands after three steps, and what another one makes of the next two."""
    one, two = (method_class(method)(SCENE, seed=1) for _ in range(2))
    for scan in SCANS[:3]:
        one.step(scan)
    return one, one.now, [two.step(scan) for scan in SCANS[:5]][3:]


@pytest.mark.slow
@pytest.mark.parametrize("case", BAD)
def test_a_scan_that_makes_no_sense_is_refused_and_changes_nothing(case):
    spoil, says = BAD[case]
    methods = sorted(name for name, entry in METHODS.items() if entry.takes == "paths" and not entry.several)
    one, three_steps_on, undisturbed = begun(methods[len(case) % len(methods)])
    one.now = three_steps_on
    with pytest.raises(gs.InputError, match=says) as refused:
        one.step(spoil(SCANS[3]))
    assert "\n" not in str(refused.value)
    for scan, there in zip(SCANS[3:5], undisturbed, strict=True):
        here = one.step(scan)
        np.testing.assert_array_equal(here.position_m, there.position_m)
        np.testing.assert_array_equal(here.covariance, there.covariance)


def test_steps_that_go_back_are_refused_of_a_filter_that_was_saved_as_of_any(tmp_path):
    """A second drive counts from 0 again, at later times: estimates of two steps would have one number."""
    slam, path = gs.GridSlam(SCENE, seed=1), tmp_path / "c.h5"
    slam.save(path)
    gs.GridSlam.resume(path).step(SCANS[0])  # before the first there is none
    for scan in SCANS[:3]:
        slam.step(scan)
    slam.save(path)
    again = gs.GridSlam.resume(path)
    with pytest.raises(gs.InputError, match=r"^scan: step: found 0; allowed: 2 or above.*counted on$"):
        again.step(replace(SCANS[0], time_s=100.0))
    np.testing.assert_array_equal(again.step(SCANS[3]).covariance, slam.step(SCANS[3]).covariance)


def test_a_checkpoint_of_an_earlier_version_holds_no_number(tmp_path):
    slam, path = gs.GridSlam(SCENE, seed=1), tmp_path / "c.h5"
    slam.step(SCANS[2])
    slam.save(path)
    with h5py.File(path, "r+") as file:
        del file["run"].attrs["number"]
    path.write_bytes(path.read_bytes() + seal(path.read_bytes()))
    gs.GridSlam.resume(path).step(replace(SCANS[0], time_s=100.0))
    with h5py.File(path, "r+") as file:
        file["run"].attrs["number"] = "two"
    path.write_bytes(path.read_bytes() + seal(path.read_bytes()))
    with pytest.raises(gs.InputError, match="/run/number: found 'two'; allowed: a whole number"):
        gs.GridSlam.resume(path)


def test_lists_will_do_for_columns():
    one, two = gs.GridSlam(SCENE, seed=1), gs.GridSlam(SCENE, seed=1)
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    listed = replace(SCANS[0], **{name: getattr(SCANS[0], name).tolist() for name in names})
    np.testing.assert_array_equal(one.step(SCANS[0]).position_m, two.step(listed).position_m)
    one.step(gs.Scan(2, 2.0, [], [], [], [], []))


@pytest.mark.parametrize(("factor", "says"), [(1e3, "up to radio.max_distance_m"), (1 / 299792458, "metres")])
def test_distances_in_another_unit_are_refused_as_those_of_a_table(factor, says):
    """In one line, by the first scan; the filter stays as it was."""
    slam, other = gs.GridSlam(SCENE, seed=1), gs.GridSlam(SCENE, seed=1)
    with pytest.raises(gs.InputError, match=rf"^scan: distance_m: found .* m; allowed: {says}"):
        slam.step(replace(SCANS[0], distance_m=factor * SCANS[0].distance_m))
    np.testing.assert_array_equal(slam.step(SCANS[0]).covariance, other.step(SCANS[0]).covariance)
    slam.step(replace(SCANS[1], distance_m=1e3 * SCANS[1].distance_m))  # as in a run of a whole table
    few = gs.Scan(0, 0.0, [0, 0], [61.0, 70.0], [0.0, 0.0], [0.0, 0.0])
    gs.GridSlam(SCENE, seed=1).step(few)


def test_clocks_may_make_distances_long_or_negative():
    data = SCENE.model_dump(exclude_none=True) | {"clocks": {"anchor_prior_ns": 1000.0}}
    slam = gs.NetworkSlam(gs.Scene.checked(data, "room"), seed=1)
    slam.step(replace(SCANS[0], distance_m=SCANS[0].distance_m + 200.0))


def test_anchors_by_name_are_refused_in_one_line():
    with pytest.raises(gs.InputError) as refused:
        gs.GridSlam(SCENE, seed=1).step(replace(SCANS[0], anchor=["A"] * len(SCANS[0])))
    many = "whole numbers, 0 to 1: which of the scene's anchors"
    assert str(refused.value) == f"scan: anchor: found 'A'; allowed: {many}"


def test_a_scan_that_a_checkpoint_holds_is_refused_after_it(tmp_path):
    slam = gs.GridSlam(SCENE, seed=1)
    slam.step(SCANS[0])
    slam.save(tmp_path / "after.h5")
    with pytest.raises(gs.InputError, match=r"scan: time_s: found 0\.0; allowed: later than 0\.0"):
        gs.GridSlam.resume(tmp_path / "after.h5").step(SCANS[0])


def test_signals_and_agents_at_once_are_taken_in_once_a_time():
    agents = gs.NetworkScan(0, 3.0, (SCANS[3],))
    for scan in (SCANS[3], agents, gs.SignalScan(0, 3.0, np.ones((2, 1, 1, 5)), np.ones(2, bool))):
        with pytest.raises(gs.InputError, match=r"time_s: found 3\.0; allowed: later than 3\.0"):
            scan.checked(2, after=3.0)


def test_columns_that_were_not_measured_may_be_left_out():
    one, two = gs.GridSlam(SCENE, seed=1), gs.GridSlam(SCENE, seed=1)
    nothing = np.full(len(SCANS[0]), np.nan)
    first = SCANS[0]
    left_out = one.step(
        gs.Scan(first.step, first.time_s, first.anchor, first.distance_m, aoa_rad=first.aoa_rad)
    )
    unknown = two.step(replace(SCANS[0], aod_rad=nothing, amplitude=nothing))
    np.testing.assert_array_equal(left_out.covariance, unknown.covariance)
    with pytest.raises(gs.InputError, match="scan: "):
        one.step(gs.Scan(9, 9.0, [0], None, None, None, None))


@pytest.mark.parametrize("method", sorted(METHODS))
def test_a_scene_without_agents_is_refused(method):
    data = SCENE.model_dump(exclude_none=True)
    with pytest.raises(gs.InputError, match="room: agents: found none; allowed: at least one"):
        method_class(method)(gs.Scene.checked({**data, "agents": []}, "room"))


def loud_scan(count, first=SCANS[0]):
    """What one anchor's line of sight and `count` other loud paths from anywhere would be heard as."""
    draw = np.random.default_rng(1 + first.step)
    more = (
        np.zeros(count, np.intp), draw.uniform(1, 20, count), *draw.uniform(-3, 3, (2, count)),
        draw.uniform(5, 20, count),
    )  # fmt: skip
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    return replace(
        first, **{n: np.append(getattr(first, n), m) for n, m in zip(names, more, strict=True)}
    )  # fmt: skip


@pytest.mark.slow
def test_too_many_loud_paths_cost_little_memory_and_are_told():
    data = SCENE.model_dump(exclude_none=True)
    data["agents"] = [data["agents"][0] | {"prior": {"position_m": 3.0, "heading_deg": 90.0}}]
    vague, blank, walls = gs.Scene.checked(data, "room"), gs.GridSlam(SCENE).map(), SCENE.segments()
    surfaces = SurfaceEstimate.from_lines(
        walls.line, np.tile(1e-8 * np.eye(2), (4, 1, 1)), np.full(4, 0.7), np.full(4, 0.01), np.ones(4),
        np.full((4, 2), np.nan), np.arange(4),
    )  # fmt: skip
    known = replace(blank, surfaces=surfaces, surface_reflection=None)
    gs.GridSlam(vague, known, seed=1).step(SCANS[0])  # whatever is made once
    slam, scan = gs.GridSlam(vague, known, seed=1), loud_scan(400)
    tracemalloc.start()
    try:
        estimate = slam.step(scan)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1e8  # before: 1.3 GB
    assert np.linalg.norm(estimate.position_m - SCENE.track("agent1").position_m[0]) < 0.2
    assert "loud paths of one anchor: 30 of them propose poses" in estimate.health.why
    assert not estimate.health.ok
    assert np.isfinite(estimate.covariance).all()
    assert "propose" not in gs.GridSlam(vague, seed=1).step(SCANS[0]).health.why


@pytest.mark.slow
def test_so_many_loud_paths_as_fit_anywhere_move_nobody_and_are_told():
    """Any place explains some of them: the agent used to be moved by metres, in steps of 20 s."""
    slam, track = gs.GridSlam(SCENE, seed=1), SCENE.track("agent1")
    for step in range(8):
        estimate = slam.step(SCANS[step] if step < 3 else loud_scan(500, SCANS[step]))
        assert np.linalg.norm(estimate.position_m - track.position_m[step]) < 0.1
        told = "so many fit anywhere: no other place is compared" in estimate.health.why
        assert told == (step >= 3)
    assert len(estimate.hypotheses.weight) == 1


@pytest.mark.slow
def test_poses_score_alike_in_blocks_of_any_size(monkeypatch):
    data = SCENE.model_dump(exclude_none=True)
    data["agents"] = [data["agents"][0] | {"prior": {"position_m": 3.0, "heading_deg": 90.0}}]
    vague, found = gs.Scene.checked(data, "room"), []
    for block in (50, 10**9):
        monkeypatch.setattr(pose_fix, "BLOCK", block)
        found.append(gs.GridSlam(vague, seed=1).step(SCANS[0]).position_m)
    np.testing.assert_allclose(*found, atol=1e-9)


def test_a_filter_says_in_a_line_what_it_is():
    assert repr(gs.AdaptiveSlam(gs.Scene.load("room"))) == "<AdaptiveSlam of agent1 in room: 0 steps>"
