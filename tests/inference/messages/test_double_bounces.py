"""Births that a double bounce may explain as well wait until departures tell which it was."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.double_bounces import mirror_odds, put_off_double_bounces
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.leftovers import Leftovers
from gridslam.world.geometry import mirror, wrap
from gridslam.world.scan import Scan

ANGLE, DISTANCE = 0.1, 0.05
STD = [DISTANCE, ANGLE, ANGLE]


def heard(*values):
    """Measurements of the one anchor, at the origin and facing east."""
    value = np.array(values, float)
    return AnchorScan.of(0, np.zeros(2), 0.0, value, np.tile(STD, (len(value), 1)), np.full(len(value), 4.0))


def known_to(variance):
    """A state at (4, 0) that faces east."""
    return state_of(Belief(np.array([4.0, 0, 0, 0, 0]), np.diag(np.full(5, variance))), 1)


def odds(state, *values):
    model = model_of("room", [[0.0, 0.0, 0.0]])
    return mirror_odds(0, 0, state, heard(*values), model.radio, model)


def left_over(*values):
    """The same from the same place, a step each."""
    steps = len(values)
    return Leftovers(
        np.tile([4.0, 0, 0], (steps, 1)), np.tile(1e-12 * np.eye(3), (steps, 1, 1)), np.arange(steps),
        np.zeros(steps, np.int64), np.array(values, float), np.tile(STD, (steps, 1)), np.full(steps, 4.0),
    )  # fmt: skip


def test_odds_by_hand():
    # image (4, 6): a mirror's path departs at 2 atan2(6, 4) - pi/2, a corner's at pi/2. Variances: departure
    # 0.01; of the mirror's by the image 0.0641^2 0.36 + 0.1538^2 0.0025; N(0; 0.01154) over 0.5 / (2 pi)
    value = [6.0, 2 * np.arctan2(6, 4) - np.pi / 2, np.pi / 2]
    assert odds(known_to(1e-12), value) == pytest.approx(3.843, abs=1e-3)
    # straight on both depart alike: N(0; 0.0104) over 0.5 N(0; 0.02) + 0.5 / (2 pi)
    assert odds(known_to(1e-12), [6.0, 0.0, 0.0]) == pytest.approx(0.965, abs=1e-3)
    # a heading known to 0.3 rad turns a mirror's departure by 0.385 of it, and a corner's by all of it
    wide = replace(known_to(1e-12).belief, covariance=np.diag([1e-12, 1e-12, 1, 1, 0.09]))
    of_mirror = 0.0115385 + 0.384615**2 * 0.09
    double = 0.5 * np.exp(-0.5 * 1.17601**2 / 0.11) / np.sqrt(2 * np.pi * 0.11) + 0.5 / (2 * np.pi)
    by_hand = np.log(1 / np.sqrt(2 * np.pi * of_mirror) / double)
    assert odds(replace(known_to(1e-12), belief=wide), value) == pytest.approx(by_hand, abs=1e-4)


def test_one_departure_that_is_off_counts_as_one_of_all_that_came_from_the_image():
    single, corner = [6.0, 2 * np.arctan2(6, 4) - np.pi / 2, np.pi / 2], [6.0, np.pi / 2, np.pi / 2]
    state = known_to(1e-12)
    assert odds(state, single) > 3 > -3 > odds(state, corner)
    assert odds(replace(state, leftovers=left_over(*[corner] * 8)), single) < -3
    assert odds(replace(state, leftovers=left_over(*[single] * 8)), single) > odds(state, single) + 0.2
    elsewhere = [[3.0, np.pi / 2, np.pi / 2], [6.0, np.pi / 2, -1.0]]
    assert odds(replace(state, leftovers=left_over(*elsewhere)), single) == pytest.approx(odds(state, single))


def births_of(*hits):
    count = len(hits)
    return Births(
        np.arange(count, dtype=np.int32), np.array(hits, np.int32), np.zeros((count, 2)), np.full(count, 9.0),
        np.zeros(count, np.int32),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("variance", "bounces", "kept"), [(0.02, 2, [1, 2]), (0.02, 1, [0, 1, 2, 3]), (0.0004, 2, [0, 1, 2, 3])]
)
def test_what_waits(variance, bounces, kept):
    """Single bounces that depart as over a corner, while the position is vague; none without a departure."""
    corner, unmeasured = [6.0, np.pi / 2, np.pi / 2], [6.0, np.nan, np.pi / 2]
    model = replace(model_of("room", [[0.0, 0.0, 0.0]]), max_bounces=bounces)
    births = births_of((-1, -1), (-1, 0), (-1, -1), (-1, -1))
    scan = heard(corner, corner, unmeasured, corner)
    after = put_off_double_bounces(births, known_to(variance), scan, model.radio, model)
    assert after.measurement.tolist() == ([1, 2] if len(kept) == 2 else kept)
    assert (after is births) == (len(kept) == 4)


@pytest.mark.parametrize(("variance", "kept"), [(0.021, [2]), (0.019, [0, 1, 2])])
def test_without_an_arrival_nothing_is_born_while_the_position_is_vague(variance, kept):
    """Known to 0.2 m, both axes together: below, no image tells a corner from a mirror; (M558)."""
    wall, deaf = [6.0, 2 * np.arctan2(6, 4) - np.pi / 2, np.pi / 2], [6.0, np.pi / 2, np.nan]
    model, births = model_of("room", [[0.0, 0.0, 0.0]]), births_of((-1, -1), (-1, 0), (-1, -1))
    state = known_to(variance)
    after = put_off_double_bounces(births, state, heard(deaf, deaf, wall), model.radio, model)
    assert after.measurement.tolist() == kept
    alone = replace(model, max_bounces=1)
    assert put_off_double_bounces(births, state, heard(deaf, deaf, wall), alone.radio, alone) is births


def test_what_is_left_keeps_what_goes_with_it():
    corner, unmeasured = [6.0, np.pi / 2, np.pi / 2], [6.0, np.nan, np.pi / 2]
    support = np.arange(3.0)[:, None] * np.ones(20)
    births = replace(births_of((-1, -1), (-1, -1), (-1, -1)), support=support, seen=np.array([4, 5, 6]))
    model = model_of("room", [[0.0, 0.0, 0.0]])
    after = put_off_double_bounces(
        births, known_to(0.02), heard(corner, unmeasured, corner), model.radio, model
    )
    assert (after.measurement.tolist(), after.seen.tolist(), after.support[:, 0].tolist()) == (
        [1],
        [5],
        [1.0],
    )


ANCHOR, FLOOR, WALL = np.array([3.0, 2.0]), np.array([-np.pi / 2, 0.0]), np.array([0.0, 12.0])


def over(image, mirrored, pose):
    """What is heard of a virtual anchor, given the agent's own mirror image as the anchor sees it."""
    back, out = image - pose[:2], mirrored - ANCHOR
    return [np.hypot(*back), np.arctan2(out[1], out[0]), wrap(np.arctan2(back[1], back[0]) - pose[2])]


def corner(pose):
    return over(mirror(WALL, mirror(FLOOR, ANCHOR)), mirror(FLOOR, mirror(WALL, pose[:2])), pose)


def wall(pose):
    return over(mirror(WALL, ANCHOR), mirror(WALL, pose[:2]), pose)


@pytest.mark.parametrize("method", [gs.GridSlam, gs.AdaptiveSlam])
@pytest.mark.parametrize(("path", "found"), [(corner, 0), (wall, 1)])
def test_corner_bears_no_wall_while_the_position_is_vague_and_a_wall_does(method, path, found):
    """Heard without noise from a track whose start is known to 0.3 m; no line of sight, and no other path."""
    scene = gs.Scene.from_toml(
        "[grid]\nx_m = [-1, 13]\ny_m = [-1, 9]\ncell_m = 0.2\n[radio]\nsnr_at_1m_db = 34\n"
        '[[anchors]]\nname = "a"\nposition_m = [3, 2]\norientation_deg = 0\n'
        '[[agents]]\nname = "one"\nstart_m = [8, 4.5]\nstart_heading_deg = 180\n'
        "waypoints_m = [[5, 4.5]]\nstep_m = 0.05\n"
        "[filter]\nparticles = 500\n",
        "corner",
    )
    slam, most = method(scene, seed=1), 0
    for step in range(10):
        pose = np.array([8 - 0.05 * step, 4.5, np.pi])
        distance, departing, arriving = path(pose)
        one = np.array([distance]), np.array([departing]), np.array([arriving]), np.array([5.0])
        estimate = slam.step(Scan(step, 0.1 * step, np.array([0]), *one))
        most = max(most, int((estimate.surfaces.existence > 0.5).sum()))
    assert most == found
