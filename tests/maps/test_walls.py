"""Walls that were found: where along a surface there is one, and that nothing gets through it on the map
exported."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_samples import surfaces
from matplotlib.figure import Figure
from nav2_maps import FREE, OCCUPIED, UNKNOWN, nav2_load
from scene_samples import shortened

import gridslam as gs
from gridslam.drawing import map_figure
from gridslam.importers.geojson import read_walls, write_surfaces
from gridslam.maps.map import Map

CLEAR, DOUBT, HELD = -11.0, 0.5, 9.0
"""Evidence of cells: surely crossed, next to nothing (occupancy 0.02, called free), a wall."""
SIDE = 0.1


def street(y=2.05, length=12.0, extent=(0.0, 12.0), more=()):
    """All cells below a wall are free, those above unknown; the line of the wall lies at `y`, extent in x."""
    lines = [(np.pi / 2, y), *more]
    grid = Map.blank((0, 0), SIDE, (60, round(length / SIDE)), 0.01)
    observed, evidence = np.zeros(grid.shape, bool), np.zeros(grid.shape, np.float32)
    row = int(y / SIDE)
    observed[: row + 1], evidence[:row] = True, CLEAR
    evidence[row] = DOUBT
    coefficient = grid.coefficient.copy()
    coefficient[row, :, 3] = 5.0
    found = surfaces(lines, std=(1e-3, 1e-2), extent=(-extent[1], -extent[0]))
    return replace(grid, evidence=evidence, observed=observed, coefficient=coefficient, surfaces=found)


def changed(grid, x_m, y_m, evidence=None, hits=None, observed=None):
    """The map with other cells in a rectangle."""
    at = tuple(slice(round(a / SIDE), round(b / SIDE)) for a, b in (y_m, x_m))
    parts = {name: getattr(grid, name).copy() for name in ("evidence", "coefficient", "observed")}
    if evidence is not None:
        parts["evidence"][at] = evidence
    if hits is not None:
        parts["coefficient"][at] = 0.0
        parts["coefficient"][at][..., 3] = hits
    if observed is not None:
        parts["observed"][at] = observed
    return replace(grid, **parts)


def stretches(grid):
    """Ends in x of the walls along x, ascending."""
    return np.sort(np.sort(grid.wall_segments().ends_m[:, :, 0], axis=1), axis=0)


def leaks(values, grid, ends, reach=0.25, gap=0.004):
    """How many of the rays cast across a segment, straight and slanting, meet no occupied cell."""
    way = ends[1] - ends[0]
    length = max(float(np.hypot(*way)), 1e-9)
    along = way / length
    share = np.linspace(0, 1, max(3, int(length / 0.013)))
    count = 0
    for angle in (90, 45, 135, 60, -75):
        turn = np.radians(angle)
        ray = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ along
        step = gap * np.arange(-round(reach / gap), round(reach / gap) + 1)  # the crossing itself included
        point = ends[0] + share[:, None, None] * way + step[None, :, None] * ray
        cell, inside = grid.index(point)
        here = values[np.where(inside, cell[..., 0], 0), np.where(inside, cell[..., 1], 0)] == OCCUPIED
        crossed = grid.index(ends[0] + share[:, None] * way)[1]
        count += int((crossed & ~(here & inside).any(axis=1)).sum())
    return count


def four_connected(values):
    """Whether no diagonal move between free cells passes between two occupied ones."""
    wall = values == OCCUPIED
    slip = wall[:-1, :-1] & wall[1:, 1:] & ~wall[:-1, 1:] & ~wall[1:, :-1]
    return not (slip | (~wall[:-1, :-1] & ~wall[1:, 1:] & wall[:-1, 1:] & wall[1:, :-1])).any()


def test_wall_found_is_a_wall_for_planners_however_low_its_cells_are(tmp_path):
    grid = street()
    assert grid.free[20, 40]  # occupancy 0.02: what made planners drive through it
    grid.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    assert leaks(values, grid, grid.surfaces.ends_m[0]) == 0
    grid.to_nav2(tmp_path / "raw", raw=True)
    _, raw = nav2_load(tmp_path / "raw", "map")
    np.testing.assert_array_equal(raw == FREE, grid.free)
    np.testing.assert_array_equal(raw == OCCUPIED, grid.occupied)


def test_opening_that_rays_crossed_splits_a_surface():
    grid = changed(street(), (4, 7), (1.8, 2.4), CLEAR, 0.0, True)
    np.testing.assert_allclose(stretches(grid), [[0, 4], [7, 12]], atol=0.11)
    walls = grid.wall_segments()
    assert walls.surface.tolist() == [0, 0]
    np.testing.assert_allclose(walls.length_m, [5, 4], atol=0.11)  # ascending along the tangent, which is -x
    np.testing.assert_allclose(grid.surfaces.extent_m, [[-12, 0]])  # the file's stay as they are


@pytest.mark.parametrize(("far_side", "shown"), [(CLEAR, FREE), (DOUBT, UNKNOWN)])
def test_gap_is_free_for_planners_only_where_rays_went_from_one_side_to_the_other(tmp_path, far_side, shown):
    """Rays that run along a wall between two rows of cells free both, and never cross it."""
    grid = changed(street(y=2.0), (0, 12), (2.0, 3.5), CLEAR, observed=True)
    grid = changed(grid, (0, 12), (1.8, 2.1), DOUBT, 5.0)
    grid = changed(grid, (4, 5), (1.8, 2.1), CLEAR, 0.0)
    grid = changed(grid, (4, 5), (2.1, 2.2), far_side, 0.0)
    np.testing.assert_allclose(stretches(grid), [[0, 4], [5, 12]], atol=0.11)
    grid.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    assert (values[20, 41:49] == shown).all()


@pytest.mark.parametrize(
    ("x", "y", "evidence", "hits", "observed", "open_m"),
    [
        ((4, 4.2), (1.8, 2.4), CLEAR, 0.0, True, 0.0),  # too short for a door
        ((4, 4.5), (1.8, 2.4), CLEAR, 0.0, True, 0.5),
        ((4, 7), (1.8, 2.4), CLEAR, 90.0, True, 3.0),  # rays that crossed outweigh reflections
        ((4, 7), (1.8, 2.1), CLEAR, 0.0, True, 3.0),  # those behind it are unknown, which holds nothing
        ((4, 7), (2.0, 2.1), -1.0, 0.0, True, 3.0),  # nothing was ever hit over 3 m
        ((4, 4.45), (1.9, 2.4), -1.0, 0.0, False, 0.0),  # nothing was hit over much less than a door is wide
        ((4, 4.65), (1.9, 2.4), -1.0, 0.0, False, 0.65),
        ((4, 4.9), (1.9, 2.4), -0.3, 1.0, True, 0.9),  # faint hits, as are spread into a door from its jambs
        ((4, 4.9), (1.9, 2.4), 0.3, 1.0, True, 0.0),  # a wall that is faint where no ray speaks against it
        ((4, 4.9), (1.9, 2.4), -0.3, 5.0, True, 0.0),  # one that was hit for sure
        ((4, 7), (1.8, 2.4), HELD, 0.0, True, 0.0),
        ((11.6, 12), (1.8, 2.4), CLEAR, 0.0, True, 0.4),  # at an end there is no least length
    ],
)
def test_what_counts_as_an_opening(x, y, evidence, hits, observed, open_m):
    grid = changed(street(), x, y, evidence, hits, observed)
    if y == (1.8, 2.1):
        grid = changed(grid, x, (2.1, 2.4), CLEAR, 0.0, True)
    assert 12 - grid.wall_segments().length_m.sum() == pytest.approx(open_m, abs=0.25)


def test_door_of_which_half_is_open_and_half_unknown_is_no_wall():
    grid = changed(street(), (4, 4.2), (1.8, 2.4), CLEAR, 0.0, True)
    grid = changed(grid, (4.2, 5.5), (1.8, 2.4), 0.0, 0.0, False)
    np.testing.assert_allclose(stretches(grid), [[0, 4], [5.5, 12]], atol=0.11)


def test_wall_ends_before_a_stray_hit_beyond_an_opening():
    """One angle that is far off hits a cell beside a pillar, where rays went by."""
    grid = changed(street(extent=(0.0, 9.25)), (9, 9.2), (1.8, 2.4), CLEAR, 0.0, True)
    stray = changed(grid, (9.2, 9.3), (1.8, 2.4), -0.7, 12.0, True)
    np.testing.assert_allclose(stretches(stray), [[0, 9]], atol=0.06)
    goes_on = changed(street(extent=(0.0, 10.0)), (9, 9.2), (1.8, 2.4), CLEAR, 0.0, True)
    np.testing.assert_allclose(stretches(goes_on), [[0, 10]], atol=0.06)


def test_stretches_that_belong_together_do_so_whatever_lies_between_them():
    """Two pieces are long enough together for what each alone is not."""
    grid = changed(street(), (4, 5.8), (1.8, 2.4), 0.0, 0.0, False)
    for x in ((4.5, 4.6), (4.8, 5.3)):
        grid = changed(grid, x, (2.0, 2.1), DOUBT, 5.0, True)
    np.testing.assert_allclose(stretches(grid), [[0, 12]], atol=0.06)
    single = changed(grid, (4.8, 5.3), (1.8, 2.4), 0.0, 0.0, False)
    np.testing.assert_allclose(stretches(single), [[0, 4], [4.5, 4.6], [5.8, 12]], atol=0.06)


def test_faint_hits_in_open_air_are_no_wall():
    grid = changed(street(), (4, 9), (1.8, 2.4), CLEAR, 0.0, True)
    grid = changed(grid, (6, 6.6), (2.0, 2.1), -2.0, 0.4)
    np.testing.assert_allclose(stretches(grid), [[0, 4], [9, 12]], atol=0.11)
    grid = changed(grid, (6, 6.6), (2.0, 2.1), DOUBT, 4.0)  # a pillar between two gates
    np.testing.assert_allclose(stretches(grid), [[0, 4], [6, 6.6], [9, 12]], atol=0.11)


def test_without_cells_the_extent_is_the_wall_and_what_was_never_hit_is_none():
    bare = replace(Map.blank((0, 0), SIDE, (30, 60), 0.01), surfaces=surfaces([(0.4, 2.0)], extent=(-1, 2)))
    np.testing.assert_allclose(bare.wall_segments().ends_m, bare.surfaces.ends_m, atol=1e-9)
    never = replace(bare, surfaces=surfaces([(0.4, 2.0)], extent=(np.nan, np.nan)))
    assert len(never.wall_segments()) == len(Map.blank((0, 0), SIDE, (3, 3), 0.01).wall_segments()) == 0


def test_nothing_is_free_behind_a_wall_but_what_an_opening_shows(tmp_path):
    grid = changed(street(y=3.05), (0, 3), (3.1, 3.3), CLEAR, None, True)  # a band behind the wall
    grid = changed(grid, (9, 9.4), (5, 5.3), CLEAR, None, True)  # and a speck
    grid = changed(grid, (4, 7), (2.8, 5), CLEAR, 0.0, True)  # a court, seen through a gate
    grid.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    assert (values[31:33, :30] == UNKNOWN).all()
    assert (values[50:53, 90:94] == UNKNOWN).all()
    assert (values[32:48, 42:68] == FREE).all()
    assert (values[:29] == FREE).all()
    assert grid.free[31, 5]  # in the map they stay what they are


def test_planner_is_told_where_a_wall_is_not_proven(tmp_path):
    grid = changed(street(y=3.05), (2, 3), (3, 3.1), -1.0, 0.0, True)  # neither hit nor surely crossed
    grid = changed(grid, (6, 7), (2.9, 3.4), CLEAR, 0.0, True)
    grid.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    assert (values[30, 21:29] == UNKNOWN).all()
    assert (values[30, 61:69] == FREE).all()
    assert (values[30, 32:58] == OCCUPIED).all()


def test_cells_that_paths_told_next_to_nothing_of_are_unknown_to_planners(tmp_path):
    """Outermost rays of vague paths, behind a wall that was never heard there."""
    grid = changed(street(y=3.05, extent=(0.0, 8.0)), (8, 12), (3.0, 3.4), -0.1, 0.0, True)
    assert grid.free[31:34, 80:].all()
    grid.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    assert (values[31:34, 80:] == UNKNOWN).all()
    assert (values[:29] == FREE).all()


def test_room_on_the_other_side_of_a_wall_stays_free(tmp_path):
    """Two agents, two rooms, no door: either side has been seen."""
    grid = changed(street(y=3.05), (0, 12), (3.1, 5), CLEAR, None, True)
    grid.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    assert (values[33:49] == FREE).all()
    assert (values[:29] == FREE).all()


@pytest.mark.parametrize("far", [30.0, 1e9, 1e300])
@pytest.mark.parametrize("blank", [False, True])
def test_wall_of_any_length_is_drawn_as_far_as_the_grid_reaches(tmp_path, far, blank):
    """Maps of others may claim what they like; what a line claims far beyond the grid can't be looked up."""
    grid = street(extent=(-far, far))
    if blank:
        grid = replace(grid, observed=grid.observed & False, coefficient=grid.coefficient * 0)
    found = stretches(grid)
    assert len(found) == 1
    assert np.abs(found).max() < 30
    grid.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    assert (values[20] == OCCUPIED).all()
    beyond = replace(grid, surfaces=surfaces([(np.pi / 2, 2.05)], std=(1e-3, 1e-2), extent=(far, 2 * far)))
    assert len(stretches(beyond)) == 0


@pytest.mark.parametrize(
    "anchors",
    [
        {"anchors": ["a", "b"], "anchor_x_m": [1.0, 2.0], "anchor_y_m": [1.0]},
        {"anchors": ["a"], "anchor_x_m": ["west"], "anchor_y_m": [[1.0]]},
        {"anchors": ["a"], "anchor_x_m": [float("nan")], "anchor_y_m": [1e300]},
        {"anchors": [], "anchor_x_m": [], "anchor_y_m": []},
        {"anchor_x_m": 3},
    ],
)
def test_anchors_of_others_that_make_no_sense_are_none(tmp_path, anchors):
    grid = replace(street(), provenance=anchors)
    grid.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    assert (values[:19] == FREE).all()


coordinate = st.one_of(st.integers(-5, 65).map(lambda n: n / 10), st.floats(-0.5, 6.5))


@pytest.mark.slow
@given(ends=st.lists(st.tuples(*[coordinate] * 4), min_size=1, max_size=4), off=st.sampled_from([0.0, 0.037]))
@settings(max_examples=60, deadline=None)
def test_no_ray_gets_through_any_wall_of_the_exported_map(tmp_path_factory, ends, off):
    folder = tmp_path_factory.mktemp("nav2")
    points = np.array(ends).reshape(-1, 2, 2)
    way = points[:, 1] - points[:, 0]
    points, way = points[np.hypot(*way.T) > 0.02], way[np.hypot(*way.T) > 0.02]
    angle = np.arctan2(way[:, 1], way[:, 0]) - np.pi / 2
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    offset = (normal * points[:, 0]).sum(-1)
    reach = np.sort((points * np.stack([-normal[:, 1], normal[:, 0]], -1)[:, None]).sum(-1), axis=1)
    blank = Map.blank((off, -off), SIDE, (60, 60), 0.01)
    if not len(points):
        return
    free = np.full(blank.shape, DOUBT, np.float32)
    hits = np.zeros_like(blank.coefficient)
    hits[..., 3] = 90.0
    found = replace(surfaces(np.column_stack([angle, offset])), extent_m=reach)
    grid = replace(
        blank, evidence=free, observed=np.ones(blank.shape, bool), coefficient=hits, surfaces=found
    )
    walls = grid.wall_segments()
    assert set(walls.surface) == set(range(len(points)))
    grid.to_nav2(folder)
    _, values = nav2_load(folder, "map")
    assert sum(leaks(values, grid, one) for one in walls.ends_m) == 0
    alone = replace(grid, surfaces=grid.surfaces.take([0]))
    alone.to_nav2(folder)
    assert four_connected(nav2_load(folder, "map")[1])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["room", "alcove", "canyon"])
def test_no_ray_gets_through_the_walls_that_a_run_found(tmp_path, name):
    scene = shortened(gs.Scene.load(name), 60)
    done = gs.map_scene(scene, gs.simulate(scene, "agent1", 1), seed=1, particles=300).map
    done.to_nav2(tmp_path)
    _, values = nav2_load(tmp_path, "map")
    walls = done.wall_segments()
    assert len(walls) >= 2
    assert sum(leaks(values, done, ends) for ends in walls.ends_m) == 0
    assert ((values == FREE) <= done.free).all()
    done.to_nav2(tmp_path, raw=True)
    _, raw = nav2_load(tmp_path, "map")
    assert sum(leaks(raw, done, ends) for ends in walls.ends_m) > 0  # the cells alone are full of holes


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_tables_geojson_and_the_command_line_show_the_stretches(say, tmp_path):
    grid = changed(street(more=[(0.3, 1.0)]), (4, 7), (1.8, 2.4), CLEAR, 0.0, True)
    grid = replace(grid, surfaces=replace(grid.surfaces, extent_m=np.array([[-12, 0], [np.nan, np.nan]])))
    grid.save(tmp_path / "map.h5")
    assert say("export", "map.h5", "-o", "out").code == 0
    assert say("export", "map.h5", "-o", "raw", "--raw").code == 0
    with open(tmp_path / "out" / "surfaces.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["identity"] for row in rows] == ["0", "0", "1"]
    assert [row["start_x_m"] == "" for row in rows] == [False, False, True]
    assert abs(float(rows[0]["start_x_m"]) - float(rows[0]["end_x_m"])) == pytest.approx(5, abs=0.11)
    first, second = json.loads((tmp_path / "out" / "surfaces.geojson").read_text())["features"]
    assert first["geometry"]["type"] == "MultiLineString"
    assert first["properties"]["length_m"] == pytest.approx(9, abs=0.2)
    assert second["geometry"] is None
    assert len(read_walls(tmp_path / "out" / "surfaces.geojson")) == 2
    write_surfaces(tmp_path / "whole.geojson", grid.surfaces)
    assert len(read_walls(tmp_path / "whole.geojson")) == 1
    _, values = nav2_load(tmp_path / "out", "map")
    _, raw = nav2_load(tmp_path / "raw", "map")
    assert (values[20, 5:35] == OCCUPIED).all()
    assert (raw[20, 5:35] == FREE).all()
    assert (values[20, 45:65] == FREE).all()


def test_figure_draws_the_stretches():
    grid = changed(street(), (4, 7), (1.8, 2.4), CLEAR, 0.0, True)
    axes = Figure().subplots()
    map_figure.surfaces(axes, grid)
    drawn = np.array(axes.collections[0].get_segments())
    np.testing.assert_allclose(np.sort(drawn[:, :, 0].ravel()), [0, 4, 7, 12], atol=0.11)


@pytest.mark.parametrize(("wall_m", "found"), [(6.0, [0.0, 6.0]), (0.0, [10.0, 10.05])])
def test_half_a_cell_at_the_end_of_the_extent_is_drawn_only_if_nothing_else_is(wall_m, found):
    """As beside a pillar of `hall`, where a stray hit 20 cm beyond the corner was a stub of 5 cm."""
    grid = changed(street(extent=(0.0, 10.05)), (wall_m, 10.0), (1.7, 2.4), CLEAR, hits=0.0)
    np.testing.assert_allclose(stretches(grid), [found], atol=0.06)
