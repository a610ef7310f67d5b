"""Names of scenes, anchors and agents: what would cost a run at its end is refused at its start."""

import json
import os
from pathlib import Path

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tables import table
from tiny import TINY

from gridslam.errors import InputError
from gridslam.measurements.table import Measurements
from gridslam.world.scene import Scene

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
SCENE = Scene.from_toml(TINY, "tiny.toml")
EVERY = settings(
    max_examples=200,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def named(*agents, anchor="A", name="tiny"):
    """The tiny scene with other names."""
    whole = SCENE.model_dump(exclude_none=True)
    whole["agents"] = [{**whole["agents"][0], "name": agent} for agent in agents or ("agent1",)]
    whole["anchors"] = [{**whole["anchors"][0], "name": anchor}, whole["anchors"][1]]
    return {**whole, "name": name}


FILES = (
    "figures",
    "run.json",
    "report.html",
    "scene.toml",
    "map.h5",
    "map.yaml",
    "map.pgm",
    "reflection.pgm",
)
DEVICES = ("CON", "nul", "Aux.txt", "prn.a.b", "COM1", "com9.h5", "LPT3", "lpt0", "COM¹", "con .x")
BAD_ENDS = ("a.", "a ", "a. ", "..", ".", " a", ".hidden", "")
BAD_MIDDLES = ("a/b", "a\\b", "../a", "/a", "a:b", "a\0b", "a\nb", "a\x7fb", "a\u202eb", "<b>", "名" * 80)


@pytest.mark.parametrize("name", [*FILES, "Figures", "RUN.json", *DEVICES, *BAD_ENDS, *BAD_MIDDLES])
def test_agent_that_could_not_be_a_folder_is_refused_in_the_scene(name):
    with pytest.raises(InputError) as caught:
        Scene.checked(named(name), "tiny.toml")
    assert caught.value.where == "tiny.toml: agents[0].name"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["agent1", "config", "connie.x", "com10", "a.b", "Jürgen 2", "名前", "map"])
def test_agent_that_can_be_a_folder_is_not(name):
    assert Scene.checked(named(name), "tiny.toml").agents[0].name == name


@pytest.mark.parametrize(("first", "second"), [("a", "A"), ("straße", "STRASSE"), ("\u00e5", "\u212b")])
def test_agents_that_some_disks_take_for_one_are_refused(first, second):
    with pytest.raises(InputError) as caught:
        Scene.checked(named("b", first, second), "tiny.toml")
    assert caught.value.where == "tiny.toml: agents[2].name"


@pytest.mark.slow
@EVERY
@given(name=st.text(st.characters(codec="utf-8"), max_size=8) | st.text("=+-@ \t\0A1", max_size=4))
def test_anchor_and_scene_with_any_name_are_refused_at_once_or_survive_all_files(tmp_path, name):
    try:
        scene = Scene.checked(named(anchor=name, name=name), "tiny.toml")
    except InputError:
        return
    assert Scene.from_toml(scene.to_toml(), "again.toml") == scene
    measurements = Measurements(**table(4, anchors=scene.anchor_names))
    measurements.to_h5(tmp_path / "a.h5")
    measurements.to_csv(tmp_path / "a.csv")
    assert Measurements.from_h5(tmp_path / "a.h5").anchors == measurements.anchors
    assert Measurements.from_csv(tmp_path / "a.csv").anchors == measurements.anchors


@pytest.mark.parametrize("name", ["=cmd|'/c calc'!A1", "+1", "-1", "@SUM(1)", "a\0", "\ta", " a"])
def test_no_table_begins_a_cell_with_a_formula(name):
    for where, data in (("anchors[0].name", named(anchor=name)), ("name", named(name=name))):
        with pytest.raises(InputError) as caught:
            Scene.checked(data, "tiny.toml")
        assert caught.value.where == f"tiny.toml: {where}"
    with pytest.raises(InputError, match="anchors"):
        Measurements(**table(4, anchors=(name, "B")))


def test_scene_file_of_any_name_is_read():
    text = TINY.replace('name = "tiny"\n', "", 1)
    assert [Scene.from_toml(text, f"{stem}.toml").name for stem in ("-x", "@home", "y")] == [
        "scene",
        "scene",
        "y",
    ]


@pytest.mark.slow
def test_everything_in_a_runs_folder_is_no_name_for_an_agent(say, blank_figures):
    Path("tiny.toml").write_text(TINY)
    assert say("run", "tiny.toml", "--particles", "100", "-o", "out").code == 0
    assert say("report", "out", "--still").code == 0
    own = set(os.listdir("out")) - {"agent1", "agent2"}
    assert {"run.json", "report.html", "map.h5"} <= own
    for name in (*own, *(word.upper() for word in own)):
        Path("bad.toml").write_text(tomli_w.dumps(named(name)))
        with pytest.raises(InputError, match=r"bad\.toml: agents\[0\]\.name"):
            Scene.load("bad.toml")
    result = say("check", "bad.toml")
    assert (result.code, len(result.complaints)) == (2, 1)


@pytest.mark.slow
@pytest.mark.parametrize("outside", ["../evil", "absolute"])
def test_agent_in_run_json_leads_nowhere_else(say, tmp_path, monkeypatch, outside):
    """A folder outside that has all files of an agent would be read, and a film written beside it."""
    Path("tiny.toml").write_text(TINY)
    with monkeypatch.context() as quick:
        quick.setattr("gridslam.viewers.plots.draw_all", lambda folder, run=None: [])
        assert say("run", "tiny.toml", "--particles", "100", "--agent", "agent1", "-o", "out").code == 0
    Path("out/agent1").rename("evil")
    name = str(tmp_path / "evil") if outside == "absolute" else outside
    summary = json.loads(Path("out/run.json").read_text())
    summary["agents"] = {name: summary["agents"]["agent1"]}
    Path("out/run.json").write_text(json.dumps(summary))
    before = sorted(tmp_path.rglob("*"))
    for command in (("report", "out"), ("plot", "out"), ("check", "out")):
        result = say(*command)
        assert (result.code, len(result.complaints)) == (2, 1)
        assert "run.json: agents" in result.err
    assert sorted(tmp_path.rglob("*")) == before
