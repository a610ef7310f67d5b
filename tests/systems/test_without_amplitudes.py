"""Grid SLAM without amplitudes: walls that are heard reflect, and what isn't known is said."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny import TINY

import gridslam as gs

ROOM = gs.Scene.load("room").with_filter(particles=512)


def silent(scene, agent="agent1"):
    heard = gs.simulate(scene, agent, 1)
    return replace(heard, amplitude=np.full(len(heard.step), np.nan))


@pytest.mark.slow
def test_paths_that_are_heard_teach_coefficients_as_those_that_are_missed_do():
    """By misses alone the walls of 0.7 came out at 0.1, with false surfaces beside them."""
    run = gs.map_scene(ROOM, silent(ROOM), seed=1)
    assert len(run.surfaces) == 4
    assert (run.surfaces.reflection > 0.6).all()
    assert run.surfaces.reflection_learned.all()


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_coefficients_of_which_nothing_is_known_are_not_exported_as_if_they_were(say):
    """A constant chance of detection tells nothing of them: 0.5 +-0.29 is where they began."""
    radio = 'radio = { detection_probability = 0.9, measures = ["distance", "aod", "aoa"] }\n'
    text = radio + TINY.replace("steps = 3", "steps = 15")
    Path("quiet.toml").write_text(text)
    scene = gs.Scene.load("quiet.toml")
    silent(scene).to_csv("heard.csv")
    run = ("run", "quiet.toml", "--agent", "agent1", "--measurements", "heard.csv", "-o", "out")
    assert say(*run).code == 0
    assert say("export", "out", "-o", "files").code == 0
    rows = list(csv.DictReader(Path("files/surfaces.csv").read_text().splitlines()))
    assert rows
    assert {(row["reflection"], row["reflection_var"]) for row in rows} == {("", "")}
    assert all(float(row["existence"]) > 0.5 for row in rows)
    for one in json.loads(Path("files/surfaces.geojson").read_text())["features"]:
        assert (one["properties"]["reflection"], one["properties"]["reflection_std"]) == (None, None)
    assert say("report", "out", "--still").code == 0
    assert "<td>not measured</td>" in Path("out/report.html").read_text()
