"""How far lines of surfaces walk, by how far steps move them: docs/model.md, (M361)."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief, predict, update
from gridslam.inference.messages import motion
from gridslam.inference.messages.surface_walk import (
    DOUBT,
    GAIN,
    LEAST,
    LEAST_GAIN,
    MOST_SURPRISED,
    WIDEST,
    learn_surface_walks,
)

LINE = (0.3, 4.0)
"""Angle and offset of the one surface."""
OWN = slice(5, 7)
"""Its entries."""


@pytest.fixture(scope="module")
def state():
    """One surface, hit at tangential coordinate 0."""
    return start()


def start():
    mean = np.append(np.zeros(5), LINE)
    return state_of(Belief(mean, np.eye(7)), anchors=2)


def with_line(state, line, covariance, foot=0.0, walk=(0.0, 0.0)):
    """The state with the mean and the covariance of its line, which was hit at `foot`."""
    belief = state.belief
    mean, whole = belief.mean.copy(), belief.covariance.copy()
    mean[OWN], whole[OWN, OWN] = line, covariance
    bank = replace(state.surfaces, foot=np.array([foot]), walk=np.array([walk], float))
    return replace(state, belief=replace(belief, mean=mean, covariance=whole), surfaces=bank)


def learned(state, moved, foot=0.0, walk=(1.0, 1.0)):
    """Walk after a line was moved by (shift, turn), of variance 4 before and 1 after, in cm and mrad."""
    shift, turn = 1e-2, 1e-3
    there = np.array([[0.0, 1.0], [1.0, foot]]) * [shift, turn]  # of (shift, turn) to (angle, offset)
    spread = there @ there.T
    before = with_line(state, LINE, 4 * spread, foot, walk)
    after = with_line(before, LINE + there @ np.asarray(moved), spread, foot, walk)
    return learn_surface_walks(before, after).surfaces.walk[0]


@pytest.mark.parametrize("foot", [0.0, -3.0, 7.0])
def test_a_line_that_is_moved_more_than_its_variance_shrinks_walks_more(state, foot):
    flat = np.sqrt(3.0)  # the square that is expected where the variance falls from 4 to 1
    still = 1.0 - GAIN * DOUBT
    assert learned(state, (flat, flat), foot) == pytest.approx([still, still])
    twice = np.sqrt(6.0)
    assert learned(state, (flat, twice), foot) == pytest.approx([still, still + GAIN])
    assert learned(state, (twice, flat), foot) == pytest.approx([still + GAIN, still])
    assert learned(state, (0, 0), foot) == pytest.approx([still - GAIN] * 2)
    assert learned(state, (-90, 90), foot) == pytest.approx([1 + GAIN * MOST_SURPRISED] * 2), (
        "one step's most"
    )


def test_walks_are_bounded(state):
    assert learned(state, (0, 0), walk=(LEAST, LEAST)).tolist() == [LEAST, LEAST]
    assert np.exp(learned(state, (90, 90), walk=np.log(WIDEST))) == pytest.approx(WIDEST)


def test_a_step_that_tells_nothing_of_a_line_teaches_nothing(state):
    before = with_line(state, LINE, np.diag([1e-6, 1e-4]), walk=(0.7, 0.7))
    after = with_line(before, LINE, (1 - 0.5 * LEAST_GAIN) * np.diag([1e-6, 1e-4]), walk=(0.7, 0.7))
    assert learn_surface_walks(before, after).surfaces.walk.tolist() == [[0.7, 0.7]]
    assert before.surfaces.walk.tolist() == [[0.7, 0.7]], "nothing is changed in place"


def test_a_line_across_the_turn_hasn_t_moved(state):
    spread = np.diag([1e-6, 1e-4])
    before = with_line(state, (np.pi - 1e-4, 4.0), 4 * spread, walk=(1.0, 1.0))
    after = with_line(before, (-np.pi + 1e-4, 4.0), spread, walk=(1.0, 1.0))
    assert (learn_surface_walks(before, after).surfaces.walk < 1).all()


def test_other_surfaces_than_those_before_are_refused(state):
    other = replace(state, surfaces=replace(state.surfaces, identity=state.surfaces.identity + 1))
    with pytest.raises(ValueError, match="surfaces before"):
        learn_surface_walks(state, other)


def test_what_was_learned_is_what_a_line_walks_by_at_the_next_step(state):
    model, spread = model_of(), np.diag([1e-6, 1e-4])
    grown = [
        motion.predict(replace(with_line(state, LINE, spread, walk=walk), time_s=0.0), 1.0, 0, model)
        .belief.covariance[OWN, OWN].diagonal() - spread.diagonal()
        for walk in ((0, 0), (np.log(2), np.log(3)), (LEAST, LEAST))
    ]  # fmt: skip
    assert grown[1] / grown[0] == pytest.approx([9, 4])
    assert grown[2].tolist() == grown[0].tolist(), "never below a flat wall's"


def followed(seed, turn_per_step, learning=True):
    """Error over claimed variance (N,), and the last walk, of a line that is measured 300 times."""
    draw = np.random.default_rng(seed)
    now = with_line(start(), LINE, np.diag([1e-4, 1e-2]))
    true, watched = np.array(LINE), np.eye(7)[OWN]
    noise, scores = np.array([0.03, 0.02]) ** 2, []
    for _ in range(300):
        true += [turn_per_step, 0.0]
        belief = predict(now.belief, 1.0, 0.0, 0.0, 1e-3, np.zeros(1), np.exp(now.surfaces.walk))
        gap = true + draw.normal(size=2) * np.sqrt(noise) - belief.mean[OWN]
        before = replace(now, belief=belief)
        now = replace(now, belief=update(belief, watched, gap[None], noise[None], np.ones(1)))
        now = learn_surface_walks(before, now) if learning else now
        miss = now.belief.mean[OWN] - true
        scores.append(miss @ np.linalg.solve(now.belief.covariance[OWN, OWN], miss))
    return np.array(scores), np.exp(now.surfaces.walk[0])


@pytest.mark.slow
def test_lines_of_flat_walls_stay_and_those_of_curved_ones_are_followed_honestly():
    flat = [followed(seed, 0.0) for seed in range(3)]
    assert np.median([walk for _, walk in flat], axis=0).max() < 2
    assert np.mean([score[100:].mean() for score, _ in flat]) < 2.5
    curved = [followed(seed, 0.005) for seed in range(3)]
    assert min(walk[1] for _, walk in curved) > 3
    assert np.mean([score[100:].mean() for score, _ in curved]) < 6
    assert np.mean([followed(seed, 0.005, learning=False)[0][100:].mean() for seed in range(2)]) > 20


@pytest.mark.slow
@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam])
def test_steps_of_grid_and_adaptive_slam_learn_walks(method):
    room = gs.Scene.load("room")
    slam = method(room, seed=1)
    for scan in list(gs.simulate(room, "agent1", seed=1))[:8]:
        slam.step(scan)
    assert len(slam.state.surfaces) > 0
    assert slam.state.surfaces.walk.any()
