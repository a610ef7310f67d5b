"""Bounds against the Kalman filter, finite differences, and what must hold between them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import shortened

from gridslam.errors import InputError
from gridslam.evaluation.bounds import (
    AGENT,
    estimable_covariance,
    known_map_bound,
    predict_information,
    unknown_map_bound,
)
from gridslam.evaluation.path_slopes import surface_lines, whitened_jacobian
from gridslam.simulation.image_source import simulate_labelled, true_paths
from gridslam.world.geometry import mirror, sfv_covariance, wrap
from gridslam.world.scene import Scene


def linear_slam(draw, steps, landmarks):
    """A linear world: [x, v] of an agent on a line, and landmarks whose distances to it are measured."""
    size = 2 + landmarks
    forward, push = np.eye(size), np.zeros((size, 1 + landmarks))
    forward[0, 1] = 0.7
    push[:2, 0] = 0.245, 0.7
    push[2:, 1:] = np.eye(landmarks)
    variance = draw.uniform(0.01, 2.0, 1 + landmarks)
    looks = []
    for _ in range(steps):
        looking = np.zeros((draw.integers(1, 5), size))
        looking[:, 0] = draw.normal(size=len(looking))
        looking[np.arange(len(looking)), draw.integers(2, size, len(looking))] = 1.0
        looks.append((looking, draw.uniform(0.05, 3.0, len(looking))))
    return forward, push, variance, looks


def kalman(forward, push, variance, looks, covariance):
    for step, (looking, noise) in enumerate(looks):
        if step:
            covariance = forward @ covariance @ forward.T + (push * variance) @ push.T
        spread = covariance @ looking.T
        gain = spread @ np.linalg.inv(looking @ spread + np.diag(noise))
        covariance = covariance - gain @ spread.T
    return covariance


def tichavsky(forward, push, variance, looks, information):
    backward = np.linalg.inv(forward)
    for step, (looking, noise) in enumerate(looks):
        if step:
            information = predict_information(information, backward, push, variance)
        information = information + (looking.T / noise) @ looking
    return information


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), steps=st.integers(1, 12), landmarks=st.integers(1, 4))
@settings(max_examples=40, deadline=None)
def test_recursion_is_the_kalman_filter_in_a_linear_gaussian_world(seed, steps, landmarks):
    draw = np.random.default_rng(seed)
    world = linear_slam(draw, steps, landmarks)
    root = draw.normal(size=(2 + landmarks,) * 2)
    prior = root @ root.T + 0.1 * np.eye(2 + landmarks)
    expected = kalman(*world, prior)
    found = estimable_covariance(tichavsky(*world, np.linalg.inv(prior)))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_landmark_without_prior_is_the_limit_of_a_wide_prior_and_an_unseen_one_is_infinite(seed):
    draw = np.random.default_rng(seed)
    world = linear_slam(draw, 6, 3)
    looks = [(np.where(np.arange(5) == 4, 0.0, looking), noise) for looking, noise in world[3]]
    prior = np.diag([1.0, 0.5, 1e6, 1e6, 1e6])  # wider, and the Kalman filter loses its digits
    wide = kalman(*world[:3], looks, prior)
    found = estimable_covariance(tichavsky(*world[:3], looks, np.diag([1.0, 2.0, 0, 0, 0])))
    assert np.isinf(found[4]).all()
    seen = np.diag(wide) < 1e5
    assert (np.isfinite(np.diag(found)) == seen).all()
    np.testing.assert_allclose(found[np.ix_(seen, seen)], wide[np.ix_(seen, seen)], rtol=1e-3, atol=1e-3)


def test_sum_of_two_unknowns_alone_fixes_neither_and_leaves_the_third_alone():
    information = np.array([[4.0, 0, 0], [0, 1, 1], [0, 1, 1]])
    np.testing.assert_array_equal(
        estimable_covariance(information), [[0.25, np.inf, np.inf], [np.inf] * 3, [np.inf] * 3]
    )


def measured(agent, heading, anchor, chain):
    """Distance, AoD and AoA by image sources alone: chain of lines, first hit first."""
    image, mirrored = anchor, agent
    for line in chain:
        image = mirror(line, image)
    for line in reversed(chain):
        mirrored = mirror(line, mirrored)
    seen, leaving = image - agent, mirrored - anchor
    arrival, departure = np.arctan2(seen[1], seen[0]) - heading, np.arctan2(leaving[1], leaving[0])
    return np.array([np.hypot(*seen), departure, arrival])


@pytest.mark.slow
def test_joint_jacobian_is_that_of_finite_differences():
    scene = Scene.load("alcove")
    paths, track = true_paths(scene, "agent1"), scene.track("agent1")
    walls, lines, signal = scene.segments(), surface_lines(scene), scene.signal_model("agent1")
    surface = np.arange(len(lines))
    whitened = whitened_jacobian(scene, "agent1", paths, surface)
    kinds = set()
    for row in range(0, len(paths), 97):
        step, bounces = paths.step[row], paths.bounces[row]
        kinds.add(int(bounces))
        chain = walls.surface[paths.segment[row, :bounces]]
        state = np.concatenate(
            [track.position_m[step], [0, 0], [track.heading_rad[step]], lines[surface].ravel()]
        )

        def hear(state, row=row, chain=chain):
            own = state[AGENT:].reshape(-1, 2)
            anchor = scene.anchor_positions[paths.anchor[row]]
            return measured(state[:2], state[4], anchor, [own[s] for s in chain])

        expected = np.zeros((3, len(state)))
        for entry in range(len(state)):
            move = 1e-6 * (np.arange(len(state)) == entry)
            gap = hear(state + move) - hear(state - move)
            expected[:, entry] = np.array([gap[0], *wrap(gap[1:])]) / 2e-6
        std = np.array(
            [
                signal.distance_std(paths.amplitude[row]),
                signal.angle_std(
                    paths.amplitude[row], paths.aod_rad[row], signal.anchor_aperture[paths.anchor[row]]
                ),
                signal.angle_std(paths.amplitude[row], paths.aoa_rad[row], signal.agent_aperture),
            ]
        )
        np.testing.assert_allclose(whitened[row] * std[:, None], expected, rtol=1e-5, atol=1e-7)
    assert kinds == {0, 1, 2}


@pytest.fixture(scope="module")
def alcove():
    scene = Scene.load("alcove")
    return scene, true_paths(scene, "agent1")


@pytest.mark.slow
def test_unknown_map_costs_and_a_sharp_prior_gives_the_known_map_back(alcove):
    scene, paths = alcove
    known = known_map_bound(scene, "agent1", paths)
    unknown = unknown_map_bound(scene, "agent1", paths)
    assert (unknown.position_m > known.position_m).all()
    assert (unknown.heading_rad > known.heading_rad).all()
    sharp = unknown_map_bound(
        scene, "agent1", paths, 0.0, replace(unknown, information=1e12 * np.eye(len(unknown.information)))
    )
    np.testing.assert_allclose(sharp.position_m, known.position_m, rtol=1e-6)
    np.testing.assert_allclose(sharp.heading_rad, known.heading_rad, rtol=1e-6)
    blunt = unknown_map_bound(
        scene, "agent1", paths, before=replace(unknown, information=0 * unknown.information)
    )
    np.testing.assert_allclose(blunt.position_m, unknown.position_m)


@pytest.mark.slow
def test_second_agent_starts_from_what_the_first_one_learned(alcove):
    scene, paths = alcove
    first = unknown_map_bound(scene, "agent1", paths)
    second = unknown_map_bound(scene, "agent1", paths, before=first)
    assert (second.position_m <= first.position_m * (1 + 1e-9)).all()
    assert (second.surface_m[0] < first.surface_m[0]).all()
    # without a first look, the lines are exactly as uncertain as they were handed over
    deaf = unknown_map_bound(scene, "agent1", replace(paths, amplitude=1e-9 * paths.amplitude), 0.0, first)
    handed = np.linalg.inv(first.information)
    blocks = np.stack([handed[i : i + 2, i : i + 2] for i in range(0, len(handed), 2)])
    expected = np.sqrt(np.trace(sfv_covariance(first.line, blocks), axis1=1, axis2=2))
    np.testing.assert_allclose(deaf.surface_m[0], expected, rtol=1e-6)


@pytest.mark.slow
def test_static_walls_are_known_ever_better_and_jitter_forgets(alcove):
    scene, paths = alcove
    still = unknown_map_bound(scene, "agent1", paths, jitter_m=0.0)
    assert (np.diff(still.surface_m, axis=0) <= 1e-9).all()
    loose = unknown_map_bound(scene, "agent1", paths, jitter_m=0.01)
    assert (loose.surface_m >= still.surface_m - 1e-12).all()
    assert (np.diff(loose.surface_m, axis=0) > 0).any()
    assert (loose.position_m >= still.position_m - 1e-12).all()


@pytest.mark.slow
def test_surface_is_bounded_from_its_first_sight_on():
    scene = Scene.load("canyon")
    paths = true_paths(scene, "agent1")
    bound = unknown_map_bound(scene, "agent1", paths)
    walls = scene.segments()
    for column, number in enumerate(bound.surface):
        rows = (paths.segment >= 0) & (walls.surface[paths.segment] == number)
        first = paths.step[rows.any(1)].min()
        assert np.isinf(bound.surface_m[:first, column]).all()
        assert np.isfinite(bound.surface_m[-1, column])
    assert np.isfinite(bound.position_m).all()


@pytest.mark.slow
def test_given_that_all_paths_were_detected_the_bound_is_that_of_sure_detection():
    """(M371) with every path is (M47) with p_d = 1; clutter, -1, tells of nothing."""
    scene = shortened(Scene.load("room"), 12)
    sure = scene.model_copy(update={"radio": scene.radio.model_copy(update={"detection_probability": 1.0})})
    rows = np.append(np.arange(len(true_paths(scene, "agent1"))), -1)
    for bound in known_map_bound, unknown_map_bound:
        given_all = bound(scene, "agent1", detected=rows)
        np.testing.assert_allclose(given_all.position_m, bound(sure, "agent1").position_m, rtol=1e-12)


@pytest.mark.parametrize("detected", [np.ones(9, bool), [0.0], [-7], [100_000], [3, 3], [[0, 1]], "all"])
def test_detected_rows_that_are_none_are_refused(detected):
    with pytest.raises(InputError, match="detected"):
        known_map_bound(shortened(Scene.load("room"), 2), "agent1", detected=detected)


@pytest.mark.slow
def test_where_little_is_heard_the_bound_given_the_detections_is_larger_in_the_mean_square():
    """Jensen: the inverse of mean information is below the mean of inverses, [Tong2012detection]."""
    scene = shortened(Scene.load("room"), 30)
    faint = scene.model_copy(update={"radio": scene.radio.model_copy(update={"snr_at_1m_db": 17.0})})
    plain = np.square(known_map_bound(faint, "agent1").position_m)[10:]
    squares = []
    for seed in range(20):
        _, label = simulate_labelled(faint, "agent1", seed)
        squares.append(np.square(known_map_bound(faint, "agent1", detected=label).position_m)[10:].mean())
    assert np.mean(squares) > plain.mean() + 3 * np.std(squares) / np.sqrt(20)


def test_world_without_walls_has_a_bound_and_no_surfaces():
    scene = Scene.from_toml(
        'anchors = [{ name = "A", position_m = [0, 0] }, { name = "B", position_m = [4, 0] }]\n'
        "grid = { x_m = [-5, 5], y_m = [-5, 5] }\n"
        'agents = [{ name = "a", start_m = [0, 2], waypoints_m = [[2, 2]], steps = 5 }]\n'
    )
    bound, known = unknown_map_bound(scene, "a"), known_map_bound(scene, "a")
    assert bound.surface_m.shape == (5, 0)
    np.testing.assert_allclose(bound.position_m, known.position_m)
    assert (known.position_m < 0.3).all()
