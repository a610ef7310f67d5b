"""Paths of one step that nothing explains yet, and what they would make of the line of sight."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import received, signal_model

from gridslam import runtime
from gridslam.inference.messages.features.joint_update import update
from gridslam.inference.messages.features.strangers import stranger, update_beside_strangers
from gridslam.inference.state.features.features import FeatureBank
from gridslam.inference.state.features.hybrid_state import JointBelief

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
HEARD, HEADING = np.array([True]), 0.4
SPREAD = (0.05, 0.05, 0.1, 0.1)


def world(points, powers, seed):
    """A model whose anchor stands at the first point, what is received, and a belief that knows its power."""
    model = signal_model(spread=SPREAD)
    z = received(model, (0, 0), HEADING, points, powers, np.random.default_rng(seed))
    belief = JointBelief(
        np.array([0.0, 0.0, 0.5, 0.0]), np.diag(np.square(SPREAD)), FeatureBank.empty(), np.array([0.99]),
        np.array([powers[0]]), np.ones(1),
    )  # fmt: skip
    return model, z, belief


LOS = np.array([3.0, 4.0, 0.0])
BESIDE = 5.3 * np.array([np.cos(1.2), np.sin(1.2), 0.0])


@pytest.mark.parametrize("seed", range(4))
def test_a_path_that_overlaps_the_line_of_sight_no_longer_bends_it(seed):
    model, z, belief = world([LOS, BESIDE], [4000.0, 3000.0], seed)
    bent, without = update(belief, z, HEARD, HEADING, model, 20)
    found, evidence = update_beside_strangers(belief, z, HEARD, HEADING, model, 20)
    off, off_bent = (np.hypot(*one.mean[:2]) for one in (found, bent))
    assert evidence > without + 30
    assert off < 0.5 * off_bent
    deviations = found.mean[:2] @ np.linalg.solve(found.agent_covariance[:2, :2], found.mean[:2])
    assert deviations < 16 < bent.mean[:2] @ np.linalg.solve(bent.agent_covariance[:2, :2], bent.mean[:2])


def test_it_is_forgotten_after_the_step_and_where_all_is_explained_there_is_none():
    model, z, belief = world([LOS, BESIDE], [4000.0, 3000.0], 1)
    found, _ = update_beside_strangers(belief, z, HEARD, HEADING, model, 20)
    assert len(found.features) == 0
    assert found.mean.shape == belief.mean.shape
    model, z, belief = world([LOS], [4000.0], 1)
    alone = update_beside_strangers(belief, z, HEARD, HEADING, model, 20)
    plain = update(belief, z, HEARD, HEADING, model, 20)
    np.testing.assert_array_equal(alone[0].mean, plain[0].mean)
    np.testing.assert_array_equal(alone[0].covariance, plain[0].covariance)
    assert alone[1] == plain[1]


def test_it_is_found_where_it_is():
    model, z, belief = world([LOS, BESIDE], [4000.0, 3000.0], 2)
    got = stranger(belief, z[0], 0, HEADING, model)
    assert got is not None
    assert got.length == pytest.approx(5.3, abs=0.3)
    assert got.direction % (2 * np.pi) == pytest.approx(1.2, abs=0.25)
    assert stranger(replace(belief, existence=np.zeros(1)), z[0], 0, HEADING, model) is None
