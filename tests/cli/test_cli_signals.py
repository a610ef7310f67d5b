"""From samples to a map by the command line: simulate --signal, extract, run."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs

RADIO = {
    "frequencies": 64, "frequency_step_hz": 1e7, "false_alarms": 0.1, "detection_threshold_db": 9.0,
    "array": {"rows": 2, "columns": 2, "spacing_wavelengths": 0.4},
}  # fmt: skip


@pytest.fixture
def room(tmp_path):
    whole = shortened(gs.Scene.load("room"), 12).model_dump(exclude_none=True)
    scene = gs.Scene.checked({**whole, "radio": RADIO, "filter": {"particles": 1000}}, "room")
    (tmp_path / "room.toml").write_text(scene.to_toml())


@pytest.mark.slow
def test_samples_become_paths_and_paths_become_a_map(say, room, tmp_path, no_figures):
    assert say("simulate", "room.toml", "--signal", "--seed", 1, "-o", "z.h5").code == 0
    result = say("extract", "z.h5", "--scene", "room.toml", "-o", "heard.h5")
    assert (result.code, result.err) == (0, "")
    assert result.out.startswith("wrote heard.h5: 12 steps, ")
    for method in ("grid", "adaptive", "va"):
        words = ("run", "room.toml", "--measurements", "heard.h5", "--method", method, "-o", method)
        result = say(*words)
        assert (result.code, result.err) == (0, ""), result
        score = json.loads((tmp_path / method / "run.json").read_text())["agents"]["agent1"]
        assert score["position_rmse_m"] < 2.5 * score["position_bound_m"], method
        assert score["surfaces_detected"] >= 3


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_what_a_method_does_not_map_is_neither_scored_nor_written(say, tmp_path):
    """Hybrid SLAM and its reference map no surfaces and no cells: no OSPA of 5 m, no empty pictures."""
    whole = shortened(gs.Scene.load("screen"), 12).with_filter(particles=500)
    (tmp_path / "screen.toml").write_text(whole.to_toml())
    for method in ("hybrid", "los"):
        result = say("run", "screen.toml", "--method", method, "-o", method)
        assert result.code == 0, result
        score = json.loads((tmp_path / method / "run.json").read_text())["agents"]["agent1"]
        assert {score[key] for key in ("surfaces_detected", "surfaces_true", "surface_ospa_m")} == {None}
        assert (score["features"] is None) == (method == "los")
        assert "0/2" not in result.out
        left = {path.name for path in (tmp_path / method).rglob("*")}
        assert "map.h5" in left
        assert not left & {"map.pgm", "map.yaml", "agent1-reflection.png"}


@pytest.mark.slow
def test_extract_writes_a_table_that_reads_back_and_replaces_nothing(say, tmp_path):
    assert say("simulate", "screen", "--signal", "-o", "z.h5").code == 0
    assert say("extract", "z.h5", "--false-alarms", "0.01", "-o", "heard.csv").code == 0
    measurements = gs.Measurements.from_csv(tmp_path / "heard.csv", ["A"])
    assert len(measurements) == 190
    assert (measurements.distance_std_m > 0).all()
    result = say("extract", "z.h5", "-o", "heard.csv")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert say("extract", "z.h5", "-o", "heard.csv", "--overwrite").code == 0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("extract", "none.h5", "-o", "a.csv"), "no file"),
        (("extract", "z.h5", "-o", "a.mat"), ".csv or .h5"),
        (("extract", "z.h5", "-o", "a.csv", "--scene", "room"), "anchors"),
        (("extract", "z.h5", "-o", "a.csv", "--false-alarms", "0"), "false_alarms"),
        (("extract", "heard.h5", "-o", "a.csv"), "gridslam-signal"),
    ],
)
def test_what_cannot_be_extracted_is_told_in_one_line(say, tmp_path, words, says):
    assert say("simulate", "screen", "--signal", "-o", "z.h5").code == 0
    assert say("simulate", "room", "-o", "heard.h5").code == 0
    result = say(*words)
    assert (result.code, len(result.complaints)) == (2, 1), result
    assert says in result.err
    assert not (tmp_path / "a.csv").exists()


def test_files_of_another_kind_say_where_they_go(say):
    assert say("simulate", "screen", "--signal", "-o", "z.h5").code == 0
    assert say("simulate", "room", "-o", "heard.h5").code == 0
    gs.Map.of_scene(gs.Scene.load("room")).save("map.h5")
    for words, says in (
        (("room", "--measurements", "z.h5"), "--signal, and gridslam extract makes paths of them"),
        (("overlap", "--method", "direct", "--signal", "heard.h5"), "measured paths go in by --measurements"),
        (("room", "--measurements", "map.h5"), "maps go in by --map"),
        (("room", "--signal", "heard.csv"), "allowed: --measurements heard.csv"),
        (("overlap", "--signal", "z.h5"), "allowed: --method direct, direct_grid, hybrid, or --measurements"),
    ):
        result = say("run", *words)
        assert (result.code, len(result.complaints)) == (2, 1), result
        assert says in result.err


@pytest.fixture
def pair(tmp_path, say):
    """The first steps of `overlap` with two agents, and what each receives."""
    data = shortened(gs.Scene.load("overlap"), 4).model_dump(exclude_none=True)
    data["agents"] = [data["agents"][0] | {"name": name} for name in ("one", "two")]
    (tmp_path / "pair.toml").write_text(gs.Scene.checked(data, "pair").to_toml())
    for seed, name in enumerate(("one", "two")):
        words = ("simulate", "pair.toml", "--signal", "--agent", name, "--seed", seed, "-o", f"{name}.h5")
        assert say(*words).code == 0
    return "run", "pair.toml", "--method", "direct", "-o", "out"


@pytest.mark.slow
def test_several_agents_run_in_turn_by_a_file_each_and_figures_are_of_each(say, pair, tmp_path, monkeypatch):
    monkeypatch.setattr("gridslam.viewers.plots.encoded", lambda figure, form: b"drawn, not rendered")
    result = say(*pair, "--signal", "two=two.h5", "--signal", "one=one.h5", "--checkpoint", 2)
    assert result.code == 0, result
    summary = json.loads((tmp_path / "out" / "run.json").read_text())
    assert list(summary["agents"]) == ["two", "one"]
    assert [known["file"] for known in summary["source"]] == ["two.h5", "one.h5"]
    for name in ("one", "two"):
        assert summary["agents"][name]["position_rmse_m"] < 0.3
    drawn = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    titles = ("map", "rays", "errors", "signal", "gospa", "images")
    assert drawn == {f"{name}-{title}.png" for name in ("one", "two") for title in titles}


@pytest.mark.slow
def test_files_that_do_not_say_whose_they_are_are_refused(say, pair):
    for words, says in (
        (("--signal", "one.h5", "--signal", "two.h5"), "NAME=FILE"),
        (("--signal", "one=one.h5", "--signal", "one=two.h5"), "one file of agent one"),
        (("--signal", "one=one.h5", "--agent", "two"), "as --agent says"),
        (("--signal", "three=one.h5"), "three"),
        (("--signal", "one=one.h5", "--measurements", "two.h5"), "--measurements"),
        (("--signal", "one.h5", "--agent", "one", "--agent", "two"), "NAME=FILE"),
    ):
        result = say(*pair, *words)
        assert (result.code, len(result.complaints)) == (2, 1), result
        assert says in result.err


@pytest.mark.slow
def test_files_of_unlike_kinds_are_refused_before_the_first_agent_runs(say, pair, tmp_path):
    chamber = shortened(gs.Scene.load("chamber"), 4)
    recording = gs.simulate(chamber, chamber.agents[0].name, seed=1, what="signal")
    recording.to_h5(tmp_path / "array.h5")
    for method in ("direct", "direct-paper", "direct_grid"):
        words = (*pair[:3], method, *pair[4:], "--signal", "one=one.h5", "--signal", "two=array.h5")
        result = say(*words)
        assert (result.code, len(result.complaints)) == (2, 1), result
        assert "one.h5 of single antennas" in result.err
        assert "array.h5 of arrays" in result.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("scene", "method"), [("overlap", "direct"), ("screen", "los"), ("room", "va")])
def test_a_map_that_the_method_would_leave_aside_is_refused(say, tmp_path, scene, method):
    result = say("run", scene, "--method", method, "--map", "map.h5", "-o", "out")
    assert (result.code, len(result.complaints)) == (2, 1), result
    assert "--map" in result.err
    assert "goes on from no map" in result.err
    assert not (tmp_path / "out").exists()


def test_measured_paths_given_as_signals_are_called_what_they_are(say, tmp_path, room):
    (tmp_path / "heard.csv").write_text("step,time_s,anchor,distance_m\n0,0,A,1\n")
    result = say("run", "overlap", "--method", "direct", "--signal", "heard.csv", "-o", "out")
    assert result.code == 2
    assert result.complaints == [
        "error: heard.csv: found a CSV file, which holds measured paths; "
        "allowed: sampled signals (.h5, .mat); a method on paths takes it as --measurements"
    ]


@pytest.mark.slow
def test_calibrate_writes_the_samples_with_the_element_where_it_is(say, tmp_path):
    scene = shortened(gs.Scene.load("screen"), 60)
    (tmp_path / "screen.toml").write_text(scene.to_toml())
    recording = gs.simulate(scene, "agent1", 3, what="signal")
    wave, off = recording.waveform, np.array([[0.05, -0.02], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    off = (off - off.mean(0)) * wave.wavelength_m
    off_centre = replace(recording, waveform=replace(wave, agent_element_m=wave.agent_element_m - off))
    off_centre.to_h5(tmp_path / "z.h5")
    result = say("calibrate", "screen.toml", "z.h5", "-o", "better.h5")
    assert (result.code, result.err) == (0, ""), result
    lines = result.out.splitlines()
    assert lines[0].startswith("wrote better.h5: 60 steps")
    assert [line.split(":")[0] for line in lines[1:]] == [*(f"element {n}" for n in range(4)), "pulse"]
    found = gs.Recording.from_h5(tmp_path / "better.h5")
    np.testing.assert_array_equal(found.samples, recording.samples)
    place = found.waveform.agent_element_m - found.waveform.agent_element_m.mean(0)
    assert np.abs(place - wave.agent_element_m).max() < 0.015 * wave.wavelength_m
    replace(off_centre, truth=None).to_h5(tmp_path / "blind.h5")
    (tmp_path / "run").mkdir()
    other = {"anchors": ["Z"], "anchor_x_m": [0.0], "anchor_y_m": [0.0], "frame": "elsewhere"}
    replace(gs.Map.of_scene(scene), provenance=other).save(tmp_path / "run/map.h5")
    for words, says in (
        (("blind.h5", "-o", "a.h5"), "no true track"),
        (("z.h5", "-o", "a.csv"), ".h5"),
        (("z.h5", "-o", "better.h5"), "--overwrite"),
        (("z.h5", "--agent", "nobody", "-o", "a.h5"), "nobody"),
        (("z.h5", "--map", "none.h5", "-o", "a.h5"), "none.h5"),
        (("z.h5", "--map", "run", "-o", "a.h5"), "--same-frame"),
    ):
        refused = say("calibrate", "screen.toml", *words)
        assert (refused.code, len(refused.complaints)) == (2, 1), refused
        assert says in refused.err
        assert not (tmp_path / "a.h5").exists()
    result = say("calibrate", "screen.toml", "z.h5", "--map", "run", "--same-frame", "-o", "a.h5")
    assert (result.code, result.err) == (0, ""), result
