"""Several agents from the command line: one run, its folder, and one line for whatever is wrong."""

import csv
import json
import signal
from dataclasses import replace

import h5py
import numpy as np
import pytest
from interrupted_runs import as_if_killed, same_runs
from scene_samples import short

import gridslam as gs
from gridslam.cli.network import recorded_network
from gridslam.runs.network_files import read_clocks
from gridslam.runs.unfinished import read_unfinished
from gridslam.systems.network_front import NetworkFront

SHORT = {"steps": 5}


@pytest.fixture
def short_exchange(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    whole["filter"]["particles"] = 500
    whole["agents"] = [agent | SHORT for agent in whole["agents"][:2]]
    whole["clocks"]["anchor_prior_ns"] = 5.0  # wider ones are searched for in whole steps, which takes long
    for anchor in whole["anchors"]:
        anchor["clock"]["offset_ns"] *= 0.04
    scene = gs.Scene.checked(whole, "short")
    (tmp_path / "short.toml").write_text(scene.to_toml())
    return "short.toml"


def with_known_clocks(scene):
    """The same scene with clocks that are right, and lengths of paths for distances."""
    radio = scene.radio.model_copy(update={"window_m": None})
    return scene.model_copy(update={"clocks": None, "radio": radio})


@pytest.mark.slow
def test_a_run_of_all_agents_writes_tracks_clocks_and_figures(say, short_exchange, tmp_path, monkeypatch):
    result = say("run", short_exchange, "--method", "network", "--seed", "1", "-o", "all")
    assert result.code == 0, result.err
    assert "apparent biases" in result.out
    assert "labels" in result.out
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
    monkeypatch.setattr("gridslam.viewers.plots.encoded", lambda *_: b"<svg>")  # they were drawn above
    assert say("plot", "all", "--format", "svg", "--width", "8.8").code == 0
    again = {path.stem for path in (tmp_path / "all" / "figures").glob("*.svg")}
    assert again == {path.removesuffix(".png") for path in drawn}


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_grid_slam_is_network_grid_slam_where_clocks_are_not_known(say, short_exchange, tmp_path):
    result = say("run", short_exchange, "--agent", "agent1", "--seed", "2", "-o", "one")
    assert result.code == 0, result.err
    assert "note: exchange: clocks aren't known, so grid is network_grid, which finds them" in result.err
    summary = json.loads((tmp_path / "one" / "run.json").read_text())
    assert summary["method"] == "network_grid"
    assert (tmp_path / "one" / "clocks.csv").exists()
    with h5py.File(tmp_path / "one" / "agent1" / "measurements.h5") as file:
        assert (file["measurements/anchor"][:] >= 0).all()
    heard = say("run", short_exchange, "--measurements", "one/agent1/measurements.h5", "-o", "two")
    assert heard.code == 0, heard.err
    assert "labels are simulated" not in heard.err


@pytest.mark.slow
@pytest.mark.parametrize(("asked", "stands"), [("grid", "network_grid"), ("adaptive", "network")])
def test_from_python_too(short_exchange, asked, stands):
    scene = gs.Scene.load(short_exchange)
    heard = gs.simulate(scene, "agent1", 3)
    run, same = (gs.map_scene(scene, heard, name, seed=3) for name in (asked, stands))
    assert run.method == same.method == stands
    assert run.trajectory.position_m.tolist() == same.trajectory.position_m.tolist()
    known = with_known_clocks(scene)
    assert gs.map_scene(known, gs.simulate(known, "agent1", 3), asked, seed=3).method == asked
    with pytest.raises(gs.InputError, match="clocks that aren't known"):
        gs.map_scene(scene, heard, "va")


@pytest.mark.slow
def test_a_run_of_a_file_has_the_agents_of_the_file(say, short_exchange, tmp_path, monkeypatch):
    monkeypatch.setattr("gridslam.viewers.plots.draw_all", lambda part, run=None: [])
    both = "--agent", "agent2", "--agent", "agent1"
    assert say("simulate", short_exchange, *both, "--unlabelled", "-o", "heard.csv").code == 0
    title, *rows = (tmp_path / "heard.csv").read_text().splitlines()
    (tmp_path / "heard.csv").write_text(
        "\n".join([f"{title},aoa_elevation_rad", *(f"{r},0.1" for r in rows)])
    )
    result = say("run", short_exchange, "--method", "network", "--measurements", "heard.csv", "-o", "two")
    assert result.code == 0, result.err
    assert "note: the elevations that were measured aren't used by network" in result.err
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
    result = say(
        "run", short_exchange, "--method", "network", "--measurements", "heard.csv", *more, "-o", "out"
    )
    assert result.code == 2
    assert says in result.err
    assert result.err.strip().count("\n") == 0
    assert not (tmp_path / "out").exists()


def test_what_does_not_fit_several_agents_is_refused(say, short_exchange, tmp_path):
    run = "run", short_exchange, "--method", "network"
    assert "which takes path measurements" in say(*run, "--signal", "z.h5").err
    assert "'agent1' twice" in say(*run, "--agent", "agent1", "--agent", "agent1").err
    street = short("canyon", 2)  # whose clocks are known
    (tmp_path / "street.toml").write_text(street.to_toml())
    gs.simulate(street, ["agent1", "agent2"], unlabelled=True).to_h5(tmp_path / "heard.h5")
    result = say("run", "street.toml", "--method", "adaptive", "--measurements", "heard.h5", "-o", "out")
    assert (result.code, "2 agents" in result.err) == (2, True)


def stop_at(monkeypatch, step):
    """Send Ctrl-C to this process at a step, once."""
    whole, left = NetworkFront.step, [step]

    def cut(slam, scan):
        if scan.step in left:
            left.clear()
            signal.raise_signal(signal.SIGINT)
        return whole(slam, scan)

    monkeypatch.setattr(NetworkFront, "step", cut)


NETWORK = ("run", "short.toml", "--method", "network", "--seed", "1")


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures", "ctrl_c", "short_exchange")
def test_interrupted_run_shows_its_table_and_keeps_what_is_done(say, monkeypatch, tmp_path):
    stop_at(monkeypatch, 2)
    result = say(*NETWORK, "-o", "out")
    assert result.code == 130
    assert "agent2" in result.out
    assert "apparent biases" in result.out
    assert result.complaints == ["interrupted after 3 of 5 steps: out holds what was done"]
    assert json.loads((tmp_path / "out" / "run.json").read_text())["agents"]["agent1"]["interrupted"]


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures", "ctrl_c", "short_exchange")
def test_interrupted_run_that_is_resumed_is_as_if_it_never_was(say, monkeypatch):
    """With a grid beside what all agents share; of network SLAM alone, a run that is killed below."""
    words = ("run", "short.toml", "--method", "network_grid", "--seed", "1")
    assert say(*words, "-o", "whole").code == 0
    for step, more in ((0, (*words, "--checkpoint", "2", "-o", "out")), (2, ("run", "--resume", "out"))):
        with monkeypatch.context() as patch:
            stop_at(patch, step)
            result = say(*more)
        done = f"interrupted after {step + 1} of 5 steps of agent1, agent2; "
        assert (result.code, result.complaints) == (130, [f"{done}to go on: gridslam run --resume out"])
    result = say("run", "--resume", "out", "--seed", "2")
    assert (result.code, "error: --seed: found 2" in result.err) == (2, True)
    assert say("run", "--resume", "out").code == 0
    same_runs("whole", "out")


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures", "short_exchange")
def test_killed_run_loses_no_more_than_the_steps_since_its_checkpoint(say):
    """Checkpoints: 1 nothing, 2 the agents begin, 3 and 4 two steps each, 5 the last step.

    Of one agent after the other, real processes are killed; to load these kernels takes one eight seconds.
    """
    assert say(*NETWORK, "-o", "whole").code == 0
    as_if_killed(say, 4, *NETWORK, "-o", "out", "--checkpoint", "2")
    (agents,) = read_unfinished("out").agents
    assert (agents.name, agents.done, agents.total) == ("agent1, agent2", 2, 5)
    assert say("run", "--resume", "out").code == 0
    same_runs("whole", "out")


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures", "short_exchange")
def test_recorded_measurements_are_scored_by_the_tracks_that_are_given(say, tmp_path, monkeypatch):
    scene = gs.Scene.load("short.toml")
    assert (
        say("simulate", "short.toml", "--agent", "agent1", "--agent", "agent2", "-o", "heard.csv").code == 0
    )
    for name in ("agent1", "agent2"):
        scene.track(name).to_tum(f"{name}.tum")
    recorded = (*NETWORK, "--measurements", "heard.csv")
    result = say(*recorded, "--truth", "agent2=agent2.tum", "-o", "one")
    assert result.code == 0, result.err
    scores = json.loads((tmp_path / "one" / "run.json").read_text())["agents"]
    assert scores["agent1"]["position_rmse_m"] is None
    assert 0 < scores["agent2"]["position_rmse_m"] < 0.3
    assert scores["agent2"]["surfaces_true"] == 4
    assert scores["agent1"]["surfaces_true"] is None
    assert "are scored by what agent2 alone could hear: no true track of agent1 is given" in result.out
    assert not (tmp_path / "one" / "agent1" / "truth.tum").exists()
    for item in ("agent1.tum", "agent3=agent1.tum"):
        result = say(*recorded, "--truth", item, "-o", "two")
        assert result.code == 2
        assert f"--truth: found {item}; allowed: NAME=FILE.tum, one for each of agent1, agent2" in result.err
    result = say(*NETWORK, "--truth", "agent1=agent1.tum", "-o", "two")
    assert "only together with --measurements" in result.err


def agent_twice(scene, measurements):
    return scene.replace('name = "agent2"', 'name = "agent1"'), measurements


def agent_as_an_anchor(scene, measurements):
    return scene.replace('name = "agent2"', 'name = "B"'), measurements


def agent_elsewhere(scene, measurements):
    return scene.replace('name = "agent2"', 'name = "other"'), measurements


def no_prior(scene, measurements):
    lines = [line for line in scene.splitlines() if not line.startswith("anchor_prior_ns")]
    return "\n".join(lines), measurements


def some_labels(scene, measurements):
    label = np.where(np.arange(len(measurements.agent)) % 2, measurements.table.anchor, -1)
    table = replace(measurements.table, anchor=label, unlabelled=True)
    return scene.replace('name = "C"', 'name = "Z"'), replace(measurements, table=table)


@pytest.mark.parametrize("kind", ["csv", "h5"])
@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (agent_twice, "agents[1].name: found 'agent1'; allowed: a name that isn't taken"),
        (agent_as_an_anchor, "agents[1].name: found 'B'; allowed: a name that no anchor has"),
        (agent_elsewhere, "agent{kind}: found 'agent2'; allowed: agent1, other"),
        (no_prior, "clocks.anchor_prior_ns: found neither it nor a reference; allowed: a half width"),
        (some_labels, "anchor{kind}: found {found}; allowed: A, B, Z, D"),
    ],
)
def test_what_does_not_belong_together_is_one_line_of_run_and_check(
    say, short_exchange, tmp_path, kind, spoil, says
):
    scene = gs.Scene.load(tmp_path / short_exchange)
    text, measurements = spoil(scene.to_toml(), gs.simulate(scene, ["agent1", "agent2"], seed=1))
    (tmp_path / "spoilt.toml").write_text(text)
    path = tmp_path / f"heard.{kind}"
    (measurements.to_csv if kind == "csv" else measurements.to_h5)(path)
    found = "'C'" if kind == "csv" else "A, B, C, D"
    says = says.format(kind="" if kind == "csv" else "s", found=found)
    run = "run", "spoilt.toml", "--method", "network", "--measurements", path.name, "-o", "out"
    for words in (run, ("check", path.name, "--scene", "spoilt.toml")):
        result = say(*words)
        assert result.code == 2
        assert says in result.err
        assert ("spoilt.toml" if "allowed: a name" in says or "prior" in says else path.name) in result.err
        assert result.err.strip().count("\n") == 0
        assert not result.out.strip()
    assert not (tmp_path / "out").exists()
    assert path.exists()


def test_file_without_a_column_agent_is_that_of_the_one_agent_that_was_asked_for(tmp_path):
    from gridslam.cli.network import recorded_network

    world, path = gs.Scene.load("exchange"), tmp_path / "heard.csv"
    path.write_text("# toolkit 4.1\nstep,time_s,distance_m\n0,0,1.5\n1,0.1,2.5\n")
    chosen = world.agents[1].name
    assert recorded_network(world, path, [chosen]).agents == (chosen,)
    with pytest.raises(gs.InputError, match=r"heard.csv: line 2: found no column 'agent'"):
        recorded_network(world, path, None)


def test_agents_are_there_when_the_scene_says_whatever_epoch_the_table_counts_from(tmp_path):
    """A recorder counts from 1970; `present_s` counts from where the table begins."""
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    whole["agents"] = [agent | {"steps": 12} for agent in whole["agents"][:2]]
    whole["agents"][1]["present_s"] = (4.0, 1000.0)
    scene, present = gs.Scene.checked(whole, "late"), []
    heard = gs.simulate(scene, ["agent1", "agent2"], 4, unlabelled=True)
    heard.to_csv(tmp_path / "heard.csv")
    head, *rows = csv.reader((tmp_path / "heard.csv").read_text().splitlines())
    column = head.index("time_s")
    for began in (0.0, 1.7e9):
        later = [[*row[:column], repr(float(row[column]) + began), *row[column + 1 :]] for row in rows]
        with open(tmp_path / "later.csv", "w", newline="") as file:
            csv.writer(file).writerows([head, *later])
        present.append(recorded_network(scene, tmp_path / "later.csv", None).present)
    assert present[0][1][0] == 4
    np.testing.assert_array_equal(present[1], present[0])
