"""Anchors at several heights in a scene without any: the heights are named, not an offset of clocks."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.diagnose import suspicions

CANYON = gs.Scene.load("canyon")
HEIGHTS_M = np.array([3.2, 2.0, 1.2])


def named(table, scene=CANYON):
    """What `check` suspects."""
    columns = {name: np.asarray(values) for name, values in table.columns.items()}
    return [str(item) for item in suspicions(columns, table.anchors, scene, "agent1")]


@pytest.mark.slow
def test_the_height_of_each_anchor_is_named():
    heard = gs.simulate(CANYON, "agent1", 63)
    (line,) = named(replace(heard, distance_m=np.hypot(heard.distance_m, HEIGHTS_M[heard.anchor])))
    found = dict(re.findall(r"([ABC]) ([\d.]+)", re.search(r"by about \((.*?)\)", line)[1]))
    assert "the scene has no heights" in line
    assert "clocks" not in line
    np.testing.assert_allclose([float(found[name]) for name in "ABC"], HEIGHTS_M, atol=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [31, 32])
def test_a_height_of_all_anchors_is_named_beside_what_explains_as_much(seed):
    """0.8 m in a room: offsets and places of anchors fit within some nats of it."""
    room = gs.Scene.load("room")
    heard = gs.simulate(room, "agent1", seed)
    (line,) = named(replace(heard, distance_m=np.hypot(heard.distance_m, 0.8)), room)
    assert "probably slant ranges of all anchors" in line
    assert float(re.search(r"about ([\d.]+) m above", line)[1]) == pytest.approx(0.8, abs=0.1)
    assert named(heard, room) == []
