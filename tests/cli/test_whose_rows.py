"""One agent's rows of a table of several devices: `run --agent` takes them, for any method of one agent."""

import json

import h5py
import numpy as np
import pytest

import gridslam as gs
from gridslam.cli.observed import own_rows
from gridslam.errors import InputError

TABLE = """step,time_s,agent,anchor,distance_m
0,0,me,A,1.5
0,0,you,B,2.5
1,1,you,A,3.5
2,2,me,,4.5
"""


@pytest.fixture
def fleet(tmp_path):
    path = tmp_path / "fleet.csv"
    path.write_text(TABLE)
    return path


def test_rows_of_one_of_several(fleet):
    own = own_rows(fleet, ("A", "B"), "you", False)
    assert own.distance_m.tolist() == [2.5, 3.5]
    assert own.anchor.tolist() == [1, 0]
    assert own.step.tolist() == [0, 1]


@pytest.mark.parametrize(
    ("agent", "said"),
    [("nobody", "agent: found no row of 'nobody'; allowed: me, you"), ("me", "anchor: found 1 of 2 rows")],
)
def test_rows_that_are_not_there_or_leave_their_anchor_open(fleet, agent, said):
    with pytest.raises(InputError, match=f"fleet.csv: {said}"):
        own_rows(fleet, ("A", "B"), agent, False)


def test_a_table_of_one_agent_is_read_as_ever(tmp_path):
    path = tmp_path / "one.csv"
    path.write_text("\n".join(line for line in TABLE.splitlines() if ",you," not in line))
    assert own_rows(path, ("A", "B"), "you", False) is None


@pytest.mark.slow
def test_run_takes_the_rows_of_the_agent_that_is_named(say, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gridslam.viewers.plots.draw_all", lambda part, run=None: [])
    whole = gs.Scene.load("canyon").model_dump(exclude_none=True)
    whole["agents"] = [agent | {"steps": 3} for agent in whole["agents"]]
    (tmp_path / "short.toml").write_text(gs.Scene.checked(whole, "short").to_toml())
    both = "--agent", "agent1", "--agent", "agent2"
    assert say("simulate", "short.toml", *both, "-o", "both.csv").code == 0
    assert say("simulate", "short.toml", "--agent", "agent2", "-o", "second.csv").code == 0
    either = say("run", "short.toml", "--measurements", "both.csv", "-o", "either")
    assert either.code == 2
    assert "found 2 agents (agent1, agent2); allowed: one (run --agent NAME takes one's rows)" in either.err
    for name in ("both", "second"):
        asked = "run", "short.toml", "--measurements", f"{name}.csv", "--agent", "agent2", "-o", name
        assert say(*asked).code == 0
    in_turn = "run", "short.toml", "--measurements", "both.csv"
    result = say(*in_turn, *both, "-o", "turn")
    assert result.code == 0, result.err
    summary = json.loads((tmp_path / "turn" / "run.json").read_text())
    assert (list(summary["agents"]), summary["source"]["file"]) == (["agent1", "agent2"], "both.csv")
    assert gs.Map.load(tmp_path / "turn" / "map.h5").provenance["agents"] == ["agent1", "agent2"]
    whose = [
        gs.Measurements.from_h5(tmp_path / run / "agent2" / "measurements.h5") for run in ("turn", "both")
    ]
    np.testing.assert_array_equal(*(heard.distance_m for heard in whose))
    tracks = [h5py.File(tmp_path / name / "agent2" / "steps.h5") for name in ("both", "second")]
    np.testing.assert_array_equal(*(file["steps/position_m"][:] for file in tracks))


@pytest.mark.slow
def test_run_takes_a_table_of_each_agent_in_their_order_or_by_name(say, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gridslam.viewers.plots.draw_all", lambda part, run=None: [])
    whole = gs.Scene.load("canyon").model_dump(exclude_none=True)
    whole["agents"] = [agent | {"steps": 3} for agent in whole["agents"]]
    (tmp_path / "short.toml").write_text(gs.Scene.checked(whole, "short").to_toml())
    for name in ("agent1", "agent2"):
        assert say("simulate", "short.toml", "--agent", name, "-o", f"{name}.csv").code == 0
    both = "--agent", "agent1", "--agent", "agent2"
    ordered = "--measurements", "agent1.csv", "--measurements", "agent2.csv"
    named = "--measurements", "agent2=agent2.csv", "--measurements", "agent1=agent1.csv"
    for folder, words in (("ordered", (*both, *ordered)), ("named", (*both, *named))):
        result = say("run", "short.toml", *words, "-o", folder)
        assert result.code == 0, result.err
        summary = json.loads((tmp_path / folder / "run.json").read_text())
        assert list(summary["agents"]) == ["agent1", "agent2"]
        assert [one["file"] for one in summary["source"]] == ["agent1.csv", "agent2.csv"]
        for name in summary["agents"]:
            kept = gs.Measurements.from_h5(tmp_path / folder / name / "measurements.h5")
            heard = gs.Measurements.from_csv(tmp_path / f"{name}.csv", kept.anchors)
            np.testing.assert_array_equal(kept.distance_m, heard.distance_m)


def test_files_that_are_too_few_or_too_many_are_refused_in_one_line(say, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    both = "--agent", "agent1", "--agent", "agent2"
    for agents, files, said in (
        (
            both[:2],
            ("a.csv", "b.csv"),
            "--measurements: found 2 files for 1 --agent; allowed: NAME=FILE of each",
        ),
        ((), ("a.csv", "b.csv"), "--measurements: found 2 files for 0 --agents; allowed: NAME=FILE of each"),
        (both, ("a.csv", "b.csv", "c.csv"), "--measurements: found 3 files for 2 --agents"),
        (both, ("agent1=a.csv", "b.csv"), "--measurements: found b.csv beside files of named agents"),
        (both, ("agent1=a.csv", "agent1=b.csv"), "--measurements: found agent1=b.csv; allowed: one file"),
        (both, ("agent1=a.csv",), "--measurements: found of agent1; allowed: of agent1, agent2"),
        (
            (*both, "--method", "network"),
            ("a.csv", "b.csv"),
            "one file, of all agents: a table with a column",
        ),
    ):
        given = (word for file in files for word in ("--measurements", file))
        result = say("run", "canyon", *agents, *given, "-o", "x")
        assert (result.code, len(result.complaints), said in result.err) == (2, 1, True), result.err
    assert not (tmp_path / "x").exists()


def test_several_agents_want_a_table_that_says_whose_its_rows_are(say, fleet, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.csv").write_text("step,time_s,anchor,distance_m\n0,0,A,1.5\n")
    (tmp_path / "mine.csv").write_text("step,time_s,agent,anchor,distance_m\n0,0,agent1,A,1.5\n")
    for file, said in (
        ("one.csv", "agent1, agent2, with one file whose rows don't say whose they are (one.csv); allowed: "),
        ("mine.csv", "mine.csv: agent: found no row of 'agent2'; allowed: agent1"),
        ("gone.csv", "gone.csv: found no such file"),
    ):
        asked = "run", "canyon", "--measurements", file, "--agent", "agent1", "--agent", "agent2", "-o", "x"
        result = say(*asked)
        assert (result.code, said in result.err) == (2, True), result.err
    assert not (tmp_path / "x").exists()
