"""The joint belief of agent and features: slopes, information, and what a step makes of it."""

from dataclasses import replace

import numpy as np
import pytest
from signal_worlds import received, signal_model

from gridslam.inference.messages.features.heard_paths import HeardPaths
from gridslam.inference.messages.features.joint_update import TURNS_RAD, predict, update
from gridslam.inference.messages.features.path_products import paths_at, whiten
from gridslam.inference.messages.features.presence import log_likelihood
from gridslam.inference.state.features.features import FeatureBank, entries, place_jacobian, places
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.radio import SPEED_OF_LIGHT

POINTS = np.array([[3.0, 4.0, 0.0], [-6.0, 2.0, 0.0], [2.0, -5.0, 3.0]])  # line of sight, image, scatterer
POWERS = np.array([4000.0, 2000.0, 1200.0])
AUDIBLE = np.array([True])


def belief(agent=(0.0, 0.0, 0.5, 0.0), spread=0.1, features=2, power=POWERS):
    one = JointBelief(
        np.array(agent), np.diag(np.full(4, spread**2)), FeatureBank.empty(), np.array([0.9]), power[:1],
        np.ones(1),
    )  # fmt: skip
    for n in range(features):
        origin = np.array([0.3, -0.2])
        width = np.diag(np.square([0.05, 0.02, 0.05 * (POINTS[n + 1, 2] > 0)]))
        one = one.with_feature(0, entries(POINTS[n + 1], origin), width, origin, power[n + 1], n, 0)
    return one


def known_at(x, one, z, heading, model):
    """Paths at a state with an error of the heading, and products of their responses."""
    heard = HeardPaths(one, z[None], AUDIBLE, heading, model, (0.0, 0.0))
    heard.place(np.stack([x, x]), np.eye(len(x)))
    return heard, *heard.multiply()


def state_slopes(x, one, z, heading, power, model):
    """Slope and curvature by the joint state and the heading's error, and the value."""
    heard, _ = known_at(x, one, z, heading, model)
    found, jacobian = heard.slopes(power), heard.towards
    return jacobian.T @ found.score, jacobian.T @ found.curvature @ jacobian, found.log_density


def same(one, other):
    np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())


def responses(paths, wave):
    """Responses of all samples, their slopes by length and by angle, (3, N M, C), one by one."""
    count = len(paths.numbers) // 2
    rate = 2 * np.pi / SPEED_OF_LIGHT * wave.offset_hz
    element = 2 * np.pi / wave.wavelength_m * wave.agent_element_m
    out = []
    for length, angle in zip(paths.numbers[:count], paths.numbers[count:], strict=True):
        antenna = np.exp(1j * (element[:, 0] * np.cos(angle) + element[:, 1] * np.sin(angle)))
        bent = 1j * (element[:, 1] * np.cos(angle) - element[:, 0] * np.sin(angle)) * antenna
        spectrum = wave.pulse * np.exp(-1j * rate * length) / length
        sloped = (-1j * rate - 1 / length) * spectrum
        out.append([np.kron(antenna, spectrum), np.kron(antenna, sloped), np.kron(bent, spectrum)])
    return np.moveaxis(np.array(out), 0, -1)


@pytest.mark.slow
@pytest.mark.parametrize("frequencies", [40, 41])
def test_products_are_those_of_responses_made_in_full(frequencies):
    model, draw = signal_model(frequencies=frequencies), np.random.default_rng(frequencies)
    z = received(model, (0.05, -0.02), 0.3, POINTS, POWERS, draw)[0]
    paths, known = known_at(np.append(belief().mean, 0.02), belief(), z, 0.3, model)
    whole = np.concatenate(list(responses(paths, model.waveform)), 1)
    same(known.gram, whole.conj().T @ whole)
    same(known.matched, whole.conj().T @ z.ravel())
    assert known.energy == pytest.approx(np.vdot(z, z).real)
    covariance = 1.7 * np.eye(z.size) + (whole[:, :3] * POWERS) @ whole[:, :3].conj().T
    white = whiten(known.of(slice(0, 3)), POWERS, 1.7)
    solved = np.linalg.solve(covariance, whole[:, :3])
    same(white.own, np.einsum("zn,zn->n", whole[:, :3].conj(), solved).real)
    same(white.matched, solved.conj().T @ z.ravel())


def test_slopes_of_paths_by_the_state_are_differences():
    one, model, step = belief(), signal_model(), 1e-6
    at = np.append(one.mean + 0.01, 0.02)
    jacobian = paths_at(at[:-1], one, 0, 0.3 + at[-1], model).jacobian
    for entry, way in enumerate(step * np.eye(len(at))):
        more, less = (paths_at(x[:-1], one, 0, 0.3 + x[-1], model).numbers for x in (at + way, at - way))
        np.testing.assert_allclose(jacobian[:, entry], (more - less) / (2 * step), atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("entry", range(11))
def test_slopes_are_those_of_the_log_likelihood(entry):
    model, draw, step = signal_model(), np.random.default_rng(entry), 1e-6
    z = received(model, (0.05, -0.02), 0.3, POINTS, POWERS, draw)[0]
    at = np.append(belief().mean, 0.02)
    score, _, value = state_slopes(at, belief(), z, 0.3, POWERS, model)

    def density(x):
        return log_likelihood(known_at(x, belief(), z, 0.3, model)[1], POWERS, 1.0)

    way = step * np.eye(len(at))[entry]
    assert value == pytest.approx(density(at))
    assert score[entry] == pytest.approx(
        (density(at + way) - density(at - way)) / (2 * step), rel=1e-5, abs=1e-3
    )


def test_log_likelihood_is_that_of_the_covariance_of_all_samples():
    model, draw = signal_model(), np.random.default_rng(0)
    samples = received(model, (0.0, 0.0), 0.3, POINTS, POWERS, draw)[0]
    paths, known = known_at(np.append(belief().mean, 0.0), belief(), samples, 0.3, model)
    plain, z = responses(paths, model.waveform)[0], samples.ravel()
    covariance = 1.7 * np.eye(len(z)) + (plain * POWERS) @ plain.conj().T
    _, logdet = np.linalg.slogdet(np.pi * covariance)
    expected = -np.vdot(z, np.linalg.solve(covariance, z)).real - logdet
    assert log_likelihood(known, POWERS, 1.7) == pytest.approx(expected, abs=1e-8)


def test_information_is_the_scatter_of_the_score():
    # at the truth, over noise and phases: E[score score^T] = E[curvature], up to the volume's own share
    model, draw, one = signal_model(), np.random.default_rng(4), belief()
    scores, curvature = [], np.zeros((11, 11))
    for _ in range(400):
        z = received(model, one.mean[:2], 0.3, POINTS, POWERS, draw)[0]
        score, square, _ = state_slopes(np.append(one.mean, 0.0), one, z, 0.3, POWERS, model)
        scores.append(score)
        curvature += square / 400
    known = [0, 1, 4, 5, 7, 8, 10]
    scatter = np.var(scores, axis=0)[known] / np.diagonal(curvature)[known]
    assert (scatter > 0.75).all()
    assert (scatter < 1.3).all()


def test_a_path_that_is_not_heard_says_nothing_of_its_feature():
    model, draw, one = signal_model(), np.random.default_rng(1), belief()
    at, there, gone = np.append(one.mean, 0.0), [], []
    for _ in range(50):
        z = received(model, (0.0, 0.0), 0.3, POINTS, POWERS, draw)[0]
        there.append(state_slopes(at, one, z, 0.3, POWERS, model)[1][4, 4])
        z = received(model, (0.0, 0.0), 0.3, POINTS[[0, 2]], POWERS[[0, 2]], draw)[0]
        gone.append(state_slopes(at, one, z, 0.3, POWERS, model)[1][4, 4])
    assert np.mean(gone) < 0.1 * np.mean(there)


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariance_says():
    model, squares = signal_model(), []
    for seed in range(60):
        draw = np.random.default_rng(seed)
        one = belief()
        truth = one.mean + np.linalg.cholesky(one.covariance + 1e-18 * np.eye(10)) @ draw.normal(size=10)
        points = np.concatenate([POINTS[:1], places(truth, one.features.origin_m)])
        for step in range(3):
            z = received(model, truth[:2], 0.3, points, POWERS, draw)
            one, _ = update(one, z, AUDIBLE, 0.3, model, step)
        known = [0, 1, 4, 5, 7, 8, 9]
        off = (one.mean - truth)[known]
        squares.append(off @ np.linalg.solve(one.covariance[np.ix_(known, known)], off) / len(known))
    assert 0.75 < np.mean(squares) < 1.3  # 420 squares: a deviation of 0.07 about 1


def test_what_is_left_of_the_covariance_is_the_priors_and_the_samples_information():
    """Their precisions add up, where the maximum is; the prior is singular, an image has no extra length."""
    model, draw, one = signal_model(), np.random.default_rng(2), belief()
    z = received(model, (0.05, -0.05), 0.3, POINTS, POWERS, draw)
    found, _ = update(one, z, AUDIBLE, 0.3, model, 0)
    at = np.append(found.mean, 0.0)
    _, curvature, _ = state_slopes(at, one, z[0], 0.3, POWERS, model)
    before = np.pad(one.covariance, (0, 1))
    before[-1, -1] = model.waveform.heading_std_rad**2
    left = np.linalg.solve(np.eye(len(at)) + before @ curvature, before)[:-1, :-1]
    assert (np.diagonal(left)[:2] < 0.2 * np.diagonal(one.covariance)[:2]).all()
    scale = np.sqrt(np.outer(np.diagonal(left), np.diagonal(left))) + 1e-12
    np.testing.assert_allclose(found.covariance / scale, left / scale, atol=0.02)


def test_agent_and_features_stay_correlated():
    model, draw = signal_model(), np.random.default_rng(3)
    z = received(model, (0.05, 0.05), 0.3, POINTS[1:], POWERS[1:], draw)
    found, _ = update(belief(spread=0.3), z, AUDIBLE, 0.3, model, 0)
    correlation = found.covariance[0, 4] / np.sqrt(found.covariance[0, 0] * found.covariance[4, 4])
    assert abs(correlation) > 0.3


def test_a_heading_of_which_nothing_is_sure_turns_nothing():
    sure, vague = signal_model(), signal_model(heading_std_rad=0.5)
    draw = np.random.default_rng(5)
    z = received(sure, (0.0, 0.0), 0.5, POINTS, POWERS, draw)  # 0.2 rad beside what is measured
    right, _ = update(belief(), z, AUDIBLE, 0.3, vague, 0)
    wrong, _ = update(belief(), z, AUDIBLE, 0.3, sure, 0)
    assert np.hypot(*right.mean[:2]) < 0.1
    assert np.hypot(*right.mean[:2]) < 0.5 * np.hypot(*wrong.mean[:2])


def test_a_hidden_line_of_sight_is_noticed_and_one_that_comes_back_too():
    model, draw, one = signal_model(), np.random.default_rng(6), belief(spread=0.02)
    for seen, expected in ((True, True), (False, False), (False, False), (True, True)):
        rows = slice(None) if seen else slice(1, None)
        one, _ = update(
            one, received(model, (0, 0), 0.3, POINTS[rows], POWERS[rows], draw), AUDIBLE, 0.3, model, 0
        )
        assert (one.existence[0] > 0.5) == expected


@pytest.mark.slow
def test_powers_and_noise_go_to_what_is_received():
    model, draw = signal_model(), np.random.default_rng(7)
    one = replace(belief(spread=0.01, power=np.array([400.0, 8000.0, 1200.0])), noise=np.array([3.0]))
    for step in range(60):
        one, _ = update(one, received(model, (0, 0), 0.3, POINTS, POWERS, draw), AUDIBLE, 0.3, model, step)
        one = predict(replace(one, mean=np.array([0, 0, 0.5, 0, *one.mean[4:]])), 0.0, 1.0)
    np.testing.assert_allclose(one.noise, 1.0, rtol=0.1)
    np.testing.assert_allclose(one.los_power, POWERS[0], rtol=0.15)
    np.testing.assert_allclose(one.features.power, POWERS[1:], rtol=0.3)
    assert (one.features.steps_seen > 50).all()


def test_an_anchor_that_was_not_heard_changes_nothing():
    model, one = signal_model(), belief()
    found, evidence = update(one, np.zeros((1, 4, 41), complex), np.array([False]), 0.3, model, 0)
    np.testing.assert_allclose(found.mean, one.mean)
    np.testing.assert_allclose(found.covariance, one.covariance)
    assert evidence == 0


def test_evidence_falls_with_a_feature_that_is_not_there():
    model, with_it, without = signal_model(), 0.0, 0.0
    for seed in range(10):
        z = received(model, (0, 0), 0.3, POINTS[:2], POWERS[:2], np.random.default_rng(seed))
        with_it += update(belief(spread=0.02), z, AUDIBLE, 0.3, model, 0)[1]
        without += update(belief(spread=0.02, features=1), z, AUDIBLE, 0.3, model, 0)[1]
    assert without > with_it


def test_places_and_their_slopes_follow_from_the_entries():
    one, step = belief(), 1e-6
    np.testing.assert_allclose(places(one.mean, one.features.origin_m), POINTS[1:], atol=1e-12)
    jacobian = place_jacobian(one.mean)
    for entry in range(6):
        way = step * np.eye(10)[4 + entry]
        more, less = (places(one.mean + s * way, one.features.origin_m) for s in (1, -1))
        slope = ((more - less) / (2 * step))[entry // 3]
        np.testing.assert_allclose(jacobian[entry // 3, :, entry % 3], slope, atol=1e-8)


@pytest.mark.slow
def test_features_that_are_heard_beside_their_places_leave_errors_as_large_as_claimed():
    model, squares = signal_model(), {0.0: [], 0.1: []}
    for seed in range(40):
        for extent, found in squares.items():
            draw, one = np.random.default_rng(seed), replace(belief(), extent=extent)
            truth = one.mean + np.linalg.cholesky(one.covariance + 1e-18 * np.eye(10)) @ draw.normal(size=10)
            still = places(truth, one.features.origin_m)
            for step in range(4):
                far, beside = np.hypot(*(still[:, :2] - truth[:2]).T), truth.copy()
                far /= truth[[4, 7]] - truth[[6, 9]]
                beside[[4, 7]] += 0.1 * draw.normal(size=2)
                beside[[5, 8]] += 0.1 * TURNS_RAD * draw.normal(size=2) * far
                points = np.concatenate([POINTS[:1], places(beside, one.features.origin_m)])
                z = received(model, truth[:2], 0.3, points, POWERS, draw)
                one, _ = update(one, z, AUDIBLE, 0.3, model, step)
            off = (one.mean - truth)[:2]
            found.append(off @ np.linalg.solve(one.covariance[:2, :2], off) / 2)
    assert 0.65 < np.mean(squares[0.1]) < 1.4  # 80 squares: a deviation of 0.16 about 1
    assert np.mean(squares[0.0]) > 1.5 * np.mean(squares[0.1])


def test_without_an_extent_nothing_is_beside_its_place():
    model, draw, one = signal_model(), np.random.default_rng(8), belief()
    z = received(model, (0.05, -0.02), 0.3, POINTS, POWERS, draw)
    none, some = (update(replace(one, extent=e), z, AUDIBLE, 0.3, model, 0) for e in (0.0, 1e-7))
    np.testing.assert_allclose(none[0].mean, some[0].mean, atol=1e-8)
    assert none[1] == pytest.approx(some[1], abs=1e-6)
    wide = update(replace(one, extent=0.1), z, AUDIBLE, 0.3, model, 0)[0]
    assert (np.diagonal(wide.covariance)[[0, 1, 4, 7]] > np.diagonal(none[0].covariance)[[0, 1, 4, 7]]).all()
