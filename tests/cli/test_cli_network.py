"""Several agents from the command line: one run, its folder, and one line for whatever is wrong."""

import csv
import json

import h5py
import numpy as np
import pytest

import gridslam as gs
from gridslam.runs.network_files import read_clocks

SHORT = {"steps": 5}


@pytest.fixture
def short_exchange(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    whole["filter"]["particles"] = 500
    whole["agents"] = [agent | SHORT for agent in whole["agents"][:2]]
    scene = gs.Scene.checked(whole, "short")
    (tmp_path / "short.toml").write_text(scene.to_toml())
    return "short.toml"


@pytest.mark.slow
def test_a_run_of_all_agents_writes_tracks_clocks_and_figures(say, short_exchange, tmp_path):
    said = say("run", short_exchange, "--method", "network", "--seed", "1", "-o", "all")
    assert said.code == 0, said.err
    assert "apparent biases" in said.out
    assert "labels" in said.out
    summary = json.loads((tmp_path / "all" / "run.json").read_text())
    assert list(summary["agents"]) == ["agent1", "agent2"]
    assert summary["method"] == "network"
    assert summary["network"]["labels_judged"] > 30
    rows = list(csv.DictReader((tmp_path / "all" / "clocks.csv").read_text().splitlines()))
    assert len(rows) == 5 * 6
    assert list(rows[0]) == ["step", "time_s", "device", "offset_s", "offset_std_s"]
    clocks, truth = read_clocks(tmp_path / "all" / "clocks.h5")
    assert clocks.device[4:] == ("agent1", "agent2")
    np.testing.assert_allclose(float(rows[0]["offset_s"]), clocks.offset_s[0, 0])
    assert np.abs(clocks.errors(truth)[-1]).max() < 1e-8
    drawn = {path.name for path in (tmp_path / "all" / "figures").iterdir()}
    assert {"clocks.png", "tracks.png", "labels.png", "agent2-map.png"} <= drawn
    with h5py.File(tmp_path / "all" / "agent1" / "measurements.h5") as file:
        assert (file["measurements/anchor"][:] == -1).all()
    assert say("plot", "all", "--format", "svg", "--width", "8.8").code == 0
    again = {path.stem for path in (tmp_path / "all" / "figures").glob("*.svg")}
    assert again == {path.removesuffix(".png") for path in drawn}


def test_a_run_of_a_file_has_the_agents_of_the_file(say, short_exchange, tmp_path, monkeypatch):
    monkeypatch.setattr("gridslam.viewers.plots.draw_all", lambda part: [])
    both = "--agent", "agent2", "--agent", "agent1"
    assert say("simulate", short_exchange, *both, "--unlabelled", "-o", "heard.csv").code == 0
    said = say("run", short_exchange, "--method", "network", "--measurements", "heard.csv", "-o", "two")
    assert said.code == 0, said.err
    summary = json.loads((tmp_path / "two" / "run.json").read_text())
    assert list(summary["agents"]) == ["agent1", "agent2"]
    assert summary["network"]["label_errors"] is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("agent1,", "agent9,"), "line 2: agent: found 'agent9'"),
        (("agent1,,", "agent1,Z,"), "line 2: anchor: found 'Z'"),
        (None, "'agent2', who should be there and has no row"),
    ],
)
def test_bad_tables_are_one_line(say, short_exchange, tmp_path, change, says):
    scene = gs.Scene.load(tmp_path / short_exchange)
    gs.simulate(scene, ["agent1"], unlabelled=True).to_csv(tmp_path / "heard.csv")
    text = (tmp_path / "heard.csv").read_text()
    more = ()
    if change is None:
        more = "--agent", "agent1", "--agent", "agent2"
    else:
        (tmp_path / "heard.csv").write_text(text.replace(*change, 1))
    said = say(
        "run", short_exchange, "--method", "network", "--measurements", "heard.csv", *more, "-o", "out"
    )
    assert said.code == 2
    assert says in said.err
    assert said.err.strip().count("\n") == 0
    assert not (tmp_path / "out").exists()


def test_what_does_not_fit_several_agents_is_refused(say, short_exchange, tmp_path):
    run = "run", short_exchange, "--method", "network"
    assert "--checkpoint" in say(*run, "--checkpoint", "5").err
    assert "'agent1' twice" in say(*run, "--agent", "agent1", "--agent", "agent1").err
    scene = gs.Scene.load(tmp_path / short_exchange)
    gs.simulate(scene, ["agent1", "agent2"], unlabelled=True).to_h5(tmp_path / "heard.h5")
    said = say("run", short_exchange, "--method", "adaptive", "--measurements", "heard.h5", "-o", "out")
    assert (said.code, "2 agents" in said.err) == (2, True)
