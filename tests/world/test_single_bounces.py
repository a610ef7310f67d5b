"""Single bounces of many lines, places and poses at once."""

import numpy as np

from gridslam.world.geometry import trace, wrap
from gridslam.world.single_bounces import single_bounces


def drawn(count, seed=3):
    draw = np.random.default_rng(seed)
    line = np.stack([draw.uniform(-np.pi, np.pi, count), draw.uniform(-6, 6, count)], -1)
    place = np.column_stack(
        [draw.uniform(-5, 5, (count, 2)), draw.uniform(-3, 3, count), draw.normal(0, 2, count)]
    )
    return line, place, np.column_stack([draw.uniform(-5, 5, (count, 2)), draw.uniform(-3, 3, count)])


def test_they_and_their_slopes_are_those_of_the_tracer():
    line, place, pose = drawn(200)
    path = trace(pose[:, :2], place[:, :2], line, line, np.ones(200, int), place[:, 3])
    found = single_bounces(line, place, pose)
    np.testing.assert_allclose(found.value[:, 0], path.distance, rtol=1e-12)
    np.testing.assert_allclose(wrap(found.value[:, 1] - path.departure + place[:, 2]), 0, atol=1e-11)
    np.testing.assert_allclose(wrap(found.value[:, 2] - path.arrival + pose[:, 2]), 0, atol=1e-11)
    np.testing.assert_array_equal(found.possible, path.valid)
    assert 50 < found.possible.sum() < 150
    by_line, by_pose = found.slopes()
    np.testing.assert_allclose(by_line, path.jacobian[:, :, 3:5], atol=1e-9)
    np.testing.assert_allclose(by_pose, path.jacobian[:, :, :3], atol=1e-9)


def test_slopes_are_differences_and_shapes_broadcast():
    line, place, pose = drawn(5)
    found = single_bounces(line[:, None, None], place[:3, None], pose)
    assert found.value.shape == (5, 3, 5, 3)
    assert found.possible.shape == (5, 3, 5)
    by_line, by_pose = found.slopes()
    one = single_bounces(line[4], place[2], pose[1])
    np.testing.assert_array_equal(found.value[4, 2, 1], one.value)
    for whole, own in zip((by_line, by_pose), one.slopes(), strict=True):
        np.testing.assert_array_equal(whole[4, 2, 1], own)
    for slope, columns in ((by_line, 2), (by_pose, 3)):
        for column in range(columns):
            off = 1e-6 * np.eye(columns)[column]
            turn = (off, 0) if columns == 2 else (0, off)
            above, below = (
                single_bounces(line[:, None, None] + s * turn[0], place[:3, None], pose + s * turn[1]).value
                for s in (1, -1)
            )
            moved = above - below
            moved[..., 1:] = wrap(moved[..., 1:])
            np.testing.assert_allclose(slope[..., column], moved / 2e-6, atol=2e-5)
