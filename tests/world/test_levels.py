"""Floor and ceiling: paths over them against images in space, what a scene may say, and who knows them."""

import numpy as np
import pytest
from scene_samples import raised, shortened, with_levels

import gridslam as gs
from gridslam.errors import InputError
from gridslam.evaluation.bounds import unknown_map_bound
from gridslam.evaluation.path_slopes import path_jacobian
from gridslam.simulation.image_source import true_paths
from gridslam.world.levels import CEILING, DIRECT, FLOOR, verticals_of

ROOM = gs.Scene.load("room")
TALL = with_levels(raised(shortened(ROOM, 4), [1.5, 1.1]))


def box_lengths(scene, place, height, anchor):
    """Lengths by image sources in space: over up to two walls, and none or one of floor and ceiling."""
    walls = [*scene.segments().line]
    planes = [np.array([np.cos(a), np.sin(a), 0.0, o]) for a, o in walls]
    levels = [np.array([0.0, 0.0, 1.0, level.height_m]) for level in (scene.floor, scene.ceiling)]

    def image(point, plane):
        return point + 2 * (plane[3] - plane[:3] @ point) * plane[:3]

    source = np.array(scene.anchors[anchor].position_m)
    lengths = {}
    for over, level in enumerate([None, *levels]):
        first = source if level is None else image(source, level)
        lengths[over] = np.linalg.norm(first - [*place, height])
        for number, plane in enumerate(planes):
            lengths[over, number] = np.linalg.norm(image(first, plane) - [*place, height])
    return lengths


def test_paths_over_floor_and_ceiling_are_those_of_images_in_space():
    paths, track = true_paths(TALL, "agent1"), TALL.track("agent1")
    assert set(paths.over) == {DIRECT, FLOOR, CEILING}
    for row in np.flatnonzero(paths.bounces < 2):
        place, anchor, over = track.position_m[paths.step[row]], paths.anchor[row], int(paths.over[row])
        lengths = box_lengths(TALL, place, 1.0, anchor)
        key = over if paths.bounces[row] == 0 else (over, int(paths.segment[row, 0]))
        assert paths.distance_m[row] == pytest.approx(lengths[key], abs=1e-9)


def test_each_path_comes_once_for_each_level_with_its_coefficient_and_the_same_azimuths():
    paths = true_paths(TALL, "agent1")
    straight, over = paths.take(paths.over == DIRECT), paths.take(paths.over == CEILING)
    assert len(straight) == len(over) == len(paths) // 3
    np.testing.assert_array_equal(straight.aod_rad, over.aod_rad)
    np.testing.assert_array_equal(straight.points, over.points)
    ratio = over.amplitude * over.distance_m / (straight.amplitude * straight.distance_m)
    np.testing.assert_allclose(ratio, 0.4)
    assert true_paths(raised(shortened(ROOM, 4), 1.0), "agent1").over.max() == DIRECT


def test_heights_of_images_by_hand():
    # anchor 2.5 m up, agent at 1 m, floor at 0, ceiling at 3 m: images at -2.5 m and at 3.5 m
    scene = with_levels(raised(ROOM, 1.5))
    ways = scene.verticals("agent1")
    np.testing.assert_allclose(ways.height, [[1.5, 1.5], [-3.5, -3.5], [2.5, 2.5]])
    np.testing.assert_allclose(ways.gain, [1.0, 0.5, 0.4])
    only = verticals_of(np.array([1.5]), 1.0, None, scene.ceiling)
    assert only.heights(np.array([CEILING, DIRECT]), np.array([0, 0])).tolist() == [2.5, 1.5]


def test_slopes_of_paths_over_levels_are_differences_of_their_lengths():
    paths = true_paths(TALL, "agent1").at(1)
    track, surface = TALL.track("agent1"), np.arange(4)
    slopes = path_jacobian(TALL, "agent1", paths, surface)[:, 0, :2]
    moved = []
    for step in (1e-6 * np.eye(2), -1e-6 * np.eye(2)):
        ways = [
            type(track)(track.time_s, track.position_m + s, track.velocity_mps, track.heading_rad)
            for s in step
        ]
        moved.append([true_paths(TALL, "agent1", way).at(1).distance_m for way in ways])
    np.testing.assert_allclose(slopes, (np.subtract(*moved) / 2e-6).T, atol=1e-6)


def test_levels_without_heights_or_on_the_wrong_side_are_refused_in_one_line():
    floor = {"height_m": 0.0, "coefficient": 0.5}
    for scene, changes, words in (
        (ROOM, {"floor": floor}, "floor: found a floor, but no anchor has a height"),
        (
            raised(ROOM, 1.5),
            {"floor": {**floor, "height_m": 1.0}},
            r"floor.height_m: found 1; allowed: a height below",
        ),
        (
            raised(ROOM, 1.5),
            {"ceiling": {**floor, "height_m": 2.4}},
            r"ceiling.height_m.*nearest of which is at 2.5",
        ),
        (raised(ROOM, 1.5), {"ceiling": {**floor, "coefficient": 0.0}}, "ceiling.coefficient"),
    ):
        with pytest.raises(InputError, match=words) as error:
            gs.Scene.checked({**scene.model_dump(exclude_none=True), **changes}, "room")
        assert "\n" not in str(error.value)
    assert gs.Scene.from_toml(TALL.to_toml()) == TALL


@pytest.mark.parametrize("method", [gs.VirtualAnchorSlam, gs.NetworkSlam])
def test_methods_whose_paths_go_over_walls_alone_refuse_them(method):
    with pytest.raises(InputError, match=r"floor: found a floor that reflects, for .*grid or adaptive"):
        method(TALL)


def test_known_levels_tell_more_than_none():
    without = unknown_map_bound(raised(shortened(ROOM, 4), [1.5, 1.1]), "agent1").position_m
    assert (unknown_map_bound(TALL, "agent1").position_m < without).all()
