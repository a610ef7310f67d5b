"""Births leave the measurement that is a line of sight to it, and may take any other."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.management.branching import placed
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.messages.sight_births import leave_sights
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import FRESH_SIGHT
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import tables
from gridslam.world.geometry import mirror

AT_1M = model_of().radio.amplitude_at_1m
SIGHT = [4.0, 0.0, np.pi, AT_1M / 4]
"""Distance (m), AoD and AoA (rad) and amplitude of the line of sight."""


def left(measured, los=0.99, variance=1e-6, walls=()):
    """Which of some measurements may still bear a wall, and the sums of their births, 1 and their numbers.

    The anchor at the origin faces east, as does the agent, 4 m east of it.
    """
    measured, model = np.array(measured, float), model_of("room", [[0.0, 0.0, 0.0]])
    mean = np.array([4.0, 0, 0, 0, 0, *walls])
    belief = Belief(mean, variance * np.eye(len(mean)))
    state = replace(state_of(belief), los=np.array([los]))
    scan = AnchorScan.of(
        0, np.zeros(2), 0.0, measured[:, :3], np.tile([0.05, 0.02, 0.02], (len(measured), 1)), measured[:, 3]
    )
    paths = predict_paths(state, 0, model, work=Workspace(model, 0))
    number = np.arange(len(measured), dtype=np.int32)
    births = Births(
        number, np.full((len(number), 2), -1), np.zeros((len(number), 2)), 1.0 + number, 0 * number
    )
    sums = np.ones((5, len(number)))
    sums[tables.NEW] += births.ratio
    ratios = LikelihoodRatios(
        None, None, np.zeros((12, len(paths))), np.zeros((5, len(paths), len(number))), sums
    )
    births, ratios = leave_sights(births, state, scan, paths, ratios, model.radio)
    return births.measurement.tolist(), ratios.new.tolist()


@pytest.mark.parametrize(
    ("beside", "taken"),
    [
        ([0, 0, 0, 1], True),
        ([0.25, 0.08, -0.08, 0.9], True),  # the pose is off by more than it claims
        ([0.35, 0, 0, 1], False),  # too late
        ([0, 0.12, 0, 1], False),  # six deviations beside where the anchor is
        ([0, 0, -0.12, 1], False),
        ([0, 0, 0, 0.7], False),  # too faint
        ([0, 0, 0, np.nan], True),  # no amplitudes are measured
        ([0, np.nan, 0, 1], True),  # nor where it departs
    ],
)
def test_what_is_a_line_of_sight(beside, taken):
    one = [*np.add(SIGHT[:3], beside[:3]), SIGHT[3] * beside[3]]
    births, sums = left([one, [9.0, 1.0, 1.0, 3.0]])
    assert births == ([1] if taken else [0, 1])
    assert sums == ([1.0, 3.0] if taken else [2.0, 3.0])


def test_it_takes_one_alone():
    """A wall 10 cm behind the anchor is as loud, and 0.2 m later."""
    wall = [4.2, 0.0, np.pi, 0.95 * SIGHT[3]]
    assert left([wall, SIGHT])[0] == [0]
    assert left([SIGHT, wall])[0] == [1]


def test_where_none_was_heard_walls_are_born():
    """A line of sight that never was heard may be hidden, and what is as long a reflection."""
    assert left([SIGHT], los=FRESH_SIGHT)[0] == [0]
    assert left([SIGHT], variance=0.5)[0] == [0]  # nobody knows how long it is


def test_what_a_known_wall_reflects_is_no_line_of_sight():
    """The wall y = 3 mirrors the anchor to (0, 6)."""
    length, wall = np.sqrt(52), [0.5 * np.pi, 3.0]
    assert left([[length, np.arctan2(6, 4), np.arctan2(6, -4), AT_1M / length]], walls=wall)[0] == [0]


@pytest.mark.parametrize("system", [gs.GridSlam, gs.AdaptiveSlam])
def test_a_pose_that_is_off_bears_no_wall_beside_an_anchor(system):
    """In the middle of `room`, by 21 cm and 9 degrees, and sure to 1 cm."""
    scene = gs.Scene.load("room")
    slam = system(scene, seed=1)
    scans = list(gs.simulate(scene, "agent1", 1))[:9]
    for scan in scans[:8]:
        slam.step(scan)
    state = slam.state
    off = state.belief.mean[[0, 1, 4]] + [0.05, 0.2, 0.15]
    after, _ = system.advance(placed(state, off, 1e-4 * np.eye(3), 1e-4), scans[8], slam.model, slam.work)
    born = after.belief.lines[~np.isin(after.surfaces.identity, state.surfaces.identity)]
    anchors = slam.model.anchor_positions
    beside = np.linalg.norm(mirror(born[:, None], anchors) - anchors, axis=-1)
    assert beside.min(initial=np.inf) > 1
