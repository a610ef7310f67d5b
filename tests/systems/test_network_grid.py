"""One grid for several agents: for one it is grid SLAM; what blocks one of them is told to all."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.inference.messages.network.cells import update_shared_cells
from gridslam.systems.grid import GridSlam
from gridslam.systems.network_grid import NetworkGridSlam, step

AGENTS = ["agent1", "agent2"]


def short(steps=8, **more):
    whole = gs.Scene.load("room").model_dump(exclude_none=True)
    whole["filter"]["particles"] = 1000
    whole["agents"] = [whole["agents"][0] | {"name": name, "steps": steps} for name in AGENTS]
    whole["agents"][1] |= {"start_m": (1.0, 1.5), "waypoints_m": ((-1.6, 1.0), (-1.6, -0.3))}
    whole["agents"][1] |= {"start_heading_deg": 189.0}
    return gs.Scene.checked(whole | more, "room")


@pytest.mark.slow
def test_one_agent_with_labels_and_known_clocks_is_grid_slam_bit_for_bit():
    room = short(4)
    network, grid = NetworkGridSlam(room, seed=2), GridSlam(room, seed=2)
    grid.branches = False
    grid.now = grid.believing(replace(grid.state, leftovers=None))  # births by one step alone
    for scan in gs.simulate(room, "agent1", seed=2):
        ours, theirs = network.step(scan), grid.step(scan)
        np.testing.assert_array_equal(ours.position_m, theirs.position_m)
        np.testing.assert_array_equal(ours.covariance, theirs.covariance)
    np.testing.assert_array_equal(network.map().evidence, grid.map().evidence)
    np.testing.assert_array_equal(network.map().coefficient, grid.map().coefficient)


@pytest.mark.slow
def test_messages_of_all_agents_add_up_in_the_cells():
    room = short()
    slam = NetworkGridSlam(room, agents=AGENTS, seed=2)
    measurements = gs.simulate(room, AGENTS, seed=2)
    for scan in measurements:
        slam.step(scan)
    blank = np.zeros_like(slam.state.grid.evidence)
    state = replace(slam.state, grid=replace(slam.state.grid, evidence=blank))
    one, two = slam.model.agents

    def evidence(*models):
        return update_shared_cells(state, models, works=slam.work).grid.evidence

    first, second, both = evidence(one, None), evidence(None, two), evidence(one, two)
    assert (np.abs(first) > 0.1).any()
    assert ((np.abs(second) > 0.1) & (np.abs(first) < 1e-6)).any()  # cells that the second alone has news of
    small = np.maximum(np.abs(first), np.abs(second)) < 5  # below the clip
    np.testing.assert_allclose(both[small], (first + second)[small], atol=1e-3)


@pytest.mark.slow
def test_an_agent_that_was_lost_teaches_no_cells():
    room = short()
    slam = NetworkGridSlam(room, agents=AGENTS, seed=2)
    scans = list(gs.simulate(room, AGENTS, seed=2))
    for scan in scans[:-1]:
        slam.step(scan)
    believed, blank = slam.state, np.zeros_like(slam.state.grid.evidence)
    believed = replace(believed, grid=replace(believed.grid, evidence=blank))
    anew = believed.recorded(1, believed.records[1].monitor.found_again())

    def evidence(state, scan):
        return step(state, scan, slam.model, slam.work)[0].grid.evidence

    alone = replace(scans[-1], scans=(scans[-1].scans[0], None))
    both, first, lost = evidence(believed, scans[-1]), evidence(believed, alone), evidence(anew, scans[-1])
    np.testing.assert_allclose(lost, first, atol=1e-6)
    assert (np.abs(both - first) > 0.1).any()


def test_it_maps_from_measurements_that_do_not_say_whose_they_are(tmp_path):
    room = short(clocks={"anchor_prior_ns": 20.0}, radio={"window_m": (-10.0, 60.0)})
    measurements = gs.simulate(room, AGENTS, seed=1, unlabelled=True)
    run = gs.map_network(room, measurements, seed=1, method="network_grid")
    assert run.runs["agent1"].method == "network_grid"
    assert run.map.observed.any()
    for name in AGENTS:
        error = run.runs[name].trajectory.position_m - measurements.tracks[name].position_m
        assert np.linalg.norm(error[3:], axis=1).max() < 0.2
    slam = NetworkGridSlam(room, agents=AGENTS, seed=1)
    slam.step(measurements.scan(0))
    slam.save(tmp_path / "one.h5")
    again = NetworkGridSlam.resume(tmp_path / "one.h5")
    slam.step(measurements.scan(1))
    again.step(measurements.scan(1))
    np.testing.assert_array_equal(slam.map().evidence, again.map().evidence)
