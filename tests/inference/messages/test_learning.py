"""New features: found where they are, refused where they foretell nothing."""

from dataclasses import replace

import numpy as np
import pytest
from lesson_states import LOS, MIRROR, SCATTERER, STEPS, hidden_start, lesson_of, state_after

from gridslam import runtime
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.learning import JUDGED, learn, was_detected
from gridslam.inference.messages.features.prices import PRICES, usual_prices
from gridslam.inference.messages.features.proposals import CROWD_EXTENT_M
from gridslam.inference.messages.features.rivals import CLEAR, Lesson
from gridslam.inference.messages.features.seeding import IMAGE, SCATTERED
from gridslam.inference.messages.features.settling import SIGHTED_STEPS, beginning
from gridslam.inference.messages.features.ways import BESIDE_STD, STARTS, drifted, moved_starts
from gridslam.inference.state.features.features import entries, places

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
    state, model, way = hidden_start(0, (0.6, -0.5))
    for sights, right in ((0, True), (SIGHTED_STEPS, False)):
        found = beginning(replace(state, sights=sights), state.segment, Front(model.waveform), model)
        assert (np.hypot(*(found.track[-1, :2] - way[-1])) < 0.3) == right
