"""Small things that make the command line easy to live with."""

import json
import re
import subprocess
import sys
from contextlib import nullcontext
from dataclasses import replace
from importlib.metadata import version
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table
from scene_samples import shortened
from tiny import TINY

import gridslam as gs
from gridslam.cli import run as run_command
from gridslam.cli.observed import hints
from gridslam.cli.output import print_whole
from gridslam.estimate_tables import FeatureEstimate, SurfaceEstimate
from gridslam.runs.progress import LEAST_STEPS, LINES, progress_bar

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize("words", [("--version",), ("run", "-h"), ("-h",)])
def test_version_and_help_are_told(say, words):
    result = say(*words)
    assert (result.code, result.err) == (0, "")
    assert (f"gridslam {version('gridslam')}" if words == ("--version",) else "Usage:") in result.out


def test_help_says_whose_false_alarms_are_without_labels(say):
    assert "false_alarms count for all together" in " ".join(
        say("simulate", "-h").out.replace("│", "").split()
    )


def test_tables_are_printed_with_all_digits_however_long_names_are(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    table, numbers = Table(box=None), [f"{100 + n:.1f}%" for n in range(30)]
    for title in ("agent", *numbers):
        table.add_column(title, no_wrap=True)
    table.add_row("an agent whose name is long", *numbers)
    print_whole(table)
    title, row = capsys.readouterr().out.splitlines()
    assert title.split()[1:] == row.split()[6:] == numbers


@pytest.mark.slow
def test_module_is_the_command_line(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "gridslam", "--version"], capture_output=True, text=True, cwd=tmp_path
    )
    assert (done.returncode, done.stdout) == (0, f"gridslam {version('gridslam')}\n")


def test_commands_come_in_groups_and_names_are_completed():
    import typer

    from gridslam.cli.asked import MAIN_SCENE
    from gridslam.cli.help import COMPARE, LOOK, MAP, SCENES, method_names, scene_names
    from gridslam.cli.main import app

    commands = typer.main.get_command(app).commands.values()
    assert {command.rich_help_panel for command in commands} == {MAP, LOOK, SCENES, COMPARE}
    assert MAIN_SCENE in scene_names()
    assert "va" in method_names()
    run = typer.main.get_command(app).commands["run"]
    completed = {p.name for p in run.params if getattr(p, "_custom_shell_complete", None) is not None}
    assert completed == {"scene", "method"}


def test_progress_is_told_in_lines_where_there_is_no_terminal(capsys):
    scene = shortened(gs.Scene.load("room"), 2)
    (estimate, _) = gs.map_scene(scene, gs.simulate(scene, "agent1", 1), particles=64).estimates
    for total, lines in ((LEAST_STEPS, LINES), (LEAST_STEPS - 1, 0), (257, LINES)):
        with progress_bar("agent1") as tell:
            for done in range(1, total + 1):
                tell(estimate, done, total)
        shown = capsys.readouterr().err.splitlines()
        assert len(shown) == lines
        assert not lines or shown[-1].startswith(f"agent1: step {total} of {total}, ")


@pytest.mark.usefixtures("no_figures")
def test_counts_of_surfaces_agree_in_table_and_file(say):
    name = "an-agent-with-a-long-name"
    Path("tiny.toml").write_text(TINY.replace("agent1", name))
    result = say("run", "tiny.toml", "--agent", name, "-o", "out")
    own = json.loads(Path("out/run.json").read_text())["agents"][name]
    assert f"{own['map']['occupied_precision']:.1%} " in result.out
    counts = [own[f"surfaces_{name}"] for name in ("detected", "matched", "true", "false")]
    assert counts[1] <= min(counts[0], counts[2])
    assert f"{counts[0]} {counts[1]}/{counts[2]} {counts[3]} " in result.out
    assert own["position_std_m"] > 0


@pytest.mark.usefixtures("no_figures")
def test_run_without_truth_shows_its_own_deviations(say):
    scene = gs.Scene.from_toml(TINY, "tiny")
    gs.simulate(scene, "agent1", 1).to_csv("heard.csv")
    Path("tiny.toml").write_text(TINY)
    note = "note: heard.csv: taken for agent1's, the scene's first agent; else: --agent agent2"
    result = say("run", "tiny.toml", "--measurements", "heard.csv", "-o", "out")
    assert (result.code, result.complaints) == (0, [note])
    own = json.loads(Path("out/run.json").read_text())["agents"]["agent1"]
    assert own["position_rmse_m"] is None
    assert f"+-{100 * own['position_std_m']:.2f}" in result.out
    assert f"+-{own['heading_std_deg']:.2f}" in result.out


@pytest.mark.usefixtures("no_figures")
def test_other_columns_of_a_table_are_passed_over_and_noted(say):
    scene = gs.Scene.from_toml(TINY, "tiny")
    measurements = gs.simulate(scene, "agent1", 1)
    measurements.to_csv("heard.csv")
    first, *rows = Path("heard.csv").read_text().splitlines()
    more = [f"{first},rssi,comment", *(f'{row},-40,"loud, near"' for row in rows)]
    Path("more.csv").write_text("\n".join(more))
    note = "note: more.csv: columns rssi, comment not used"
    Path("tiny.toml").write_text(TINY)
    run = ("run", "tiny.toml", "--agent", "agent1", "--measurements", "more.csv", "-o", "out")
    for words in (("check", "more.csv"), run):
        result = say(*words)
        assert (result.code, result.complaints) == (0, [note])
    assert json.loads(Path("out/run.json").read_text())["notes"][0] == note.removeprefix("note: ")
    with pytest.warns(gs.errors.Note, match="rssi, comment"):
        again = gs.Measurements.from_csv("more.csv")
    np.testing.assert_array_equal(again.distance_m, measurements.distance_m)
    Path("wrong.csv").write_text("\n".join([f"{first},distence_m", *(f"{row},1" for row in rows)]))
    assert "distance_m (nearest known)" in say("check", "wrong.csv").err


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_measurements_that_make_a_filter_unwell_point_to_check(say, short_room):
    measurements = gs.simulate(gs.Scene.load(short_room), "agent1")
    mixed = np.random.default_rng(1).permutation(measurements.distance_m)  # no reading of columns cures it
    replace(measurements, distance_m=mixed, aoa_rad=np.sin(mixed)).to_csv("heard.csv")
    result = say("run", short_room, "--agent", "agent1", "--measurements", "heard.csv", "-o", "one")
    assert f"is told by: gridslam check heard.csv --scene {short_room}" in result.out


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_a_table_says_which_simulation_it_is_of_and_a_run_by_another_scene_or_agent_notes_it(say, short_room):
    result = say("simulate", short_room, "--seed", 3, "-o", "heard.h5")
    assert result.out.endswith(" (room, agent1, seed 3)\n")
    assert "  simulated: room, agent1, seed 3\n" in say("check", "heard.h5").out
    other = gs.Scene.load(short_room).model_copy(update={"name": "annexe"})
    Path("other.toml").write_text(other.to_toml())
    for scene, agent, noted in (
        (short_room, "agent1", 0),
        ("other.toml", "agent1", 1),
        (short_room, "agent2", 1),
    ):
        words = ("--agent", agent, "--measurements", "heard.h5", "-o", "out", "--overwrite")
        result = say("run", scene, *words)
        assert result.code == 0
        assert result.err.count("note: heard.h5: simulated in room, agent1, seed 3, and taken for ") == noted


@pytest.mark.slow
def test_check_without_a_scene_says_what_it_could_not_tell(say, tmp_path):
    scene = shortened(gs.Scene.load("room"), 5)
    gs.simulate(scene, "agent1", 1).to_csv("heard.csv")
    gs.simulate(scene, ["agent1"], 1, unlabelled=True).to_h5("all.h5")
    for name in ("heard.csv", "all.h5"):
        alone = say("check", name)
        assert alone.code == 0
        assert "not told without a scene: " in alone.out
        assert "--scene SCENE" in alone.out.splitlines()[-1]
        assert "not told" not in say("check", name, "--scene", "room").out
    judged = say("check", "heard.csv", "--scene", "room").out.splitlines()[-1]
    assert "of 10 scans: units and frames fit the scene" in judged
    gs.simulate(gs.Scene.load("room"), "agent1", 1).to_csv("heard.csv")
    judged = say("check", "heard.csv", "--scene", "room").out.splitlines()[-1]
    assert "of 200 scans of the first 100 steps: units and frames fit the scene" in judged


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(("method", "hinted"), [("grid", True), ("va", False)])
def test_distances_alone_point_to_the_method_for_them(say, method, hinted):
    scene = gs.Scene.from_toml(TINY, "tiny")
    for name, keys in (("alone", ("distance_m",)), ("whole", ("distance_m", "aoa_rad"))):
        measurements = gs.simulate(scene, "agent1", 1)
        lines = [",".join(("step", "time_s", "anchor", *keys))]
        lines += [
            ",".join(
                map(str, (s, float(s), "AB"[a], *(float(getattr(measurements, key)[n]) for key in keys)))
            )
            for n, (s, a) in enumerate(zip(measurements.step, measurements.anchor, strict=True))
        ]
        Path(f"{name}.csv").write_text("\n".join(lines))
    Path("tiny.toml").write_text(TINY)
    words = ("run", "tiny.toml", "--method", method, "--particles", "64")
    alone = say(*words, "--measurements", "alone.csv", "-o", "one")
    assert ("--method va" in alone.err) == hinted
    assert alone.code == 0
    assert "--method va" not in say(*words, "--measurements", "whole.csv", "-o", "other").err


def test_before_a_run_it_is_said_what_a_method_does_not_use():
    overlap, tall = gs.Scene.load("overlap"), gs.Scene.load("ceiling")
    assert "made for --method direct or hybrid" in " ".join(hints(overlap, "grid", None))
    assert hints(overlap, "direct", None) == hints(gs.Scene.load("room"), "grid", None) == []
    one = np.array([0])
    values = dict.fromkeys(("time_s", "distance_m", "aod_rad", "aoa_rad", "amplitude"), np.ones(1))
    measurements = gs.Measurements(
        anchors=("A",), step=one, anchor=one, **values, aoa_elevation_rad=np.ones(1)
    )
    assert hints(tall, "grid", measurements) == []
    assert "grid and adaptive do" in " ".join(hints(tall, "va", measurements))
    assert "gives no heights" in " ".join(hints(gs.Scene.load("room"), "grid", measurements))


@pytest.mark.slow
def test_figures_are_drawn_in_other_formats_and_widths(say, monkeypatch):
    Path("tiny.toml").write_text(TINY)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gridslam.viewers.plots.draw_all", lambda folder, run=None: [])
        assert say("run", "tiny.toml", "--agent", "agent1", "-o", "out").code == 0
    assert say("plot", "out", "--format", "pdf", "--width", "8.8").code == 0
    names = {path.name for path in Path("out/figures").iterdir()}
    assert names == {f"agent1-{title}.pdf" for title in ("map", "reflection", "rays", "errors")}
    for name in ("agent1-gospa.pdf", "agent1-gospa.png", "mine.pdf"):  # of earlier drawings, and the user's
        Path("out/figures", name).write_text("old")
    monkeypatch.setattr("gridslam.viewers.plots.encoded", lambda *_: b"%PDF")  # as above: which are there?
    assert say("plot", "out", "--format", "pdf").code == 0
    assert {path.name for path in Path("out/figures").iterdir()} == {*names, "agent1-gospa.png", "mine.pdf"}
    result = say("plot", "out", "--format", "jpg")
    assert (result.code, len(result.complaints)) == (2, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_what_is_wrong_with_measurements_is_named_below_the_table_of_a_run(say, monkeypatch):
    scene = shortened(gs.Scene.load("room"), 60).with_filter(particles=64)
    measurements = gs.simulate(scene, "agent1", 12)
    Path("room.toml").write_text(scene.to_toml())
    measurements.truth.to_tum("true.tum")
    files = ("--measurements", "heard.csv", "--truth", "true.tum")
    run = ("run", "room.toml", *files, "-o", "out", "--overwrite")
    replace(measurements, anchor=1 - measurements.anchor).to_csv("heard.csv")
    result = say(*run)
    names = "anchor: probably names exchanged: A is the scene's B, B is the scene's A"
    assert f"note: agent1: suspect: {names}" in result.out
    assert "note: agent1: the true track fits what was heard far better " in result.out
    notes = json.loads(Path("out/run.json").read_text())["notes"]
    told = [line.removeprefix("note: ") for line in result.out.splitlines() if line.startswith("note: ")]
    assert [line in told for line in notes] == [True] * 5, (
        "another start fits as well, and steps that are wrong in silence"
    )
    assert notes[0].startswith("agent1: lost: ")
    assert told[:3] == notes[:3], "what is suspected comes before what follows from it"
    assert len(told) > len(notes)
    assert "is told by" not in result.out, "it has been told"
    monkeypatch.syspath_prepend(EXAMPLES)
    run = (*run, "--method", "own_method:SightFilter")  # of any method, and this one is soon through
    replace(measurements, amplitude=20 * np.log10(measurements.amplitude)).to_csv("heard.csv")
    assert "note: agent1: suspect: amplitude: decibels, where the linear root of" in say(*run).out
    replace(measurements, time_s=1e3 * measurements.time_s).to_csv("heard.csv")
    slow = ("run", "room.toml", *files[:2], "-o", "out", "--overwrite")  # no track has such times
    assert "note: agent1: suspect: time_s: probably milliseconds" in say(*slow).out
    replace(measurements, amplitude=1.5 * measurements.amplitude).to_csv("heard.csv")
    assert "suspect" not in say(*run).out
    replace(measurements, distance_m=np.maximum(np.round(2 * measurements.distance_m), 1) / 2).to_csv(
        "heard.csv"
    )
    assert "note: agent1: suspect: distance_m: comes in steps of 0.5 m: give" in say(*run).out
    for metres, times in ((0.0, 0), (1.5, 1)):
        replace(measurements, distance_m=measurements.distance_m + metres).to_csv("heard.csv")
        result = say(*run)
        assert result.code == 0
        assert "true track" not in result.out, "an offset is the scene's clocks', not the track's"
        assert times or "suspect" not in result.out
        named = re.findall(
            r"note: agent1: distances of all anchors are 1\.[45]\d m .* too long.*", result.out
        )
        assert len(named) == times


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_a_runs_folder_stands_for_its_map(say, tmp_path):
    from gridslam.cli.options import map_in

    (tmp_path / "one").mkdir()
    gs.Map.of_scene(shortened(gs.Scene.load("room"), 2)).save(tmp_path / "one/map.h5")
    assert map_in(Path("one")) == Path("one/map.h5")
    assert map_in(Path("one/map.h5")) == Path("one/map.h5")
    assert map_in(Path("nowhere")) == Path("nowhere")
    assert map_in(None) is None
    (tmp_path / "bare").mkdir()
    result = say("export", "bare", "-o", "robot")
    assert result.code == 2
    assert result.complaints == ["error: bare/map.h5: found no file; allowed: a gridslam-map file"]
    assert say("export", "one", "-o", "robot").code == 0
    assert (tmp_path / "robot/map.yaml").exists()
    result = say("run", "hall", "--map", "one", "-o", "two")
    assert (result.code, len(result.complaints)) == (2, 1)
    assert "one/map.h5" in result.err


@pytest.mark.parametrize("name", ["heard.csv", "heard.h5"])
def test_simulated_measurements_replace_no_file_unasked(say, tmp_path, name):
    (tmp_path / "tiny.toml").write_text(TINY)
    (tmp_path / name).write_text("mine")
    words = ("simulate", "tiny.toml", "-o", name)
    assert (say(*words).code, (tmp_path / name).read_text()) == (2, "mine")
    assert say(*words, "--overwrite").code == 0
    assert len(gs.Measurements.load(tmp_path / name)) > 0


def test_what_is_printed_of_large_things_is_one_line():
    scene = shortened(gs.Scene.load("screen"), 3)
    truth = gs.ground_truth(scene, "agent1")
    recording = gs.simulate(scene, "agent1", 1, what="signal")
    tables = SurfaceEstimate.empty(), FeatureEstimate.empty()
    for thing in (scene, truth, truth.trajectory, recording, recording.waveform, *tables):
        assert len(repr(thing)) < 130
        assert repr(thing).startswith(f"<{type(thing).__name__}"), repr(thing)
    assert repr(gs.Scene.load("room")) == "<Scene room: 2 anchors, 1 wall, 1 agent>"


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_an_agent_that_moves_more_sharply_than_told_is_noted_with_how_sharply(say):
    scene = shortened(gs.Scene.load("room"), 60).with_filter(particles=64)
    for settings, times in (({}, 0), ({"acceleration_mps2": 0.002, "heading_deg": 0.6}, 1)):
        Path("room.toml").write_text(scene.with_filter(**settings).to_toml())
        result = say("run", "room.toml", "-o", "out", "--overwrite")
        assert result.code == 0
        note = (
            r"note: agent1: at \d+ of 60 steps it moved more sharply than filter.acceleration_mps2 = 0.002 "
            r"and filter.heading_deg = 0.6 say; up to 0.\d+ and [2-9].\d+ were allowed there. Set them"
        )
        assert len(re.findall(note, re.sub(r"\s+", " ", result.out))) == times
        assert len(json.loads(Path("out/run.json").read_text())["notes"]) == times


def test_walls_beyond_the_region_are_told(say, tmp_path):
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    corners = ((-4.0, -3.0), (6.5, -3.0), (4.0, 3.0), (-4.0, 3.0))
    scene = gs.Scene.checked({**data, "walls": [{**data["walls"][0], "points_m": corners}]}, "wide")
    (tmp_path / "wide.toml").write_text(scene.to_toml())
    reported = say("check", "wide.toml").out.splitlines()
    assert reported[1].endswith("beyond which nothing is mapped: walls by 1.7 m")
    assert "note" not in say("check", "room").out


@pytest.mark.parametrize("method", ["grid", "adaptive", "va"])
def test_one_anchor_without_departures_is_said_to_leave_the_turn_to_the_start(method):
    screen = gs.Scene.load("screen")
    rows = {"distance_m": {"A": [[8.7]]}, "aoa_rad": {"A": [[0.3]]}, "amplitude": {"A": [[14.0]]}}
    heard = gs.Measurements.from_arrays(**rows)
    for observed in (None, heard):
        assert "how all is turned about it" in " ".join(hints(screen, method, observed))
    told = gs.Measurements.from_arrays(**rows, aod_rad={"A": [[0.1]]})
    assert hints(screen, method, told) == []
    assert not any("turned" in hint for hint in hints(screen, "hybrid", None)), "it is told the heading"
    two = screen.model_copy(update={"anchors": [screen.anchors[0], screen.anchors[0]]})
    assert not any("turned" in hint for hint in hints(two, method, heard))


def test_what_takes_seconds_shows_that_it_goes_on_where_there_is_a_terminal(monkeypatch):
    from gridslam.cli import output

    monkeypatch.setattr(output, "err", Console(force_terminal=True, file=StringIO()))
    with output.busy("drawing figures"):
        pass
    assert "drawing figures" in output.err.file.getvalue()
    monkeypatch.setattr(output, "err", Console(file=StringIO()))
    with output.busy("drawing figures"):
        pass
    assert output.err.file.getvalue() == ""


@pytest.mark.parametrize(("given", "said"), [(True, []), (False, ["simulating agent1"])])
def test_what_was_recorded_is_not_said_to_be_simulated(given, said, monkeypatch):
    told = []
    monkeypatch.setattr(run_command, "busy", lambda what: told.append(what) or nullcontext())
    done = SimpleNamespace(interrupted=False, map=None)
    monkeypatch.setattr("gridslam.runs.map_scene.map_scene", lambda *_, **__: done)
    scene = gs.Scene.from_toml(TINY, "tiny")
    heard = {"agent1": gs.simulate(scene, "agent1", seed=1)} if given else {}
    turns = run_command.Turns(scene, "grid", 1, "exact", heard, None, None, None)
    assert run_command._explore(turns, ["agent1"])[0] == [done]
    assert told == said
