"""Tracks as tables, and heights in all files of a run."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from run_samples import hall, some_measurements, write
from scene_samples import raised
from tiny import TINY

import gridslam as gs
from gridslam.runs.map_scene import believed_track
from gridslam.runs.run_files import read_run
from gridslam.runs.track_tables import COLUMNS, HEIGHT, TRUE, track_columns


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_export_of_a_folder_writes_tracks_beside_the_map(say, tmp_path):
    write(tmp_path / "out", hall())
    result = say("export", "out", "-o", "robot")
    assert (result.code, result.err) == (0, "")
    assert (tmp_path / "robot/map.yaml").exists()
    rows, found = rows_of(tmp_path / "robot/agent1-track.csv"), read_run("out").agents["agent1"]
    assert tuple(rows[0]) == (*COLUMNS, *TRUE[:3])
    assert [float(row["x_m"]) for row in rows] == found.trajectory.position_m[:, 0].tolist()
    assert [float(row["true_y_m"]) for row in rows] == pytest.approx(found.truth.position_m[:, 1].tolist())
    assert say("check", "robot/agent2-track.csv").out.startswith("table of a track: ")
    assert say("export", "out/map.h5", "-o", "cells").code == 0
    assert not list((tmp_path / "cells").glob("*track*"))


def test_heights_go_through_all_files(say, tmp_path):
    scene = raised(hall(), [2.5] * len(hall().anchors))
    measurements = some_measurements(scene, "agent1")
    height = scene.agent("agent1").height_m
    assert set(measurements.truth.height_m.tolist()) == {height}
    measurements.to_h5(tmp_path / "heard.h5")
    assert gs.Measurements.from_h5(tmp_path / "heard.h5").truth == measurements.truth
    measurements.truth.to_tum(tmp_path / "truth.tum")
    assert say("check", "truth.tum").out.strip().endswith(f"{height:.2f} m high")


def test_estimated_heights_and_their_deviations_are_columns():
    scan = next(iter(some_measurements(hall(), "agent1")))
    poses = [replace(gs.Estimate.of_pose(scan, [n, 0], 0.1, np.eye(3)), time_s=float(n)) for n in range(3)]
    assert believed_track(poses).height_m is None
    assert believed_track(poses, 1.2).height_m.tolist() == [1.2] * 3
    high = [replace(one, heights={"agent": (1.0 + 0.1 * n, 0.02)}) for n, one in enumerate(poses)]
    track = believed_track(high, 1.2)
    way = gs.Trajectory([0.0, 4.0], [[0, 0], [4, 0]], np.zeros((2, 2)), [3.1, -3.1], [0.0, 4.0])
    table = track_columns(high, track, way)
    assert tuple(table) == (*COLUMNS, *HEIGHT, *TRUE)
    assert table["height_m"] == pytest.approx([1.0, 1.1, 1.2])
    assert table["height_std_m"].tolist() == [0.02] * 3
    assert table["true_height_m"].tolist() == [0.0, 1.0, 2.0]
    assert abs(table["true_heading_rad"][2]) == pytest.approx(np.pi, abs=1e-9)  # half the way over pi
    assert track_columns(poses, believed_track(poses, 1.2))["height_std_m"].tolist() == [0.0] * 3


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_tracks_and_notes_say_that_nothing_tells_headings(tmp_path, say):
    """A TUM file can't: it has a heading at each step, and no deviation."""
    (tmp_path / "ranges.toml").write_text(f'{TINY}[radio]\nmeasures = ["distance"]\n')
    (tmp_path / "tiny.toml").write_text(TINY)
    for name, method in (("ranges", "va"), ("tiny", "adaptive")):
        words = ("run", f"{name}.toml", "--agent", "agent1", "--method", method, "--particles", "100")
        result = say(*words, "-o", name)
        assert result.code == 0, result.err
        head = (tmp_path / name / "agent1" / "trajectory.tum").read_text().splitlines()[:2]
        told = "headings are unknown: no angle of arrival was measured"
        assert (head[1] == f"# {told}") is (name == "ranges")
        assert (f"agent1: {told}" in result.out) is (name == "ranges")
        assert len(gs.Trajectory.from_tum(tmp_path / name / "agent1" / "trajectory.tum")) == 3
