"""Ctrl-C and SIGTERM after the last step of `run`: they cost scores, notes or figures, and never the run."""

import builtins
import importlib
import json
import signal
from pathlib import Path

import pytest
from interrupted_runs import prepared

import gridslam as gs

RUN = ("run", "tiny.toml", "--particles", "100", "--seed", "3")
ONE = (*RUN, "--agent", "agent1", "-o", "out")
STOPPED = {signal.SIGINT: (130, "interrupted"), signal.SIGTERM: (143, "terminated")}


@pytest.fixture
def tiny(say, no_figures, ctrl_c):
    return prepared(say)


def cut_short(monkeypatch, module, name, number=signal.SIGINT, then=lambda *_, **__: []):
    """Send a signal to this process, once, where a function begins."""
    sent = []

    def stop(*words, **more):
        if not sent:
            sent.append(name)
            signal.raise_signal(number)
        return then(*words, **more)

    monkeypatch.setattr(importlib.import_module(module), name, stop)


def kept(agent="agent1", steps=3):
    """What `run.json` says of a run that must be there, with every step of an agent."""
    summary = json.loads(Path("out/run.json").read_text())
    scores = summary["agents"][agent]
    assert (scores["steps"], scores["interrupted"]) == (steps, False)
    assert agent in gs.Map.load("out/map.h5").provenance["agents"][0]
    return summary


@pytest.mark.parametrize("number", STOPPED)
def test_stopped_in_its_notes_a_run_keeps_all_else(tiny, monkeypatch, number):
    """It was lost as a whole: notes were made before anything was written, and nothing caught it there."""
    assert tiny("simulate", "tiny.toml", "--agent", "agent1", "-o", "heard.csv").code == 0
    monkeypatch.setattr("gridslam.cli.run.radio_notes", lambda world: ["made before"])
    cut_short(monkeypatch, "gridslam.cli.run", "fit_notes", number)
    told = tiny(*ONE, "--measurements", "heard.csv")
    code, word = STOPPED[number]
    line = f"{word} in looking at what was heard, after the last step: out holds all but some notes"
    assert (told.code, told.complaints) == (code, [line])
    assert kept()["notes"] == ["stopped in looking at what was heard: some notes left out", "made before"]
    assert "note: made before" in told.out


def test_stopped_in_scoring_a_run_keeps_all_but_scores_and_notes(tiny, monkeypatch):
    cut_short(monkeypatch, "gridslam.cli.run", "_scores")
    told = tiny(*ONE)
    line = "interrupted in scoring, after the last step: out holds all but scores by the truth and notes"
    assert (told.code, told.complaints) == (130, [line])
    assert kept()["agents"]["agent1"]["position_rmse_m"] is None


def test_stopped_in_notes_and_again_in_drawing_names_both(tiny, monkeypatch):
    cut_short(monkeypatch, "gridslam.cli.run", "jolt_notes")
    cut_short(monkeypatch, "gridslam.viewers.plots", "draw_all")
    told = tiny(*ONE)
    missing = "some notes, figures (gridslam plot out)"
    assert told.complaints == [
        f"interrupted in looking at what was heard, after the last step: out holds all but {missing}"
    ]
    kept()


def test_stopped_while_that_is_loaded_which_draws_a_run_lacks_figures_alone(tiny, monkeypatch):
    whole = builtins.__import__

    def load(name, *more):
        if name == "gridslam.viewers.plots":
            monkeypatch.setattr(builtins, "__import__", whole)
            signal.raise_signal(signal.SIGINT)
        return whole(name, *more)

    monkeypatch.setattr(builtins, "__import__", load)
    told = tiny(*ONE)
    line = "interrupted in drawing, after the last step: out holds all but figures (gridslam plot out)"
    assert (told.code, told.complaints) == (130, [line])
    kept()


def test_stopped_while_the_map_is_drawn_up_a_run_is_whole(tiny, monkeypatch):
    from gridslam.runs.heard_stretches import map_so_far

    cut_short(monkeypatch, "gridslam.runs.map_scene", "map_so_far", then=map_so_far)
    told = tiny(*ONE)
    assert (told.code, told.complaints) == (130, ["interrupted after the last step: out holds all"])
    assert kept()["agents"]["agent1"]["position_rmse_m"] is not None


def test_stopped_while_the_first_map_is_drawn_up_the_second_agent_doesn_t_begin(tiny, monkeypatch):
    from gridslam.runs.heard_stretches import map_so_far

    cut_short(monkeypatch, "gridslam.runs.map_scene", "map_so_far", then=map_so_far)
    told = tiny(*RUN, "-o", "out")
    line = "interrupted after all 3 steps of agent1, before the last of agent2: out holds what was done"
    assert (told.code, told.complaints) == (130, [line])
    assert list(kept()["agents"]) == ["agent1"]


def test_in_python_the_interrupt_has_the_run(tiny, monkeypatch):
    from gridslam.runs.heard_stretches import map_so_far

    cut_short(monkeypatch, "gridslam.runs.map_scene", "map_so_far", then=map_so_far)
    scene = gs.Scene.load("tiny.toml")
    with pytest.raises(KeyboardInterrupt) as stop:
        gs.map_scene(scene, gs.simulate(scene, "agent1"), agent="agent1", particles=100)
    assert len(stop.value.run.estimates) == 3


@pytest.mark.slow
def test_with_a_checkpoint_notes_are_made_when_the_run_goes_on(tiny, monkeypatch):
    cut_short(monkeypatch, "gridslam.cli.run", "jolt_notes")
    told = tiny(*ONE, "--checkpoint", "1")
    assert told.code == 130
    assert told.complaints[0].endswith("to go on: gridslam run --resume out")
    assert tiny("run", "--resume", "out").code == 0
    assert "notes" not in kept() or "stopped" not in str(kept()["notes"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "name", "line"),
    [
        (
            "gridslam.cli.network",
            "map_notes",
            "interrupted in looking at what was heard, after the last step: out holds all but some notes",
        ),
        ("gridslam.runs.network_run", "_labels", "interrupted after the last step: out holds all"),
    ],
)
def test_of_several_agents_at_once_neither_is_anything_lost(tiny, monkeypatch, module, name, line):
    then = getattr(importlib.import_module(module), name)
    cut_short(monkeypatch, module, name, then=then)
    told = tiny(*RUN, "--method", "network", "-o", "out")
    assert (told.code, told.complaints) == (130, [line]), told.err
    assert list(kept()["agents"]) == ["agent1", "agent2"]
