"""NEES against its distribution and by hand; a run step by step against its final score."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstest

import gridslam as gs
from gridslam.estimate_tables import PathEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.evaluation.consistency import follow, nees, nees_band, true_rays, virtual_anchors
from gridslam.evaluation.surface_truth import AudibleSurfaces, surface_scores
from gridslam.world.geometry import line_of_sfv, mirror


def test_nees_of_the_right_covariance_is_chi_square_and_of_a_bold_one_is_not():
    draw = np.random.default_rng(3)
    root = draw.normal(size=(2, 2))
    error = draw.normal(size=(4000, 2)) @ root.T
    covariance = np.broadcast_to(root @ root.T, (4000, 2, 2))
    assert kstest(nees(error, covariance), "chi2", args=(2,)).pvalue > 1e-3
    assert nees(error, covariance / 4).mean() == pytest.approx(4 * nees(error, covariance).mean())
    solved = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    np.testing.assert_allclose(nees(error, covariance), solved, rtol=1e-9)


def test_nees_of_a_direction_that_the_covariance_excludes_is_infinite():
    flat = np.diag([1.0, 0.0])
    assert nees([2.0, 0.0], flat) == 4
    assert nees([2.0, 1e-3], flat) == np.inf
    assert nees([0.0, 0.0], flat) == 0


def test_band_holds_the_mean_of_consistent_runs_as_often_as_it_says():
    low, high = nees_band(20, 2)
    means = np.random.default_rng(8).chisquare(2, (20, 3000)).mean(0)
    inside = ((low <= means) & (means <= high)).sum()
    assert binom.ppf(1e-4, 3000, 0.95) <= inside <= binom.ppf(1 - 1e-4, 3000, 0.95)
    assert nees_band(1, 2)[1] == pytest.approx(-2 * np.log(0.025))  # chi-square with 2: exponential
    narrow, wide = nees_band(100, 2), nees_band(5, 2)
    assert wide[0] < narrow[0] < 2 < narrow[1] < wide[1]


@pytest.fixture(scope="module")
def alcove():
    scene = gs.Scene.load("alcove")
    return scene, gs.ground_truth(scene, "agent1")


def perfect(scene, truth, off):
    """Estimates that are `off` (m) in x, with all surfaces found so far in place and no path but the true."""
    estimates = []
    audible = AudibleSurfaces.of(truth)
    for step in range(len(truth.trajectory)):
        line = line_of_sfv(audible.feature[audible.first <= step])
        one = np.ones(len(line))
        surfaces = SurfaceEstimate.from_lines(line, np.zeros((len(line), 2, 2)), one, one, one)
        at = truth.paths.at(step)
        paths = PathEstimate(
            at.anchor,
            np.full((len(at), 2), -1),
            at.distance_m,
            at.aod_rad,
            at.aoa_rad,
            at.amplitude,
            np.where(at.bounces < 2, 0.9, 0.4),
            at.points,
        )
        estimates.append(
            Estimate(
                step,
                truth.trajectory.time_s[step],
                truth.trajectory.position_m[step] + [off, 0],
                np.zeros(2),
                float(truth.trajectory.heading_rad[step]) + 2 * np.pi - 0.01,
                np.diag([0.01, 0.04, 1, 1, 1e-4]),
                surfaces,
                paths,
                one > 0,
                1.0,
                0.0,
            )
        )
    return estimates


@pytest.mark.slow
def test_steps_of_a_run_that_knows_all_but_its_place(alcove):
    scene, truth = alcove
    steps = follow(perfect(scene, truth, 0.2), scene, truth)
    np.testing.assert_allclose(steps.position_error_m, 0.2)
    np.testing.assert_allclose(steps.heading_error_rad, -0.01, atol=1e-9)
    np.testing.assert_allclose(steps.position_nees, 4)
    np.testing.assert_allclose(steps.heading_nees, 1, rtol=1e-6)
    assert (steps.surface_ospa_m < 1e-9).all()
    assert steps.surfaces[-1] == 5
    few = truth.paths.bounces < 2
    expected = np.zeros_like(steps.rays)
    np.add.at(expected, (truth.paths.anchor[few], truth.paths.step[few]), 1)
    np.testing.assert_array_equal(steps.rays, expected)
    np.testing.assert_allclose(steps.ray_belief, 0.9 * expected)
    there = AudibleSurfaces.of(truth).first[:, None] <= np.arange(steps.surface_error_m.shape[1])
    assert (np.isfinite(steps.surface_error_m) == there).all()
    assert (steps.surface_error_m[there] < 1e-9).all()


def test_ospa_over_time_ends_at_the_score_of_the_run(alcove):
    scene, truth = alcove
    estimates = perfect(scene, truth, 0.0)
    line = estimates[-1].surfaces.line[:3] + np.array([0.01, 0.05])
    one = np.ones(3)
    last = SurfaceEstimate.from_lines(line, np.zeros((3, 2, 2)), one, one, one)
    estimates[-1] = replace(estimates[-1], surfaces=last, detected=one > 0)
    score = surface_scores(last, truth)["surface_ospa_m"]
    assert follow(estimates, scene, truth).surface_ospa_m[-1] == pytest.approx(score)


def test_virtual_anchors_of_true_paths_are_mirror_images_of_the_anchors(alcove):
    scene, truth = alcove
    at = truth.paths.at(200)
    where, whose = virtual_anchors(
        at, truth.trajectory.position_m[200], float(truth.trajectory.heading_rad[200])
    )
    bent = np.flatnonzero(at.bounces > 0)
    assert set(at.bounces[bent]) == {1, 2}
    np.testing.assert_array_equal(whose, at.anchor[bent])
    for row, image in zip(bent, where, strict=True):
        expected = scene.anchor_positions[at.anchor[row]]
        for piece in at.segment[row][: at.bounces[row]]:
            expected = mirror(truth.segments.line[piece], expected)
        np.testing.assert_allclose(image, expected, atol=1e-9)


@pytest.mark.slow
def test_virtual_anchors_are_judged_anchor_by_anchor(alcove):
    scene, truth = alcove
    step = 200
    sure = perfect(scene, truth, 0.0)[step]
    at = truth.paths.at(step)
    whole = replace(sure, heading_rad=float(truth.trajectory.heading_rad[step]))

    def score(estimate, rows):
        certain = replace(estimate.paths, existence=np.where(rows, 0.9, 0.4))
        estimates = [replace(whole, paths=PathEstimate.empty())] * step + [replace(estimate, paths=certain)]
        return follow(estimates, scene, truth).image_ospa_m[-1]

    every = at.bounces >= 0
    counts = np.bincount(at.anchor[at.bounces > 0])
    assert (counts > 1).all()
    assert score(whole, every) == pytest.approx(0, abs=1e-9)
    assert score(whole, at.bounces > 0) == pytest.approx(0, abs=1e-9)  # line of sight has no virtual anchor
    missed = every.copy()
    missed[np.flatnonzero((at.bounces > 0) & (at.anchor == 0))[0]] = False
    assert score(whole, missed) == pytest.approx(5 / counts[0] / 2)
    shifted = replace(whole, position_m=whole.position_m + np.array([0.03, 0.04]))
    assert score(shifted, every) == pytest.approx(0.05)
    turned = replace(whole, heading_rad=whole.heading_rad + 0.01)
    apart = [at.distance_m[(at.anchor == anchor) & (at.bounces > 0)].mean() for anchor in (0, 1)]
    assert score(turned, every) == pytest.approx(2 * np.sin(0.005) * np.mean(apart))


def test_paths_are_counted_from_a_detection_probability_on(alcove):
    scene, truth = alcove
    every, likely = true_rays(scene, "agent1", truth), true_rays(scene, "agent1", truth, 0.5)
    assert every.sum() == len(truth.paths)
    assert (likely <= every).all()
    loud = scene.signal_model("agent1").detection_probability(truth.paths.amplitude) > 0.5
    assert likely.sum() == loud.sum() < len(truth.paths)


def test_offsets_of_clocks_are_no_part_of_virtual_anchors():
    scene = gs.Scene.load("exchange")
    truth = gs.ground_truth(scene, "agent1").first(1)
    own = perfect(scene, truth, 0)[0]
    off = replace(own.paths, distance_m=own.paths.distance_m - 30, existence=np.ones(len(own.paths)))
    own = replace(own, paths=off, heading_rad=float(truth.trajectory.heading_rad[0]))
    assert follow([own], scene, truth).image_ospa_m[0] == pytest.approx(0, abs=1e-6)
