"""`check` names anchors that are turned, by how much, and those whose angles are mirrored."""

import re
from dataclasses import replace

import numpy as np
import pytest
from check_tables import BRIEF, SCENES, named, simulated_columns
from docs_scripts import script

import gridslam as gs
from gridslam.checks.anchors.turned_anchors import Turn, _borne_out
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.verdicts.diagnose import suspicions
from gridslam.world.geometry import wrap


def turned(columns, anchor, degrees=0.0, sign=1.0):
    """What is measured if an anchor stands that much clockwise of what the scene says, or is mirrored."""
    own = columns["anchor"] == anchor
    return columns | {
        "aod_rad": np.where(own, wrap(sign * columns["aod_rad"] + np.radians(degrees)), columns["aod_rad"])
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "anchor", "degrees"), [("room", 0, 90), ("alcove", 1, -20), ("room", 1, 135)]
)
def test_one_anchor_that_is_turned_is_named_and_by_how_much(name, anchor, degrees):
    scene = SCENES[name]
    (found,) = named(turned(simulated_columns(name, 1, steps=BRIEF), anchor, degrees), name)
    assert (found.column, found.kind, found.certain) == ("aod_rad", "turned", True)
    words = re.match(r"anchor (\w) is turned by (-?\d+) degrees: .* should be about (-?\d+)$", found.text)
    assert words[1] == scene.anchor_names[anchor]
    assert abs(wrap(np.radians(float(words[2]) + degrees))) < np.radians(8)
    right = scene.anchor_orientations[anchor] - np.radians(degrees)
    assert abs(wrap(np.radians(float(words[3])) - right)) < np.radians(8)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "anchor"), [("room", 1), ("alcove", 0)])
def test_one_anchor_whose_angles_are_mirrored_is_named(name, anchor):
    (found,) = named(turned(simulated_columns(name, 1, steps=BRIEF), anchor, sign=-1.0), name)
    assert (found.column, found.kind) == ("aod_rad", "turned")
    assert found.text.startswith(f"angles of anchor {'AB'[anchor]} are counted clockwise")


@pytest.mark.slow
def test_a_table_of_one_anchor_and_two_that_are_turned_each_by_its_own():
    both = turned(turned(simulated_columns("room", 2, steps=BRIEF), 0, 90), 1, -60)
    (found,) = named(both, "room")
    assert found.kind == "turned"
    assert re.match(
        r"anchor A is turned by -[89]\d degrees.*; anchor B is turned by [56]\d degrees", found.text
    )
    columns = simulated_columns("room", 1, steps=BRIEF)
    alone = {key: values[columns["anchor"] == 0] for key, values in columns.items()}
    (found,) = named(turned(alone, 0, 90), "room")
    assert re.match(r"anchor A is turned by -[89]\d degrees", found.text)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2000, 2032])
def test_no_anchor_is_accused_where_the_agent_is_slow_and_goes_around_bends(seed):
    """A filter that is led astray by its own motion explains angles worse than another reading does."""
    scene = script("random_plans").scene_of(seed, 40.0, "grid")
    table = gs.simulate(scene, "agent1", seed)
    assert suspicions(dict(table.columns), table.anchors, scene, "agent1") == []


def test_an_anchor_that_is_hidden_all_the_time_is_not_called_turned():
    """What walls reflect of its signals fits some turn: `check` accused it in a drawn plan (1845)."""
    scene = gs.Scene.load("hall")
    table = dict(gs.simulate(scene, "agent1", 11).columns)
    turns = (Turn(1, 0.0, True),)  # B comes into sight at step 140, the filter looks at 100
    sight = explain(table, scene, "agent1")
    rows = np.flatnonzero(table["anchor"] == 1)[:20]
    fits = replace(
        sight, row=rows, probability=np.ones(20),
        position_m=np.tile(scene.anchor_positions[0] + 0.5, (len(np.unique(table["step"][rows])), 1)),
    )  # fmt: skip
    assert not _borne_out(fits, turns, table, scene)
    assert _borne_out(replace(fits, position_m=fits.position_m + np.array([10.0, 7.0])), turns, table, scene)


@pytest.mark.slow
def test_one_anchor_in_sight_is_not_called_turned_for_certain():
    """Its clock was off by 5 ns: the table was said to be of an anchor that is turned by 10 degrees."""
    scene = script("random_plans").scene_of(17002, 36.0, "grid")
    table = gs.simulate(scene, "agent1", 0)
    late = {**table.columns, "distance_m": table.distance_m + 1.5}
    (found,) = suspicions(late, table.anchors, scene, "agent1")
    assert not found.certain
    assert found.kind != "turned" or "or from an error in its distances" in found.reason
