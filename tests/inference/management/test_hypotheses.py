"""Steps of several hypotheses: vague starts, rival places, checkpoints, and what users are told of them."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam.bench.growth import drawn
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.health.doubt import places
from gridslam.inference.health.reasons import NOT_FOUND, TURNABLE, UNPROVEN
from gridslam.inference.management import hypotheses, mixture
from gridslam.inference.management.branching import placed
from gridslam.inference.management.hypotheses import PARTICLES, _split, _started, begun, each_stepped
from gridslam.inference.management.poses.pose_search import Modes
from gridslam.inference.state.population import Population
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.grid import GridSlam
from gridslam.world.start import assumed_start


@pytest.fixture(scope="module")
def scene():
    return shortened(gs.Scene.load("room"), 10).with_filter(particles=256)


@pytest.fixture(scope="module")
def scans(scene):
    return list(gs.simulate(scene, "agent1", seed=2))


def vague(scene, position_m=8.0, heading_deg=180.0):
    """The scene with a start that is known to some metres."""
    agent = scene.agents[0]
    prior = agent.prior.model_copy(update={"position_m": position_m, "heading_deg": heading_deg})
    return scene.model_copy(update={"agents": (agent.model_copy(update={"prior": prior}),)})


@pytest.mark.parametrize("system", [GridSlam, AdaptiveSlam])
def test_one_hypothesis_is_stepped_as_if_there_were_no_others(system, scene, scans):
    slam = system(scene, seed=3)
    state = slam.state
    for scan in scans:
        estimate = slam.step(scan)
        state, _ = system.advance(state, scan, slam.model, slam.work)
        np.testing.assert_array_equal(estimate.position_m, state.belief.mean[:2])
        np.testing.assert_array_equal(estimate.covariance, state.belief.covariance[:5, :5])
        assert estimate.hypotheses.weight.tolist() == [1.0]
    assert len(slam.state.surfaces)


@pytest.mark.slow
@pytest.mark.parametrize("system", [GridSlam, AdaptiveSlam])
def test_twenty_hypotheses_go_on_as_each_does_alone(system, scene, scans):
    slam, other = system(scene, seed=3), system(scene, seed=3)
    for scan in scans[:2]:
        slam.step(scan)
    among, calibrations = drawn(slam.state, 20), []
    alone = among.states
    for scan in scans[2:4]:
        calibrations.append(among.best.calibration)
        states, _ = each_stepped(among, scan, slam.model, slam.work, slam.advance)
        among = replace(among, states=tuple(states))
    other.work.particles.limit = PARTICLES
    for state, together in zip(alone, among.states, strict=True):
        for scan, calibration in zip(scans[2:4], calibrations, strict=True):
            shared = replace(state, calibration=calibration)
            state, _ = system.advance(shared, scan, other.model, other.work)
        np.testing.assert_array_equal(together.belief.mean, state.belief.mean)
        np.testing.assert_array_equal(together.belief.covariance, state.belief.covariance)
        if state.grid:
            np.testing.assert_array_equal(together.grid.evidence, state.grid.evidence)
            np.testing.assert_array_equal(together.grid.hit, state.grid.hit)
    assert len({state.belief.mean.tobytes() for state in among.states}) == 20


@pytest.mark.slow
def test_a_start_that_is_known_to_nothing_is_found_at_the_first_scan_that_tells(scene, scans):
    """It is 5 m and half a turn from what the filter is told; nothing is mapped before it is found."""
    slam = GridSlam(vague(scene), seed=3)
    track = scene.track("agent1")
    slam.start_at(track.position_m[0] + [4.0, 3.0], track.heading_rad[0] + 3.0)
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    silent = replace(scans[0], **{name: getattr(scans[0], name)[:0] for name in names})
    estimate = slam.step(silent)
    assert not estimate.health.ok
    assert NOT_FOUND in estimate.health.why
    assert estimate.health.silent_steps == 1
    assert np.sqrt(np.trace(estimate.covariance[:2, :2])) > 4
    assert not len(estimate.surfaces)
    for step, scan in enumerate(scans[1:], 1):
        estimate = slam.step(scan)
        off = np.linalg.norm(estimate.position_m - track.position_m[step])
        assert off < 0.3
        assert off < 4 * np.sqrt(np.trace(estimate.covariance[:2, :2]))
    assert estimate.health.ok
    assert len(slam.population) == 1
    assert len(estimate.surfaces)


def branched(scene, scans):
    """A filter of two hypotheses, one of them a metre off."""
    slam = GridSlam(scene, seed=3)
    for scan in scans[:3]:
        slam.step(scan)
    state = slam.state
    pose = state.belief.mean[[0, 1, 4]]
    away = placed(state, pose + np.array([1.0, 0.0, 0.0]), 0.01 * np.eye(3), 0.01)
    both = Population((state, away), (np.log(0.5),) * 2, guard=1, since=0)
    slam.now = slam.now._replace(believed=both)
    return slam


def test_the_parent_of_a_branching_is_known_when_others_are_split(scene, scans):
    slam = branched(scene, scans)
    here, parent = slam.state, slam.population.states[1]
    wide = placed(here, here.belief.mean[[0, 1, 4]], np.diag([0.9, 0.2, 0.01]) ** 2, 0.01)
    whole = _split(Population((wide, parent), (np.log(0.5),) * 2, guard=1, since=0), scans[3], slam.model)
    assert len(whole) > 3
    assert whole.states[whole.guard] is parent


@pytest.mark.slow
def test_two_places_are_told_and_evidence_decides_between_them(scene, scans):
    slam, track = branched(scene, scans), scene.track("agent1")
    population = slam.population
    states, log = population.states, population.log_weight
    assert places(log, lambda rows: mixture.together([states[k].belief for k in rows])) == 2
    before = slam.population
    estimate = slam.step(scans[3])
    assert slam.population.weights[0] > 0.9
    assert np.linalg.norm(estimate.position_m - track.position_m[3]) < 0.2
    assert estimate.hypotheses.weight.sum() == pytest.approx(1)
    assert len(estimate.hypotheses) == 2, "the guard stays for a while"
    assert before.weights.tolist() == [0.5, 0.5]
    for scan in scans[4:]:
        slam.step(scan)
    assert slam.population.weights[0] > 0.9999


@pytest.mark.slow
def test_a_population_goes_on_from_its_checkpoint_bit_for_bit(scene, scans, tmp_path):
    slam = branched(scene, scans)
    slam.save(tmp_path / "here.h5")
    again = GridSlam.resume(tmp_path / "here.h5")
    assert len(again.population) == 2
    assert again.population.guard == 1
    for scan in scans[3:]:
        here, there = slam.step(scan), again.step(scan)
        np.testing.assert_array_equal(here.covariance, there.covariance)
        np.testing.assert_array_equal(here.hypotheses.weight, there.hypotheses.weight)


@pytest.mark.parametrize("weight", [[0.0], [0.0, 0.0], [np.nan, 0.0]])
def test_a_checkpoint_whose_weights_cannot_be_is_refused(scene, scans, tmp_path, monkeypatch, weight):
    from gridslam.systems import values

    slam, put = branched(scene, scans), values.put

    def spoiled(group, name, value, units):
        put(group, name, np.array(weight) if name == "log_weight" else value, units)

    with monkeypatch.context() as patch:
        patch.setattr(values, "put", spoiled)
        slam.save(tmp_path / "here.h5")
    with pytest.raises(gs.InputError):
        GridSlam.resume(tmp_path / "here.h5")


def test_an_agent_that_left_the_grid_says_so(scene, scans):
    slam = GridSlam(scene, seed=3)
    mean = slam.state.belief.mean.copy()
    mean[:2] = [30.0, 0.0]
    slam.now = slam.believing(replace(slam.state, belief=replace(slam.state.belief, mean=mean)))
    assert "left the grid" in slam.step(scans[0]).health.why


def test_radios_without_bearings_and_inherited_maps_search_for_no_start(scene):
    model = vague(scene).filter_model("agent1")
    slam = GridSlam(scene, seed=1)
    assert begun(
        replace(slam.state, belief=Belief(model.start_mean, np.diag(model.start_variance))), model
    ).searching
    deaf = replace(model, radio=replace(model.radio, measures=("distance",)))
    vague_state = replace(slam.state, belief=Belief(model.start_mean, np.diag(model.start_variance)))
    assert not begun(vague_state, deaf).searching
    assert not begun(slam.state, slam.model).searching


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize("measures", [("distance", "aod", "aoa"), ("distance", "aoa")])
@pytest.mark.parametrize("anchors", [1, 2])
def test_what_a_start_leaves_open_is_told(scene, complete, measures, anchors):
    scene = vague(scene).model_copy(update={"anchors": scene.anchors[:anchors]})
    model = scene.filter_model("agent1")
    model = replace(model, radio=replace(model.radio, measures=measures))
    state, poses = GridSlam(scene, seed=1).state, np.array([[0.0, 0.5, 0.1], [1.0, 0.5, 0.1]])
    modes = Modes(poses, np.tile(0.01 * np.eye(3), (2, 1, 1)), np.zeros(2), np.zeros(2), complete)
    reasons = _started(state, modes, model).watch.reasons()
    assert (UNPROVEN in reasons) is not complete
    assert (TURNABLE in reasons) is (anchors == 1 and "aod" not in measures), "departures tell the turn"
    lone = replace(model, radio=replace(model.radio, anchor_aperture=np.zeros((anchors, 2))))
    assert (TURNABLE in _started(state, modes, lone).watch.reasons()) is (anchors == 1), (
        "one antenna has none"
    )


@pytest.mark.slow
def test_vague_starts_end_right_and_never_silently_wrong():
    """Known to 8 m and any heading: by one anchor, or by two that tell no angle of departure."""
    for seed, (name, anchors, measures) in enumerate(
        [
            ("room", 1, ("distance", "aod", "aoa", "amplitude")),
            ("alcove", 2, ("distance", "aoa", "amplitude")),
        ]
    ):
        scene = shortened(gs.Scene.load(name), 30).with_filter(particles=256)
        radio = scene.radio.model_copy(update={"measures": measures})
        scene = vague(scene.model_copy(update={"radio": radio, "anchors": scene.anchors[:anchors]}))
        track, slam, wrong = scene.track("agent1"), GridSlam(scene, seed=seed), 0
        start = assumed_start(scene, "agent1", seed)
        slam.start_at(start.position_m, start.heading_rad)
        for step, scan in enumerate(gs.simulate(scene, "agent1", seed=seed + 900)):
            estimate = slam.step(scan)
            gap = estimate.position_m - track.position_m[step]
            off, square = np.linalg.norm(gap), gap @ np.linalg.solve(estimate.covariance[:2, :2], gap)
            wrong += off > 0.5 and square > 16 and estimate.health.ok
        assert off < 0.3
        assert wrong <= 2


@pytest.mark.slow
def test_faint_paths_after_a_silence_lead_no_vague_agent_astray(monkeypatch):
    """Of twenty scans after ten silent ones the faint measurements alone: one Gaussian went off by 7 m."""
    scene = gs.Scene.load("canyon")
    scene = shortened(scene, 81).with_filter(particles=512)
    slam, track = GridSlam(scene, seed=2), scene.track("agent1")
    names = ("anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    counts, reduce = list[int](), hypotheses.reduce
    monkeypatch.setattr(
        hypotheses, "reduce", lambda all, model: counts.append(len(all)) or reduce(all, model)
    )
    for step, scan in enumerate(gs.simulate(scene, "agent1", seed=2)):
        kept = (scan.amplitude < 6) & (step >= 70) | (step < 60)
        estimate = slam.step(replace(scan, **{name: getattr(scan, name)[kept] for name in names}))
        off = np.linalg.norm(estimate.position_m - track.position_m[step])
        assert off < 4 * np.sqrt(np.trace(estimate.covariance[:2, :2]))
    assert off < 0.3
    assert max(counts) > 1, "poses were listed by scan and map"
