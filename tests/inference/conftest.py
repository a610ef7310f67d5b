"""What several rooms of inference are tested on."""

import pytest
from scene_samples import ENOUGH

import gridslam as gs
from gridslam.simulation import disturbances


@pytest.fixture(scope="session")
def room():
    """The scene `room` as its filter believes it to be, with measurements and truth, and few particles."""
    return disturbances.undisturbed(gs.Scene.load("room").with_filter(particles=ENOUGH), seed=1)


@pytest.fixture(scope="session")
def signal(room):
    return room.scene.signal_model(room.agent)
