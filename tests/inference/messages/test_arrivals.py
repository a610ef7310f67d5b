"""Lines of sight among louder paths: nothing arrives before them, and they are one wave."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import received, signal_model

from gridslam import runtime
from gridslam.inference.beliefs.calibration import KEEP
from gridslam.inference.health.signal_watch import EARLY
from gridslam.inference.management.features.hybrid_info import conclude
from gridslam.inference.messages.features.arrivals import (
    COST,
    OLD_M,
    Arrivals,
    arrivals_of,
    contradictions,
)
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.following import StepSamples, count_step
from gridslam.inference.messages.features.learning import Learned
from gridslam.inference.messages.features.lessons import HybridWork
from gridslam.inference.messages.features.sight import Moments
from gridslam.inference.state.features.features import FeatureBank
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment
from gridslam.systems.hybrid import start, step, step_by_sight
from gridslam.world.signal_scan import SignalScan

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
LOS, BEHIND = np.array([3.0, 4.0, 0.0]), np.array([3.0, 4.0, 1.5])
AUDIBLE = np.array([True])


def came(points, powers, seed=1, **more):
    model = signal_model(**more)
    z = received(model, (0, 0), 0.4, points, powers, np.random.default_rng(seed))
    return Arrivals.of(z[0], Front(model.waveform))


@pytest.mark.parametrize("seed", range(5))
def test_what_arrives_first_contradicts_longer_lines_of_sight_alone(seed):
    both = came([LOS, BEHIND], [3000.0, 9000.0], seed)  # 5.0 and 6.5 m
    short, right, *long = both.against(np.array([3.0, 5.0, 5.5, 6.5, 9.0]))
    assert max(short, right) < COST  # a shorter one may be hidden
    assert min(long) > right + 50
    assert [both.before(far) for far in (3.0, 5.0, 5.3, 6.5, 9.0)] == [False, False, False, True, True]


def test_the_first_path_arrives_at_its_length():
    assert came([LOS], [30000.0]).first_m() == pytest.approx(5.0, abs=0.02)
    assert came([BEHIND], [90000.0]).first_m() == pytest.approx(6.5, abs=0.02)
    assert came([LOS, BEHIND], [30000.0, 90000.0]).first_m() == pytest.approx(5.0, abs=0.1)
    assert came([], []).first_m() == 0.0


def test_steps_and_anchors_that_are_contradicted_are_counted_where_anything_is_heard():
    model, draw = signal_model(), np.random.default_rng(2)
    z = np.stack([received(model, (0, 0), 0.4, [LOS], [3000.0], draw) for _ in range(3)])
    heard = np.array([[True], [False], [True]])
    arrivals = arrivals_of(z, heard, Front(model.waveform))
    assert [len(step) for step in arrivals] == [1, 1, 1]
    assert arrivals[1] == [None]
    for lengths, count in (([5.0, 5.0, 5.0], 0), ([8.0, 8.0, 5.0], 1), ([8.0, 8.0, 8.0], 2)):
        way = np.array(lengths)[:, None, None] * [0.6, 0.8]
        assert contradictions(arrivals, way, np.zeros((2, 2))) == count
    vague = np.diag([0.6, 0.8]) ** 2  # three deviations of a metre
    assert contradictions(arrivals, np.full((3, 1, 2), 8.0) * [0.6, 0.8], vague) == 0


def test_side_lobes_of_a_loud_path_arrive_no_earlier():
    loud = came([BEHIND], [1e8])
    assert not loud.before(6.5)
    assert loud.before(8.0)


def test_a_line_of_sight_is_told_from_other_paths_by_its_direction():
    one = came([LOS], [3000.0])
    total = (np.abs(one.output) ** 2).sum(1)
    peak = np.array([int(np.argmax(total))])
    at, total, expected = one.step_m * peak, total[peak], np.array([[one.noise * 480.0]])
    right, wrong = (float(one.seen(at, share * total, expected)[0, 0]) for share in (0.99, 0.25))
    assert right > COST > 0 > wrong


def test_paths_of_the_step_before_are_old_within_a_step_of_their_lengths():
    model, draw = signal_model(), np.random.default_rng(3)
    before, now = (received(model, (x, 0), 0.4, [BEHIND], [9000.0], draw)[0] for x in (0.0, 0.1))
    got = Arrivals.of(now, Front(model.waveform), before)
    rows = np.flatnonzero(got.old) * got.step_m
    assert rows.min() < 6.5 < rows.max(), "5 m and 1.5 m more"
    assert np.ptp(rows) < 2 * OLD_M
    assert not Arrivals.of(now, Front(model.waveform)).old.any()


def test_a_line_of_sight_counts_as_one_wave_of_as_many_as_there_are_antennas_by_hand():
    output = np.sqrt(np.repeat([[0.0], [40.0], [0.0]], 4, 1)) + 0j
    got = Arrivals(output, 2.0, np.array([1.0, 0.0, 0.0]), 0.5, np.array([1]), np.zeros(3), np.ones(3, bool))
    at = np.array([0.5]), np.array([100.0]), np.array([[90.0]])
    found, later = got.seen(*at)[0, 0], got.seen(*at, comes=True)[0, 0]

    def density(power, count, cost=COST):  # of outputs in noise of 2, or with a path besides
        level = max(power / (2 * count), 1.0)
        return np.logaddexp(0, count * (level - 1 - np.log(level)) - cost) - power / 2 - count * np.log(2)

    wave = -np.log(20 + 90) - 100 / 110  # three others leave 60 of 160
    assert found == pytest.approx(wave + density(60, 3) - density(160, 4))
    # where a path was the step before, and no line of sight, one more costs nothing
    assert later == pytest.approx(wave + density(60, 3) - density(160, 4, cost=0.0))
    assert later < 0 < found
    new = replace(got, old=np.zeros(3, bool))
    assert new.seen(*at, comes=True)[0, 0] == found


def test_what_side_lobes_send_somewhere_is_no_wave_there_by_hand():
    output = np.sqrt(np.repeat([[0.0], [40.0], [0.0]], 4, 1)) + 0j
    got = Arrivals(
        output,
        2.0,
        np.array([1.0, 0.0, 0.0]),
        0.5,
        np.array([2]),
        np.array([0.0, 4.5, 0.0]),
        np.zeros(3, bool),
    )
    at = np.array([0.5]), np.array([155.0]), np.array([[90.0]])
    found, clear = (one.seen(*at)[0, 0] for one in (got, replace(got, lobes=np.zeros(3))))

    def density(power, count):  # in 2 of noise and 4 times 4.5 of lobes
        return np.logaddexp(0, count * _excess(power / (20 * count)) - COST) - power / 20 - count * np.log(20)

    wave = -np.log(20 + 90) - 155 / 110
    assert found == pytest.approx(wave + density(5, 3) - density(160, 4))
    assert found < clear - 10


def _excess(level):
    return level - 1 - np.log(level) if level > 1 else 0.0


@pytest.mark.slow
def test_hybrid_slam_stays_with_the_first_arrival_where_a_louder_one_follows_and_its_reference_does_not():
    model, draw = signal_model(spread=(0.5, 0.5, 0.1, 0.1)), np.random.default_rng(3)
    z = received(model, (0, 0), 0.4, [LOS, BEHIND], [3000.0, 9000.0], draw)
    scan = SignalScan(0, 0.0, z[:, None], AUDIBLE, 0.4)
    work = HybridWork(Front(model.waveform), 1)
    hybrid, reference = (
        np.hypot(*(model.anchors[0, :2] - advance(start(model), scan, model, work)[1].agent[:2]))
        for advance in (step, step_by_sight)
    )
    assert hybrid == pytest.approx(5.0, abs=0.3)
    assert reference > 5.4


def test_a_belief_that_is_contradicted_stays_so_while_no_line_of_sight_is_seen():
    model, draw = signal_model(), np.random.default_rng(4)
    front = Front(model.waveform)
    joint = JointBelief(
        np.zeros(4), 1e-4 * np.eye(4), FeatureBank.empty(), np.array([0.99]), np.ones(1), np.ones(1)
    )
    state = HybridState(joint, joint, Segment.empty(1, 4, 41))
    seen, hidden = (
        StepSamples(received(model, (0, 0), 0.4, points, [3000.0], draw), AUDIBLE, 0.4)
        for points in ([LOS], [BEHIND])
    )
    along, across = np.zeros((2, 4, 4))
    along[:2, :2], across[:2, :2] = np.outer([0.3, 0.4], [0.3, 0.4]), np.outer([0.4, -0.3], [0.4, -0.3])
    right, wrong, unsure, aside = (
        Moments(np.array([*place, 0.0, 0.0]), 1e-4 * np.eye(4) + spread, 0.0, np.inf)
        for place, spread in (
            ([0, 0], 0.0),
            ([-0.6, -0.8], 0.0),
            ([-0.6, -0.8], along),
            ([-0.6, -0.8], across),
        )
    )
    state = count_step(state, seen, right, front, model)
    assert state.early == 0.0
    assert count_step(state, seen, unsure, front, model).early == 0.0, "it may be as near as that"
    state = count_step(state, seen, aside, front, model)
    assert count_step(replace(state, early=0.0), seen, wrong, front, model).early == state.early
    assert state.early == pytest.approx(1 - KEEP)
    unseen = replace(state, joint=replace(joint, existence=np.array([0.01])))
    assert count_step(unseen, hidden, right, front, model).early == state.early
    assert count_step(state, seen, right, front, model).early == pytest.approx(KEEP * state.early)
    for share, well in ((EARLY, True), (EARLY + 0.01, False)):
        info = conclude(replace(state, early=share), right, Learned(), 0.4, {}, model)
        assert info.health.ok == well
