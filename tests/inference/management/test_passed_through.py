"""Walls of an earlier map that paths went through lose their existence; those that stand keep it."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.management.in_sight import LASTING
from gridslam.inference.management.passed_through import doubt_passed
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.parked import Parked
from gridslam.world.radio import BINS

MODEL = model_of("room")
WALL_M = 1.25
"""Where a wall along y stands, from y = -2 to 2 m."""


def inherited(sightings=LASTING, known=9.0):
    """A state that goes on from a map with a wall."""
    mean = np.concatenate([np.zeros(5), [0.0, WALL_M]])
    state = state_of(Belief(mean, 1e-4 * np.eye(len(mean))), existence=0.99)
    bank = replace(state.surfaces, seen=np.array([sightings]), extent=np.array([[-2.0, 2.0]]))
    cells = np.zeros(MODEL.grid.shape)
    cells[at(-2.0, 2.0)] = known
    grid = Grid.inherited(cells, cells != 0, np.zeros((*cells.shape, BINS), np.float32))
    return replace(state, surfaces=bank, grid=grid)


def at(low, high):
    """Cells along the wall."""
    (x, y), side = MODEL.grid.origin_m, MODEL.grid.cell_m
    return slice(round((low - y) / side), round((high - y) / side)), int((WALL_M - x) / side)


def crossed(state, low, high):
    """The same after paths went through a part of the wall."""
    evidence = state.grid.evidence.copy()
    evidence[:, at(low, high)[1] - 2 : at(low, high)[1] + 3][at(low, high)[0]] = -4.0
    return replace(state, grid=replace(state.grid, evidence=evidence))


def after(earlier, state, steps=1):
    for _ in range(steps):
        state = doubt_passed(earlier, state, MODEL)
    return float(state.surfaces.existence[0])


def test_a_wall_that_paths_went_through_all_along_is_gone_in_some_steps():
    earlier = inherited()
    now = crossed(earlier, -2.0, 2.0)
    assert after(earlier, now) == pytest.approx(1 / (1 + np.e**4 / 99))  # for four steps at once
    assert after(earlier, now, 2) < MODEL.settings.prune_below


@pytest.mark.parametrize("part", [(-2.0, -2.0), (-2.0, 1.0), (-0.5, 0.5)])
def test_a_wall_of_which_a_part_stands_keeps_its_existence(part):
    earlier = inherited()
    assert after(earlier, crossed(earlier, *part)) == 0.99


def test_a_wall_that_is_heard_stands_whatever_the_cells_say():
    earlier = inherited()
    now = crossed(earlier, -2.0, 2.0)
    heard = replace(now, surfaces=replace(now.surfaces, seen=now.surfaces.seen + 1))
    assert after(earlier, heard) == 0.99


def test_an_agent_without_an_earlier_map_goes_by_its_rays_as_before():
    earlier = inherited()
    own = replace(earlier, grid=replace(earlier.grid, withheld=None))
    assert after(own, crossed(own, -2.0, 2.0)) == 0.99
    young = inherited(sightings=LASTING - 1)
    assert after(young, crossed(young, -2.0, 2.0)) == 0.99


def test_walls_that_are_parked_out_of_sight_stay_as_they_are():
    """They come back into the joint belief before anything is heard through where they stood."""
    earlier = inherited()
    now = crossed(earlier, -2.0, 2.0)
    bank = now.surfaces.take(np.array([0]))
    parked = Parked(bank, np.array([0.0, WALL_M]), 1e-4 * np.eye(2), np.zeros((2, len(now.belief.mean))))
    held = doubt_passed(earlier, replace(now, parked=parked), MODEL)
    assert held.parked is parked
    assert held.surfaces.existence[0] < 0.99
