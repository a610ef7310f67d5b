"""Sets of features that rival each other in a lesson: what they cost, which wins, which is given up."""

from dataclasses import replace

import numpy as np
import pytest
from lesson_states import LOS, LOS_POWER, MIRROR, SCATTERER, lesson_of, state_after

from gridslam import runtime
from gridslam.inference.messages.features import rivals
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.following import START_STEPS
from gridslam.inference.messages.features.prices import PRICES, usual_prices
from gridslam.inference.messages.features.proposals import AMBIGUOUS, CROWD_EXTENT_M
from gridslam.inference.messages.features.rivals import (
    CLEAR,
    FOLLOWED,
    HOPELESS,
    LOUD,
    REACH,
    SEEN,
    SHIFTED,
    Lesson,
    best_of,
)
from gridslam.inference.messages.features.seeding import LEAST_GAIN, NONE_M
from gridslam.inference.state.features.features import MOVING, entries

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())


def test_first_steps_that_paths_reach_before_their_lines_of_sight_are_worth_less():
    """(M536): 12 nats for each, of a beginning that is 3 m farther from the anchor than the agent is."""
    state, model = state_after([MIRROR], [1500.0], 0)
    short = state.segment.first(START_STEPS)
    lesson = Lesson.of(replace(state, step=START_STEPS), short, 0, Front(model.waveform), model)
    later = Lesson.of(state, state.segment, 0, Front(model.waveform), model)
    assert [len(lesson.arrivals), len(later.arrivals)] == [START_STEPS, 0]
    bare = replace(lesson, arrivals=[])
    away = state.before.mean - 3 * np.array([0.6, 0.8, 0.0, 0.0])
    wrong, still = replace(state.before, mean=away), replace(short, agent=np.tile(away, (START_STEPS, 1)))
    assert bare.judge(wrong, still).score - lesson.judge(wrong, still).score == 12.0 * START_STEPS
    assert bare.judge(state.before, short).score == lesson.judge(state.before, short).score


@pytest.mark.slow
def test_a_line_of_sight_that_was_taken_for_a_feature_pulls_all_back_where_it_belongs():
    """Seen from a way 0.7 m off, a feature beside the anchor explains what the line of sight does."""
    state, model = state_after([MIRROR], [1500.0], 4, spread=(0.5, 0.5, 0.1, 0.1))
    off = np.array([0.5, -0.5])
    beside = replace(state.segment, agent=state.segment.agent + np.append(off, [0.0, 0.0]))
    lesson, price = lesson_of(state, model), usual_prices(state.before, model)
    astray = state.before
    for n, point in enumerate([LOS, MIRROR]):
        place = point + np.append(off, 0.0)
        spread = np.diag(np.square([0.05, 0.02, 1e-3]))
        astray = astray.with_feature(0, entries(place, off), spread, off, LOS_POWER / (n + 1), n, 0)
    believed = replace(astray, mean=np.append(astray.mean[:2] + off, astray.mean[2:]))
    wrong = lesson.judge(replace(believed, existence=np.array([0.01])), beside)
    np.testing.assert_array_equal(lesson.sights(wrong.joint), [True, False])
    np.testing.assert_allclose(lesson.shift(wrong), -off, atol=0.15)
    right = lesson.best([wrong], [beside], price[0])
    assert np.hypot(*(right.track - state.segment.agent)[-1, :2]) < 0.2
    assert right.joint.existence[0] > 0.9
    assert not lesson.sights(right.joint).any()
    assert lesson.shift(right) is None


@pytest.mark.slow
def test_a_feature_that_explains_nothing_costs_its_price():
    state, model = state_after([], [], 5)
    lesson = lesson_of(state, model)
    spread, origin = np.diag(np.square([0.3, 0.2, 1e-3])), np.zeros(2)
    more = state.before.with_feature(0, entries(MIRROR, origin), spread, origin, 1e-6, 0, 0)
    scores = [lesson.judge(belief, state.segment).score for belief in (state.before, more)]
    assert scores[0] - scores[1] == pytest.approx(LEAST_GAIN, abs=1.0)


@pytest.mark.slow
def test_a_rival_that_falls_far_behind_is_given_up_and_one_that_keeps_up_is_not():
    state, model = state_after([MIRROR], [1500.0], 3)
    lesson, (segment, before) = lesson_of(state, model), (state.segment, state.before)
    spread, origin = np.diag(np.square([0.3, 0.2, 1e-3])), np.zeros(2)
    right = lesson.judge(
        before.with_feature(0, entries(MIRROR, origin), spread, origin, 1500.0, 0, 0), segment
    )
    given_up = lesson.judge(before, segment, right)
    assert given_up.score == -np.inf
    gone = int(np.flatnonzero(given_up.evidence == -np.inf)[0])
    plain = lesson.judge(before, segment)
    assert (given_up.evidence[gone + 1 :] == 0).all()
    behind = np.cumsum(right.evidence - plain.evidence) - LEAST_GAIN
    assert behind[gone] > HOPELESS
    assert (behind[:gone] <= HOPELESS).all()
    again = lesson.judge(right.start, segment, plain)
    assert again.score == right.score
    np.testing.assert_array_equal(again.track, right.track)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [START_STEPS, START_STEPS + 1])
def test_a_short_track_does_not_tell_that_an_image_is_one(steps):
    state, model = state_after([MIRROR], [1500.0], 5)
    lesson = Lesson.of(state, state.segment, 0, Front(model.waveform), model)
    (one, _) = lesson.rivals(state.segment, state.joint, PRICES, state.segment.first(steps))
    extra = one.start.covariance[MOVING + 2, MOVING + 2] ** 0.5
    length = one.start.mean[MOVING]
    assert extra == pytest.approx(AMBIGUOUS * length if steps <= START_STEPS else NONE_M)


def crowd_with(place, power, existence=0.99, extent=CROWD_EXTENT_M):
    """A lesson, and a belief with one feature of a crowd beside a line of sight."""
    state, model = state_after([], [], 1)
    spread, origin = 0.01 * np.eye(3), np.array([0.5, 0.0])
    joint = state.joint.with_feature(0, entries(place, origin), spread, origin, power, 0, 0)
    return lesson_of(state, model), replace(joint, extent=extent, existence=np.array([existence]))


@pytest.mark.slow
def test_a_line_of_sight_says_where_a_crowd_is_unless_a_feature_is_as_loud_and_near():
    reach = REACH * crowd_with(MIRROR, 1.0)[0].drift_m
    near, far = LOS + np.outer([0.9 * reach, 1.1 * reach], [1.0, 0.0, 0.0])
    loud, faint = 1.1 * LOUD * LOS_POWER, 0.9 * LOUD * LOS_POWER
    for place, power, existence, extent, expected in (
        (near, loud, 0.99, 0.2, False),
        (far, loud, 0.99, 0.2, True),
        (near, faint, 0.99, 0.2, True),
        (near, loud, 0.99, 0.0, True),
        (far, faint, 0.1, 0.2, False),
    ):
        lesson, joint = crowd_with(place, power, existence, extent)
        assert lesson.placed(joint) is expected
        short = replace(lesson, samples=lesson.samples[:START_STEPS])
        assert short.placed(joint) is (existence > 0.5), "so short a track doesn't tell"


@pytest.mark.slow
def test_in_a_crowd_a_set_that_sees_its_line_of_sight_is_preferred_within_the_scatter_of_scores():
    lesson, joint = crowd_with(MIRROR, 1.0)
    state, _ = state_after([], [], 1)
    plain = lesson.judge(state.before, state.segment)
    seen = plain._replace(joint=joint, score=0.0, placed=True)
    for ahead, wins in ((0.9 * SEEN, True), (1.1 * SEEN, False)):
        hidden = seen._replace(placed=False, score=ahead)
        assert (best_of([hidden, seen]) is seen) is wins
        assert seen.beats(hidden) is wins
    ahead = hidden._replace(score=1.0)
    assert ahead.adrift
    for one, other in ((True, True), (True, False), (False, True)):
        pair = [ahead._replace(known=one), seen._replace(known=other)]
        assert best_of(pair) is pair[0], "known features say where the agent is, seen or not"
    known = replace(lesson, before=joint).judge(replace(joint, existence=np.zeros(1)), state.segment)
    assert known.known
    assert not known.adrift
    image = seen._replace(joint=replace(joint, extent=0.0))
    assert best_of([image._replace(placed=False, score=1.0), image]) is not image
    assert not seen._replace(score=0.9 * CLEAR).beats(seen, CLEAR)


@pytest.mark.slow
def test_a_crowd_is_looked_for_from_other_starts_and_the_best_are_followed_up():
    """Along a way half a metre off, some of the others explain the segment better."""
    state, model = state_after([MIRROR, SCATTERER], [1500.0, 800.0], 3, spread=(0.3, 0.3, 0.1, 0.1))
    lesson, segment = lesson_of(state, model), state.segment
    off = np.array([0.4, -0.5, 0.0, 0.0])
    astray = replace(segment, agent=segment.agent + off)
    (wrong,) = lesson.rivals(astray, state.joint, PRICES[:1])
    lost = wrong._replace(track=astray.agent, score=wrong.score - 200, placed=False)
    found, ways = lesson.elsewhere(lost, astray, PRICES[0])
    assert len(found) == len(ways) == FOLLOWED
    assert found[0].placed, "the first that sees its line of sight will do"
    assert found[0].score > lost.score
    assert ways[0] is not astray
    found, ways = lesson.elsewhere(lost._replace(placed=True), astray, PRICES[0])
    assert [len(found), ways] == [1, [astray]]


def given_up(earlier, later, cost, others_cost, monkeypatch):
    """At which step a set is given up that gains so much beside others that do, and costs so much more."""
    state, model = state_after([], [], 0)
    lesson = lesson_of(state, model)
    other = lesson.judge(lesson.before, state.segment)
    gains = np.where(np.arange(len(state.segment)) < 5, earlier, later)
    asked = []

    def replayed(belief, segment, before_s, first, model, least=None):
        asked.append(np.flatnonzero(np.cumsum(other.evidence + gains) < least))
        return other.joint, other.evidence + gains, other.track

    costs = {id(lesson.before): others_cost}
    with monkeypatch.context() as patched:
        patched.setattr(rivals, "replay", replayed)
        patched.setattr(Lesson, "_cost", lambda self, belief: costs.get(id(belief), cost))
        lesson.judge(replace(lesson.before), state.segment, other)
    return asked[0][0] if len(asked[0]) else None


@pytest.mark.slow
def test_a_richer_set_has_until_the_end_to_earn_what_its_features_cost(monkeypatch):
    assert given_up(0.0, 0.0, 5 * HOPELESS, 0.0, monkeypatch) is None
    assert given_up(-0.9 * HOPELESS / 5, 0.0, 5 * HOPELESS, 0.0, monkeypatch) is None
    assert given_up(-1.1 * HOPELESS / 5, 0.0, 5 * HOPELESS, 0.0, monkeypatch) == 4
    assert given_up(-1.1 * HOPELESS / 5, 0.0, 0.0, HOPELESS, monkeypatch) is None, "what it saves counts"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("crowd", "gain", "placed", "moves"),
    [
        (True, 0.9 * SHIFTED, False, False),
        (True, 1.1 * SHIFTED, False, True),
        (True, 0.0, True, True),
        (False, 1.0, False, True),
        (False, -1.0, False, False),
    ],
)
def test_a_crowd_is_shifted_as_a_whole_for_much_evidence_or_a_line_of_sight(
    monkeypatch, crowd, gain, placed, moves
):
    state, model = state_after([], [], 0)
    lesson = lesson_of(state, model)
    plain = lesson.judge(lesson.before, state.segment)
    found = plain._replace(joint=replace(plain.joint, extent=float(crowd)), placed=False)
    moved = found._replace(score=found.score + gain, placed=placed)
    shifts = iter([np.array([1.0, 0.0])])
    monkeypatch.setattr(Lesson, "climb", lambda self, rival, segment, price: rival)
    monkeypatch.setattr(Lesson, "shift", lambda self, rival: next(shifts, None))
    monkeypatch.setattr(Lesson, "rivals", lambda self, *asked, **more: [moved])
    assert (lesson.best([found], [state.segment], PRICES[0]) is moved) == moves
