"""Particles of agent and noise, visibility and power of the line of sight."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from signal_worlds import received, signal_model

from gridslam import reference, runtime
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.messages.features.sight import (
    NODES,
    los_power,
    predict_particles,
    rescaled,
    start_particles,
    update_particles,
)
from gridslam.inference.state.features.features import FeatureBank, entries
from gridslam.inference.state.features.hybrid_state import JointBelief, ParticleBelief
from gridslam.world.radio import SPEED_OF_LIGHT

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
LOS, IMAGE = np.array([3.0, 4.0, 0.0]), np.array([-6.0, 2.0, 0.0])
AUDIBLE = np.array([True])


def prior(model, features=0):
    one = JointBelief(
        model.start_mean[:4], np.diag(model.start_variance[:4]), FeatureBank.empty(), np.array([0.5]),
        np.ones(1), np.ones(1),
    )  # fmt: skip
    for n in range(features):
        one = one.with_feature(0, entries(IMAGE, np.zeros(2)), np.eye(3), np.zeros(2), 500.0, n, 0)
    return one


def few(agent, noise, existence=0.6):
    count = len(agent)
    weight = np.arange(1.0, NODES + 1) / np.arange(1, NODES + 1).sum()
    return ParticleBelief(
        np.column_stack([agent, np.zeros((count, 2))]), np.reshape(noise, (1, -1)), np.array([existence]),
        np.geomspace(30, 3000, NODES)[None], weight[None],
    )  # fmt: skip


def density(model, z, place, heading, noise, los, image):
    """Log density by the covariance of all samples; the image's response is without the line of sight."""
    wave = model.waveform
    element = 2 * np.pi / wave.wavelength_m * wave.agent_element_m
    rate = 2 * np.pi * wave.offset_hz / SPEED_OF_LIGHT
    sight, rest = reference.columns(
        np.array([*place, heading]), np.array([[*IMAGE, 1.0]]), LOS[:2], element, wave.pulse, rate
    )
    covariance = noise * np.eye(len(z)) + los * np.outer(sight, sight.conj()) + image * rest @ rest.conj().T
    return -np.vdot(z, np.linalg.solve(covariance, z)).real - np.linalg.slogdet(np.pi * covariance)[1]


@pytest.mark.slow
@pytest.mark.parametrize(("features", "los"), [(0, 300.0), (1, 300.0), (0, 0.0), (1, 5.0)])
def test_messages_are_those_of_every_particle_node_and_visibility_listed(features, los):
    model, draw = signal_model(frequencies=15), np.random.default_rng(features)
    agent, noise = draw.normal(0, 0.05, (3, 2)), np.array([0.8, 1.0, 1.3])
    z = received(model, (0, 0), 0.4, [LOS, IMAGE], [los, 500.0 * features], draw)
    cloud, front, belief = few(agent, noise), Front(model.waveform), prior(model, features)
    found, moments = update_particles(cloud, belief, z, [front.tables(z)], AUDIBLE, 0.4, front, model, 1, 5)
    joint = np.zeros((3, NODES + 1))
    for p in range(3):
        for g, power in enumerate([*cloud.node[0], 0.0]):
            chance = 0.6 * cloud.weight[0, g] if power else 0.4
            joint[p, g] = np.log(chance / 3) + density(
                model, z.ravel(), agent[p], 0.4, noise[p], power, 500.0 * features
            )
    total = logsumexp(joint)
    share = np.exp(logsumexp(joint, axis=1) - total)
    nodes = np.exp(logsumexp(joint[:, :NODES], axis=0) - logsumexp(joint[:, :NODES]))
    assert moments.log_evidence == pytest.approx(total, abs=0.02)  # tables are linear
    np.testing.assert_allclose(moments.mean[:2], share @ agent, atol=2e-4)
    np.testing.assert_allclose(found.existence[0], 1 - np.exp(logsumexp(joint[:, NODES]) - total), atol=2e-3)
    np.testing.assert_allclose(found.weight[0], nodes, atol=2e-3)


def test_prediction_moves_agents_and_lets_sights_come_and_go():
    one = few(np.zeros((4000, 2)), np.ones(4000), existence=0.6)
    agent = one.agent.copy()
    agent[:, 2] = 1.5
    found = predict_particles(replace(one, agent=agent), 0.1, 2.0, 3, 7)
    assert found.agent[:, 0].mean() == pytest.approx(0.15, abs=1e-3)
    assert found.agent[:, 2].std() == pytest.approx(0.2, rel=0.05)
    assert found.existence[0] == pytest.approx(0.6 * 0.95 + 0.4 * 0.01)
    assert found.noise.std() == pytest.approx(0.1, rel=0.1)
    np.testing.assert_allclose(found.weight.sum(1), 1)
    # the power's logarithm spreads as that of the noise does
    level = np.log(one.node[0])
    sure = replace(one, weight=np.eye(NODES)[[8]], existence=np.array([1.0]))
    spread = predict_particles(sure, 0.1, 2.0, 3, 7).weight[0] @ (level - level[8]) ** 2
    assert spread == pytest.approx(1 / 100, rel=1e-6)


def test_random_numbers_are_a_function_of_seed_and_step():
    one = few(np.zeros((10, 2)), np.ones(10))
    first, again, later = (predict_particles(one, 0.1, 2.0, 3, step) for step in (7, 7, 8))
    np.testing.assert_array_equal(first.agent, again.agent)
    assert (first.agent != later.agent).any()


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e4])
def test_the_start_finds_noise_and_power_at_any_scale(scale):
    model, draw = signal_model(), np.random.default_rng(2)
    z = scale * received(model, (0, 0), 0.4, [LOS], [3000.0], draw)
    front = Front(model.waveform)
    tables = [front.tables(z)]
    cloud = start_particles(rescaled(prior(model), tables, AUDIBLE), tables, AUDIBLE, model, 1)
    assert cloud.noise.min() < scale**2 < cloud.noise.max()
    assert cloud.node[0, 0] < 3000 * scale**2 < cloud.node[0, -1]
    found, _ = update_particles(cloud, prior(model), z, tables, AUDIBLE, 0.4, front, model, 1, 0)
    assert 0.5 < los_power(found)[0] / (3000 * scale**2) < 2


def test_power_is_that_of_the_loudest_path_where_the_start_is_hidden():
    """Not that of the noise where the line of sight would arrive: it would never be heard when it does."""
    model, draw = signal_model(), np.random.default_rng(2)
    z = received(model, (0, 0), 0.4, [IMAGE], [1500.0], draw)
    tables = [Front(model.waveform).tables(z)]
    cloud = start_particles(rescaled(prior(model), tables, AUDIBLE), tables, AUDIBLE, model, 1)
    assert 1500 < cloud.node[0, -1] < 10 * 1500


def test_powers_of_handed_over_features_follow_the_scale_of_the_samples():
    model, draw = signal_model(), np.random.default_rng(2)
    z = 100 * received(model, (0, 0), 0.4, [LOS], [300.0], draw)
    found = rescaled(prior(model, features=1), [Front(model.waveform).tables(z)], AUDIBLE)
    assert found.features.power[0] == pytest.approx(500 * 1e4, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_where_few_particles_carry_the_weight_others_are_drawn_about_them(seed):
    model, draw = signal_model(), np.random.default_rng(seed)
    front = Front(model.waveform)
    start = model.start_mean[:2] + 0.3 * draw.standard_normal(2)
    z = received(model, start, 0.4, [LOS], [1e6], draw)
    tables, belief = [front.tables(z)], prior(model)
    belief = rescaled(belief, tables, AUDIBLE)
    cloud = start_particles(belief, tables, AUDIBLE, model, seed)
    given = cloud, belief, z, tables, AUDIBLE, 0.4, front, model, seed, 0
    _, plain = update_particles(*given)
    after, moments = update_particles(*given, bounded=True)
    assert plain.effective < 10
    assert moments.effective > 0.03 * len(cloud.agent) - 1
    off = moments.mean[:2] - start
    assert off @ np.linalg.solve(moments.covariance[:2, :2], off) < 20
    speed = np.sqrt(np.diagonal(np.cov(after.agent[:, 2:].T)))
    assert (speed > 0.2).all(), "nothing has told of it yet: 0.5 m/s"
