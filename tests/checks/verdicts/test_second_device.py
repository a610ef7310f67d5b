"""Rows of two robots in a table without a column agent are told of; those of one are not."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short
from workshop import workshop

import gridslam as gs
from gridslam.checks.verdicts.diagnose import describe, suspicions


@pytest.mark.slow
@pytest.mark.parametrize("walls", [True, False])
def test_two_robots_in_one_table_are_told_of(walls):
    scene = workshop(walls)
    both = gs.simulate(workshop(), ["r1", "r2"], 1)
    (one,) = suspicions(both.table.columns, both.table.anchors, scene, "r1")
    assert (one.column, one.kind, one.certain) == ("agent", "second device", False)
    assert "begins near (9.5, 3.5) m" in one.reason
    assert "say whose each row is, in a column agent" in one.text
    for name in ("r1", "r2"):
        assert suspicions(both[name].columns, both[name].anchors, scene, name) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["room", "hall"])
def test_one_robot_is_no_second_one(name):
    scene = gs.Scene.load(name)
    agent = scene.agents[0].name
    bare = gs.Scene.checked(scene.model_dump(exclude_none=True) | {"walls": []}, "bare")
    table = gs.simulate(scene, agent, 2)
    for known in (scene, bare):
        found = suspicions(table.columns, table.anchors, known, agent)
        assert not [item for item in found if item.kind == "second device"]


@pytest.mark.slow
def test_mirrored_robots_are_left_where_no_arrival_is_measured(tmp_path):
    both = gs.simulate(workshop(), ["r1", "r2"], 1).table
    replace(both, aoa_rad=np.full(len(both.step), np.nan)).to_csv(tmp_path / "a.csv")
    assert not any("two devices" in line for line in describe(tmp_path / "a.csv", workshop(), "r1"))


@pytest.mark.slow
def test_a_device_that_the_scene_knows_is_told_by_name():
    """Each one's rows fit from its own start: it isn't the other's table."""
    both = gs.simulate(workshop(), ["r1", "r2"], 1).table
    (one,) = suspicions(both.columns, both.anchors, workshop(), "r2")
    assert (one.column, one.kind, one.certain) == ("agent", "second device", True)
    assert one.text.startswith("rows of two devices, r2 and r1, in one table")


@pytest.mark.slow
def test_the_scenes_other_agent_is_told_of_among_many_reflections():
    """Where so many rows are left that no one of them tells where a device could begin."""
    scene = short("canyon", 60)
    both = gs.simulate(scene, ["agent1", "agent2"], 1)
    (one,) = suspicions(both.table.columns, both.table.anchors, scene, "agent1")
    assert (one.kind, one.certain) == ("second device", False)
    assert "begins near (-6.0, -5.3) m, as agent2 does" in one.reason
    for name in ("agent1", "agent2"):
        assert suspicions(both[name].columns, both[name].anchors, scene, name) == []
