"""A method on samples goes in by the same doors as all: runs, checkpoints, studies, benchmarks."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from echo_slam import EchoFilter
from refusals import one_line
from signal_samples import sampled_scene

import gridslam as gs
from gridslam.bench import bench
from gridslam.bench.plan import QUICK
from gridslam.errors import InputError
from gridslam.runs.run_files import read_run

HELPERS = Path(__file__).resolve().parents[1] / "helpers"
NAME = "echo_slam:EchoFilter"
WALL = {"material": "concrete", "points_m": [[-6.0, 6.0], [6.0, 6.0]]}
SCENE = sampled_scene([WALL], {"snr_at_1m_db": 60.0}, prior={"position_m": 0.1, "velocity_mps": 0.01})


@pytest.fixture
def files(say, tmp_path):
    """A scene, what was received in it, and the method, in a folder."""
    (tmp_path / "scene.toml").write_text(SCENE.to_toml())
    shutil.copy(HELPERS / "echo_slam.py", tmp_path)
    result = say("simulate", "scene.toml", "--signal", "--seed", 2, "-o", "z.h5")
    assert (result.code, result.out) == (
        0,
        "wrote z.h5: 3 steps, samples 1 x 1 x 1 x 41 (scene, me, seed 2)\n",
    )
    return tmp_path


def test_map_scene_takes_a_recording_and_hands_over_its_waveform():
    measurements = gs.simulate(SCENE, "me", 2, what="signal")
    run = gs.map_scene(SCENE, measurements, EchoFilter)
    assert run.method == "echo_slam:EchoFilter"
    assert run.score(gs.ground_truth(SCENE, "me"))["position_rmse_m"] < 0.15


def test_map_scene_refuses_the_other_kind():
    recording = gs.simulate(SCENE, "me", 2, what="signal")
    with pytest.raises(InputError, match=r"method 'grid': found sampled signals.*extract"):
        gs.map_scene(SCENE, recording)
    with pytest.raises(InputError, match=r"echo_slam:EchoFilter.*path measurements.*Recording"):
        gs.map_scene(SCENE, gs.simulate(SCENE, "me"), EchoFilter)
    other = gs.Recording.from_arrays(recording.samples, 6e9, recording.waveform.offset_hz, ["B"])
    with pytest.raises(InputError, match="anchors"):
        gs.map_scene(SCENE, other, EchoFilter)


def test_run_simulates_what_the_method_takes_and_its_folder_reads_back(say, files, no_figures):
    result = say("run", "scene.toml", "--method", NAME, "-o", "r")
    assert (result.code, result.err) == (0, "")
    assert {"signal.h5", "trajectory.tum", "truth.tum"} <= {
        path.name for path in (files / "r" / "me").iterdir()
    }
    assert not (files / "r" / "me" / "measurements.h5").exists()
    found = read_run(files / "r")
    assert isinstance(found.agents["me"].measurements, gs.Recording)
    assert say("check", "r").code == 0


def test_run_takes_a_file_and_names_it_with_its_checksum(say, files, no_figures):
    result = say("run", "scene.toml", "--method", NAME, "--signal", "z.h5", "-o", "r")
    assert (result.code, result.err) == (0, "")
    summary = json.loads((files / "r" / "run.json").read_text())
    content = hashlib.sha256((files / "z.h5").read_bytes()).hexdigest()
    assert summary["source"] == {"file": "z.h5", "sha256": content}
    assert summary["agents"]["me"]["position_rmse_m"] < 0.15


@pytest.mark.slow
def test_an_interrupted_run_goes_on_from_its_samples(say, files, no_figures, monkeypatch):
    assert say("run", "scene.toml", "--method", NAME, "--signal", "z.h5", "-o", "whole").code == 0
    step, taken = EchoFilter.step, []

    def interrupted(self, scan):
        taken.append(scan.step)
        if scan.step == 1 and taken.count(1) == 1:
            raise KeyboardInterrupt
        return step(self, scan)

    with monkeypatch.context() as patch:
        from gridslam.systems.registry import method_class

        patch.setattr(method_class(NAME), "step", interrupted)
        words = ("run", "scene.toml", "--method", NAME, "--signal", "z.h5", "--checkpoint", 1, "-o", "r")
        assert say(*words).code == 130
        assert say("run", "--resume", "r").code == 0
    one, two = (read_run(files / name).agents["me"] for name in ("whole", "r"))
    assert np.array_equal(one.trajectory.position_m, two.trajectory.position_m)


def test_the_wrong_file_is_refused_with_a_way_out(say, files):
    assert say("simulate", "scene.toml", "-o", "heard.csv").code == 0
    one_line(say("run", "scene.toml", "--signal", "z.h5", "-o", "r"), "--signal", "'grid'", "extract z.h5")
    wrong = say("run", "scene.toml", "--method", NAME, "--measurements", "heard.csv", "-o", "r")
    one_line(wrong, "--measurements", "--signal FILE")
    both = ("--signal", "z.h5", "--measurements", "heard.csv")
    one_line(say("run", "scene.toml", "--method", NAME, *both, "-o", "r"), "one of them")
    one_line(say("run", "room", "--method", NAME, "-o", "r"), "radio.frequencies")
    assert not (files / "r").exists()


def test_simulate_refuses_what_no_recording_holds(say, files):
    one_line(say("simulate", "scene.toml", "--signal", "-o", "z.csv"), ".h5")
    one_line(say("simulate", "scene.toml", "--signal", "--unlabelled", "-o", "y.h5"), "one agent")
    one_line(say("simulate", "room", "--signal", "-o", "y.h5"), "radio.frequencies")
    assert not (files / "y.h5").exists()


@pytest.mark.slow
def test_study_simulates_samples(say, files, monkeypatch):
    pytest.importorskip("joblib")
    monkeypatch.setattr("gridslam.studies.plots.draw_study", lambda *_: [])
    result = say("study", "scene.toml", "--runs", 1, "--workers", 1, "--method", NAME, "-o", "s")
    assert result.code == 0, result
    assert "1 of 1 run, 1 of them new" in result.out


@pytest.mark.slow
def test_bench_times_it_on_samples():
    speed = bench.measure(QUICK, methods=[EchoFilter])
    assert {step.scene for step in speed.steps} == {"overlap"}
    assert all(step.step_ms > 0 for step in speed.steps)


def test_a_class_on_samples_must_take_a_waveform():
    class Least:
        takes = "signal"

        def __init__(self, scene, prior_map=None, agent=None, seed=0):
            self.agent = agent

        def step(self, scan):
            return None

        def map(self):
            return None

    measurements = gs.simulate(SCENE, "me", what="signal")
    with pytest.raises(InputError, match=r"constructor.*waveform=None"):
        gs.map_scene(SCENE, measurements, Least)
    Least.takes = "sound"
    with pytest.raises(InputError, match=r"takes.*'sound'"):
        gs.map_scene(SCENE, measurements, Least)
