"""Tables of angles alone: `check` and `run` refuse them in the same words, and nothing is left of the run."""

import csv
import re
from pathlib import Path

import pytest
from cli_samples import listing
from scene_samples import shortened
from tiny import TINY

import gridslam as gs

OWN = """
import numpy as np

import gridslam as gs


class Angles:
    def __init__(self, scene, prior_map=None, agent=None, seed=0):
        self.model, self.blank = scene.filter_model(agent), gs.Map.of_scene(scene)
        self.agent = self.model.agent

    def step(self, scan):
        mean, variance = self.model.start_mean, self.model.start_variance
        return gs.Estimate.of_pose(scan, mean[:2], mean[4], np.diag(variance))

    def map(self):
        return self.blank
"""


def without(column, source, target="bare.csv"):
    """A table as it was, but for a column."""
    with open(source, newline="") as file:
        rows = list(csv.DictReader(file))
    with open(target, "w", newline="") as file:
        table = csv.DictWriter(file, [name for name in rows[0] if name != column], extrasaction="ignore")
        table.writeheader()
        table.writerows(rows)


@pytest.fixture
def bare(say):
    """The command line beside a table without distances of a small scene."""
    Path("tiny.toml").write_text(TINY)
    assert say("simulate", "tiny.toml", "--agent", "agent1", "-o", "heard.csv").code == 0
    without("distance_m", "heard.csv")
    return say


@pytest.mark.parametrize(
    "words",
    [
        ("check", "bare.csv"),
        ("check", "bare.csv", "--scene", "tiny.toml"),
        ("run", "tiny.toml", "--measurements", "bare.csv", "-o", "out"),
        ("run", "tiny.toml", "--measurements", "bare.csv", "--method", "va", "-o", "out"),
        (
            "run",
            "tiny.toml",
            "--measurements",
            "bare.csv",
            "--method",
            "network",
            "--agent",
            "agent1",
            "-o",
            "out",
        ),
    ],
)
def test_a_table_without_distances_is_refused_in_one_line(bare, tmp_path, words):
    """`run` mapped it, metres off, and noted that nothing can be mapped without distances."""
    told = bare(*words)
    found = "distance_m: found a distance in no row; allowed: distances: nothing can be mapped without"
    assert (told.code, told.complaints) == (2, [f"error: bare.csv: {found}"])
    assert listing(tmp_path) == ["bare.csv", "heard.csv", "tiny.toml"]


@pytest.mark.parametrize("method", ["grid", "network"])
@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (1e9, r"found \S+ to \S+e\+\d+ m; allowed: up to radio.max_distance_m"),
        (1 / 299792458, r"found \S+e-\d+ to \S+e-\d+ m; allowed: metres, half of them above 0.001 m"),
    ],
)
def test_a_table_with_no_distance_that_the_radio_measures_is_refused_in_one_line(bare, method, factor, says):
    """Distances times 1e9 were a traceback, "Singular matrix"; those in seconds ran through."""
    with open("heard.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    with open("far.csv", "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(row | {"distance_m": repr(factor * float(row["distance_m"]))} for row in rows)
    told = bare(
        "run", "tiny.toml", "--measurements", "far.csv", "--method", method, "--agent", "agent1", "-o", "out"
    )
    (line,) = told.complaints
    assert told.code == 2
    assert re.search(f"far.csv: distance_m: {says}", line)
    scene, heard = gs.Scene.load("tiny.toml"), gs.Measurements.load("far.csv")
    with pytest.raises(gs.InputError, match=f"distance_m: {says}"):
        gs.map_scene(scene, heard, agent="agent1")


def test_a_table_of_several_agents_without_distances_is_refused_by_check(bare):
    with open("bare.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    with open("both.csv", "w", newline="") as file:
        table = csv.DictWriter(file, [*rows[0], "agent"])
        table.writeheader()
        table.writerows(row | {"agent": name} for row in rows for name in ("agent1", "agent2"))
    told = bare("check", "both.csv", "--scene", "tiny.toml")
    assert told.code == 2
    assert "both.csv: distance_m: found a distance in no row" in told.err


def test_a_method_of_one_s_own_may_do_without_distances(bare, tmp_path, monkeypatch, no_figures):
    (tmp_path / "angles.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    told = bare("run", "tiny.toml", "--measurements", "bare.csv", "--method", "angles:Angles", "-o", "out")
    assert told.code == 0, told.err


def test_arrays_without_distances_are_refused_in_python(bare):
    scene = gs.Scene.load("tiny.toml")
    heard = gs.Measurements.load("bare.csv")
    with pytest.raises(gs.InputError, match="distance_m: found a distance in no row"):
        gs.map_scene(scene, heard, agent="agent1")


@pytest.mark.slow
def test_check_of_heights_without_distances_is_no_traceback(say):
    """Elevations are told by distances: it was a KeyError where lines of sight are found by angles."""
    Path("high.toml").write_text(shortened(gs.Scene.load("ceiling"), 40).to_toml())
    assert say("simulate", "high.toml", "-o", "heard.csv").code == 0
    without("distance_m", "heard.csv")
    told = say("check", "bare.csv", "--scene", "high.toml")
    assert told.code == 2
    assert len(told.complaints) == 1, told.err
