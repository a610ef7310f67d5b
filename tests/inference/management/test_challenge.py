"""Doubt about worlds that fit themselves: a fresh start's word against them, and challengers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.inference.beliefs.layout import HEADING, POSE
from gridslam.inference.health.doubt import (
    ASKED_EVIDENCE,
    DOUBT_STEPS,
    ELSEWHERE,
    LOW_LEAD,
    ONE_ALONE,
    Doubt,
)
from gridslam.inference.management import challenge
from gridslam.inference.management.branching import placed
from gridslam.inference.management.challenge import (
    EVERY,
    HANDICAP,
    TRIAL,
    WITHOUT_AMPLITUDE,
    Comparison,
    challenged,
    compare_poses,
    leading,
    loud_of,
    on_trial,
    pose_likelihood,
    watched,
)
from gridslam.inference.management.mixture import poses
from gridslam.inference.management.poses.pose_search import Modes
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.state.population import Population
from gridslam.simulation.image_source import simulate_labelled, true_paths
from gridslam.systems.grid import GridSlam, start
from gridslam.world.geometry import wrap
from gridslam.world.start import Start

NAMES = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")

SURE = np.diag([1e-4, 1e-4, 1e-4])
"""Covariance of a pose that is known to a centimetre and half a degree."""


@pytest.fixture(scope="module")
def scene():
    return shortened(gs.Scene.load("room"), 31).with_filter(particles=256)


@pytest.fixture(scope="module")
def scans(scene):
    return list(gs.simulate(scene, "agent1", seed=2))


@pytest.fixture(scope="module")
def mapped(scene, scans):
    """A filter after twenty steps, and its leads until then."""
    slam, leads = GridSlam(scene, seed=3), []
    for scan in scans[:20]:
        slam.step(scan)
        leads.append(slam.population.watch)
    return slam, leads


def moved(state, by, turn=0.0):
    """The state with its agent elsewhere, and sure of it."""
    pose = state.belief.mean[POSE] + np.array([*by, turn])
    return placed(state, pose, np.diag([1e-4, 1e-4, 1e-4]), 1e-4)


def test_the_best_pose_scores_about_what_the_true_pose_scores(scene, scans):
    slam, track = GridSlam(scene, seed=3), scene.track("agent1")
    for step in (0, 7, 19):
        likelihood = pose_likelihood(split_by_anchor(scans[step], slam.model), slam.state, slam.model)
        true = np.array([*track.position_m[step], track.heading_rad[step]])
        far = np.array([3.0, 2.5, 2.0])
        score = likelihood.score(np.stack([true, far]))
        best, there, _ = compare_poses(likelihood, far, SURE, np.random.default_rng(1))
        assert best - there > 30
        assert score[1] < score[0] - 30
        assert score[0] - 4 < best < score[0] + 20
        best, here, _ = compare_poses(likelihood, true, SURE, np.random.default_rng(1))
        assert here >= score[0]
        assert best - here < 1


def test_a_right_world_leads_a_fresh_start_and_is_well(mapped, scans):
    slam, leads = mapped
    split, believed = split_by_anchor(scans[19], slam.model), slam.state.belief.mean[POSE]
    best, here, _ = compare_poses(
        pose_likelihood(split, slam.state, slam.model), believed, SURE, np.random.default_rng(1)
    )
    assert slam.info.log_evidence > best + 1.5 * LOW_LEAD * loud_of(split, slam.model)
    assert best == here
    assert not any(watch.loud for watch in leads), "a fresh start where the agent is believed is no rival"
    assert slam.info.health.ok
    assert not slam.population.watch.doubtful


def test_a_right_world_without_amplitudes_is_well_and_a_wrong_one_is_not(scene):
    """Nothing is loud then: counted as loud, all of it would make the lead of a right map look low."""
    measurements = gs.simulate(scene, "agent1", seed=3)
    scans = list(replace(measurements, amplitude=np.full(len(measurements.step), np.nan)))
    slam, leads = GridSlam(scene, seed=3), []
    for scan in scans:
        slam.step(scan)
        leads.append(slam.population.watch)
    assert not any("fresh start" in reason for watch in leads for reason in watch.reasons())
    split = split_by_anchor(scans[20], slam.model)
    count = len(split.whole) - 2 * scene.radio.false_alarms
    assert loud_of(split, slam.model) == pytest.approx(WITHOUT_AMPLITUDE * count)
    wrong = leads[-1].compared(30.0, 29.0, 27.0, 0.0, loud_of(split, slam.model))
    assert "fresh start" in replace(wrong, lead=1.0 * wrong.loud).reasons()[0]


def test_a_world_that_a_fresh_start_explains_as_well_is_doubted_and_said_so(mapped, scans):
    slam, _ = mapped
    before = Doubt(lead=10.0 * LOW_LEAD, loud=10.0)
    population = replace(slam.population, watch=before)
    now = slam.state.step
    assert now % EVERY == 0
    scan, model = scans[now - 1], slam.model
    loud = sum(int(own.loud.sum()) for own in split_by_anchor(scan, model))
    wrong = replace(population, states=(moved(slam.state, (2.0, 1.0), 1.0),))
    good, right, bad = (
        watched(each, lambda worth=worth: float(worth * loud), scan, model, slam.work).watch
        for each, worth in ((wrong, 40.0), (population, 18.5), (wrong, 18.5))
    )
    assert not any("a fresh start" in reason for reason in good.reasons())
    assert not right.reasons(), "a fresh start at the believed place is no rival"
    assert right.doubtful == 0
    assert "a fresh start" in bad.reasons()[0]
    assert bad.doubtful == DOUBT_STEPS
    later = replace(slam.state, step=now + 1)
    bad = replace(bad, elsewhere=0.0, surplus=0.0)
    kept = watched(Population((later,), watch=bad), lambda: np.nan, scan, model, slam.work).watch
    assert kept.lead == bad.lead, "compared every few steps alone"
    assert kept.doubtful == DOUBT_STEPS - 1
    silent = replace(
        scan, **{n: getattr(scan, n)[:0] for n in ("anchor", "distance_m", "aod_rad", "aoa_rad")}
    )
    silent = replace(silent, amplitude=scan.amplitude[:0])
    assert watched(population, lambda: np.nan, silent, model, slam.work).watch == before


def test_a_place_that_few_loud_measurements_contradict_is_doubted(mapped, scans):
    """However well the map fits itself there; and not the right place."""
    slam, _ = mapped
    scan, leading = scans[19], 100.0 * LOW_LEAD
    wrong = moved(slam.state, (2.0, 1.0), 1.0)
    right, lost = (
        watched(Population((state,)), lambda: leading, scan, slam.model, slam.work).watch
        for state in (slam.state, wrong)
    )
    assert right.elsewhere == 0.0
    assert not right.reasons()
    assert "fits another place better" in lost.reasons()[0]
    assert lost.doubtful == DOUBT_STEPS
    only = np.flatnonzero(scan.amplitude == scan.amplitude.max())
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    single = replace(scan, **{name: getattr(scan, name)[only] for name in names})
    one = watched(Population((wrong,)), lambda: leading, single, slam.model, slam.work).watch
    assert one.elsewhere < lost.elsewhere - ONE_ALONE, "one measurement says less than all"
    assert not Doubt(elsewhere=ELSEWHERE).reasons()


@pytest.mark.slow
def test_an_agent_that_is_surely_elsewhere_is_challenged_and_found(mapped, scene, scans):
    """Two metres off and sure: one scan lists the true place, as a restart and with the map that there is."""
    slam, _ = mapped
    track, model = scene.track("agent1"), slam.model
    wrong = moved(slam.state, (2.0, 1.0), 1.0)
    lost = Population((wrong,), watch=Doubt(doubtful=DOUBT_STEPS))
    assert challenged(replace(lost, watch=Doubt()), scans[20], start(model), model, slam.work).states == (
        wrong,
    )
    several = challenged(lost, scans[20], start(model), model, slam.work)
    assert several.states[0] is wrong, "challengers begin with a handicap"
    assert all(state.monitor.leap_m > 1.5 for state in several.states[1:]), "no motion leads there"
    here = np.linalg.norm(poses(several)[1:, :2] - track.position_m[20], axis=1)
    sizes = [len(state.surfaces) for state, off in zip(several.states[1:], here, strict=True) if off < 0.3]
    assert sorted(sizes) == [0, len(wrong.surfaces)]
    held = replace(lost.best, turn_variance=0.01, turn_anchor=1, sight_nats=np.array([2.0, 0.0]))
    about = challenged(replace(lost, states=(held,)), scans[20], start(model), model, slam.work).states
    assert len(about) > 1
    assert {one.turn_anchor for one in about} == {1}, "about the anchor that is held"
    assert all(one.sight_nats is held.sight_nats for one in about)
    right = challenged(replace(lost, states=(slam.state,)), scans[19], start(model), model, slam.work)
    near = np.linalg.norm(poses(right)[:, :2] - track.position_m[19], axis=1)
    assert np.count_nonzero(near < 0.3) == 1, "what is believed already is no challenge"
    after = GridSlam(scene, seed=3)
    after.now = slam.now._replace(believed=several)
    for scan in scans[20:]:
        after.step(scan)
    off = np.linalg.norm(after.state.belief.mean[:2] - track.position_m[30])
    assert off < 0.15
    assert len(after.state.surfaces) >= 4


def test_an_agent_is_challenged_where_its_motion_leads_not_where_it_was(mapped, scene, scans):
    """One that goes 0.8 m a step: where a scan finds it is no other place than the believed one."""
    slam, _ = mapped
    track, way = scene.track("agent1"), np.array([0.8, 0.0])
    true = np.array([*track.position_m[20], track.heading_rad[20]])
    before = moved(slam.state, true[:2] - way - slam.state.belief.mean[:2])
    before.belief.mean[HEADING] = true[2]
    before.belief.mean[2:4] = way / (scans[20].time_s - before.time_s)
    doubted = Population((before,), watch=Doubt(doubtful=DOUBT_STEPS, unproven=True))
    several = challenged(doubted, scans[20], start(slam.model), slam.model, slam.work)
    assert not several.watch.unproven  # nothing fits elsewhere
    assert (np.linalg.norm(poses(several)[1:, :2] - true[:2], axis=1) > 0.5).all()
    standing = moved(slam.state, true[:2] - way - slam.state.belief.mean[:2])
    standing = replace(doubted, states=(standing,))
    several = challenged(standing, scans[20], start(slam.model), slam.model, slam.work)
    assert (np.linalg.norm(poses(several)[1:, :2] - true[:2], axis=1) < 0.3).any()


def test_places_on_trial_fall_no_further_behind_than_they_began(mapped):
    state = mapped[0].state
    tried = replace(state, monitor=replace(state.monitor, trial=1))
    log = on_trial(np.array([-3.0, -50.0, -4.0, -60.0]), [state, tried, tried, state])
    assert log.tolist() == [-3.0, -3.0 - HANDICAP, -4.0, -60.0]
    assert tried.monitor.next_step(5).trial == 0 == state.monitor.next_step(5).trial
    called = Population((moved(state, (2.0, 1.0), 1.0),), watch=Doubt(doubtful=DOUBT_STEPS))
    for watch, steps in [(called.watch, 0), (replace(called.watch, elsewhere=ELSEWHERE + 1), TRIAL)]:
        model, work = mapped[0].model, mapped[0].work
        scan = next(iter(gs.simulate(shortened(gs.Scene.load("room"), 31), "agent1", seed=2)))
        several = challenged(replace(called, watch=watch), scan, start(model), model, work)
        assert len(several) > 1
        assert {one.monitor.trial for one in several.states[1:]} == {steps}


@pytest.mark.slow
def test_a_world_that_was_mapped_from_a_wrong_place_is_left_once_lines_of_sight_are_heard():
    """Told starts 3.5 m wrong in `pillars`, two ways, and heard no line of sight for 25 steps."""
    scene = shortened(gs.Scene.load("pillars"), 42)
    radio = scene.radio.model_copy(update={"snr_at_1m_db": 40.0})
    scene = scene.model_copy(update={"radio": radio})
    track = scene.track("agent1")
    for seed in (0, 2):
        heard, label = simulate_labelled(scene, "agent1", seed)
        straight = (label >= 0) & (true_paths(scene, "agent1").bounces[label] == 0) & (heard.step < 25)
        told = {name: getattr(heard, name)[~straight] for name in ("step", "time_s", *NAMES)}
        way = 3.5 * np.array([np.cos(seed * np.pi / 4), np.sin(seed * np.pi / 4)])
        begins = Start(track.position_m[0] + way, float(track.heading_rad[0]))
        run = gs.map_scene(scene, replace(heard, **told), seed=seed, start=begins)
        off = np.linalg.norm(run.trajectory.position_m[38:] - track.position_m[38:], axis=1)
        assert off.max() < 0.3, seed


def test_a_list_that_lacks_places_challenges_only_what_is_called_wrong(mapped):
    """And by all places that no single measurement stands for, where a complete one names three."""
    score = np.array([40.0, 39.0, 38.0, 37.0, ONE_ALONE - 1, -5.0])
    modes = Modes(np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1)), np.zeros(6), score, complete=False)
    likelihood = SimpleNamespace(score=lambda poses: np.zeros(len(poses)))
    led = [mapped[0].state.belief]
    assert not len(leading(modes, likelihood, led, Doubt()))
    assert (
        leading(modes, likelihood, led, Doubt(elsewhere=ELSEWHERE + 1)).score.tolist() == score[:4].tolist()
    )
    whole = replace(modes, complete=True)
    assert leading(whole, likelihood, led, Doubt()).score.tolist() == score[:3].tolist()


def test_an_agent_out_of_sight_is_found_by_the_map_where_a_scan_alone_fits_too_many_places(mapped, scene):
    """Single bounces alone, two metres off: a start anew may be anywhere, known walls tell where it is."""
    slam, _ = mapped
    step, model, track = 20, slam.model, scene.track("agent1")
    measurements, label = simulate_labelled(scene, "agent1", seed=2)
    scan, label = measurements.scan(step), label[measurements.step == step]
    once = (label >= 0) & (true_paths(scene, "agent1").bounces[label] == 1)
    scan = replace(scan, **{name: getattr(scan, name)[once] for name in NAMES})
    wrong = replace(moved(slam.state, (2.0, 1.0), 1.0), step=step + 3)
    doubtful = Population((wrong,), watch=Doubt(doubtful=DOUBT_STEPS))
    assert challenged(doubtful, scan, start(model), model, slam.work) is doubtful, "every so often"
    lost = replace(doubtful, watch=replace(doubtful.watch, raised=True))
    first, there = challenged(lost, scan, start(model), model, slam.work).states
    assert first is wrong
    assert np.linalg.norm(there.belief.mean[:2] - track.position_m[step]) < 0.1
    assert len(there.surfaces) == len(slam.state.surfaces), "its map is the one that there was"
    close = replace(lost, states=(replace(moved(slam.state, (0.02, 0.0)), step=step),))
    assert challenged(close, scan, start(model), model, slam.work) == close, "better, and no other place"


def test_a_step_that_is_hardly_explained_is_compared_at_once(mapped, scans):
    slam, _ = mapped
    scan, model, work = scans[slam.state.step - 1], slam.model, slam.work
    loud = loud_of(split_by_anchor(scan, model), model)
    right = replace(slam.state, step=EVERY * 2 + 3)
    wrong = moved(right, (2.0, 1.0), 1.0)
    for state, worth, said in ((wrong, 1.1, False), (wrong, 0.9, True), (right, 0.9, False)):
        evidence = worth * ASKED_EVIDENCE * loud
        watch = watched(Population((state,)), lambda evidence=evidence: evidence, scan, model, work).watch
        assert bool(watch.reasons()) is watch.raised is said
        assert (watch.lead, watch.loud) == (0.0, 0.0), "of wrong steps alone it would say too little"


@pytest.mark.parametrize("mirrored", [True, False])
def test_what_one_mirror_shows_of_two_anchors_is_told_from_lines_of_sight(mapped, mirrored):
    """Without amplitudes, from a place in line with both: as the mirror shows it, or with another heading."""
    slam, _ = mapped
    far, near = slam.model.places[0, :2], slam.model.places[1, :2]
    image = near + 3.0 * (near - far) / np.hypot(*(near - far))
    believed = np.array([1.5, -1.0, 0.5])
    wall = np.arctan2(*(image - believed[:2])[::-1])
    toward = slam.model.places[:2, :2] - image
    back, distance = np.arctan2(*toward.T[::-1]), np.hypot(*toward.T)
    heading = 2 * back[0] + believed[2] - 2 * wall - np.pi + (0.0 if mirrored else 1.5)
    leaving = wrap(back + np.pi - slam.model.places[:2, 2])
    heard = gs.Scan(40, 40.0, np.arange(2), distance, leaving, wrap(back - heading), np.full(2, np.nan))
    likelihood = pose_likelihood(split_by_anchor(heard, slam.model), slam.state, slam.model)
    best, here, added = compare_poses(likelihood, believed, SURE, np.random.default_rng(1))
    assert best - here > 18
    assert (added > 8) == mirrored
    assert bool(Doubt().compared(1e3, best, here, added, 2.0).elsewhere) != mirrored


@pytest.mark.parametrize(
    ("step", "deaf", "called"), [(EVERY, True, True), (9 * EVERY, True, False), (EVERY, False, False)]
)
def test_without_arrivals_no_mirror_excuses_a_start(mapped, scans, monkeypatch, step, deaf, called):
    """Told wrong, it fits over one mirror that shows all anchors; so may a hidden agent, later."""
    slam, _ = mapped
    scan = scans[slam.state.step - 1]
    if deaf:
        scan = replace(scan, aoa_rad=np.full(len(scan), np.nan))
    monkeypatch.setattr(challenge, "compare_poses", lambda *_: Comparison(90.0, 50.0, 30.0))
    population = Population((replace(slam.state, step=step),))
    watch = watched(population, lambda: 1e3, scan, slam.model, slam.work).watch
    assert (watch.elsewhere > ELSEWHERE) is called
    slam.work.begin()


def test_a_start_is_compared_at_every_step_until_it_is_borne_out(mapped, scans):
    slam, _ = mapped
    scan, model, work = scans[slam.state.step - 1], slam.model, slam.work
    state = replace(slam.state, step=EVERY * 2 + 3)
    for unproven, worth, reported in ((True, 1e4, False), (True, 0.0, True), (False, np.nan, False)):
        before = Population((state,), watch=Doubt(unproven=unproven))
        after = watched(before, lambda worth=worth: worth, scan, model, work).watch
        assert after.unproven is reported
        assert (after.borne > 0) is (worth == 1e4)
        assert (after.sighted > 0) is unproven, "its lines of sight are as loud as they should be"
        assert after.lead == 0.0, "the lead is taken every few steps"


def test_a_start_is_borne_out_by_a_scan_that_fits_nowhere_else(mapped, scans):
    slam, _ = mapped
    doubt = Doubt(unproven=True, doubtful=DOUBT_STEPS)
    right, scan = replace(slam.state, step=EVERY), scans[slam.state.step - 1]
    for state, reported in ((right, False), (moved(right, (2.0, 1.0), 1.0), True)):
        population = Population((state,), watch=doubt)
        after = challenged(population, scan, start(slam.model), slam.model, slam.work)
        assert after.watch.unproven is reported
