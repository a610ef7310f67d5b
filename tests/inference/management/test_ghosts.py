"""Ghosts of double bounces yield to the walls that made them; walls don't."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import short

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief, append
from gridslam.inference.management import ghosts, merging
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.world.geometry import line_between, mirror
from gridslam.world.radio import REFLECTION_BINS

NEAR_M, AROUND_M = 0.5, 1.0
"""Gaps of virtual anchors that are looked at, as kernels have them."""
BINS = np.full(len(REFLECTION_BINS), 1 / len(REFLECTION_BINS))
WALLS = np.array([[np.pi, 2.0], [0.5 * np.pi, 3.0]])  # x = -2 and y = 3, which meet at (-2, 3)
PLACES = np.array([[0.8, 0.1], [1.2, -2.2]])


def world(line, existence=0.7, std=0.01, elsewhere=0.05):
    """Two sure walls and a third line that anchor 0 has heard, and the other anchor `elsewhere`."""
    belief, bank = Belief(np.zeros(5), 0.01 * np.eye(5)), SurfaceBank.empty(len(PLACES))
    for number, (other, chance) in enumerate([*((w, 0.999) for w in WALLS), (line, existence)]):
        belief = append(belief, np.asarray(other), np.square(std) * np.eye(2))
        bank = bank.add(number, chance, BINS, 0.0, (0, -1, -1), -1)
    bank.seen[:] = [40, 40, 12]
    bank.single[:] = [[1.0, 1.0, 0.1], [1.0, 1.0, elsewhere]]
    return bank, belief


def image_of_corner(place):
    """Line whose single bounce has the virtual anchor of the double bounce in the corner."""
    return line_between(place, mirror(WALLS[0], mirror(WALLS[1], place)))


def test_a_ghost_goes_and_takes_nothing_along():
    bank, belief = world(image_of_corner(PLACES[0]))
    left, rest = ghosts.drop_ghosts(bank, belief, PLACES)
    assert left.identity.tolist() == [0, 1]
    np.testing.assert_array_equal(rest.mean, belief.mean[:-2])
    np.testing.assert_array_equal(rest.covariance, belief.covariance[:-2, :-2])


@pytest.mark.parametrize(
    "unlike",
    [
        {"elsewhere": 0.9},  # another anchor hears it, where no double bounce explains it
        {"existence": 0.9999},  # surer than the walls
        {"std": 0.4},  # nobody knows yet where it is
    ],
)
def test_what_may_be_a_wall_stays(unlike):
    bank, belief = world(image_of_corner(PLACES[0]), **unlike)
    left, rest = ghosts.drop_ghosts(bank, belief, PLACES)
    assert (left, rest) == (bank, belief)


def test_a_wall_seen_as_often_as_others_stays():
    bank, belief = world(image_of_corner(PLACES[0]))
    bank.seen[2] = 30
    assert len(ghosts.drop_ghosts(bank, belief, PLACES)[0]) == 3


def test_without_departures_a_ghost_goes_that_is_seen_as_often_as_its_walls():
    """Both predict the very same distance and arrival, and share what is heard."""
    bank, belief = world(image_of_corner(PLACES[0]))
    bank.seen[2] = 30
    assert ghosts.drop_ghosts(bank, belief, PLACES, departs=False)[0].identity.tolist() == [0, 1]
    heard, where = world(image_of_corner(PLACES[0]), elsewhere=0.9)
    assert len(ghosts.drop_ghosts(heard, where, PLACES, departs=False)[0]) == 3


def test_departures_once_told_count_at_steps_without_any(monkeypatch):
    asked, scene = [], short("room", 6, 256)
    table = gs.simulate(scene, "agent1", 3)
    blank = replace(table, aod_rad=np.where(table.step < 3, table.aod_rad, np.nan))
    real = merging.drop_ghosts
    monkeypatch.setattr(merging, "drop_ghosts", lambda *a: (asked.append(a[-1]), real(*a))[1])
    for told, want in ((blank, [True] * 6), (replace(table, aod_rad=np.nan * table.aod_rad), [False] * 6)):
        slam = gs.GridSlam(scene, seed=1)
        asked.clear()
        for step in range(6):
            slam.step(told.scan(step))
        assert asked == want


def test_a_silent_ghost_goes_that_was_heard_for_long_before_its_walls_were_known():
    bank, belief = world(image_of_corner(PLACES[0]))
    bank.seen[:], bank.age[:] = [300, 14, 22], [200.0, 14.0, 76.0]
    assert len(ghosts.drop_ghosts(bank, belief, PLACES)[0]) == 3  # of peaks, totals count alone
    assert ghosts.drop_ghosts(bank, belief, PLACES, by_ratio=True)[0].identity.tolist() == [0, 1]
    bank.single[0, 2] = 0.5  # it is heard
    assert len(ghosts.drop_ghosts(bank, belief, PLACES, by_ratio=True)[0]) == 3
    bank.single[0, 2], bank.age[2] = 0.1, 13.0  # it came after both
    assert len(ghosts.drop_ghosts(bank, belief, PLACES, by_ratio=True)[0]) == 3
    bank.age[2], bank.seen[2] = 76.0, 60  # it was heard as often as the younger of them
    assert len(ghosts.drop_ghosts(bank, belief, PLACES, by_ratio=True)[0]) == 3


def test_walls_that_were_hardly_seen_take_nobodys_place():
    bank, belief = world(image_of_corner(PLACES[0]))
    bank.seen[1] = 3
    assert len(ghosts.drop_ghosts(bank, belief, PLACES)[0]) == 3


@given(st.floats(-3, 3), st.floats(0.5, 6))
@settings(max_examples=60, deadline=None)
def test_a_line_elsewhere_is_no_ghost(angle, offset):
    line = np.array([angle, offset])
    doubles = [mirror(WALLS[a], mirror(WALLS[1 - a], p)) for a in (0, 1) for p in PLACES]
    gaps = [np.linalg.norm(mirror(line, p) - d) for p in PLACES for d in doubles]
    bank, belief = world(line)
    kept = len(ghosts.drop_ghosts(bank, belief, PLACES)[0])
    if min(gaps) > AROUND_M:  # nearer ones may go, silent as this line is
        assert kept == 3


def test_no_surfaces_no_ghosts():
    bank, belief = SurfaceBank.empty(2), Belief(np.zeros(5), np.eye(5))
    assert ghosts.drop_ghosts(bank, belief, PLACES) == (bank, belief)


@pytest.mark.parametrize(("detected", "left"), [(0.05, 2), (0.9, 3)])
def test_a_silent_line_through_the_corner_goes(detected, left):
    angle = image_of_corner(PLACES[0])[0] + np.radians(5)
    line = np.array([angle, np.array([-2.0, 3.0]) @ [np.cos(angle), np.sin(angle)]])
    gap = np.linalg.norm(mirror(line, PLACES[0]) - mirror(WALLS[0], mirror(WALLS[1], PLACES[0])))
    assert NEAR_M < gap < AROUND_M
    bank, belief = world(line)
    bank.single[0, 2] = detected
    assert len(ghosts.drop_ghosts(bank, belief, PLACES)[0]) == left
