"""Where an agent may be after a silence, and whether a snapshot tells it."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import received, signal_model

from gridslam import runtime
from gridslam.inference.messages.features.found_again import update_anywhere
from gridslam.inference.messages.features.joint_update import predict
from gridslam.inference.messages.features.silences import carried, lasts, region_axes, unheard, usual
from gridslam.inference.state.features.features import FeatureBank, entries
from gridslam.inference.state.features.hybrid_state import JointBelief

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
HEARD, HEADING, STEP = np.array([True]), 0.3, 40
ALL = np.array([[3.0, 4.0, 0.0], [2.0, 15.0, 0.0], [-9.0, 3.0, 0.0], [4.0, -9.0, 0.0]])
LOS, IMAGES = ALL[0], ALL[1:]
POWERS = 4000.0, 2500.0, 2000.0, 2200.0
SINGLE = {"agent_element_m": np.zeros((1, 2))}
WAY = np.array([[1.0, -1.0], [-3.5, -2.0], [-2.0, 2.5], [0.5, -3.0]])


def followed(model, points=IMAGES):
    """An agent that has been followed up to a place, and knows where some paths come from."""
    agent = np.array([*WAY[0], 0.5, 0.2])
    one = JointBelief(
        agent, np.diag(np.square([0.03, 0.03, 0.1, 0.1])), FeatureBank.empty(), np.array([0.9]),
        np.array(POWERS[:1]), np.ones(1), usual_s=0.1,
    )  # fmt: skip
    width = np.diag(np.square([0.05, 0.02, 1e-3]))
    for k, point in enumerate(points):
        one = one.with_feature(0, entries(point, WAY[0]), width, WAY[0], POWERS[k + 1], k, 0)
    return one


def snapshot(model, place, points, seed):
    powers = (POWERS if len(points) != 3 else POWERS[1:])[: len(points)]
    return received(model, place, HEADING, points, powers, np.random.default_rng(seed))


def test_a_short_time_is_motion_alone():
    model = signal_model()
    belief = followed(model)
    after, moved = carried(belief, 0.5, model), predict(belief, 0.5, 2.0)
    np.testing.assert_array_equal(after.mean, moved.mean)
    np.testing.assert_array_equal(after.covariance, moved.covariance)
    assert not after.astray


def test_steps_that_are_long_throughout_are_no_silences():
    """One of a second at 2 m/s^2 leaves more than 1 m open; but there are no others."""
    model = signal_model()
    belief = replace(followed(model), usual_s=1.0)
    after, moved = carried(belief, 1.0, model), predict(belief, 1.0, 2.0)
    np.testing.assert_array_equal(after.covariance, moved.covariance)
    assert not after.astray
    assert carried(belief, 3.1, model).astray
    assert not lasts(3.1, 0.0, model)  # of the first step nobody knows
    assert lasts(3.1, 1.0, model)
    assert not lasts(0.8, 0.1, model)


def test_one_long_or_short_step_hardly_changes_what_is_usual():
    assert usual(0.0, 5.0) == 5.0
    assert usual(1.0, 60.0) == 1.1
    assert usual(1.0, 0.001) == 0.5
    assert usual(1.0, 1.05) == 1.05


def test_where_motion_leads_out_of_the_region_the_agent_is_at_its_edge():
    model = signal_model()
    belief = followed(model)
    far = replace(belief, mean=np.array([1e4, 0.0, *belief.mean[2:]]))
    after = carried(far, 1.5, model)
    assert model.grid.x_m[1] - 2 < after.mean[0] < model.grid.x_m[1]
    assert np.isfinite(after.covariance).all()


def test_who_is_heard_is_not_astray_however_vague():
    model = signal_model()
    belief = followed(model)
    wide = belief.covariance.copy()
    wide[:2, :2] += 4 * np.eye(2)
    vague = replace(belief, covariance=wide)
    assert not unheard(vague, np.array([True])).astray
    assert unheard(vague, np.array([False])).astray


def test_a_region_as_narrow_as_one_place_has_two():
    model = signal_model()
    narrow = replace(model, grid=model.grid.model_copy(update={"x_m": (0.0, 0.1)}))
    after = carried(followed(model), 3600.0, narrow)
    assert np.linalg.eigvalsh(after.agent_covariance).min() > 0


@pytest.mark.parametrize("seconds", [60.0, 3600.0, 1e6])
def test_after_a_long_silence_the_agent_may_be_anywhere_in_the_region(seconds):
    model = signal_model()
    belief = followed(model)
    after = carried(belief, seconds, model)
    for axis, (low, high) in enumerate((model.grid.x_m, model.grid.y_m)):
        assert after.mean[axis] == pytest.approx(0.5 * (low + high), abs=0.1)
        deviation = (high - low) / np.sqrt(12)
        assert after.covariance[axis, axis] == pytest.approx(deviation**2, rel=0.02)
        # as fast as one push gets it that far
        assert after.covariance[axis + 2, axis + 2] == pytest.approx(4.0 * deviation, rel=0.02)
    assert after.astray
    np.testing.assert_array_equal(after.mean[4:], belief.mean[4:])
    np.testing.assert_array_equal(after.covariance[4:, 4:], belief.covariance[4:, 4:])
    assert not after.covariance[:4, 4:].any()


def test_what_a_gaussian_has_beyond_the_region_is_left_out():
    model = signal_model()
    after = carried(followed(model), 1.5, model)
    across = [np.asarray(along) for along in region_axes(model)]
    moved = predict(followed(model), 1.5, 2.0)
    for axis, along in enumerate(across):
        share = np.exp(-0.5 * (along - moved.mean[axis]) ** 2 / moved.covariance[axis, axis])
        share /= share.sum()
        mean = share @ along
        assert after.mean[axis] == pytest.approx(mean)
        assert after.covariance[axis, axis] == pytest.approx(share @ (along - mean) ** 2)


def test_steps_at_which_nothing_is_heard_add_up_to_a_silence():
    model = signal_model()
    belief = followed(model)
    states = []
    for _ in range(400):
        belief = unheard(carried(belief, 0.1, model), np.array([False]))
        states.append((belief.astray, np.sqrt(np.trace(belief.agent_covariance[:2, :2]))))
    astray = [one for one, _ in states]
    assert not astray[0]
    assert astray == sorted(astray)
    assert states[astray.index(True)][1] == pytest.approx(1.0, abs=0.2)
    sides = np.diff([model.grid.x_m, model.grid.y_m])[:, 0]
    assert states[-1][1] < 1.2 * np.sqrt((sides**2).sum() / 12)


@pytest.mark.parametrize("hidden", [False, True])
def test_one_snapshot_tells_where_it_was_taken(hidden):
    """By line of sight and features, or by features alone: squared errors are as large as claimed."""
    model, squared = signal_model(), []
    points = ALL[hidden:]
    for seed, place in enumerate(np.repeat(WAY, 3, 0)):
        belief = carried(followed(model), 3600.0, model)
        z = snapshot(model, place, points, seed)
        after, evidence = update_anywhere(belief, z, HEARD, HEADING, model, STEP)
        assert np.isfinite(evidence)
        if not after.astray:
            off = after.mean[:2] - place
            assert np.hypot(*off) < 0.5
            squared.append(off @ np.linalg.solve(after.agent_covariance[:2, :2], off))
    assert len(squared) >= (9 if hidden else 12)
    assert 0.5 < np.mean(squared) < 4.5  # 2 is right, to 0.6 of twelve


def test_lengths_to_one_anchor_tell_no_place():
    model = signal_model(**SINGLE)
    for seed, place in enumerate(WAY):
        belief = carried(followed(model, ()), 3600.0, model)
        after, evidence = update_anywhere(
            belief, snapshot(model, place, [LOS], seed), HEARD, HEADING, model, STEP
        )
        assert after.astray
        np.testing.assert_array_equal(after.mean, belief.mean)
        np.testing.assert_array_equal(after.covariance, belief.covariance)
        assert after.existence < belief.existence  # nothing was seen
        assert np.isfinite(evidence)


def test_noise_tells_no_place():
    model = signal_model()
    for seed in range(4):
        belief = carried(followed(model), 3600.0, model)
        after, _ = update_anywhere(belief, snapshot(model, WAY[0], [], seed), HEARD, HEADING, model, STEP)
        assert after.astray


def test_an_agent_that_is_followed_is_not_sought():
    model = signal_model()
    belief = replace(predict(followed(model), 0.1, 2.0), astray=False)
    place = belief.mean[:2]
    after, _ = update_anywhere(belief, snapshot(model, place, ALL, 1), HEARD, HEADING, model, STEP)
    assert np.hypot(*(after.mean[:2] - place)) < 0.1
