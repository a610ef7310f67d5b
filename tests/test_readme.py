"""What the README and the page of the command line say is there: commands, options, links, a sample."""

import doctest
import importlib
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import typer

import gridslam as gs

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = (DOCS / "command-line.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.M | re.S)


def setup_commands():
    """The lines that do everything from nothing."""
    return [
        line for block in blocks("sh") for line in block.splitlines() if line.startswith("python3 -m venv")
    ]


def commands():
    from gridslam.cli.main import app

    return typer.main.get_command(app).commands


def test_main_command_ends_in_a_command_that_there_is(say):
    run, _ = setup_commands()
    last = shlex.split(run.split("&&")[-1])
    assert last[0] == ".venv/bin/gridslam"
    result = say(*last[1:], "--help")
    assert result.code == 0
    assert "scene" in result.out.lower()


def test_gate_runs_the_test_command_of_the_readme():
    _, test = setup_commands()
    assert test in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()


@pytest.mark.slow
def test_sample_of_own_data_fits_the_room_and_gives_no_phantom_wall(say, tmp_path):
    """Each wall found lies on a wall of the scene, 8 x 6 m about the origin."""
    page = (DOCS / "tutorials" / "own-data.md").read_text(encoding="utf-8")
    (sample,) = re.findall(r"^```text\n(step,time_s,anchor.*?)^```", page, re.M | re.S)
    path = tmp_path / "heard.csv"
    path.write_text(sample)
    result = say("check", path, "--scene", "room")
    assert (result.code, result.err) == (0, "")
    assert "suspect" not in result.out
    assert "fit the scene" in result.out
    explained, scans = map(int, re.search(r"in about (\d+) of (\d+) scans", result.out).groups())
    assert explained >= 0.8 * scans
    scene = gs.Scene.load("room")
    run = gs.map_scene(scene, gs.Measurements.from_csv(path, scene.anchor_names), seed=1)
    for angle, offset in run.surfaces.line:
        normal = np.abs([np.cos(angle), np.sin(angle)])
        assert normal.max() > 0.98, "slanted"
        assert abs(abs(offset) - (4.0, 3.0)[int(normal.argmax())]) < 0.3


@pytest.mark.parametrize(
    "path", sorted(ROOT.glob("*.md")) + sorted(ROOT.glob("docs/**/*.md")), ids=lambda p: p.name
)
def test_tables_have_as_many_cells_in_every_row(path):
    """GitHub shows a table whose delimiter row has another number of cells as plain text."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    for table in re.findall(r"(?:^\|.*\|[ ]*\n)+", text, re.M):
        counts = {len(re.split(r"(?<!\\)\|", line.strip())) for line in table.splitlines()}
        assert len(counts) == 1, table.splitlines()[0]


def test_options_are_those_of_the_page_of_the_command_line():
    there = {
        name
        for group in commands().values()
        for command in (group, *getattr(group, "commands", {}).values())
        for parameter in command.params
        for name in parameter.opts
        if name.startswith("--") and name != "--help"
    }
    there |= {"--install-completion", "--version"}  # of the program itself
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", COMMANDS)) == there


def test_every_command_is_on_the_page_of_the_command_line():
    for name in commands():
        assert f"gridslam {name}" in COMMANDS or f"## `{name}`" in COMMANDS, name


def test_readme_is_one_screen():
    assert len(README.splitlines()) < 75


def test_links_lead_somewhere():
    links = re.findall(r"\]\(([^)#]+)\)", README)
    for link in links:
        if not link.startswith(("http:", "https:")):
            assert (ROOT / link).is_file(), link


EXAMPLES = "measurements.table measurements.recording world.scene simulation.image_source simulation.simulate"


@pytest.mark.parametrize("name", EXAMPLES.split())
def test_examples_in_docstrings(name, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    found = doctest.testmod(importlib.import_module(f"gridslam.{name}"))
    assert found.attempted > 0
    assert found.failed == 0
