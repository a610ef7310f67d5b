"""What a step is taken for where a line of sight seems to come: evidence tells it from another path."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import received, signal_model

from gridslam import runtime
from gridslam.inference.messages.features import readings
from gridslam.inference.messages.features.joint_update import update
from gridslam.inference.messages.features.readings import seen_before, update_by_readings
from gridslam.inference.state.features.features import FeatureBank, entries
from gridslam.inference.state.features.hybrid_state import JointBelief

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
HEARD, HEADING, STEP = np.array([True]), 0.3, 40
LOS, MIRROR = np.array([3.0, 4.0, 0.0]), np.array([2.0, 5.3, 0.0])
POWERS = 4000.0, 2500.0


def lost(spread, off):
    """An agent whose line of sight is hidden, off its place, and a feature whose path is heard."""
    one = JointBelief(
        np.array([*off, 0.0, 0.0]), np.diag(np.square([spread, spread, 0.1, 0.1])), FeatureBank.empty(),
        np.array([1e-3]), np.array(POWERS[:1]), np.ones(1),
    )  # fmt: skip
    width = np.diag(np.square([0.02, 0.02, 1e-3]))
    return one.with_feature(0, entries(MIRROR, np.zeros(2)), width, np.zeros(2), POWERS[1], 0, 0)


@pytest.mark.parametrize("seed", range(4))
def test_a_line_of_sight_that_comes_back_is_seen(seed):
    model, belief = signal_model(), lost(0.3, (0.25, -0.2))
    z = received(model, (0, 0), HEADING, [LOS, MIRROR], POWERS, np.random.default_rng(seed))
    found, evidence = update_by_readings(belief, z, HEARD, HEADING, model, STEP)
    assert found.existence[0] > 0.99
    assert np.hypot(*found.mean[:2]) < 0.15
    without, its = update(belief, z, HEARD, HEADING, model, STEP, hidden=HEARD)
    assert evidence > its + 10
    assert without.existence[0] < 1e-6


def test_it_is_not_looked_for_elsewhere_where_that_explains_less(monkeypatch):
    model, belief = signal_model(), lost(0.3, (0.1, 0.0))
    z = received(model, (0, 0), HEADING, [MIRROR], POWERS[1:], np.random.default_rng(1))
    plain = update_by_readings(belief, z, HEARD, HEADING, model, STEP)
    elsewhere = belief.mean + np.eye(len(belief.mean))[1]
    monkeypatch.setattr(readings, "regained", lambda *_: elsewhere)
    found, evidence = update_by_readings(belief, z, HEARD, HEADING, model, STEP)
    assert evidence >= plain[1]
    np.testing.assert_allclose(found.mean, plain[0].mean, atol=0.02)


def test_a_path_of_a_feature_is_not_the_line_of_sight_that_comes(monkeypatch):
    """What is left of a path beside its believed place passes for a line of sight, until both are weighed."""
    model, belief = signal_model(), lost(0.3, (0.0, 0.0))
    z = received(model, (0, 0), HEADING, [MIRROR], POWERS[1:], np.random.default_rng(2))
    calls = []
    run = readings.beside_strangers

    def deluded(one, *args):
        hidden = args[-1]
        calls.append(hidden)
        after, *rest = run(one, *args)
        return (after if hidden is not None else replace(after, existence=np.ones(1)), *rest)

    monkeypatch.setattr(readings, "beside_strangers", deluded)
    found, _ = update_by_readings(belief, z, HEARD, HEADING, model, STEP)
    assert len(calls) >= 2
    assert found.existence[0] < 1e-6


def test_lines_of_sight_come_and_go_as_seldom_as_they_do():
    before, after = lost(0.1, (0, 0)), lost(0.1, (0, 0))
    there = replace(after, existence=np.ones(1))
    assert seen_before(before, there, HEARD) == pytest.approx(np.log(0.011), rel=0.1)
    assert seen_before(there, there, HEARD) == pytest.approx(np.log(0.95))
    assert seen_before(before, after, np.array([False])) == 0
