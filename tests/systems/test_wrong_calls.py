"""Wrong things handed over: one line that says what is taken, no error from inside."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.systems.registry import METHODS, method_class

SCENE = gs.Scene.load("room")
SCAN = gs.simulate(SCENE, "agent1", 1).scan(0)
A_SCENE = "found str; allowed: a Scene"
A_MAP = "found str; allowed: a Map"


@pytest.mark.parametrize("method", METHODS)
def test_filters_refuse_the_name_of_a_scene(method):
    with pytest.raises(gs.InputError, match=A_SCENE):
        method_class(method)("room")


@pytest.mark.parametrize("name", ["grid", "refa", "network"])
@pytest.mark.parametrize("scan", ["hello", None])
def test_steps_refuse_what_is_no_scan(name, scan):
    with pytest.raises(gs.InputError, match=f"step: found {type(scan).__name__}; allowed: .*Scan"):
        method_class(name)(SCENE).step(scan)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: gs.simulate("room", "agent1"), A_SCENE),
        (lambda: gs.simulate("room", ["agent1"]), A_SCENE),
        (lambda: gs.simulate("screen", "agent1", what="signal"), A_SCENE),
        (lambda: gs.simulate(SCENE, 5), "agent: found 5"),
        (lambda: gs.map_network("room", gs.simulate(SCENE, ["agent1"]), particles=9), A_SCENE),
        (lambda: gs.ground_truth("room", "agent1"), A_SCENE),
        (lambda: gs.fuse("a"), "fuse: found str; allowed: maps"),
        (lambda: gs.fuse(None), "fuse: found NoneType; allowed: maps"),
        (lambda: gs.fuse(gs.Map.of_scene(SCENE)), "fuse: found Map; allowed: maps"),
        (lambda: gs.fuse(["a"]), f"map 1: {A_MAP}"),
        (lambda: gs.extract("z.h5"), "found str; allowed: a Recording"),
        (lambda: gs.GridSlam(SCENE, prior_map="map.h5"), A_MAP),
        (lambda: gs.NetworkSlam(SCENE, prior_map="map.h5"), A_MAP),
        (lambda: gs.Scene.load(5), "scene: found int; allowed: alcove"),
        (lambda: setattr(SCENE, "name", "x"), "Scene.name: found a change"),
        (lambda: setattr(SCENE.radio, "bandwidth_hz", 1.0), "Radio.bandwidth_hz: found a change"),
        (
            lambda: gs.Measurements.from_arrays([1.0]),
            "distance_m: found list; allowed: rows of paths by anchor",
        ),
        (lambda: gs.Map.of_scene(SCENE).query("here"), "points: found 'here'"),
        (lambda: gs.Map.of_scene(SCENE).query(None), r"points: found shape \(\)"),
        (lambda: gs.Map.of_scene(SCENE).query([0, 0, 0]), r"points: found shape \(3,\)"),
        (lambda: gs.Map.of_scene(SCENE).query([]), r"points: found shape \(0,\)"),
    ],
)
def test_what_is_of_another_kind_is_refused(call, told):
    with pytest.raises(gs.InputError, match=told):
        call()


def test_complex_columns_of_scans_and_tables_are_refused():
    heard = gs.simulate(SCENE, "agent1", 1)
    with pytest.raises(gs.InputError, match="distance_m: found complex"):
        replace(heard, distance_m=heard.distance_m + 1j)
    with pytest.raises(gs.InputError, match="distance_m: found complex"):
        gs.Measurements.from_arrays({"A": [np.array([3 + 1j])]})
    with pytest.raises(gs.InputError, match="complex"):
        gs.GridSlam(SCENE).step(replace(SCAN, distance_m=SCAN.distance_m + 1j))


@pytest.mark.parametrize(
    ("pose", "told"),
    [
        (([np.nan, 0], 0.0, np.eye(3)), "position_m: found NaN"),
        (([0, 0], np.nan, np.eye(3)), "heading_rad: found NaN"),
        (([0, 0], 0.0, np.full((3, 3), np.nan)), "covariance: found NaN"),
        (([0, 0], 0.0, -np.eye(3)), "covariance: found an eigenvalue of -1"),
        (([0, 0], 0.0, np.array([[1, 2, 0], [2, 1, 0], [0, 0, 1]])), "covariance: found an eigenvalue of -1"),
        (("ab", 0.0, np.eye(3)), "position_m: found text"),
        (([0, 0], None, np.eye(3)), "heading_rad: found NaN"),
    ],
)
def test_estimates_by_hand_hold_numbers_and_variances(pose, told):
    with pytest.raises(gs.InputError, match=told):
        gs.Estimate.of_pose(SCAN, *pose)
    assert gs.Estimate.of_pose(SCAN, [0, 0], 0.0, np.zeros((3, 3))).covariance[0, 0] == 0, "a sure pose"


@pytest.mark.parametrize("method", ["grid", "adaptive", "network"])
def test_a_filter_is_saved_as_a_checkpoint_and_not_pickled(method, tmp_path):
    slam = method_class(method)(SCENE)
    slam.step(SCAN)
    with pytest.raises(gs.InputError, match=r"a filter to be pickled; allowed: .*save\(path\), then "):
        pickle.dumps(slam)
    slam.save(tmp_path / "checkpoint.h5")
    later = gs.simulate(SCENE, "agent1", 1).scan(1)
    others = type(slam).resume(tmp_path / "checkpoint.h5"), copy.deepcopy(slam), copy.copy(slam)
    position = slam.step(later).position_m
    for other in others:
        assert other.state.step == 1
        np.testing.assert_array_equal(other.step(later).position_m, position)
