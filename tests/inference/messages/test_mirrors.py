"""Surfaces whose paths depart as over a corner are no mirrors: they go, and what they taught stays little."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of_departures
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

import gridslam as gs
from gridslam.inference.management.readout import surface_estimate
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.double_bounces import put_off_double_bounces
from gridslam.inference.messages.mirrors import ARRIVED, DEPARTED, TURNED, mirror_chances, mirror_odds
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.scan import Scan

SYSTEMS = [gs.GridSlam, gs.NetworkSlam, gs.NetworkGridSlam]


def test_odds_by_hand():
    """Of one departure of deviation 0.1 rad, which is a mirror's, and misses a right corner's by 0.2 rad."""
    # any other corner: the mean over all directions of exp(-100 (1 - cos)), 0.0399; 2.43 in all
    mean = quad(
        lambda beta: np.exp(-100 * (1 - np.cos(0.2 - beta))) / (2 * np.pi), -np.pi, np.pi, points=[0.2]
    )
    by_hand = -np.log(0.5 * np.exp(-2) + 0.5 * mean[0])
    systematic = 0.5 * np.log1p(100 * np.radians(0.5) ** 2)
    odds = mirror_odds(state_of_departures([0.0], [0.1], [0.2]).surfaces)
    np.testing.assert_allclose(odds, by_hand - systematic, rtol=1e-9)
    assert by_hand == pytest.approx(2.43, abs=0.01)
    # none was heard: nothing is known; else six of seven are mirrors before
    silent = state_of_departures([], []).surfaces
    assert (mirror_odds(silent).tolist(), mirror_chances(silent).tolist()) == ([0.0], [1.0])
    chance = mirror_chances(state_of_departures([0.0], [0.1], [0.2]).surfaces)
    np.testing.assert_allclose(chance, 1 / (1 + np.exp(systematic - by_hand) / 6), rtol=1e-9)


@pytest.mark.parametrize(("missed", "beside", "low", "high"), [
    (0.0, 0.0, -3, 1),  # along the normal of a mirror both depart alike
    (0.0, 0.3, 2, 8),  # 20 of them all turned alike: a corner that isn't a right one
    (0.2, 0.0, -40, -30),  # a right corner's
    (0.2, 0.3, -35, -25),  # another corner's
])  # fmt: skip
def test_odds_of_twenty_departures(missed, beside, low, high):
    several = np.full(20, missed), np.full(20, 0.1), np.full(20, beside)
    assert low < mirror_odds(state_of_departures(*several).surfaces)[0] < high


def test_what_all_miss_together_says_little():
    """Of an anchor that is turned by 0.7 degrees 10 000 departures say so, and none is a corner's."""
    turned = np.full(10**4, np.radians(0.7))
    assert mirror_odds(state_of_departures(turned, np.full(10**4, 0.1), turned).surfaces)[0] > -3


def test_users_see_how_likely_a_mirror_is():
    """Of a corner's departures little is left of an existence of 0.9."""
    state = state_of_departures(np.full(20, 0.1), np.full(20, 0.1), np.zeros(20))
    (shown,) = surface_estimate(state, work=Workspace(model_of("room", [[0.0, 0.0, 0.0]]), 0)).existence
    assert shown == pytest.approx(0.9 * mirror_chances(state.surfaces)[0])
    assert 0 < shown < 0.01


@given(st.floats(-3, 3), st.floats(-0.3, 0.3), st.integers(1, 30))
def test_odds_are_the_same_either_way_round(beside, missed, count):
    left, right = (
        mirror_odds(
            state_of_departures(
                np.full(count, s * missed), np.full(count, 0.1), np.full(count, s * beside)
            ).surfaces
        )
        for s in (1, -1)
    )
    np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-9)


def followed(off, system=gs.GridSlam, steps=12):
    """Of a filter that hears one wall, x = 12, whose paths depart `off` rad beside a mirror's: states."""
    scene = gs.Scene.from_toml(
        "[grid]\nx_m = [-1, 13]\ny_m = [-1, 9]\ncell_m = 0.2\n[radio]\nsnr_at_1m_db = 34\n"
        '[[anchors]]\nname = "a"\nposition_m = [3, 2]\norientation_deg = 0\n'
        '[[agents]]\nname = "one"\nstart_m = [8, 4.5]\nstart_heading_deg = 150\n'
        "waypoints_m = [[5.402, 6]]\nstep_m = 0.05\n"
        "prior = { position_m = 0.01, velocity_mps = 0.01, heading_deg = 1 }\n[filter]\nparticles = 500\n",
        "corner",
    )
    slam, states = system(scene, seed=1), []
    for step in range(steps):
        x, y = 8 - 0.05 * step * np.cos(np.pi / 6), 4.5 + 0.025 * step
        back, out = np.array([21 - x, 2 - y]), np.array([21 - x, y - 2])
        values = (
            np.hypot(*back),
            np.arctan2(out[1], out[0]) + off,
            np.arctan2(back[1], back[0]) - np.radians(150),
        )
        slam.step(Scan(step, 0.1 * step, np.array([0]), *(np.array([v]) for v in (*values, 5.0))))
        states.append(slam.state)
    return states


@pytest.mark.parametrize("system", SYSTEMS)
def test_angles_are_weighed_step_by_step(system):
    states = followed(0.0, system)
    for kind in (DEPARTED, ARRIVED):
        weights, missed = np.array([state.surfaces.angles[0, 0, kind] for state in states]).T
        assert weights[0] == 0  # what bears a surface doesn't speak for it
        assert (np.diff(weights) > 0).all()
        assert np.abs(missed[1:] / weights[1:]).max() < 0.01
    assert system is not gs.GridSlam or not len(states[-1].corners)
    # it departs as far north of east as it arrives from south of it: twice that beside a right corner's
    beside = np.arctan2(*states[-1].surfaces.angles[0, 0, TURNED][::-1])
    assert beside == pytest.approx(2 * np.arctan2(2.6, 13.2), abs=0.05)
    assert mirror_chances(states[-1].surfaces)[0] > 0.9


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
    state = replace(state_of_departures(np.zeros(1), np.full(1, 0.1)), corners=np.array([[0.0, *corner]]))
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
    """Two noises: squared errors over claimed variances, of two dimensions, and no false wall at the end."""
    scene = gs.Scene.from_toml(PLAN, "corner")
    squared = []
    for seed in (2, 3):  # at which unweighed departures turn networks to 4 and 9
        run = gs.map_scene(scene, gs.simulate(scene, "one", seed), method, seed=seed)
        error = run.trajectory.position_m[20:, :2] - scene.track("one").position_m[20:, :2]
        certain = np.linalg.inv(run.covariance[20:, :2, :2])
        squared.append(np.einsum("ni,nij,nj->n", error, certain, error).mean())
    assert np.mean(squared) < 3.5, squared


def test_a_state_knows_none_at_first():
    assert State.start(model_of("room")).corners.shape == (0, 3)
