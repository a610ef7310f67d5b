"""Figures of runs on sampled signals show what they are of."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.estimate_tables import RingEstimate, SurfaceEstimate
from gridslam.runs.run_files import AgentFiles
from gridslam.viewers.plots import draw_errors, draw_rays
from gridslam.viewers.signal_plots import (
    BELIEVED,
    draw_gospa,
    draw_images,
    draw_signal,
    has_images,
    typical_step,
)

STEPS = 30


@pytest.fixture(scope="module")
def ran():
    scene = short("overlap", STEPS)
    recording = gs.simulate(scene, "agent1", 1, what="signal")
    slam = gs.DirectSlam(scene, waveform=recording.waveform)
    return scene, recording, slam, [slam.step(scan) for scan in recording]


def curves(axes):
    return {line.get_label(): np.array(line.get_xydata()) for line in axes.lines}


@pytest.mark.slow
def test_received_and_modelled_profiles_peak_at_the_line_of_sight(ran):
    scene, recording, _, estimates = ran
    figure = draw_signal(recording, estimates, 20, gs.ground_truth(scene, "agent1"))
    assert len(figure.axes) == 2
    for anchor, axes in enumerate(figure.axes):
        own = curves(axes)
        far = np.linalg.norm(recording.truth.position_m[20] - scene.anchor_positions[anchor])
        near = np.abs(own["received"][:, 0] - far) < 0.05
        assert own["received"][near, 1].max() > 5
        assert own["mean of the model"][near, 1].max() > 10
        assert np.abs(own["true paths"][:, 0] - far).min() < 0.01


def test_gospa_has_a_curve_for_each_anchor(ran):
    scene, _, _, estimates = ran
    own = curves(draw_gospa(scene, estimates, gs.ground_truth(scene, "agent1")).axes[0])
    assert set(own) == {"A", "B"}
    assert (own["A"][:, 1] >= 0).all()


def test_images_are_drawn_where_the_state_has_them(ran):
    """Both moments, both anchors: all likely places of rings, true virtual anchors, images found."""
    scene, _, slam, estimates = ran
    figure = draw_images(scene, estimates)
    figure.draw_without_rendering()
    assert len(figure.axes) == 4
    rings = slam.state.tentative.rings
    for anchor, axes in enumerate(figure.axes[1::2]):
        assert axes.get_title() == f"anchor {scene.anchor_names[anchor]} at step {STEPS - 1}"
        own = curves(axes)
        mine = (rings.anchor == anchor) & (rings.existence > BELIEVED)
        (marks,) = [c for c in axes.collections if c.get_label() == "places of rings"]
        places = rings.mean[mine][rings.weight[mine] >= 1e-3][:, -2:]
        np.testing.assert_allclose(np.array(marks.get_offsets()), places)
        assert len(places) > 20
        x, y = scene.anchor_positions[anchor]
        low, high = scene.segments().start.min(0), scene.segments().start.max(0)
        true = [[2 * low[0] - x, y], [2 * high[0] - x, y], [x, 2 * low[1] - y], [x, 2 * high[1] - y]]
        for corner in true:  # the outer walls' images, by hand
            assert np.linalg.norm(own["true virtual anchors"] - corner, axis=1).min() < 1e-9


def test_found_images_lie_at_the_mirror_images_of_their_surfaces(ran):
    scene, _, _, estimates = ran
    wall = SurfaceEstimate.from_lines(
        np.array([[0.0, 3.0]]), np.diag([1e-4, 1e-2])[None], *np.ones((3, 1)), owner=np.array([1])
    )
    last = replace(estimates[-1], surfaces=wall, detected=np.ones(1, bool))
    figure = draw_images(scene, [*estimates[:-1], last])
    first, second = figure.axes[1], figure.axes[3]
    x, y = scene.anchor_positions[1]
    np.testing.assert_allclose(curves(second)["images found"], [[6 - x, y]])
    assert len(second.patches) == 1 > len(first.patches)
    assert not len(curves(first)["images found"])


@pytest.mark.parametrize(
    ("believed", "expected"),
    [([1, 1, 1, 1, 1], 2), ([1, 0, 0, 0, 1], 0), ([0, 0, 0, 1, 0], 3), ([0, 0, 0], 1)],
)
def test_the_typical_step_is_one_at_which_a_path_is_believed_in(believed, expected):
    steps = [SimpleNamespace(paths=SimpleNamespace(existence=np.array([0.2, 0.9 * b]))) for b in believed]
    assert typical_step(steps) == expected


def test_images_are_of_methods_that_have_them_alone(ran):
    _, _, _, estimates = ran
    assert has_images(estimates)
    bare = [replace(e, rings=RingEstimate.empty(), surfaces=SurfaceEstimate.empty()) for e in estimates]
    assert not has_images(bare)


@pytest.fixture(scope="module")
def folder(ran):
    _, recording, slam, estimates = ran
    pose = [[getattr(e, name) for e in estimates] for name in ("position_m", "velocity_mps", "heading_rad")]
    track = gs.Trajectory(np.array([e.time_s for e in estimates]), *map(np.array, pose))
    return AgentFiles(recording, track, recording.truth, estimates, slam.map())


def test_rays_are_of_the_paths_believed_in_as_those_of_the_signals(ran, folder):
    paths = folder.estimates[20].paths
    assert (paths.existence > BELIEVED).sum() > 1
    doubted = replace(paths, existence=np.append(BELIEVED / 2, paths.existence[1:]))
    found = replace(folder, estimates=[replace(folder.estimates[20], paths=doubted)])
    axes = draw_rays(ran[0], "agent1", found, 0).axes[0]
    assert len(paths) == 2
    assert axes.get_title() == "estimated: 1 path at step 20"


def test_errors_leave_out_a_heading_that_nothing_tells_of(ran, folder):
    labels = [axes.get_ylabel() for axes in draw_errors(ran[0], "agent1", folder, takes="signal").axes]
    assert labels == ["position (cm)", "surfaces"]
