"""Where paths were reflected by walls of methods without cells, and what lies between."""

from types import SimpleNamespace

import numpy as np
import pytest
from map_samples import surfaces

import gridslam as gs
from gridslam.estimate_tables import PathEstimate, SurfaceEstimate, SurfaceStretches
from gridslam.maps.map import Map
from gridslam.maps.walls import WallSegments
from gridslam.runs.heard_stretches import heard_stretches, with_stretches
from gridslam.runs.unhit import unhit, unhit_words

WALL = 7


def wall(extent=(-5.0, 0.0)):
    """The line y = 2, whose tangent is (-1, 0)."""
    flat = np.zeros((1, 2, 2))
    line, one = np.array([[np.pi / 2, 2.0]]), np.ones(1)
    return SurfaceEstimate.from_lines(
        line, flat, one, one, one, extent_m=np.array([extent]), identity=np.array([WALL])
    )


def step(places, existence=1.0, double=False, y=2.0, agent=0.0):
    """Paths that bounce off the wall at x = `places`; double ones there last, and off another wall first."""
    count = len(places)
    none, there = np.full((count, 2), np.nan), np.column_stack([places, np.full(count, y)])
    other = np.zeros((count, 2))
    bounces = [other, there] if double else [there, none]
    points = np.stack([np.zeros((count, 2)), *bounces, np.ones((count, 2))], axis=1)
    pair = np.tile([WALL, 9] if double else [WALL, WALL], (count, 1))
    one = np.ones(count)
    paths = PathEstimate(np.zeros(count, int), pair, one, one, one, one, existence * one, points)
    return SimpleNamespace(paths=paths, position_m=np.array([agent, 0.0]))


def mapped(steps, found=None, earlier=None):
    """A map without cells whose surface was heard by these steps, its walls' ends in x, ascending."""
    table = wall() if found is None else found
    grid = Map.blank((-1, -1), 0.1, (60, 80), 0.01)
    whole = with_stretches(_with(grid, table), [steps], earlier)
    return whole, np.sort(whole.wall_segments().ends_m[:, :, 0], axis=1)[::-1]


def _with(grid, table, **more):
    names = ("origin_m", "cell_m", "evidence", "coefficient", "observed", "prior")
    return Map(*(getattr(grid, name) for name in names), surfaces=table, **more)


LEFT, RIGHT = np.arange(0, 3.01, 0.05), np.arange(4, 5.01, 0.05)


def test_a_door_is_open_whichever_bounce_hit_beside_it():
    grid, ends = mapped([step(LEFT), step(RIGHT, double=True)])
    np.testing.assert_allclose(ends, [[0, 3], [4, 5]], atol=0.06)
    np.testing.assert_allclose(np.abs(unhit(grid.wall_segments())[0, :, 0]), [4, 3], atol=0.06)


def test_gaps_as_short_as_cells_would_close_are_closed():
    _, ends = mapped([step(LEFT), step(np.arange(3.4, 5.01, 0.05))])
    np.testing.assert_allclose(ends, [[0, 5]], atol=0.06)


def test_paths_that_are_hardly_believed_in_and_strays_make_no_wall():
    steps = [step(LEFT), step(RIGHT, 0.4), step([3.98, 4.0, 4.02], 0.8), step([4.5, 4.52])]
    np.testing.assert_allclose(mapped(steps)[1], [[0, 3]], atol=0.06)


def test_bounces_of_a_line_that_was_elsewhere_then_make_no_wall():
    assert len(mapped([step(LEFT), step(RIGHT, y=2.4)])[1]) == 1


def test_an_agent_that_takes_long_steps_leaves_no_wall_of_dots():
    steps = [step([x], agent=2 * x) for x in np.arange(0, 5.01, 0.4)]
    np.testing.assert_allclose(mapped(steps)[1], [[0, 5]], atol=0.3)


def test_what_an_earlier_map_has_stays_a_wall():
    first, _ = mapped([step(LEFT), step(RIGHT)])
    _, ends = mapped([step(np.arange(2, 3.31, 0.05))], earlier=first)
    np.testing.assert_allclose(ends, [[0, 3.3], [4, 5]], atol=0.06)
    whole = _with(first, wall())  # of an earlier version: nobody knows better
    np.testing.assert_allclose(mapped([step(LEFT)], earlier=whole)[1], [[0, 5]], atol=0.06)


def test_a_surface_without_sure_bounces_is_no_wall_and_a_method_that_tells_no_paths_has_whole_ones():
    grid, ends = mapped([step(LEFT, 0.7)])
    assert len(ends) == len(grid.stretches) == 0
    grid, ends = mapped([step([])])
    assert grid.stretches is None
    np.testing.assert_allclose(ends, [[0, 5]], atol=1e-9)
    assert with_stretches(_with(grid, None), [[step(LEFT)]]).stretches is None
    assert heard_stretches([[], [step(LEFT)]], wall()) is not None


def test_map_keeps_its_stretches_in_a_file_and_refuses_others(tmp_path):
    grid, _ = mapped([step(LEFT), step(RIGHT)])
    grid.save(tmp_path / "map.h5")
    again = Map.load(tmp_path / "map.h5")
    np.testing.assert_array_equal(again.stretches.extent_m, grid.stretches.extent_m)
    np.testing.assert_array_equal(again.wall_segments().ends_m, grid.wall_segments().ends_m)
    for row, extent in ((1, [0.0, 1.0]), (0, [0.0, np.nan])):
        with pytest.raises(Exception, match="map: stretches"):
            _with(grid, wall(), stretches=SurfaceStretches(np.array([row]), np.array([extent])))


def test_only_neighbouring_stretches_of_one_surface_have_something_between_them():
    table = surfaces([(0.0, 2.0), (1.0, 2.0)])
    extent = np.array([[0.0, 1.0], [3.0, 4.0], [9.0, 10.0]])
    rows, ends = np.array([0, 0, 1]), np.stack([extent, np.zeros((3, 2))], axis=-1)
    np.testing.assert_array_equal(
        unhit(WallSegments(rows, table.identity[rows], extent, ends)), [[[1, 0], [3, 0]]]
    )


def test_the_longest_are_told_with_their_sum():
    ends = np.array([[[0.0, x], [1.0 / x, x]] for x in range(1, 7)])
    said = unhit_words(ends)
    assert said.startswith(
        ". Nothing was heard off 2.4 m in between: from (0.0, 1.0) to (1.0, 1.0), from (0.0, 2"
    )
    assert said.endswith(" and 2 more")
    assert unhit_words(ends[:0]) == ""


def test_a_map_in_mid_run_is_what_the_end_of_a_run_would_have():
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    scene = gs.Scene.checked({**data, "agents": [{**data["agents"][0], "steps": 25}]}, "room")
    heard, estimates = gs.simulate(scene, "agent1", seed=3), []
    slam = gs.AdaptiveSlam(scene, agent="agent1", seed=3)
    for step in range(25):
        estimates.append(slam.step(heard.scan(step)))
    run = gs.map_scene(scene, heard, method="adaptive", seed=3, start="exact")
    whole, ended = slam.map(), gs.map_so_far(slam, estimates)
    assert whole.stretches is None
    np.testing.assert_array_equal(ended.stretches.extent_m, run.map.stretches.extent_m)
    lengths = [np.ptp(found.wall_segments().extent_m, axis=1).sum() for found in (whole, ended)]
    assert 0 < lengths[1] < lengths[0]
