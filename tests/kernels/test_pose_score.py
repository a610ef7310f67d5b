"""The kernel that scores poses by one scan, against its plain counterpart."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam import runtime
from gridslam.inference.management.poses.pose_fix import Sources
from gridslam.inference.management.poses.pose_score import IN_SIGHT, NEAREST_M, PoseLikelihood, clues_of
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.reference.pose_score import score_poses
from gridslam.world.geometry import mirror


@pytest.fixture(scope="module")
def scene():
    return gs.Scene.load("room")


def known_by(place, draw, count):
    line = np.stack([draw.uniform(-np.pi, np.pi, count), draw.uniform(-5, 5, count)], -1)
    line[0] = 0.0
    image = np.concatenate([place[None], mirror(line[1:], place)])
    return Sources(image, line, draw.uniform(0.2, 1.0, count), draw.uniform(0.2, 0.95, count))


def likelihood_by(scene, seed, height=0.0, missing=0.0, known=0):
    draw, model = np.random.default_rng(seed), scene.filter_model("agent1")
    scan = list(gs.simulate(scene, "agent1", seed=seed))[seed % 4]
    for name in ("distance_m", "aod_rad", "aoa_rad", "amplitude"):
        column = getattr(scan, name).copy()
        column[draw.random(len(scan)) < missing] = np.nan
        scan = replace(scan, **{name: column})
    scans = [replace(own, height=height * draw.normal()) for own in split_by_anchor(scan, model)]
    radios = [replace(model.radio, amplitude_at_1m=model.radio.amplitude_at_1m * g) for g in (0.9, 1.1)]
    over = [known_by(own.position, draw, known) for own in scans] if known else None
    return PoseLikelihood.of(scans, radios, model, over)


def poses_by(scene, seed):
    """Anywhere, at the truth and about it, and where an anchor stands."""
    draw, track = np.random.default_rng(seed), scene.track("agent1")
    near = np.column_stack([track.position_m, track.heading_rad])[:20]
    anywhere = draw.uniform([-6, -6, -7], [6, 6, 7], (300, 3))
    places = np.column_stack([scene.filter_model("agent1").anchor_positions, [0.3, -0.3]])
    return np.concatenate([anywhere, near, near + draw.normal(0, [0.05, 0.05, 0.02], near.shape), places])


@pytest.mark.slow
@pytest.mark.parametrize("widen", [1.0, 2.0])
@pytest.mark.parametrize(
    "odd", [{}, {"height": 2.0}, {"missing": 0.3}, {"known": 6}, {"known": 4, "missing": 0.2, "height": 1.0}]
)
def test_scores_are_those_of_the_plain_counterpart(scene, widen, odd):
    runtime.start()
    for seed in range(3):
        likelihood, poses = likelihood_by(scene, seed, **odd), poses_by(scene, seed)
        step = likelihood.terms[0].table.step
        expected = score_poses(IN_SIGHT, NEAREST_M, step, poses, clues_of(likelihood, widen))
        found = likelihood.score(poses, widen)
        # literals of a kernel are single: angles that turn once around are 2e-7 rad off
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=2e-4)
        assert np.ptp(expected) > 10


def test_many_sure_measurements_overflow_nothing_and_no_poses_have_no_scores(scene):
    likelihood, track = likelihood_by(scene, 1), scene.track("agent1")
    pose = np.array([[*track.position_m[1], track.heading_rad[1]]])
    each = np.array([own.score(pose, 1.0)[0] for own in likelihood.terms])
    many = PoseLikelihood(likelihood.terms * 40)
    assert many.score(pose)[0] == pytest.approx(40 * each.sum(), rel=1e-9)
    assert likelihood.score(pose[:0]).shape == (0,)
    assert PoseLikelihood(()).score(pose).tolist() == [0.0]
