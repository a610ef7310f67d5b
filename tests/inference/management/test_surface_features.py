"""Surfaces as features and back: images are where mirrors put them, as surely as the surfaces are known."""

from dataclasses import replace

import numpy as np
import pytest
from feature_samples import ANCHOR, LINES, learned, surfaces
from signal_worlds import signal_model

from gridslam.estimate_tables import MIRROR, SCATTERER
from gridslam.inference.management.features.surface_features import (
    between,
    image_features,
    mirror_surfaces,
    mirrored,
)
from gridslam.maps.map import Map
from gridslam.systems.front import inherit_surfaces
from gridslam.world.geometry import line_of_sfv


def images(lines):
    """By reflecting the anchor: once in each line, twice in each ordered pair."""

    def image(point, line):
        normal = np.array([np.cos(line[0]), np.sin(line[0])])
        return point + 2 * (line[1] - normal @ point) * normal

    once = [image(ANCHOR, line) for line in lines]
    return once, [image(once[0], lines[1]), image(once[1], lines[0])]


def test_images_of_surfaces_and_of_pairs_become_features():
    table, joint, _ = image_features(surfaces(), None, signal_model())
    once, twice = images(LINES)
    np.testing.assert_allclose(table.position_m, [*once, *twice])
    assert not table.bias_m.any()
    assert (table.kind == MIRROR).all()
    assert table.variance[2] / table.variance[0] == pytest.approx(0.49)
    assert joint.shape == (12, 12)
    assert np.linalg.eigvalsh(joint).min() > 0
    none = (None, surfaces(np.zeros((0, 2))))
    assert [len(image_features(one, None, signal_model())[0]) for one in none] == [0, 0]


def test_two_orders_of_walls_at_right_angles_are_one_image():
    lines = np.array([[0.2, 6.0], [0.2 + np.pi / 2, 5.0]])
    table, *_ = image_features(surfaces(lines), None, signal_model())
    assert len(table) == 3


def test_images_are_as_sure_as_the_surfaces_they_stand_in():
    draw, model = np.random.default_rng(0), signal_model()
    _, joint, _ = image_features(surfaces(deviation=(2e-3, 0.01)), None, model)
    rows = []
    for _ in range(4000):
        lines = LINES + draw.normal(size=LINES.shape) * [2e-3, 0.01]
        rows.append(np.concatenate([np.append(p, 0.0) for group in images(lines) for p in group]))
    found = np.cov(np.array(rows).T)
    keep = np.arange(12) % 3 < 2
    np.testing.assert_allclose(
        joint[np.ix_(keep, keep)], found[np.ix_(keep, keep)], atol=0.06 * np.abs(found).max()
    )


@pytest.mark.parametrize("angle", [0.2, 1.9, -2.5])
def test_slopes_of_lines_and_images_equal_differences(angle):
    step = 1e-6
    for line in (np.array([angle, 6.0]), np.array([angle, -6.0])):
        at, slope = mirrored(ANCHOR, np.zeros((2, 2)), line, 0)
        for column, way in enumerate(step * np.eye(2)):
            expected = (mirrored(ANCHOR, slope, line + way, 0)[0] - at) / step
            np.testing.assert_allclose(slope[:, column], expected, rtol=1e-4, atol=1e-4)
        found, back = between(ANCHOR, at)
        assert found[1] >= 0
        np.testing.assert_allclose(np.cos(found[0]) * found[1], np.cos(line[0]) * line[1])
        for column, way in enumerate(step * np.eye(2)):
            expected = (between(ANCHOR, at + way)[0] - found) / step
            np.testing.assert_allclose(back[:, column], expected, rtol=1e-4, atol=1e-4)


def test_mirror_images_become_surfaces_but_not_images_of_images():
    once, twice = images(LINES)
    found = mirror_surfaces(learned([*once, *twice]))
    np.testing.assert_allclose(found.line[np.argsort(found.line[:, 0])], LINES)
    np.testing.assert_allclose([line_of_sfv(sfv) for sfv in found.sfv_m], found.line)
    none = (
        {"kind": np.full(2, SCATTERER)},
        {"steps_seen": np.full(2, 3)},
    )
    for more in none:
        assert len(mirror_surfaces(learned(once, **more))) == 0
    assert len(mirror_surfaces(learned([once[0], once[0] + 0.05]))) == 1, "one wall, heard twice"


def test_what_reflects_in_one_method_does_in_the_other():
    once, twice = images(LINES)
    table = mirror_surfaces(learned([*once, *twice]))
    back, *_ = image_features(table, None, signal_model())
    np.testing.assert_allclose(np.sort(back.position_m, 0), np.sort([*once, *twice], 0), atol=1e-9)


def test_a_filter_by_surfaces_starts_from_the_mirrors_that_were_learned():
    import gridslam as gs
    from gridslam.inference.state.state import State

    once, twice = images(LINES)
    prior = replace(Map.blank((-15.0, -15.0), 0.5, (60, 60), 0.1), features=learned([*once, *twice]))
    state = inherit_surfaces(State.start(gs.Scene.load("room").filter_model()), prior)
    assert len(state.surfaces) == 2
