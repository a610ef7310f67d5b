"""Where first arrivals say that an agent of one antenna is, and lost agents that are found by them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

import gridslam as gs
from gridslam.inference.management.samples.arrival_places import (
    DILUTION,
    TRIAL,
    borne_out,
    crossings,
    found_again,
    only_place,
    place_told,
    tried,
)
from gridslam.inference.messages.samples.early_paths import EVERY, LOOKS
from gridslam.inference.messages.samples.signal_likelihood import band_of
from gridslam.inference.state.population import Population
from gridslam.inference.state.samples.images import DirectState
from gridslam.world.signal_model import SignalModel

THREE = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 3.0]])
ROOM = """
[radio]
frequencies = 41
frequency_step_hz = 1e7
bandwidth_hz = 4e8
fading = "steady"
snr_at_1m_db = 40.0
array = { rows = 1, columns = 1 }
[grid]
x_m = [-1.0, 11.0]
y_m = [-1.0, 9.0]
[[anchors]]
name = "A"
position_m = [0.7, 1.0]
[[anchors]]
name = "B"
position_m = [9.3, 1.4]
[[anchors]]
name = "C"
position_m = [4.2, 7.4]
[[walls]]
material = "concrete"
points_m = [[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]]
closed = true
[[agents]]
name = "a"
start_m = [START]
start_heading_deg = 20.0
waypoints_m = [[NEXT], [8.0, 6.0]]
step_m = 0.05
steps = 42
"""


def room(off):
    """The room with the start, and the way from it, so far off."""
    start, following = ([x + off[0], y + off[1]] for x, y in ((3.0, 3.0), (6.5, 4.2)))
    text = ROOM.replace("START", "{}, {}".format(*start)).replace("NEXT", "{}, {}".format(*following))
    return gs.Scene.from_toml(text, "room")


@pytest.fixture(scope="module")
def model():
    slam = gs.DirectSlam(room((0.0, 0.0)))
    assert isinstance(slam.model, SignalModel)
    return slam.model


def looks(model, way):
    """What arrives first at the places of a way (K, 2): the lines of sight."""
    length = np.linalg.norm(np.asarray(way)[:, None] - model.anchor_positions, axis=-1)
    return np.column_stack([EVERY * np.arange(len(way)), length])


WAY = np.array([3.0, 3.0]) + np.outer(np.arange(LOOKS), [0.14, 0.05])


def test_distances_cross_where_they_do_by_hand():
    """(1, 1) is sqrt 2, sqrt 10 and sqrt 5 from the three anchors."""
    place, missed = crossings(THREE, np.sqrt([[2.0, 10.0, 5.0]]))
    np.testing.assert_allclose(place, [[1.0, 1.0]], atol=1e-9)
    np.testing.assert_allclose(missed, 0.0, atol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_crossings_are_those_of_least_squares(seed):
    draw = np.random.default_rng(seed)
    anchors, place = draw.uniform(0, 10, (3, 2)), draw.uniform(0, 10, 2)
    length = np.linalg.norm(anchors - place, axis=1) + draw.normal(0, 0.02, 3)
    found, missed = crossings(anchors, length[None])
    if not len(found):
        toward = (place - anchors) / np.linalg.norm(place - anchors, axis=1)[:, None]
        assert np.trace(np.linalg.inv(toward.T @ toward)) > 10.0  # a place known badly
        return
    toward = (found[0] - anchors) / np.linalg.norm(found[0] - anchors, axis=1)[:, None]
    assert np.trace(np.linalg.inv(toward.T @ toward)) < DILUTION**2 * (1 + 1e-9)
    misses = least_squares(lambda at: np.linalg.norm(anchors - at, axis=1) - length, found[0], xtol=1e-14).fun
    assert missed[0] == pytest.approx(np.sqrt(np.mean(misses**2)), abs=1e-3)


def test_anchors_in_one_line_tell_no_place():
    line = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]])
    place, missed = crossings(line, np.full((1, 3), 3.0))
    assert place.shape == (0, 2)
    assert missed.shape == (0,)


def test_a_third_anchor_decides_once_the_mirrored_place_is_far_enough_from_it():
    """By hand: (0, 3) mirrors to (0, -3); from (0, 0.3) they are 2.7 and 3.3 m away."""
    anchors = np.array([[-4.0, 0.0], [4.0, 0.0], [0.0, 0.3]])
    assert only_place(np.array([0.0, 3.0]), anchors, 0.59)
    assert not only_place(np.array([0.0, 3.0]), anchors, 0.61)
    beside = np.array([[-4.0, 0.0], [4.0, 0.0], [1.0, 4.0]])
    assert only_place(np.array([0.0, 0.2]), beside, 0.45)  # 0.4 m from its mirrored place, which is the same


def test_arrivals_tell_place_and_velocity_after_so_many_looks(model):
    band = band_of(model.waveform)
    told = place_told(looks(model, WAY), model.anchor_positions, model, band)
    np.testing.assert_allclose(told.place_m, WAY[-1], atol=1e-6)
    np.testing.assert_allclose(told.velocity_mps, [0.14 / EVERY, 0.05 / EVERY], atol=1e-6)
    deviation = np.hypot(np.sqrt(2) / 8 * band.resolution_m / 6, 6 * model.settings.acceleration_mps2)
    assert told.velocity_std_mps == pytest.approx(deviation)  # looks are 3 s apart
    assert sorted(told.three) == [0, 1, 2]
    assert place_told(looks(model, WAY[:-1]), model.anchor_positions, model, band) is None
    resting = looks(model, np.tile(WAY[:1], (LOOKS, 1)))
    assert place_told(resting, model.anchor_positions, model, band) is not None
    resting[3:, 0] += 600.0  # nothing was recorded meanwhile
    assert place_told(resting, model.anchor_positions, model, band) is None


def told_by(model, anchors, place):
    """What agents that stand at a place are told by these anchors' lines of sight."""
    length = np.linalg.norm(anchors - place, axis=1)
    firsts = np.column_stack([EVERY * np.arange(LOOKS), np.tile(length, (LOOKS, 1))])
    return place_told(firsts, anchors, model, band_of(model.waveform))


def test_anchors_beside_each_other_tell_no_place(model):
    near = np.array([[4.4, 7.5], [4.2, 5.7], [5.4, 5.9]])
    assert told_by(model, near, np.array([5.0, 6.5])) is not None
    assert told_by(model, near, np.array([2.4, -0.9])) is None  # directions to them differ by ten degrees


def test_a_place_that_mirrors_to_as_far_from_the_third_isnt_told(model):
    along = np.array([[5.8, 3.5], [5.5, 5.2], [5.6, 4.0]])  # 0.1 m off one line
    assert told_by(model, along, np.array([2.7, 2.4])) is None


def test_another_anchor_that_would_be_heard_before_its_line_of_sight_disproves_a_place(model):
    anchors, place = np.vstack([model.anchor_positions, [5.0, 2.0]]), WAY[-1]
    assert len(told_by(model, anchors, place).three) == 3
    length = np.linalg.norm(anchors - WAY[:, None], axis=-1)
    length[:, 3] -= 0.5
    firsts = np.column_stack([EVERY * np.arange(LOOKS), length])
    assert place_told(firsts, anchors, model, band_of(model.waveform)) is None


def test_the_nearest_six_anchors_are_looked_at(model):
    far = np.array([[0.0, 8.5], [10.5, 8.5], [10.5, -0.5], [-0.5, -0.5]])
    three = np.array([[2.0, 2.0], [4.5, 2.2], [3.0, 4.5]])
    anchors, place = np.vstack([far[:3], three]), np.array([3.1, 2.9])
    firsts = np.column_stack(
        [EVERY * np.arange(LOOKS), np.tile(np.linalg.norm(anchors - place, axis=1), (LOOKS, 1))]
    )
    firsts[:, 5:7] += 1.0  # two of the nearest are hidden
    assert place_told(firsts, anchors, model, band_of(model.waveform)) is not None


@pytest.mark.parametrize("fault", ["hidden", "silent", "leaping", "outside"])
def test_arrivals_that_are_no_lines_of_sight_tell_nothing(model, fault):
    band, firsts = band_of(model.waveform), looks(model, WAY)
    if fault == "hidden":
        firsts[2, 1] += 0.4  # over a wall
    elif fault == "silent":
        firsts[1, 3] = 0.0
    elif fault == "leaping":
        firsts = looks(model, WAY + np.where(np.arange(LOOKS) == 3, 1.0, 0.0)[:, None])
    else:
        firsts = looks(model, WAY - [5.0, 0.0])
    assert place_told(firsts, model.anchor_positions, model, band) is None


def state_at(model, place, spread=0.02, **changes):
    start = DirectState.start(
        np.append(place, [0.0, 0.0]), np.array([spread**2] * 2 + [0.01] * 2), 3, np.full(3, 0.5)
    )
    firsts = looks(model, WAY)
    return replace(start, firsts=firsts, time_s=float(firsts[-1, 0]), **changes)


def test_a_place_that_arrivals_tell_is_neither_mirrored_nor_on_trial(model):
    band = band_of(model.waveform)
    doubted = {"one_sided": np.array([1, 1, 0]), "found_again": True}
    right = borne_out(state_at(model, WAY[-1] + [0.1, 0.0], **doubted), model, band)
    assert not right.one_sided.any()
    assert not right.found_again
    for wrong in (state_at(model, WAY[-1] + [0.6, 0.0], **doubted), state_at(model, WAY[-1], 0.4, **doubted)):
        assert borne_out(wrong, model, band) is wrong
    later = replace(state_at(model, WAY[-1], **doubted), time_s=1000.0)  # between two looks
    assert borne_out(later, model, band) is later


def test_a_lost_agent_begins_anew_where_arrivals_tell(model):
    lost = Population.of(state_at(model, WAY[-1] + [2.0, 0.0]))
    found = found_again(lost, False, model)
    variance = np.diagonal(found.best.belief.covariance)
    np.testing.assert_allclose(np.sqrt(variance[:2]), 0.0937, rtol=1e-3)  # c/8B at 400 MHz
    np.testing.assert_allclose(found.best.belief.mean[:2], WAY[-1], atol=1e-6)
    assert found.best.found_again
    assert found.best.step == 0
    assert found.best.time_s == lost.best.time_s
    np.testing.assert_array_equal(found.best.links.noise, lost.best.links.noise)
    assert found_again(lost, True, model) is lost  # health has nothing to say
    right = state_at(model, WAY[-1] + [0.1, 0.0])
    both = Population((lost.best, right), (np.log(0.9), np.log(0.1)))
    for kept in (Population.of(right), both, replace(lost, searching=True)):
        assert found_again(kept, False, model) is kept


def test_reflections_off_one_wall_move_nobody_who_is_not_contradicted(model):
    """All over the wall y = 2.2, seen from below: they cross where it mirrors the agent to."""
    low = replace(model, anchors=np.array([[0.7, 0.5, 0.0], [9.3, 1.4, 0.0], [4.2, -0.8, 0.0]]))
    place, firsts = (WAY * [1.0, -1.0] + [0.0, 4.4])[-1], looks(low, WAY)
    told = place_told(firsts, low.anchor_positions, low, band_of(low.waveform))
    np.testing.assert_allclose(told.place_m, WAY[-1], atol=1e-6)  # 2 m from the agent
    sure, vague = (Population.of(replace(state_at(low, place, std), firsts=firsts)) for std in (0.1, 1.0))
    assert found_again(sure, False, low) is sure
    assert found_again(vague, False, low).best.found_again  # nothing that it knows speaks against it


def test_looks_from_a_file_that_cannot_be_are_refused(model):
    right = state_at(model, WAY[-1])
    assert all(holds for _, holds, _ in right.claims(3))
    for firsts in (right.firsts[::-1], -right.firsts, right.firsts[:, :3], right.firsts[:, 0]):
        odd = replace(right, firsts=firsts)
        assert {part for part, holds, _ in odd.claims(3) if not holds} == {"firsts"}


def test_a_trial_ends_with_arrivals_or_after_a_time_of_being_well(model):
    on_trial = state_at(model, WAY[-1], found_again=True, step=TRIAL)
    assert tried(on_trial, False) is on_trial
    assert not tried(on_trial, True).found_again
    early = replace(on_trial, step=TRIAL - 1)
    assert tried(early, True) is early


@pytest.mark.slow
def test_wrong_starts_are_mended_and_on_trial_until_borne_out():
    """Told 1.5 m wrong, and sure of it to decimetres: right within 24 steps."""
    heard = gs.simulate(room((0.0, 0.0)), "a", 3, what="signal")
    true = room((0.0, 0.0)).track("a").position_m
    slam = gs.DirectSlam(room((1.5, 0.0)))
    errors, reasons = [], []
    for scan, place in zip(heard, true, strict=True):
        estimate = slam.step(scan)
        errors.append(np.linalg.norm(estimate.position_m[:2] - place[:2]))
        reasons.append(estimate.health.why)
    assert max(errors[24:]) < 0.15
    assert max(errors[-5:]) < 0.05
    assert sum("found again" in reason for reason in reasons) >= EVERY * (LOOKS - 1)
    assert not any(reasons[-2:])
