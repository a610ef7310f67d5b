"""Elevations: signs by hand, slopes by differences, factors by samples, corrections by the stacked update."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scene_samples import replace_layers, tall

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages import elevations as elevation_messages
from gridslam.inference.messages.elevations import Foreseen, Seen, correct_by_elevations
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.kernels.primitives import tables
from gridslam.systems import adaptive, grid
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.grid import GridSlam

ROOM = gs.Scene.load("room")


def test_deviation_by_hand():
    # five layers a quarter wavelength apart: mean square 0.125 wavelengths^2; u = 10, level
    radio = tall().signal_model("agent1")
    std = radio.elevation_std(np.array([10.0]), np.array([0]), np.array([1.0]))
    np.testing.assert_allclose(std, 1 / (np.sqrt(8) * np.pi * 10 * np.sqrt(0.125)))


def some_belief(draw, rises=0):
    """An agent in the room, two walls, and rays of all ways over both."""
    mean = np.concatenate([[0.3, -0.4, 0.1, 0.0, 0.5], draw.normal(0, 0.02, rises), [0.1, 3.0, 1.5, 2.5]])
    root = 0.02 * draw.normal(size=(len(mean),) * 2)
    table = [[b, last, first, a] for a in range(6) for b, last, first in ((0, -1, -1), (1, 0, -1), (2, 1, 0))]
    rays = Rays(np.array(table, np.int32), np.ones(len(table)), np.ones(len(table)), (2, 6))
    return Belief(mean, root @ root.T + 1e-6 * np.eye(len(mean)), rises=rises), rays


@pytest.mark.parametrize("std", [0.0, 0.05])
def test_slopes_are_differences(std):
    model = tall(height_std_m=std).filter_model("agent1")
    belief, rays = some_belief(np.random.default_rng(0), len(model.rise_variance))
    found = Foreseen.of(belief, rays, model)
    assert (found.way == [0] * 6 + [1] * 12).all()
    for entry in range(len(belief.mean)):
        step = 1e-6 * np.eye(len(belief.mean))[entry]
        up, down = (
            Foreseen.of(replace(belief, mean=belief.mean + side * step), rays, model).value
            for side in (1, -1)
        )
        np.testing.assert_allclose(found.slope[:, entry], (up - down) / 2e-6, atol=1e-6)


def scan_at(scene, seed, step=4):
    model = scene.filter_model("agent1")
    return split_by_anchor(gs.simulate(scene, "agent1", seed=seed).scan(step), model)[0], model


@pytest.mark.parametrize("missing", [None, 0, 1])
def test_factors_are_means_over_the_belief(missing):
    scan, model = scan_at(tall(reports_std=True), 2)
    steep = scan.elevation.copy()
    if missing is not None:
        steep[:, missing] = np.nan
    scan = replace(scan, elevation=steep)
    seen, draw = Seen.of(scan, model.radio), np.random.default_rng(1)
    for way, sign in ((0, -1), (1, 1)):
        expected, std = 0.3, 0.1
        sampled = expected + std * draw.standard_normal(200_000)
        for m in range(3):
            density = np.ones_like(sampled)
            for end, turn in ((0, sign), (1, 1)):
                if np.isfinite(steep[m, end]):
                    own = steep[m, 2 + end]
                    gap = (steep[m, end] - turn * sampled) / own
                    density *= np.pi * np.exp(-0.5 * gap**2) / np.sqrt(2 * np.pi) / own
            ratio = seen.pairs(np.array([way]), np.array([m]), expected, std**2)[0]
            assert ratio == pytest.approx(density.mean(), rel=0.05, abs=1e-6)


def test_without_any_elevation_a_measurement_weighs_as_before():
    scan, model = scan_at(tall(reports_std=True), 2)
    seen = Seen.of(replace(scan, elevation=np.full_like(scan.elevation, np.nan)), model.radio)
    assert (seen.ratios(np.zeros((3, 1), int), np.zeros((3, 1)), np.ones((3, 1))) == 1).all()


@pytest.mark.parametrize("std", [0.0, 0.05])
def test_sure_paths_correct_as_one_stacked_update_does(std):
    scene = tall(height_std_m=std, reports_std=True)
    scan, model = scan_at(scene, 5)
    belief, rays = some_belief(np.random.default_rng(3), len(model.rise_variance))
    foreseen, share = Foreseen.of(belief, rays, model), np.zeros((len(rays), len(scan)))
    chosen = (1, 7, 13)
    near = foreseen.value[list(chosen)]
    steep = np.full((len(scan), 4), np.nan)
    gap, own = np.array([0.02, -0.01, 0.03]), np.array([0.02, 0.03, 0.04])
    steep[:3, 1], steep[:3, 3] = near + gap, own
    share[chosen, range(3)] = 1.0
    message = np.zeros((5, len(rays), len(scan)))
    message[4] = share
    state = replace(State.start(model), belief=belief)
    sums = np.zeros((12, len(rays))), message, np.zeros((5, len(scan))), np.zeros((1, 9))
    exchange = Exchange(0, rays, *sums, 512, np.zeros((0, 2)))
    after = correct_by_elevations(state, replace(scan, elevation=steep), exchange, model.radio, model).belief
    slope = foreseen.slope[list(chosen)]
    gain = belief.covariance @ slope.T
    spread = slope @ gain + np.diag(own) ** 2
    mean = belief.mean + gain @ np.linalg.solve(spread, gap)
    np.testing.assert_allclose(after.mean, mean, atol=1e-9)
    covariance = belief.covariance - gain @ np.linalg.solve(spread, gain.T)
    np.testing.assert_allclose(after.covariance, covariance, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("method", [GridSlam, AdaptiveSlam])
def test_elevations_tell_ways_apart_that_distances_do_not(method):
    # distances as rough as the ways differ: which way a path came is told by its elevation alone
    scene = tall(steps=24, distance_std_m=0.6, false_alarms=0.2)
    flat = replace_layers(scene, 1)
    errors = []
    for known in (scene, flat):
        slam, errors_of = method(known, seed=1), []
        for scan in gs.simulate(known, "agent1", seed=1):
            estimate = slam.step(scan)
            truth = known.track("agent1").position_m[scan.step]
            errors_of.append(np.linalg.norm(estimate.position_m - truth))
        errors.append(np.sqrt(np.mean(np.square(errors_of))))
    assert errors[0] < errors[1]


class Step:
    """What the messages of elevations were handed and returned in a run."""

    def __init__(self, scene, monkeypatch, system=GridSlam, seed=3, outliers=0.0):
        self.births, self.weights = [], []
        room = {GridSlam: grid, AdaptiveSlam: adaptive}[system]
        for name, found in (("weigh_by_elevations", self.births), ("weigh_elevations", self.weights)):
            monkeypatch.setattr(room, name, self.noting(getattr(elevation_messages, name), found))
        measured = gs.simulate(scene, "agent1", seed=seed)
        slam, draw = system(scene, seed=1), np.random.default_rng(seed)
        for k in range(12):
            scan = measured.scan(k)
            wrong = draw.random(len(scan)) < outliers
            steep = np.where(wrong, draw.uniform(-1.5, 1.5, len(scan)), scan.aoa_elevation_rad)
            slam.step(replace(scan, aoa_elevation_rad=steep))
            assert np.isfinite(slam.info.log_evidence)

    @staticmethod
    def noting(message, found):
        def noted(*arguments):
            handed = copy.deepcopy(arguments)  # ratios are the workspace's until the next evaluation
            result = message(*arguments)
            found.append((handed, copy.deepcopy(result)))
            return result

        return noted


@pytest.mark.slow
def test_births_weigh_as_means_over_distance_and_height_and_sums_stay_sums(monkeypatch):
    run = Step(tall(height_std_m=0.1), monkeypatch, outliers=0.2)
    for (births, _, scan, ratios, _, _), (after, summed) in run.births:
        m = births.measurement.astype(int)
        for ones, sums in ((births, ratios), (after, summed)):
            whole = 1 + np.bincount(m, ones.ratio, len(scan))
            np.testing.assert_allclose(sums.measured[tables.NEW], whole)
    births, state, scan, ratios, radio, model = run.births[0][0]
    near, m = scan.value.copy(), births.measurement.astype(int)
    near[:, 0] = 2.0  # of anchors 1.5 m above
    steep = np.tile([np.nan, 0.75, np.nan, 0.05], (len(scan), 1))
    close = replace(scan, value=near, elevation=steep)
    after, _ = elevation_messages.weigh_by_elevations(births, state, close, ratios, radio, model)
    anchor, draw = model.places[births.anchor], np.random.default_rng(4)
    assert len(m)
    assert np.allclose(anchor[:, 3], 1.5, atol=0.2)
    for n in range(len(m)):
        own = deviations(close, m[[n]], scan.amplitude[m[[n]]], near[m[[n]], 1:], radio)[0, 0]
        height = anchor[n, 3] + 0.1 * draw.standard_normal(400_000)
        angle = np.arcsin(np.clip(height / (2.0 + own * draw.standard_normal(400_000)), -1, 1))
        density = np.pi * np.exp(-0.5 * ((0.75 - angle) / 0.05) ** 2) / np.sqrt(2 * np.pi) / 0.05
        assert after.ratio[n] / births.ratio[n] == pytest.approx(density.mean(), rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("system", [GridSlam, AdaptiveSlam])
def test_every_message_of_a_measurement_is_multiplied_by_the_same_factor(monkeypatch, system):
    run = Step(tall(reports_std=True), monkeypatch, system)
    for (state, scan, paths, ratios, radio, model), after in run.weights:
        seen, path = Seen.of(scan, radio), Foreseen.of(state.belief, paths.rays, model)
        factor = seen.ratios(path.way[:, None], path.value[:, None], path.variance[:, None])
        for row in (tables.RATIO, tables.BETA):
            np.testing.assert_allclose(after.message[row], ratios.message[row] * factor)
        beta = after.message[tables.BETA]
        share = np.divide(beta, beta.sum(1, keepdims=True), out=np.zeros_like(beta), where=beta > 1e-30)
        np.testing.assert_allclose(after.measured[tables.EXPLAINED], (beta * share).sum(0), atol=1e-12)


def test_scenes_without_heights_make_nothing_of_elevations():
    measured = gs.simulate(ROOM, "agent1", seed=2).scan(3)
    elevations = np.full(len(measured), 0.4), np.full(len(measured), 0.02)
    elevated = replace(measured, aoa_elevation_rad=elevations[0], aoa_elevation_std_rad=elevations[1])
    one, other = (GridSlam(ROOM, seed=1) for _ in range(2))
    np.testing.assert_array_equal(one.step(measured).covariance, other.step(elevated).covariance)


def test_elevations_over_levels_are_as_rough_as_they_are_steep_themselves():
    scan, model = scan_at(tall(), 2)
    steep = np.full_like(scan.elevation, np.nan)
    steep[:, 1] = 1.0
    seen = Seen.of(replace(scan, elevation=steep), model.radio)
    anchor = np.zeros(len(scan), int)
    level = model.radio.elevation_std(np.maximum(scan.amplitude, model.radio.threshold), anchor, np.cos(1.0))
    np.testing.assert_allclose(seen.variance[1], level[:, 1] ** 2)
    assert (seen.variance[0] != seen.variance[1]).all()
