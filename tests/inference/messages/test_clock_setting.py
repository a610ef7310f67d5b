"""Open clocks: histograms choose the mode that all agents' paths agree on, and only when they are sure."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal, norm

import gridslam as gs
from gridslam.inference.messages.network.clock_amplitudes import amplitude_ratio
from gridslam.inference.messages.network.clock_candidates import joint_density
from gridslam.inference.messages.network.clock_evidence import agent_evidence, clock_evidence
from gridslam.inference.messages.network.clock_setting import (
    astray,
    challenge_clocks,
    evidence_of,
    set_clocks,
    witnessed_surfaces,
)
from gridslam.inference.state.network.clock_search import CELL_M, ELSEWHERE, NEVER, ClockSearch
from gridslam.systems.network import NetworkSlam, without_turns
from gridslam.world.clocks import ClockModel
from gridslam.world.radio import BINS
from gridslam.world.scan import Scan

CLOCKS = ClockModel(2, 1, np.array([30.0, 0.0, 0.0]), walk_m=0.03)
LITTLE = np.array([[0.01]])
"""Density of clutter."""
CENTRE = ClockSearch.start(CLOCKS).centre


def test_evidence_of_one_path_and_one_measurement_is_the_textbook_ratio():
    draw = np.random.default_rng(1)
    root = draw.normal(size=(3, 3)) * [[0.5], [0.1], [0.1]]
    value, spread, noise = np.array([8.0, 0.3, -2.9]), root @ root.T, np.array([0.2, 0.05, 0.08])
    measured, chance, clutter = np.array([[4.7, 0.35, 3.1]]), np.array([0.7]), 5 / 130 / (4 * np.pi**2)
    others = np.array([[clutter]])
    found = clock_evidence(value[None], spread[None], chance, measured, noise[None, None], others, CENTRE)[0]
    whole = spread + np.diag(noise**2 + np.array([0.1**2 / 12, 0, 0]))
    residual = [(measured[0] - value)[0], 0.05, 3.1 + 2.9 - 2 * np.pi]
    density = [multivariate_normal.pdf(residual - np.array([b, 0, 0]), cov=whole) for b in CENTRE]
    np.testing.assert_allclose(found, np.log(0.3 + 0.7 * np.array(density) / clutter), rtol=1e-9)


def test_an_angle_that_was_not_measured_says_nothing():
    value, spread = np.array([[8.0, 0.3, -2.9]]), np.diag([0.04, 0.01, 0.01])[None]
    std, chance = np.full((1, 1, 3), 0.1), np.array([0.7])
    found = clock_evidence(
        value, spread, chance, np.array([[4.7, np.nan, -2.8]]), std, np.array([[0.01]]), CENTRE
    )
    by_hand = norm.pdf(-3.3 - CENTRE, 0, np.sqrt(0.05 + 0.1**2 / 12)) * norm.pdf(0.1, 0, np.sqrt(0.02))
    np.testing.assert_allclose(found[0], np.log(0.3 + 0.7 * by_hand / (2 * np.pi) / 0.01), rtol=1e-9)
    nothing = clock_evidence(
        value, spread, chance, np.array([[np.nan, 0.3, -2.9]]), std, np.array([[0.01]]), CENTRE
    )
    np.testing.assert_allclose(nothing, np.log(0.3))


def test_density_of_a_measurement_is_the_textbook_normal():
    draw = np.random.default_rng(2)
    root = draw.normal(size=(3, 3)) * [[0.5], [0.1], [0.1]]
    value, spread, noise = np.array([8.0, 0.3, -2.9]), root @ root.T, np.array([0.2, 0.05, 0.08])
    measured = np.array([[8.4, 0.35, 3.2], [np.nan, 0.3, -2.9], [8.4, np.nan, np.nan]])
    found = joint_density(value[None], spread[None], measured, np.tile(noise, (1, 3, 1)))[0]
    whole = spread + np.diag(noise**2)
    off = np.array([0.4, 0.05, 3.2 + 2.9 - 2 * np.pi])
    alone = norm.pdf(0.4, 0, np.sqrt(whole[0, 0])) / (4 * np.pi**2)
    np.testing.assert_allclose(found, [multivariate_normal.pdf(off, cov=whole), 0, alone], rtol=1e-9)


def test_what_another_anchor_may_have_caused_says_less(annex):
    """A measurement of anchor 0's line of sight, where anchor 1's could have any offset."""
    slam, scan = annex
    state, model, work = slam.state, slam.model, slam.work[0]
    work.begin()
    centre, count = state.clocks.centre, len(slam.model.anchors)
    sought, known = np.arange(count) == 1, np.arange(count) == 0
    part, every = state.part(0), np.zeros(0, bool)
    both = [
        agent_evidence(part, part, sought, claims, every, centre, scan, model.agents[0], work)
        for claims in (known, np.zeros(count, bool))
    ]
    assert both[0][1].max() < both[1][1].max() - 2
    assert not both[0][[0, 2]].any()
    labelled = replace(scan, anchor=np.array([1]))  # nobody else's
    same = [
        agent_evidence(part, part, sought, claims, every, centre, labelled, model.agents[0], work)
        for claims in (known, np.zeros(count, bool))
    ]
    np.testing.assert_array_equal(*same)


def test_a_surface_that_one_link_alone_heard_tells_of_no_clock_without_labels(annex):
    """Where labels are missing, it may be the searched anchor's own path, taken for another's."""
    slam, scan = annex
    state, model, work = slam.state, slam.model, slam.work
    mean, spread = np.append(state.belief.mean, [0.0, 7.0]), state.belief.covariance
    belief = replace(state.belief, mean=mean, covariance=block_diag(spread, 1e-4 * np.eye(2)))
    bank = state.surfaces.add(1, 0.99, np.full(BINS, 1 / BINS), 0.0, (0, -1, -1))
    one = replace(state, belief=belief, surfaces=bank, labelled=False)
    two = replace(one, surfaces=replace(bank, single=np.maximum(bank.single, 0.98)))
    assert not witnessed_surfaces(one)[0]
    assert witnessed_surfaces(two)[0]
    assert witnessed_surfaces(replace(one, labelled=True))[0]

    anchor, agent = model.agents[0].anchor_positions[1], state.belief.mean[:2]
    image = np.array([14 - anchor[0], anchor[1]])
    hit = agent + (image - agent) * (7 - agent[0]) / (image[0] - agent[0])
    departing, arriving = (np.arctan2(*(hit - end)[::-1]) for end in (anchor, agent))
    length = np.array([np.hypot(*(image - agent))])
    aod, aoa = departing - model.agents[0].anchor_orientations[1], arriving - state.belief.mean[4]
    bounce = replace(scan, distance_m=length, aod_rad=np.array([aod]), aoa_rad=np.array([aoa]))

    def peak(state):
        work[0].begin()
        sought = np.arange(len(model.anchor_names)) == 1
        evidence = evidence_of(state, sought, [bounce], model, works=work)[1]
        return evidence.max() - np.median(evidence)

    assert peak(one) < 0.1
    assert peak(two) > 1


@pytest.fixture(scope="module")
def annex():
    """Network SLAM before its first step, and a measurement: anchor 0's line of sight and 1's."""
    whole = gs.Scene.load("annex").model_dump(exclude_none=True)
    whole["anchors"][1]["position_m"] = whole["anchors"][0]["position_m"]
    whole["anchors"][1]["orientation_deg"] = whole["anchors"][0]["orientation_deg"]
    whole["filter"] |= {"particles": 100}
    scene = gs.Scene.checked(whole, "test")
    slam = NetworkSlam(scene, agents=["agent1"], seed=1)
    off = scene.anchor_positions[0] - scene.track("agent1").position_m[0]
    aod = np.arctan2(*-off[::-1]) - scene.anchor_orientations[0]
    length = float(np.hypot(*off))
    scan = Scan(
        0, 0.0, np.array([-1]), np.array([length]), np.array([aod]), np.array([np.arctan2(*off[::-1])]),
        scene.signal_model("agent1").amplitude(np.array([length])),
    )  # fmt: skip
    return slam, scan


def test_an_amplitude_far_off_a_path_counts_against_it_but_rules_nothing_out():
    radio = gs.Scene.load("exchange").signal_model("agent1")
    ratio = amplitude_ratio(np.array([10.0, 2.15, 5.0, np.nan]), np.array([10.0, 1e-3]), radio)
    # sigma_u^2 = 0.5 + 100 / (4 * samples), and 1.2 for the dB: 0.02 + 0.98 * 20 / sqrt(2 pi s^2)
    scale = np.sqrt(0.5 + 25 / radio.samples + 1.44)
    assert ratio[0, 0] == pytest.approx(0.02 + 0.98 * 20 / np.sqrt(2 * np.pi) / scale)
    np.testing.assert_allclose(ratio[0, 1:3], 0.02, atol=0.01)
    assert (ratio[:, 3] == 1).all()
    # a path of unknown strength: the mean over amplitudes that are as likely as each other is 1
    grid = np.linspace(0, 20, 4001)
    assert amplitude_ratio(grid, np.array([10.0]), radio).mean() == pytest.approx(1, abs=0.01)


def test_a_clock_is_set_once_its_rivals_are_gone():
    search = replace(ClockSearch.start(CLOCKS), since=np.array([5, 0]))  # beyond the first steps
    assert search.unset.tolist() == [True, False]
    peaks = -0.5 * ((CENTRE - 7.3) / 0.2) ** 2, -0.5 * ((CENTRE + 12) / 0.2) ** 2 - 3.0
    both = np.tile(np.logaddexp(*peaks), (2, 1))
    search = search.updated(both)
    assert search.decided() == []  # the rival still has 5 %
    mean, variance = search.moments(0)
    assert -12 < mean < 7.3
    assert variance > 10
    search = search.updated(both)
    assert search.decided() == []  # 0.25 %
    search = search.updated(both)
    ((anchor, offset),) = search.decided()
    assert anchor == 0
    assert offset == pytest.approx(7.3, abs=0.02)
    assert not search.closed(0).unset.any()


def gaussian(centre, std, level):
    """Log evidence of one offset, over a flat rest with so much of the mass."""
    peak = norm.pdf(CENTRE, centre, std)
    flat = level / (1 - level) * 10 / len(CENTRE)  # of 10 a metre, as the peak's
    return np.tile(np.log(peak + flat), (2, 1))


def test_one_mode_as_wide_as_the_pose_is_decided_and_two_are_not():
    fresh = ClockSearch.start(CLOCKS)
    ((anchor, offset),) = fresh.updated(gaussian(7.3, 0.5, 1e-5)).decided()
    assert (anchor, round(offset, 1)) == (0, 7.3)
    assert fresh.updated(gaussian(7.3, 0.9, 1e-5)).decided() == []
    two = np.logaddexp(*(gaussian(7.3 + side, 0.2, 1e-9) for side in (-1, 1)))
    assert fresh.updated(two).decided() == []


def test_a_doubtful_mode_is_decided_at_no_step():
    search = ClockSearch.start(CLOCKS)
    doubtful = search.updated(gaussian(7.3, 0.5, 5e-3))
    assert doubtful.decided() == []  # the first steps have it as a hypothesis
    assert replace(doubtful, since=np.array([4, 0])).decided() == []


def test_walks_blur_and_nothing_leaves_the_prior():
    search = ClockSearch.start(CLOCKS).updated(np.tile(-0.5 * ((CENTRE - 5.0) / 0.3) ** 2, (2, 1)))
    before = search.moments(0)[1]
    after = search.walked(0.25)
    assert after.moments(0)[1] - before == pytest.approx(0.25, rel=0.02)
    assert after.mass[0].sum() == pytest.approx(1)
    assert after.mass[1].max() == 1  # the other anchor's prior is a point


def test_where_a_clock_walked_to_says_where_it_was():
    search = ClockSearch.start(CLOCKS)
    cells, last = np.zeros(len(CENTRE), bool), len(CENTRE) - 1
    cells[[5, last]] = True
    log = search.within(0, cells, 0.2 * CELL_M**2).log[0]  # a tenth of the mass goes to each neighbour
    np.testing.assert_allclose(np.exp(log[3:8]) * 0.9, [0, 0.1, 0.8, 0.1, 0], atol=1e-12)
    np.testing.assert_allclose(np.exp(log[-3:]) * 0.9, [0, 0.1, 0.9], atol=1e-12)
    np.testing.assert_allclose(log[8:-2], np.log(ELSEWHERE / 0.9))  # what bore the mode may be clutter
    np.testing.assert_array_equal(search.within(1, cells).log[1] > NEVER, search.log[1] > NEVER)
    cells[:] = np.abs(CENTRE) < 5.0
    wide = search.within(0, cells, 1.0)
    assert wide.mass[0][np.abs(CENTRE - 5.0) < 0.1].max() == pytest.approx(0.5 * wide.mass[0].max(), rel=0.05)
    np.testing.assert_array_equal(wide.log[1], search.log[1])


def test_a_mode_that_was_followed_is_sure_and_yet_can_be_left_for_another():
    search = ClockSearch.start(CLOCKS)
    near, there = np.abs(CENTRE - 7.3) < 1, np.abs(CENTRE + 12) < 0.5
    followed = replace(search.within(0, near), since=np.array([1, 0]))
    assert [anchor for anchor, _ in followed.decided(rivals=True)] == [0]
    against = np.where(there, 20.0, 0.0)  # nats of one step: what bore the mode was clutter
    once = followed.updated(np.stack([against, against]))
    assert once.mass[0, near].sum() > 0.99
    assert once.updated(np.stack([against, against])).mass[0, there].sum() > 0.99


def test_an_opened_clock_knows_nothing():
    search = ClockSearch.start(CLOCKS).updated(np.tile(-(CENTRE**2), (2, 1))).closed(0).opened(0, CLOCKS)
    assert search.unset[0]
    np.testing.assert_allclose(search.mass[0], 1 / len(CENTRE))


def test_a_set_clock_is_opened_again_by_what_stands_for_another_offset():
    closed, none = np.array([True, False]), np.zeros((2, len(CENTRE)))
    search = ClockSearch.start(CLOCKS).closed(0)
    mean, deviation = np.array([7.3, 0.0]), np.array([0.1, 0.0])
    peak = np.exp(-0.5 * ((CENTRE + 12) / 0.2) ** 2)
    opened, sums = [], search
    for _ in range(4):  # 6, then 6 + 0.7 * 6, ... = 6, 10.2, 13.1, 15.2 nats
        sums = sums.challenged(closed, none + 6 * peak, mean, deviation)
        opened.append(bool(sums.unset.any()))
    assert opened == [False, False, False, True]
    assert abs(sums.moments(0)[0] + 12) < 0.1
    for weak in (
        4 * peak,
        9 * np.exp(-0.5 * ((CENTRE - 7.0) / 0.2) ** 2),
    ):  # at most 13.3 nats; its own offset
        held = search
        for _ in range(50):
            held = held.challenged(closed, none + weak, mean, deviation)
        assert not held.unset.any()
    gone = search.challenged(closed, none + 40 * peak, np.array([45.0, 0.0]), deviation)
    assert not gone.unset.any()  # out of the prior's reach: not looked for


def test_an_offset_is_astray_beyond_its_prior_by_more_than_belief_and_walk_leave_room_for():
    """By hand: 4 sqrt(0.4^2 + 100 * 0.03^2) = 2.0 m; with drifts of 0.01 m/s, 4 sqrt(0.25 + 1) = 4.47 m."""
    mean, half, deviation = np.array([31.9, 32.1, -32.1]), np.full(3, 30.0), np.full(3, 0.4)
    assert astray(half, mean, deviation, 100.0, CLOCKS).tolist() == [False, True, True]
    drifts = replace(CLOCKS, drift_m=0.01)
    assert astray(half, mean + 2.4 * np.sign(mean), deviation, 100.0, drifts).tolist() == [False, True, True]
    assert not astray(half, 1e6 * mean, deviation, np.inf, CLOCKS).any()  # when it began isn't known


def test_a_clock_that_left_its_prior_is_opened_again():
    scene = gs.Scene.load("exchange").with_filter(particles=300, adapt_particles=False)
    slam = NetworkSlam(scene, seed=1, agents=["agent1"])
    scans = list(gs.simulate(scene, ["agent1"], seed=1))[:1]
    slam.step(scans[0])
    state, half = slam.state, ClockSearch.start(slam.model.clocks).half_widths
    first = int(state.belief.layout.devices[0])
    for offset, opened in ((half[0] + 1.0, True), (half[0] - 1.0, False)):
        belief = state.belief.independent(first, float(offset), 0.01)
        known = replace(state, belief=belief, clocks=state.clocks.closed(0))
        after = challenge_clocks(known, [None], slam.model, works=slam.work)
        assert bool(after.clocks.unset[0]) == opened


def all_turned(slam):
    """A slam's state in which departures have said of all anchors that they are turned by 0.1 rad."""
    record = slam.state.records[0]
    weight = np.full_like(record.calibration.turn_weight, 1e4)
    calibration = replace(record.calibration, turn=0.1 * weight, turn_weight=weight)
    assert np.allclose(calibration.turned, 0.1)
    return replace(slam.state, records=(replace(record, calibration=calibration),))


@pytest.mark.parametrize("agent_prior_ns", [1.0, 50.0])
def test_anchors_are_not_taken_to_be_turned_while_their_clocks_are_open(agent_prior_ns):
    """Nor any other, where the agent's own clock hangs on an open one."""
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    whole["filter"]["particles"], whole["clocks"]["agent_prior_ns"] = 100, agent_prior_ns
    slam = NetworkSlam(gs.Scene.checked(whole, "test"), seed=1, agents=["agent1"])
    state = all_turned(slam)
    unset, rows = state.clocks.unset.copy(), state.clocks.rows(state.clocks.frame_of(0))
    unset[rows] = [False, True, False, False]
    part = without_turns(replace(state, clocks=replace(state.clocks, unset=unset)), 0)
    kept = [agent_prior_ns < 2] * 4
    kept[1] = False
    assert part.calibration.turned.astype(bool).tolist() == kept
    unset[rows] = False
    part = without_turns(replace(state, clocks=replace(state.clocks, unset=unset)), 0)
    assert part.calibration is state.records[0].calibration


def test_what_a_turn_was_learned_by_goes_with_the_clock_that_is_set_anew():
    scene = gs.Scene.load("exchange").with_filter(particles=100, adapt_particles=False)
    slam = NetworkSlam(scene, seed=1, agents=["agent1"])
    state, log = all_turned(slam), slam.state.clocks.log.copy()
    log[1] = np.where(np.abs(state.clocks.centre) < 0.3, 0.0, NEVER)
    state = replace(state, clocks=replace(state.clocks, log=log))
    after = set_clocks(state, [None], slam.model, works=slam.work)
    assert after.clocks.unset.tolist() == [True, False, True, True]
    assert after.records[0].calibration.turned.astype(bool).tolist() == [True, False, True, True]
