"""Surfaces whose paths depart as over a corner are no mirrors: they go, and what they taught stays little."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.double_bounces import put_off_double_bounces
from gridslam.inference.messages.mirrors import (
    MOST_CORNERS,
    drop_no_mirrors,
    drop_shared_no_mirrors,
    no_mirrors,
    unweighed,
)
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.world.scan import Scan

SYSTEMS = [gs.GridSlam, gs.NetworkSlam, gs.NetworkGridSlam]
WALL = [0.5 * np.pi, 3.0]
"""The line y = 3, which mirrors an anchor at the origin to (0, 6)."""


def after(missed, std):
    """A state with one wall off which departures of deviation `std` missed by `missed`, both (K,) rad."""
    lines = np.array([4.0, 0, 0, 0, 0, *WALL])
    state = state_of(Belief(lines, 1e-6 * np.eye(7)), 1, existence=0.9)
    weight = np.sum(std**-2.0)
    told = np.array([[weight, np.sum(missed * std**-2.0)]])
    return replace(state, surfaces=replace(state.surfaces, departures=told))


def test_by_hand():
    # 16 departures of deviation 0.1: the mean's is 0.025, with half a degree 0.0265; five of them are 0.1325
    for mean, gone in [(0.131, False), (0.134, True), (-0.134, True)]:
        state = after(np.full(16, mean), np.full(16, 0.1))
        assert no_mirrors(state.surfaces).tolist() == [gone]
    # of any number of departures: no less than five times half a degree, 0.0436
    assert not no_mirrors(after(np.full(10**6, 0.0435), np.full(10**6, 0.1)).surfaces).any()
    assert no_mirrors(after(np.full(10**6, 0.0445), np.full(10**6, 0.1)).surfaces).all()
    assert not no_mirrors(after(np.zeros(1), np.full(1, np.inf)).surfaces).any()


def followed(off, system=gs.GridSlam, steps=12):
    """Of a filter that hears one wall, x = 12, whose paths depart `off` rad beside a mirror's: states."""
    scene = gs.Scene.from_toml(
        "[grid]\nx_m = [-1, 13]\ny_m = [-1, 9]\ncell_m = 0.2\n[radio]\nsnr_at_1m_db = 34\n"
        '[[anchors]]\nname = "a"\nposition_m = [3, 2]\norientation_deg = 0\n'
        '[[agents]]\nname = "one"\nstart_m = [8, 4.5]\nstart_heading_deg = 180\n'
        "waypoints_m = [[5, 4.5]]\nstep_m = 0.05\n"
        "prior = { position_m = 0.01, velocity_mps = 0.01, heading_deg = 1 }\n[filter]\nparticles = 500\n",
        "corner",
    )
    slam, states = system(scene, seed=1), []
    for step in range(steps):
        back, out = np.array([21.0 - 8 + 0.05 * step, -2.5]), np.array([13.0 + 0.05 * step, 2.5])
        values = np.hypot(*back), np.arctan2(out[1], out[0]) + off, np.arctan2(back[1], back[0]) - np.pi
        slam.step(Scan(step, 0.1 * step, np.array([0]), *(np.array([v]) for v in (*values, 5.0))))
        states.append(slam.state)
    return states


@pytest.mark.parametrize("system", SYSTEMS)
def test_departures_are_weighed_step_by_step(system):
    states = followed(0.0, system)
    weights, missed = np.array([state.surfaces.departures[0] for state in states]).T
    assert weights[0] == 0  # what bears a surface doesn't speak for it
    assert (np.diff(weights) > 0).all()
    assert np.abs(missed[1:] / weights[1:]).max() < 0.01
    assert system is not gs.GridSlam or not len(states[-1].corners)


@pytest.mark.parametrize("off", [-0.3, 0.3])
def test_a_wall_whose_paths_depart_elsewhere_goes_and_stays_away(off):
    states = followed(off)
    known = [len(state.surfaces) for state in states]
    gone = known.index(0, 1)
    assert 3 < gone < 12
    assert not any(known[gone:])
    assert states[-1].corners[:, 0].tolist() == [0.0]


@pytest.mark.parametrize("system", SYSTEMS[1:])
def test_of_a_network_such_a_wall_goes_too(system):
    states = followed(0.3, system)
    assert [len(state.surfaces) for state in states[:4]] == 4 * [1]
    assert not all(states[0].surfaces.identity[0] in state.surfaces.identity for state in states[4:])


def test_surfaces_that_agents_share_go_by_what_all_of_them_weighed():
    part = after(np.full(16, 0.2), np.full(16, 0.1))
    slam = gs.NetworkSlam(gs.Scene.load("exchange"), agents=["agent1", "agent2"], seed=1)
    state = replace(slam.state, surfaces=part.surfaces)
    assert drop_shared_no_mirrors(state).surfaces.existence.tolist() == [0.0]
    assert state.surfaces.existence.tolist() == [0.9]
    state = replace(state, surfaces=unweighed(part).surfaces)
    assert drop_shared_no_mirrors(state) is state


def test_what_is_no_mirror_goes_and_its_image_stays_known():
    model = model_of("room", [[0.0, 0.0, 0.0]])
    good, bad = (after(np.full(16, mean), np.full(16, 0.1)) for mean in (0.05, 0.2))
    assert drop_no_mirrors(good, model) is good
    gone = drop_no_mirrors(bad, model)
    assert gone.surfaces.existence.tolist() == [0.0]
    assert bad.surfaces.existence.tolist() == [0.9]
    np.testing.assert_allclose(gone.corners, [[0.0, 0.0, 6.0]], atol=1e-12)
    again = gone
    for _ in range(MOST_CORNERS + 3):
        again = drop_no_mirrors(again, model)
    assert len(again.corners) == MOST_CORNERS
    fresh = unweighed(gone)
    assert not len(fresh.corners)
    assert not fresh.surfaces.departures.any()


def heard(value):
    """A measurement of the one anchor, which faces east, and its birth as a single bounce."""
    scan = AnchorScan.of(
        0, np.zeros(2), 0.0, np.array([value]), np.array([[0.05, 0.1, 0.1]]), np.array([4.0])
    )
    none = np.zeros(1, np.int32)
    return scan, Births(none, np.full((1, 2), -1, np.int32), np.zeros((1, 2)), np.full(1, 9.0), none)


@pytest.mark.parametrize(("corner", "waits"), [((0, 6), True), ((0, 7), False), ((6, 0), False)])
def test_births_from_there_wait(corner, waits):
    """From (4, 0) the image (0, 6) is sqrt(52) m away; one departure as of a mirror isn't enough."""
    model = model_of("room", [[0.0, 0.0, 0.0]])
    arriving = np.arctan2(6, -4)
    scan, births = heard([np.sqrt(52), np.pi - arriving, arriving])
    state = replace(after(np.zeros(1), np.full(1, 0.1)), corners=np.array([[0.0, *corner]]))
    kept = put_off_double_bounces(births, state, scan, model.radio, model)
    assert len(kept) == (0 if waits else 1)
    other = replace(state, corners=np.array([[1.0, *corner]]))
    assert put_off_double_bounces(births, other, scan, model.radio, model) is births


PLAN = """
[radio]
snr_at_1m_db = 40
array = { rows = 5, columns = 5, spacing_wavelengths = 0.25 }
[grid]
x_m = [-2, 17]
y_m = [-2, 14]
cell_m = 0.1
[[anchors]]
name = "A"
position_m = [7.82, 10.76]
orientation_deg = -35.3
[[walls]]
points_m = [[0.47, 0], [14.93, 0], [14.9, 12.1]]
material = "concrete"
[[walls]]
points_m = [[14.9, 12.1], [0, 11.77]]
material = "plaster"
[[walls]]
points_m = [[0, 11.77], [0.47, 0]]
material = "metal"
[[walls]]
points_m = [[4.98, 5.75], [7.53, 5.75]]
material = "metal"
[materials]
concrete = 0.71
plaster = 0.5
metal = 0.95
[[agents]]
name = "one"
start_m = [11.96, 7.8]
start_heading_deg = -141.6
waypoints_m = [[9.22, 5.63]]
step_m = 0.05
steps = 60
prior = { position_m = 0.5, velocity_mps = 0.01, heading_deg = 10 }
[filter]
particles = 1000
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["grid", "adaptive", "network", "network_grid"])
def test_a_corner_of_unknown_walls_turns_nobody_about_its_anchor(method):
    """Four noises: squared errors over claimed variances, of two dimensions, and no false wall at the end."""
    scene = gs.Scene.from_toml(PLAN, "corner")
    squared = []
    for seed in range(4):
        run = gs.map_scene(scene, gs.simulate(scene, "one", seed), method, seed=seed)
        error = run.trajectory.position_m[20:, :2] - scene.track("one").position_m[20:, :2]
        certain = np.linalg.inv(run.covariance[20:, :2, :2])
        squared.append(np.einsum("ni,nij,nj->n", error, certain, error).mean())
    assert np.mean(squared) < 3.5, squared


def test_a_state_knows_none_at_first():
    assert State.start(model_of("room")).corners.shape == (0, 3)
