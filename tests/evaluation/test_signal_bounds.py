"""Bounds from samples: those of paths apart where nothing overlaps, higher where paths do."""

from dataclasses import replace

import numpy as np
import pytest
from delay_snapshots import BAND
from scene_samples import short

import gridslam as gs
from gridslam.evaluation.bounds import known_map_bound
from gridslam.evaluation.signal_bounds import signal_bound
from gridslam.simulation.image_source import true_paths
from gridslam.world.radio import SPEED_OF_LIGHT

STEPS = 12


@pytest.fixture(scope="module")
def room():
    """A few steps through a room with two anchors."""
    scene = short("seminar", STEPS)
    return scene, true_paths(scene, "agent1")


def kalman(scene, paths, deviation):
    """The known-map bound of distances measured with given deviations, by a Kalman filter at the truth."""
    track, anchors = scene.track("agent1"), scene.anchor_positions
    agent = scene.agent("agent1")
    start = np.array([agent.prior.position_m] * 2 + [agent.prior.velocity_mps] * 2) ** 2 / 3
    start[2:] += (agent.step_m / agent.interval_s) ** 2
    covariance, bounds = np.diag(start), []
    forward, push = np.eye(4), np.zeros((4, 2))
    forward[0, 2] = forward[1, 3] = 1.0
    push[[0, 1], [0, 1]], push[[2, 3], [0, 1]] = 0.5, 1.0
    for step in range(STEPS):
        if step:
            covariance = forward @ covariance @ forward.T
            covariance += scene.filter.acceleration_mps2**2 * push @ push.T
        for row in np.flatnonzero(paths.step == step):
            toward = np.append(track.position_m[step] - anchors[paths.anchor[row]], [0, 0])
            slope = toward / np.linalg.norm(toward)
            gain = covariance @ slope / (slope @ covariance @ slope + deviation[row] ** 2)
            covariance = covariance - np.outer(gain, slope @ covariance)
        bounds.append(np.sqrt(covariance[0, 0] + covariance[1, 1]))
    return np.array(bounds)


def test_bound_without_overlap_is_that_of_ranges(room):
    scene, paths = room
    direct = paths.take(paths.bounces == 0)
    beta = 1e7 * np.sqrt((41**2 - 1) / 12)
    deviation = SPEED_OF_LIGHT / (np.sqrt(8) * np.pi * beta * direct.amplitude)
    found = signal_bound(scene, "agent1", BAND, True, direct, fading=False)
    # the prior power of each path leaves a little of its amplitude unknown
    np.testing.assert_allclose(found, kalman(scene, direct, deviation), rtol=2e-2)


@pytest.mark.slow
def test_overlap_and_an_unknown_map_cost(room):
    scene, paths = room
    known = signal_bound(scene, "agent1", BAND, True, paths, draws=2)
    unknown = signal_bound(scene, "agent1", BAND, False, paths, draws=2)
    assert (known < unknown + 1e-9).all()
    assert known[-1] < 0.99 * unknown[-1]
    beta = 1e7 * np.sqrt((41**2 - 1) / 12)
    apart = kalman_of_images(scene, paths, SPEED_OF_LIGHT / (np.sqrt(8) * np.pi * beta * paths.amplitude))
    steady = signal_bound(scene, "agent1", BAND, True, paths, fading=False)
    assert (steady > apart).all()


def kalman_of_images(scene, paths, deviation):
    """As `kalman`, every path from the image that it seems to come from, each as if alone."""
    images, numbers = np.unique(np.round(_seeming(paths), 6), axis=0, return_inverse=True)
    posed = replace(paths, anchor=numbers.reshape(-1))

    class World:
        filter = scene.filter
        anchor_positions = images
        track = staticmethod(scene.track)
        agent = staticmethod(scene.agent)

    return kalman(World, posed, deviation)


def _seeming(paths):
    """Where paths (L,) seem to come from, (L, 2) m: their length along the way that they arrive."""
    hit = np.where(np.isnan(paths.points[:, 1]), paths.points[:, 0], paths.points[:, 1])
    toward = hit - paths.points[:, 3]
    return paths.points[:, 3] + paths.distance_m[:, None] * toward / np.linalg.norm(
        toward, axis=1, keepdims=True
    )


@pytest.mark.slow
def test_scores_of_a_run_on_samples_have_this_bound_and_no_heading():
    data = gs.Scene.load("overlap").model_dump(exclude_none=True)
    data["agents"][0]["steps"] = 5
    scene = gs.Scene.checked(data, "overlap")
    truth = gs.ground_truth(scene, "agent1")
    score = gs.map_scene(scene, gs.simulate(scene, "agent1", 1, what="signal"), "direct").score(truth)
    assert score["heading_rmse_deg"] is None
    paths = known_map_bound(scene, "agent1", truth.paths).position_m
    assert score["position_bound_m"] > 1.05 * np.sqrt(np.mean(paths**2))
