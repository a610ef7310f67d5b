"""New features: found where they are, refused where they foretell nothing."""

from dataclasses import replace

import numpy as np
import pytest
from lesson_states import LOS, LOS_POWER, MIRROR, SCATTERER, STEPS, hidden_start, lesson_of, state_after

from gridslam import runtime
from gridslam.inference.messages.features import rivals
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.following import START_STEPS
from gridslam.inference.messages.features.learning import JUDGED, learn, was_detected
from gridslam.inference.messages.features.prices import PRICES, usual_prices
from gridslam.inference.messages.features.proposals import (
    AMBIGUOUS,
    CROWD_EXTENT_M,
)
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
from gridslam.inference.messages.features.seeding import (
    IMAGE,
    LEAST_GAIN,
    NONE_M,
    SCATTERED,
)
from gridslam.inference.messages.features.settling import SIGHTED_STEPS, beginning
from gridslam.inference.messages.features.ways import BESIDE_STD, STARTS, drifted, moved_starts
from gridslam.inference.state.features.features import MOVING, entries, places

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())


@pytest.fixture(scope="module")
def mirror():
    """A state past a mirror, its model, and what it learns: nobody changes them."""
    state, model = state_after([MIRROR], [1500.0], 0)
    return state, model, *learn(state, Front(model.waveform), model)


@pytest.mark.slow
def test_a_mirror_image_is_found_where_it_is(mirror):
    *_, found, learned = mirror
    assert learned.taken >= 1
    assert learned.gain > 0
    place = places(found.joint.mean, found.joint.features.origin_m)
    strongest = np.argmax(found.joint.features.power)
    assert np.hypot(*(place[strongest] - MIRROR)[:2]) < 0.5
    assert abs(place[strongest, 2]) < 0.01
    assert len(found.segment) == 0
    assert found.before is found.joint
    assert found.next_identity >= 1


@pytest.mark.slow
def test_nothing_is_learned_of_a_line_of_sight_and_noise_alone():
    for seed in range(2):
        state, model = state_after([], [], seed)
        found, learned = learn(state, Front(model.waveform), model)
        assert learned.taken == 0
        assert len(found.joint.features) == 0


@pytest.mark.slow
def test_features_that_do_not_foretell_the_last_steps_are_refused():
    state, model = state_after([MIRROR], [1500.0], 0, elsewhere_from=STEPS - JUDGED)
    found, learned = learn(state, Front(model.waveform), model)
    assert learned.proposed >= 1
    assert learned.taken == 0
    assert found.joint is state.joint


def test_a_lesson_of_which_no_feature_is_left_moves_nothing(monkeypatch):
    """What a set says of the agent by features that nobody hears isn't kept without them."""
    state, model = state_after([MIRROR], [1500.0], 0)
    set_of = Lesson.rivals

    def unheard(self, *args, **more):
        found = []
        for one in set_of(self, *args, **more):
            bank = one.joint.features
            bank = replace(bank, steps_seen=np.zeros(len(bank), np.int64), presence=np.zeros(len(bank)))
            found.append(one._replace(joint=replace(one.joint, features=bank)))
        return found

    monkeypatch.setattr(Lesson, "rivals", unheard)
    after, learned = learn(state, Front(model.waveform), model)
    assert learned.proposed > learned.taken == 0
    assert learned.gain > 0
    assert after.joint is state.joint


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
def test_features_that_are_never_loud_are_kept_if_they_are_surely_there():
    state, _ = state_after([], [], 0)
    joint = state.joint
    for n in range(3):
        joint = joint.with_feature(0, entries(MIRROR, np.zeros(2)), np.eye(3), np.zeros(2), 1.0, n, 0)
    bank = replace(joint.features, steps_seen=np.array([0, 0, 3]), presence=np.array([0.95, 0.5, 0.1]))
    joint = replace(joint, features=bank)
    np.testing.assert_array_equal(was_detected(joint), [True, False, True])
    np.testing.assert_array_equal(was_detected(replace(joint, extent=CROWD_EXTENT_M)), [False, False, True])


@pytest.mark.slow
def test_features_for_the_time_being_make_way_for_as_good_ones(mirror):
    state, model, taught, _ = mirror
    lesson = lesson_of(state, model)
    best = lesson.best(lesson.rivals(state.segment, state.joint, PRICES[:1]), [state.segment], PRICES[0])
    better = replace(state, segment=replace(state.segment, evidence=best.evidence + 0.5 * CLEAR / JUDGED))
    assert learn(better, Front(model.waveform), model)[1].taken == 0
    passing = replace(better, joint=taught.joint)  # with features, `before` has none
    found, learned = learn(passing, Front(model.waveform), model)
    assert learned.taken >= 1
    assert found.joint is not passing.joint


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


def test_a_segment_that_is_too_short_is_kept_for_later():
    state, model = state_after([MIRROR], [1500.0], 0)
    short = replace(state.segment, **{name: value[:8] for name, value in vars(state.segment).items()})
    found, learned = learn(replace(state, segment=short), Front(model.waveform), model)
    assert len(found.segment) == 8
    assert learned.proposed == 0


@pytest.mark.slow
def test_what_most_features_are_is_the_rule_for_new_ones():
    _, model = state_after([], [], 0)
    belief = state_after([], [], 0)[0].joint
    assert len(usual_prices(belief, model)) == 2
    spread, origin = 0.01 * np.eye(3), np.array([0.5, 0.0])
    for place, cheapest in ((MIRROR, IMAGE), (SCATTERER, SCATTERED)):
        known = belief.with_feature(0, entries(place, origin), spread, origin, 1.0, 0, 0)
        (price,) = usual_prices(known, model)
        assert np.argmin(price) == cheapest


@pytest.mark.slow
def test_a_scatterer_is_taken_for_one():
    way = SCATTERER[:2] - LOS[:2]
    point = np.array([*SCATTERER[:2], np.hypot(*way)])
    state, model = state_after([point], [3000.0], 3)
    found, _ = learn(state, Front(model.waveform), model)
    place = places(found.joint.mean, found.joint.features.origin_m)
    assert np.hypot(*(place[0] - point)[:2]) < 0.5
    assert abs(place[0, 2] - np.hypot(*(place[0, :2] - LOS[:2]))) < 0.3


def test_ways_from_other_starts_are_the_same_way_about_the_believed_start():
    state, _ = state_after([], [], 1, spread=(0.2, 0.2, 0.1, 0.1))
    segment = replace(state.segment, agent=state.segment.agent + np.array([1.0, 2.0, 0.0, 0.0]))
    ways = moved_starts(segment, state.before)
    shift = np.array([way.agent - segment.agent for way in ways])
    assert len(ways) == STARTS
    np.testing.assert_allclose(shift, np.broadcast_to(shift[:, :1], shift.shape), atol=1e-12)
    begin = np.array([way.agent[0, :2] for way in ways]) - state.before.mean[:2]
    np.testing.assert_allclose(np.hypot(*begin.T), BESIDE_STD * 0.2)
    np.testing.assert_allclose(begin.sum(0), 0.0, atol=1e-12)


def test_an_agent_that_is_not_heard_drifts_by_its_velocity_and_jolts():
    state, model = state_after([], [], 1, spread=(0.2, 0.2, 0.5, 0.5))
    steps = STEPS // 2 - 1
    free = 0.2**2 + (0.5 * 0.1 * steps) ** 2
    acceleration = model.settings.acceleration_mps2
    jolts = sum((acceleration * (0.1**2 * k + 0.5 * 0.1**2)) ** 2 for k in range(steps))
    assert drifted(state.before, state.segment, None, model) == pytest.approx(np.sqrt(free + jolts))


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


@pytest.mark.slow
def test_features_of_the_first_step_have_the_extent_of_a_crowd_where_ten_steps_show_one(monkeypatch):
    state, model = state_after([], [], 0)
    plain = lesson_of(state, model).judge(state.before, state.segment)
    asked = []

    def rivals_of(lesson, segment, after, prices, taught=None):
        asked.append((lesson.before.extent, taught is None or len(taught)))
        return [plain._replace(joint=replace(plain.joint, extent=CROWD_EXTENT_M))]

    monkeypatch.setattr(Lesson, "rivals", rivals_of)
    monkeypatch.setattr(Lesson, "best", lambda self, sets, ways, price: sets[0])
    beginning(replace(state, sights=SIGHTED_STEPS), state.segment, Front(model.waveform), model)
    assert asked == [(0.0, True), (CROWD_EXTENT_M, 1)]


@pytest.mark.slow
def test_who_begins_hidden_finds_its_way_by_straight_ones():
    """Particles without a line of sight stand still: features proposed along that lead astray."""
    right = np.zeros(2, int)
    for seed in range(3):
        state, model, way = hidden_start(seed, (0.6, -0.5))
        for k, sights in enumerate((0, SIGHTED_STEPS)):
            found = beginning(replace(state, sights=sights), state.segment, Front(model.waveform), model)
            right[k] += np.hypot(*(found.track[-1, :2] - way[-1])) < 0.3
    assert right[0] >= right[1] + 2, right
