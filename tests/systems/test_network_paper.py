"""Network SLAM as published: clocks and labels are found, it repeats itself, and refuses what can't be."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.errors import InputError
from gridslam.evaluation.network_scores import label_errors, without_common
from gridslam.runs.network_run import map_network
from gridslam.simulation.network import simulate_network
from gridslam.systems.published.network_paper import PublishedNetworkSlam
from gridslam.systems.published.soundness import require_sound_network

AGENTS, STEPS = ["agent1", "agent2"], 4


@pytest.fixture(scope="module")
def world():
    scene = short("exchange", STEPS, particles=1500)
    return scene, *simulate_network(scene, AGENTS, 4, unlabelled=True)


@pytest.mark.slow
def test_clocks_and_labels_are_found_and_it_goes_on_bit_for_bit(world, tmp_path):
    scene, measurements, truth = world
    run = map_network(scene, measurements, seed=4, method="network-paper", starts="exact")
    error = without_common(run.clocks.errors(truth.clocks))
    assert (np.abs(error[-1]) < 4e-9).all()
    wrong, judged = label_errors(run.anchor, truth.source)
    assert judged > 40
    assert wrong <= 0.03 * judged
    for name in AGENTS:
        off = run.runs[name].trajectory.position_m - truth.agents[name].trajectory.position_m
        assert np.linalg.norm(off, axis=1).max() < 2.0
    slam = PublishedNetworkSlam(scene, seed=4, agents=AGENTS)
    for scan in measurements:
        if scan.step == STEPS - 1:
            slam.save(tmp_path / "a.h5")
            again = PublishedNetworkSlam.resume(tmp_path / "a.h5")
        before = slam.state
        kept = before.agents.copy(), before.clocks.copy(), before.features.position.copy()
        estimate = slam.step(scan)
        for now, then in zip((before.agents, before.clocks, before.features.position), kept, strict=True):
            np.testing.assert_array_equal(now, then)
    np.testing.assert_array_equal(estimate.offset_s, again.step(scan).offset_s)
    np.testing.assert_array_equal(estimate.offset_s, run.clocks.offset_s[-1])
    assert (slam.map().surfaces.owner >= 0).all()


def test_a_start_that_is_told_moves_its_agent_alone(world):
    slam = PublishedNetworkSlam(world[0], seed=1, agents=AGENTS)
    other = slam.state.agents[1].copy()
    slam.start_at(np.array([1.0, 0.5]), 2.0)
    np.testing.assert_allclose(slam.state.agents[0, :, [0, 1, 4]].mean(1), [1.0, 0.5, 2.0], atol=0.02)
    np.testing.assert_array_equal(slam.state.agents[1], other)


def test_clocks_with_rates_are_refused(world):
    data = world[0].model_dump(exclude_none=True)
    data["clocks"]["drift_prior_ppb"] = 1.0
    with pytest.raises(InputError, match="drift_prior_ppb"):
        PublishedNetworkSlam(gs.Scene.checked(data, "exchange"), agents=AGENTS)


def test_a_checkpoint_that_cant_be_is_refused(world):
    slam = PublishedNetworkSlam(world[0], seed=1, agents=AGENTS)
    state = slam.state
    for part, broken in (
        ("agents", replace(state, agents=state.agents[:1])),
        ("clocks", replace(state, clocks=state.clocks[:, :5])),
        ("existence", replace(state, features=replace(state.features, existence=np.array([2.0])))),
        ("next_identity", replace(state, next_identity=-1)),
    ):
        with pytest.raises(InputError, match=part):
            require_sound_network(broken, slam.model, "file")
