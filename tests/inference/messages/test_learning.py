"""New features: found where they are, refused where they foretell nothing."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import received, signal_model

from gridslam import runtime
from gridslam.inference.messages.features import proposals
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.following import START_STEPS
from gridslam.inference.messages.features.joint_update import predict, update
from gridslam.inference.messages.features.learning import JUDGED, learn, was_heard
from gridslam.inference.messages.features.proposals import (
    CROWD,
    CROWD_EXTENT_M,
    LOOSE,
    UNTOLD,
    extra_slopes,
    with_proposals,
)
from gridslam.inference.messages.features.rivals import (
    CLEAR,
    FOLLOWED,
    HOPELESS,
    LOUD,
    PRICES,
    REACH,
    SEEN,
    Lesson,
    best_of,
    usual_prices,
)
from gridslam.inference.messages.features.seeding import (
    IMAGE,
    LEAST_GAIN,
    NONE_M,
    POWERS,
    SCATTERED,
    candidates,
    first_gains,
    propose,
)
from gridslam.inference.messages.features.stretch import stretch_of
from gridslam.inference.messages.features.ways import BESIDE_STD, STARTS, drifted, moved_starts
from gridslam.inference.state.features.features import MOVING, FeatureBank, entries, places
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
LOS, LOS_POWER = np.array([3.0, 4.0, 0.0]), 3000.0
MIRROR, SCATTERER = np.array([-6.0, 2.0, 0.0]), np.array([2.0, -4.0, 8.06])
STEPS = 20


def state_after(points, powers, seed, elsewhere_from=STEPS, spread=(0.1, 0.1, 0.1, 0.1)):
    """A state whose segment is a way past the points; from `elsewhere_from` on, they are 5 m off."""
    model, draw = signal_model(spread=spread), np.random.default_rng(seed)
    belief = JointBelief(
        model.start_mean[:4], np.diag(model.start_variance[:4]), FeatureBank.empty(), np.array([0.9]),
        np.array([LOS_POWER]), np.ones(1),
    )  # fmt: skip
    segment, heard, at = Segment.empty(1, 4, 41), np.array([True]), belief
    for k in range(STEPS):
        place = np.array([0.1 * k, 0.5 * np.sin(0.2 * k)])
        rows = points if k < elsewhere_from else [point + np.array([0.0, 5.0, 0.0]) for point in points]
        z = received(model, place, 0.1 * k, [LOS, *rows], [LOS_POWER, *powers], draw)
        at, evidence = update(predict(at, 0.1, 2.0) if k else at, z, heard, 0.1 * k, model, k)
        segment = segment.add(0.1 * k, 0.1 * k, heard, z, np.array([*place, 1.0, 0.0]), evidence)
    return HybridState(belief, belief, segment, step=STEPS, time_s=0.1 * (STEPS - 1)), model


@pytest.mark.slow
def test_a_mirror_image_is_found_where_it_is():
    state, model = state_after([MIRROR], [1500.0], 0)
    found, learned = learn(state, Front(model.waveform), model)
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


def test_features_that_are_never_loud_are_kept_if_they_are_surely_there():
    state, _ = state_after([], [], 0)
    joint = state.joint
    for n in range(3):
        joint = joint.with_feature(0, entries(MIRROR, np.zeros(2)), np.eye(3), np.zeros(2), 1.0, n, 0)
    bank = replace(joint.features, steps_seen=np.array([0, 0, 3]), presence=np.array([0.95, 0.5, 0.1]))
    joint = replace(joint, features=bank)
    np.testing.assert_array_equal(was_heard(joint), [True, False, True])
    np.testing.assert_array_equal(was_heard(replace(joint, extent=CROWD_EXTENT_M)), [False, False, True])


@pytest.mark.slow
def test_features_for_the_time_being_make_way_for_as_good_ones():
    state, model = state_after([MIRROR], [1500.0], 0)
    taught, _ = learn(state, Front(model.waveform), model)
    lesson = lesson_of(state, model)
    best = lesson.best(lesson.rivals(state.segment, state.joint, PRICES[:1]), [state.segment], PRICES[0])
    better = replace(state, segment=replace(state.segment, evidence=best.evidence + 0.5 * CLEAR / JUDGED))
    assert learn(better, Front(model.waveform), model)[1].taken == 0
    passing = replace(better, joint=taught.joint)  # with features, `before` has none
    found, learned = learn(passing, Front(model.waveform), model)
    assert learned.taken >= 1
    assert found.joint is not passing.joint


def lesson_of(state, model):
    return Lesson.of(state, state.segment, JUDGED, Front(model.waveform), model)


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


def test_a_feature_that_explains_nothing_costs_its_price():
    state, model = state_after([], [], 5)
    lesson = lesson_of(state, model)
    spread, origin = np.diag(np.square([0.3, 0.2, 1e-3])), np.zeros(2)
    more = state.before.with_feature(0, entries(MIRROR, origin), spread, origin, 1e-6, 0, 0)
    scores = [lesson.judge(belief, state.segment).score for belief in (state.before, more)]
    assert scores[0] - scores[1] == pytest.approx(LEAST_GAIN, abs=1.0)


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


@pytest.mark.parametrize("many", [CROWD, CROWD + 1])
def test_features_of_a_crowd_are_not_taken_at_their_word(many, monkeypatch):
    """Beyond some number they stand for more scatterers than they are: with an extent, and loosely tied."""
    state, model = state_after([MIRROR], [1500.0], 6)
    kind = np.array([SCATTERED] + [IMAGE] * (many - 1))
    rows = np.tile([*MIRROR, 500.0], (many, 1))
    rows[0] = [*SCATTERER, 500.0]
    monkeypatch.setattr(proposals, "propose", lambda *_: (rows, kind))
    given = Front(model.waveform), model, lesson_of(state, model).tables
    looks = proposals.surveys(state.before, state.joint, state.segment, JUDGED, *given)
    found = with_proposals(state.before, state.segment, looks, PRICES[0], 0, 0, model)
    length, _, extra = found.mean[MOVING:].reshape(-1, 3).T
    std = np.sqrt(np.diagonal(found.covariance)[MOVING:].reshape(-1, 3))
    crowded = many > CROWD
    assert found.extent == (CROWD_EXTENT_M if crowded else 0.0)
    np.testing.assert_allclose(std[1:, 2], UNTOLD * length[1:] if crowded else NONE_M)
    assert std[0, 2] > LOOSE * length[0] if crowded else std[0, 2] < LOOSE * length[0]
    assert (found.extent, len(found.features)) == (found.keep(extra >= 0).extent, many)


@pytest.mark.parametrize("steps", [START_STEPS, START_STEPS + 1])
def test_a_short_track_does_not_tell_that_an_image_is_one(steps):
    state, model = state_after([MIRROR], [1500.0], 5)
    lesson = Lesson.of(state, state.segment, 0, Front(model.waveform), model)
    (one, _) = lesson.rivals(state.segment, state.joint, PRICES, state.segment.first(steps))
    extra = one.start.covariance[MOVING + 2, MOVING + 2] ** 0.5
    length = one.start.mean[MOVING]
    assert extra == pytest.approx(UNTOLD * length if steps <= START_STEPS else NONE_M)


def test_the_noise_is_what_features_leave():
    state, model = state_after([MIRROR], [1500.0], 2)
    stretch, _ = stretch_of(state.joint, state.segment, 0, JUDGED, Front(model.waveform), model)
    assert stretch.points[0, 3] > 1.5, "nothing explains the mirror's path yet"
    assert stretch.quieter(np.array([[*MIRROR, 1500.0]]))[0].points[:, 3] == pytest.approx(1.0, abs=0.05)


def test_a_segment_that_is_too_short_is_kept_for_later():
    state, model = state_after([MIRROR], [1500.0], 0)
    short = replace(state.segment, **{name: value[:8] for name, value in vars(state.segment).items()})
    found, learned = learn(replace(state, segment=short), Front(model.waveform), model)
    assert len(found.segment) == 8
    assert learned.proposed == 0


def stretch_and_gains(points, powers):
    state, model = state_after(points, powers, 2)
    stretch, left = stretch_of(state.joint, state.segment, 0, JUDGED, Front(model.waveform), model)
    return stretch, first_gains(stretch, left)


def test_samples_less_what_features_explain_are_those_of_the_covariance_of_all():
    # by the whole covariance, with a line of sight of which nothing is known
    from gridslam import reference

    stretch, _ = stretch_and_gains([MIRROR], [1500.0])
    front, table = stretch.front, np.array([[*MIRROR, 1500.0], [1.0, -5.0, 2.0, 300.0]])
    wave = front.waveform
    rate = 2 * np.pi * wave.offset_hz / 299792458.0
    expected = []
    for point, z in zip(stretch.points, stretch.samples, strict=True):
        given = stretch.anchor_m, front.element, wave.pulse, rate
        los, each = reference.columns(point[:3], table, *given)
        covariance = point[3] * np.eye(z.size) + (each * table[:, 3]) @ each.conj().T
        clear = z.ravel() - los * (np.vdot(los, z.ravel()) / np.vdot(los, los))
        expected.append(np.linalg.solve(covariance, clear).reshape(z.shape))
    found, right = stretch.unexplained(table), front.coarse(np.array(expected))
    np.testing.assert_allclose(found, right, atol=3e-3 * np.abs(right).max())


def test_gains_that_are_older_than_the_latest_feature_lead_to_the_same_best_place():
    stretch, gains = stretch_and_gains([MIRROR, SCATTERER], [1500.0, 1000.0])
    left = stretch.unexplained(np.array([[*MIRROR, 1500.0]]))
    gains.age()
    found = gains.best(PRICES[0], None, stretch, left)
    everywhere = stretch.front.gains(gains.places, stretch.points, left, stretch.unit * POWERS)
    total = everywhere[:, 0] - PRICES[0][gains.kinds]
    assert found == np.argmax(total)
    assert gains.fresh.sum() < 0.2 * len(total), "most places needn't be looked at again"


@pytest.mark.slow
def test_what_is_proposed_is_nearer_than_the_grid():
    stretch, gains = stretch_and_gains([MIRROR], [1500.0])
    table, kind = propose(stretch, np.zeros((0, 4)), stretch.unexplained(np.zeros((0, 4))), gains, PRICES[0])
    assert kind[0] == IMAGE
    off = table[0, :2] - MIRROR[:2]
    along = MIRROR[:2] / np.hypot(*MIRROR[:2])
    assert abs(off @ along) < 0.05
    assert table[0, 3] == pytest.approx(1500.0, rel=0.3)


def test_candidates_of_scatterers_have_the_length_to_the_anchor_as_extra():
    centre, anchor = np.array([1.0, -2.0]), np.array([3.0, 4.0])
    rows, kinds = candidates(centre, 20.0, anchor)
    tied = rows[kinds == SCATTERED]
    far = np.hypot(*(tied[:, :2] - centre).T)
    np.testing.assert_allclose(tied[:, 2], np.hypot(*(tied[:, :2] - anchor).T))
    length = far + tied[:, 2]
    assert length.min() > np.hypot(2, 6)
    assert length.max() < 20
    assert not rows[kinds == IMAGE, 2].any()


def test_slopes_of_a_scatterers_extra_length_agree_with_differences():
    origin, anchor, place = np.array([1.0, -2.0]), np.array([3.0, 4.0]), np.array([-5.0, 1.0])

    def extra(length, direction):
        """By bisection: where in this direction both ways have this length."""
        low, high = 0.0, length
        for _ in range(60):
            far = 0.5 * (low + high)
            spot = origin + far * np.array([np.cos(direction), np.sin(direction)])
            low, high = (far, high) if far + np.hypot(*(spot - anchor)) < length else (low, far)
        return length - far

    entry = entries(np.array([*place, np.hypot(*(place - anchor))]), origin)
    assert extra(*entry[:2]) == pytest.approx(entry[2])
    step = 1e-5
    expected = [
        (extra(entry[0] + step, entry[1]) - extra(entry[0] - step, entry[1])) / (2 * step),
        (extra(entry[0], entry[1] + step) - extra(entry[0], entry[1] - step)) / (2 * step),
    ]
    np.testing.assert_allclose(extra_slopes(entry, anchor - origin), expected, rtol=1e-5)


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


def test_in_a_crowd_a_set_that_sees_its_line_of_sight_is_preferred_within_the_scatter_of_scores():
    lesson, joint = crowd_with(MIRROR, 1.0)
    state, _ = state_after([], [], 1)
    plain = lesson.judge(state.before, state.segment)
    seen = plain._replace(joint=joint, score=0.0, placed=True)
    for ahead, wins in ((0.9 * SEEN, True), (1.1 * SEEN, False)):
        hidden = seen._replace(placed=False, score=ahead)
        assert (best_of([hidden, seen]) is seen) is wins
        assert seen.beats(hidden) is wins
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
