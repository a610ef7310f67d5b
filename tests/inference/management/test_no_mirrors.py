"""Surfaces that are no mirrors go: by their departures, and where two surer walls make their images."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of, state_of_departures
from hypothesis import given
from hypothesis import strategies as st

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief, append
from gridslam.inference.management.no_mirrors import (
    MOST_CORNERS,
    corners_of,
    drop_no_mirrors,
    drop_shared_no_mirrors,
    no_mirrors,
    over_corner,
    over_corners,
)
from gridslam.inference.messages.mirrors import ARRIVED, COSTS, DEPARTED, unweighed
from gridslam.inference.state.surface_bank import BINS, SurfaceBank
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.geometry import line_between, mirror, unit

WALLS = np.array([[np.pi, 2.0], [0.5 * np.pi, 3.0], [0.0, 9.0]])
"""x = -2 and y = 3, which meet at (-2, 3), and x = 9."""
CORNER, ANCHORS = np.array([-2.0, 3.0]), np.array([[0.8, 0.1], [1.2, -2.2]])


def test_means_that_miss_by_hand():
    # 16 departures of deviation 0.1: the mean's is 0.025, with half a degree 0.0265; five of them are 0.1325
    for mean, gone in [(0.131, False), (0.134, True), (-0.134, True)]:
        state = state_of_departures(np.full(16, mean), np.full(16, 0.1))
        assert no_mirrors(state.surfaces).tolist() == [gone]
    # of any number of departures: no less than five times half a degree, 0.0436
    assert not no_mirrors(state_of_departures(np.full(10**6, 0.0435), np.full(10**6, 0.1)).surfaces).any()
    assert no_mirrors(state_of_departures(np.full(10**6, 0.0445), np.full(10**6, 0.1)).surfaces).all()
    assert not no_mirrors(state_of_departures(np.zeros(1), np.full(1, np.inf)).surfaces).any()


@pytest.mark.parametrize("kind", [DEPARTED, ARRIVED])
def test_each_anchor_is_asked_by_itself(kind):
    """Over one corner two anchors' paths miss one mirror's to different sides; in all they don't."""
    state = state_of_departures(np.zeros(16), np.full(16, 0.1))
    angles = np.repeat(state.surfaces.angles, 2, axis=1)
    angles[0, :, kind] = [[1600.0, 1600 * 0.15], [1600.0, -1600 * 0.15]]  # 0.13 would be too little
    assert no_mirrors(replace(state.surfaces, angles=angles)).tolist() == [True]
    angles[0, :, kind.stop - 1] *= 0.12 / 0.15
    assert no_mirrors(replace(state.surfaces, angles=angles)).tolist() == [False]


def test_surfaces_that_agents_share_go_by_what_all_of_them_weighed():
    part = state_of_departures(np.full(16, 0.2), np.full(16, 0.1))
    slam = gs.NetworkSlam(gs.Scene.load("exchange"), agents=["agent1", "agent2"], seed=1)
    state = replace(slam.state, surfaces=part.surfaces)
    assert drop_shared_no_mirrors(state, slam.model).surfaces.existence.tolist() == [0.0]
    assert state.surfaces.existence.tolist() == [0.9]
    state = replace(state, surfaces=unweighed(part).surfaces)
    assert drop_shared_no_mirrors(state, slam.model) is state


def test_what_is_no_mirror_goes_and_its_image_stays_known():
    model = model_of("room", [[0.0, 0.0, 0.0]])
    good, bad = (state_of_departures(np.full(16, mean), np.full(16, 0.1)) for mean in (0.05, 0.2))
    work = Workspace(model, seed=1)
    assert drop_no_mirrors(good, model, work=work) is good
    gone = drop_no_mirrors(bad, model, work=work)
    assert gone.surfaces.existence.tolist() == [0.0]
    assert bad.surfaces.existence.tolist() == [0.9]
    np.testing.assert_allclose(gone.corners, [[0.0, 0.0, 6.0]], atol=1e-12)
    again = gone
    for _ in range(MOST_CORNERS + 3):
        again = drop_no_mirrors(again, model, work=work)
    assert len(again.corners) == MOST_CORNERS
    fresh = unweighed(gone)
    assert not len(fresh.corners)
    assert not fresh.surfaces.angles.any()


def double(anchor, last=WALLS[0], first=WALLS[1]):
    """The line whose single bounce has the virtual anchor of the double bounce in a corner."""
    return line_between(anchor, mirror(last, mirror(first, anchor)))


def about(corner, line, turn):
    """A line through a corner, turned about it (rad)."""
    return np.array([line[0] + turn, corner @ unit(line[0] + turn)])


def beside(line, gap):
    """A line so far (m) beside another."""
    return line + np.array([0.0, gap])


def lies_over(line, walls, anchor):
    """Whether a line lies over a corner of any two walls."""
    return over_corner(line, walls, corners_of(walls), anchor)


def test_lines_over_a_corner():
    line = double(ANCHORS[0])
    np.testing.assert_allclose(mirror(line, ANCHORS[0]), 2 * CORNER - ANCHORS[0])  # of a right angle
    assert lies_over(line, WALLS[:2], ANCHORS[0])
    # departures pull it about the corner: the image, 4.03 m from it, moves by 8.06 sin(turn)
    assert lies_over(about(CORNER, line, 0.24), WALLS[:2], ANCHORS[0])
    assert not lies_over(about(CORNER, line, 0.26), WALLS[:2], ANCHORS[0])
    # and beside it, it is another wall
    assert lies_over(beside(line, 0.14), WALLS[:2], ANCHORS[0])
    assert not lies_over(beside(line, 0.16), WALLS[:2], ANCHORS[0])
    # two walls that don't cross have none, and a wall alone neither
    assert not lies_over(double(ANCHORS[0], WALLS[0], WALLS[2]), WALLS[::2], ANCHORS[0])
    assert not lies_over(line, WALLS[:1], ANCHORS[0])


@given(st.floats(0.3, 2.8), st.floats(-3, 3), st.floats(-3, 3), st.sampled_from([1, -1]))
def test_of_any_corner(angle, x, y, order):
    """What is heard over two walls through the origin has its image there, in either order."""
    walls = np.array([[0.4, 0.0], [0.4 + angle, 0.0]])
    anchor = np.array([x, y]) + 4.0
    assert lies_over(double(anchor, *walls[::order]), walls, anchor)


def heard(line, **unlike):
    """Two walls that are known to be mirrors, and a third line of which departures don't tell."""
    told = {"mirror": 3.0, "elsewhere": 0.05, "seen": 40, "std": 0.01, "surer": 300.0, "weight": 100.0}
    told |= {"existence": 0.99, "doubted": 0.0} | unlike
    belief, bank = Belief(np.zeros(5), 0.01 * np.eye(5)), SurfaceBank.empty(len(ANCHORS))
    for number, other in enumerate([*WALLS[:2], line]):
        belief = append(belief, other, np.square(told["std"]) * np.eye(2))
        bank = bank.add(number, told["existence"], np.full(BINS, 1 / BINS), 0.0, (0, -1, -1))
    bank.seen[:] = told["seen"]
    bank.single[:] = [[1.0, 1.0, 1.0], [1.0, 1.0, told["elsewhere"]]]
    bank.angles[:, 0, DEPARTED.start] = told["weight"]
    bank.angles[:, 0, COSTS.start] = [told["doubted"], told["doubted"], told["mirror"]]
    bank.angles[:2, 0, COSTS.stop - 1] = told["surer"]
    return bank, belief


def test_walls_that_hardly_cross_have_no_corner():
    """Two at 0.1 rad to each other: their crossing is known too badly."""
    walls = np.array([[0.0, 2.0], [0.1, 2.0]])
    assert not lies_over(double(ANCHORS[0], *walls), walls, ANCHORS[0])


def test_they_go_in_a_step():
    bank, belief = heard(double(ANCHORS[0]))
    places = np.hstack([ANCHORS, np.zeros((2, 1))])
    state = replace(state_of(belief, 2), surfaces=bank)
    model = model_of("room", places)
    gone = drop_no_mirrors(state, model, work=Workspace(model, seed=1))
    assert gone.surfaces.existence.tolist() == [0.99, 0.99, 0.0]
    assert gone.corners[:, 0].tolist() == [0.0]
    slam = gs.NetworkSlam(gs.Scene.load("exchange"), agents=["agent1"], seed=1)
    shared = replace(slam.state, surfaces=bank, belief=belief)
    model = replace(slam.model, agents=(model_of("room", places),))
    assert drop_shared_no_mirrors(shared, model).surfaces.existence.tolist() == [0.99, 0.99, 0.0]


def test_what_two_surer_walls_explain_goes():
    assert over_corners(*heard(double(ANCHORS[0])), ANCHORS).tolist() == [False, False, True]
    assert not over_corners(*heard(beside(double(ANCHORS[0]), 0.5)), ANCHORS).any()
    # of a network, links of one anchor count as one
    bank, belief = heard(double(ANCHORS[0]))
    twice = replace(bank, single=np.tile(bank.single, (2, 1)))
    assert over_corners(twice, belief, ANCHORS).tolist() == [False, False, True]


@pytest.mark.parametrize(
    "unlike",
    [
        {"mirror": 0.5},  # its departures are rather a mirror's
        {"weight": 0.0},  # no departure was heard
        {"surer": 0.0, "doubted": 2.0},  # the others' are rather a corner's, too
        {"existence": 0.5},  # are they there?
        {"elsewhere": 0.9},  # another anchor hears it, where no double bounce explains it
        {"seen": 5},  # the walls are new
        {"std": 0.2},  # nobody knows yet where they are
    ],
)
def test_what_may_be_a_wall_stays(unlike):
    assert not over_corners(*heard(double(ANCHORS[0]), **unlike), ANCHORS).any()


PLAN = """
[radio]
snr_at_1m_db = 40
[grid]
x_m = [-2, 12]
y_m = [-2, 18]
cell_m = 0.1
[materials]
concrete = 0.71
glass = 0.35
metal = 0.95
[[anchors]]
name = "A"
position_m = [4.58, 7.03]
orientation_deg = -94.6
[[anchors]]
name = "B"
position_m = [2.99, 6.93]
orientation_deg = 87.8
[[anchors]]
name = "C"
position_m = [7.89, 8.44]
orientation_deg = -26.1
[[walls]]
points_m = [[0, 0], [9.79, 0.65]]
material = "metal"
[[walls]]
points_m = [[9.79, 0.65], [8.64, 16.46]]
material = "glass"
[[walls]]
points_m = [[8.64, 16.46], [0, 16.46]]
material = "concrete"
[[walls]]
points_m = [[0, 16.46], [0, 0]]
material = "metal"
[[walls]]
points_m = [[5.58, 9.87], [1.75, 12.03]]
material = "concrete"
[[walls]]
points_m = [[5.79, 11.87], [8, 11.87]]
material = "metal"
[[agents]]
name = "one"
start_m = [4.37, 11.41]
start_heading_deg = 126.3
waypoints_m = [[3.19, 13.03], [6.19, 14.12]]
step_m = 0.05
steps = 60
[filter]
particles = 256
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["grid", "adaptive", "network_grid"])
def test_three_anchors_behind_one_corner_turn_nobody(method):
    """One is in sight, all are heard over the corner: with it, too, as if off one wall, and turned by it.

    Without (M517) by anchor, (M549) and (M550) five noises of five ended metres off.
    """
    scene = gs.Scene.from_toml(PLAN, "corner")
    run = gs.map_scene(scene, gs.simulate(scene, "one", 17216), method, seed=17216, start="exact")
    error = np.hypot(*(run.trajectory.position_m - scene.track("one").position_m)[:, :2].T)
    assert error.max() < 0.5
