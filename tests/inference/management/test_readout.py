"""What users read of a belief: angles within half a turn, whatever the state adds up to."""

from dataclasses import fields, replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.management.readout import estimates


@pytest.fixture(scope="module")
def slam():
    scene = gs.Scene.load("room").with_filter(particles=256)
    slam = gs.GridSlam(scene, seed=1)
    for _, scan in zip(range(6), gs.simulate(scene, "agent1", seed=1), strict=False):
        slam.step(scan)
    return slam


def turned(state, turns):
    """The same state, with all angles so many whole turns further: updates only ever add to them."""
    mean, layout = state.belief.mean.copy(), state.belief.layout
    mean[layout.angles] += 2 * np.pi * turns
    return replace(state, belief=replace(state.belief, mean=mean))


def test_normals_past_half_a_turn_are_read_out_as_the_same_lines(slam):
    state = slam.state
    read = [
        estimates(one, slam.model, slam.model.radio.amplitude_at_1m, work=slam.work)
        for one in (state, turned(state, 1), turned(state, -2))
    ]
    assert len(read[0][0].line) >= 3
    for tables in read:
        assert (np.abs(tables[0].line[:, 0]) <= np.pi).all()
        for table, known in zip(tables, read[0], strict=True):
            for field in fields(table):
                got, wanted = (getattr(each, field.name) for each in (table, known))
                np.testing.assert_allclose(got, wanted, atol=1e-6)
