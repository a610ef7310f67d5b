"""A run that several files of commands start from."""

import pytest
from scene_samples import shortened

import gridslam as gs


@pytest.fixture(scope="session")
def mapped():
    """`room`, four steps, and the run of its first agent."""
    scene = shortened(gs.Scene.load("room"), 4)
    return scene, gs.map_scene(scene, gs.simulate(scene, "agent1", 1), seed=1)
