"""Figures of hybrid SLAM show what they are of."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.estimate_tables import FeatureEstimate, PathEstimate, SurfaceEstimate
from gridslam.runs.run_files import AgentFiles
from gridslam.viewers.feature_plots import draw_features, draw_sights, true_sight
from gridslam.viewers.plots import draw_errors

STEPS = 190


@pytest.fixture(scope="module")
def screen():
    scene = gs.Scene.load("screen")
    return scene, gs.ground_truth(scene, "agent1")


def test_the_true_line_of_sight_is_hidden_behind_the_screen(screen):
    level = true_sight(screen[1], 0, STEPS)
    assert np.isnan(level[70:125]).all()
    assert np.isfinite(level[:66]).all()
    way = screen[1].trajectory.position_m[0] - screen[0].anchor_positions[0]
    assert level[0] == pytest.approx(10 ** (42 / 20) / np.hypot(*way))


def test_sights_are_drawn_as_estimated_and_as_they_are(screen):
    scene, truth = screen
    scan = gs.simulate(scene, "agent1", 1, what="signal").scan(0)
    paths = PathEstimate(
        np.array([0]), np.full((1, 2), -1), np.array([5.0]), np.zeros(1), np.zeros(1), np.array([10.0]),
        np.array([0.8]), np.full((1, 4, 2), np.nan),
    )  # fmt: skip
    estimates = [gs.Estimate.of_pose(scan, [0, 0], 0.0, np.eye(3), paths=paths)] * 3
    seen, power = draw_sights(scene, estimates, truth).axes
    np.testing.assert_allclose(seen.lines[0].get_ydata(), 0.8)
    np.testing.assert_allclose(power.lines[0].get_ydata(), 20.0)
    assert len(power.lines) == 2


def test_every_feature_has_a_mark_and_an_ellipse(screen):
    scene, truth = screen
    count, one, square = 3, np.ones(3), np.tile(0.1 * np.eye(4), (3, 1, 1))
    table = FeatureEstimate(
        np.arange(count), np.zeros(count, int), np.tile([0.5, 5.0], (count, 1)),
        np.array([[1.0, 2.0], [3.0, 1.0], [4.0, 4.0]]), one, one, one, square,
        np.array([0, 1, 2]), np.ones(count, int), np.ones(count, int),
    )  # fmt: skip
    figure = draw_features(scene, table, truth.trajectory)
    axes, (legend,) = figure.axes[0], figure.legends
    assert len(axes.patches) == count
    names = [text.get_text() for text in legend.get_texts()]
    assert {"true walls", "mirror", "scatterer", "free"} <= set(names)
    assert {text.get_text() for text in axes.texts} == set(scene.anchor_names)
    assert axes.get_xlim() == scene.grid.x_m
    wide = replace(table, covariance=100 * square, position_m=np.array([[1.0, 2.0], [3.0, 1.0], [90.0, 4.0]]))
    axes = draw_features(scene, wide, truth.trajectory).axes[0]
    assert (axes.get_xlim(), axes.get_ylim()) == (scene.grid.x_m, scene.grid.y_m)
    assert axes.get_title() == "1 feature far beyond the region"
    behind = replace(table, position_m=np.array([[1.0, 2.0], [3.0, 1.0], [16.0, 4.0]]))  # a wall's image
    axes = draw_features(scene, behind, truth.trajectory).axes[0]
    assert (axes.get_xlim(), axes.get_title()) == ((scene.grid.x_m[0], 16.5), "")
    two = gs.Scene.load("chamber")
    assert len(two.anchors) > 1
    axes = draw_features(two, replace(table, anchor=np.array([0, 1, 0])), truth.trajectory).axes[0]
    colors = [patch.get_edgecolor() for patch in axes.patches]
    assert colors[0] == colors[2] != colors[1]
    assert draw_features(scene, table.take([]), truth.trajectory, truth.trajectory).axes
    torn = replace(truth.trajectory, holes_s=np.array([truth.trajectory.time_s[[20, 60]]]))
    axes = draw_features(scene, table.take([]), truth.trajectory, torn).axes[0]
    (drawn,) = [line.get_xdata() for line in axes.lines if line.get_label() == "true track"]
    assert np.isnan(drawn).sum() == 40  # a line across the hole would be none of the track


def test_a_method_without_surfaces_gets_no_panel_of_them(screen):
    scene, truth = screen
    recording = gs.simulate(scene, "agent1", 1, what="signal")
    estimates = [gs.Estimate.of_pose(recording.scan(n), [0.0, 0.1 * n], 0.0, np.eye(3)) for n in range(3)]
    sheet = gs.Map.of_scene(scene)
    own = truth.trajectory
    track = gs.Trajectory(own.time_s[:3], own.position_m[:3], own.velocity_mps[:3], own.heading_rad[:3])
    line = SurfaceEstimate.from_lines([[0.0, 1.0]], np.eye(2)[None], [0.5], [0.1], [0.9])
    mapped = [replace(e, surfaces=line, detected=np.ones(1, bool)) for e in estimates]
    for believed, more in ((estimates, 0), (mapped, 1)):
        found = AgentFiles(recording, track, track, believed, sheet)
        axes = draw_errors(scene, "agent1", found, truth, takes="signal").axes
        labels = [one.get_ylabel() for one in axes]
        assert labels.count("surfaces") == more
        assert axes[-1].get_xlabel() == "step"
