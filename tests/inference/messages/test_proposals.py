"""New features as they are proposed: what others leave, candidates, gains, and what a crowd is taken for."""

import numpy as np
import pytest
from lesson_states import MIRROR, SCATTERER, lesson_of, state_after

from gridslam import runtime
from gridslam.inference.messages.features import proposals
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.joint_update import moved_to
from gridslam.inference.messages.features.learning import JUDGED
from gridslam.inference.messages.features.prices import PRICES
from gridslam.inference.messages.features.proposals import (
    AMBIGUOUS,
    CROWD,
    CROWD_EXTENT_M,
    LOOSE,
    extra_slopes,
    shift_slopes,
    with_proposals,
)
from gridslam.inference.messages.features.seeding import (
    IMAGE,
    NONE_M,
    POWERS,
    SCATTERED,
    candidates,
    first_gains,
    propose,
)
from gridslam.inference.messages.features.stretch import stretch_of
from gridslam.inference.state.features.features import MOVING, FeatureBank, entries, places
from gridslam.inference.state.features.hybrid_state import JointBelief

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())


@pytest.mark.slow
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
    found = with_proposals(state.before, state.segment, looks, PRICES[0], 0, 0, np.zeros(2), model)
    length, _, extra = found.mean[MOVING:].reshape(-1, 3).T
    std = np.sqrt(np.diagonal(found.covariance)[MOVING:].reshape(-1, 3))
    crowded = many > CROWD
    assert found.extent == (CROWD_EXTENT_M if crowded else 0.0)
    np.testing.assert_allclose(std[1:, 2], AMBIGUOUS * length[1:] if crowded else NONE_M)
    assert std[0, 2] > LOOSE * length[0] if crowded else std[0, 2] < LOOSE * length[0]
    assert (found.extent, len(found.features)) == (found.keep(extra >= 0).extent, many)


@pytest.mark.parametrize("beside", [(0.0, 0.0), (0.4, -0.3)])
def test_features_that_are_proposed_beside_the_believed_start_stand_beside_their_places(beside):
    """An agent that began elsewhere heard them from there; where it is moved to the way, they are on it."""
    state, model = state_after([MIRROR], [1500.0], 6)
    given = Front(model.waveform), model, lesson_of(state, model).tables
    looks = proposals.surveys(state.before, state.joint, state.segment, JUDGED, *given)
    on_way, found = (
        with_proposals(state.before, state.segment, looks, PRICES[0], 0, 0, np.array(gap), model)
        for gap in ((0.0, 0.0), beside)
    )
    assert len(found.features) == len(on_way.features) > 0
    start = np.append(found.mean[:2] - beside, found.mean[2:MOVING])
    np.testing.assert_allclose(moved_to(found, start)[MOVING:], on_way.mean[MOVING:])
    shifted = places(found.mean, found.features.origin_m) - places(on_way.mean, on_way.features.origin_m)
    np.testing.assert_allclose(shifted[:, :2], np.tile(beside, (len(shifted), 1)), atol=0.03)


def test_the_noise_is_what_features_leave():
    state, model = state_after([MIRROR], [1500.0], 2)
    stretch, _ = stretch_of(state.joint, state.segment, 0, JUDGED, Front(model.waveform), model)
    assert stretch.points[0, 3] > 1.5, "nothing explains the mirror's path yet"
    assert stretch.quieter(np.array([[*MIRROR, 1500.0]]))[0].points[:, 3] == pytest.approx(1.0, abs=0.05)


def stretch_and_gains(points, powers):
    state, model = state_after(points, powers, 2)
    stretch, left = stretch_of(state.joint, state.segment, 0, JUDGED, Front(model.waveform), model)
    return stretch, first_gains(stretch, left)


@pytest.mark.slow
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


def test_a_feature_is_where_the_agent_saw_it_by_hand():
    """An agent that is 0.2 m farther along x saw it 0.2 m farther; one beside it, at another angle."""
    belief = JointBelief(
        np.zeros(4), np.diag([0.04, 0.01, 1.0, 1.0]), FeatureBank.empty(), np.ones(1), np.ones(1), np.ones(1)
    )
    entry = np.array([6.0, 0.0, 1.0])  # 5 m along x, and 1 m more
    moved = shift_slopes(entry)
    found = belief.with_feature(0, entry, np.diag([0.09, 0.04, 0.25]), np.zeros(2), 1.0, 0, 0, moved)
    own = found.covariance[MOVING:, MOVING:]
    np.testing.assert_allclose(own, np.diag([0.09 + 0.04, 0.04 + 0.01 / 25, 0.25]))
    towards = np.zeros((3, MOVING))
    towards[0, 0], towards[1, 1] = 0.04, 0.01 / 5
    np.testing.assert_allclose(found.covariance[MOVING:, :MOVING], towards)
    np.testing.assert_allclose(found.covariance[:MOVING, MOVING:], towards.T)
