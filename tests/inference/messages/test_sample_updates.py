"""The papers' representation: weights against the kernels' sums and against events, moments, bookkeeping."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.management.representation import (
    JointGaussian,
    SeparateGaussians,
    SeparateParticles,
    representation_of,
)
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.messages.published.sample_updates import _densities, at_samples, sample_logs
from gridslam.inference.messages.ray_amplitudes import predict_amplitudes
from gridslam.inference.messages.updates import update_surfaces_and_agent
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.state.published.state_samples import StateSamples
from gridslam.kernels.primitives import tables
from gridslam.world.geometry import mirror, wrap

STEPS = 6


@pytest.fixture(scope="module", params=[0.0, 1.2])
def followed(request):
    """Adaptive SLAM by particles after some steps, of anchors at a height, and the scan that is next."""
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    for anchor in data["anchors"]:
        anchor["position_m"] = [*anchor["position_m"][:2], request.param]
    data["agents"][0]["height_m"] = 0.0
    scene = gs.Scene.checked(data, "room").with_filter(particles=960, representation="particles")
    recorded = list(gs.simulate(scene, "agent1", 3))
    slam = gs.AdaptiveSlam(scene, seed=2)
    for scan in recorded[:STEPS]:
        slam.step(scan)
    assert len(slam.state.surfaces) >= 3
    return slam, recorded[STEPS]


@pytest.fixture(scope="module")
def evaluated(followed):
    slam, scan = followed
    state, work = slam.state, slam.work
    work.begin()
    own = split_by_anchor(scan, slam.model)[0]
    paths = at_samples(predict_paths(state, 0, slam.model, work=work), state)
    amplitudes = predict_amplitudes(state, paths, own, slam.model.radio, work=work)
    _, ratios = evaluate(own, paths, np.ones(len(paths)), amplitudes, slam.model.radio, slam.model, work=work)
    ratios.new[:] = 1.0
    _, exchange = update_surfaces_and_agent(state, own, paths, ratios, np.zeros(2), slam.model, work=work)
    ratios = replace(ratios, odds=exchange.odds, message=exchange.message, measured=exchange.measured)
    return state, own, paths, ratios, slam.model


def test_kernels_average_over_the_very_particles(evaluated):
    """What the kernel finds at them, path by path and pair by pair, by another implementation."""
    state, _, paths, ratios, model = evaluated
    some = 0
    for row in range(len(paths)):
        for n in range(ratios.pairs.start[row], ratios.pairs.start[row + 1]):
            m = ratios.pairs.index[n, 1]
            only = np.zeros_like(ratios.message[tables.NU])
            only[row, m] = 1.0
            possible, density = _densities(
                state.samples, paths.rays.table[row], row, ratios, only, model.places
            )
            expected = density[possible].sum() / max(possible.sum(), 1)
            if possible.mean() > 0.1 and expected > 1e-3:
                some += 1
                assert ratios.message[tables.RATIO, row, m] == pytest.approx(expected, rel=0.01)
    assert some > 5


@pytest.mark.parametrize("share", [1.0, 1e-6, 0.0])
def test_weights_of_a_single_bounce_are_those_of_its_events(evaluated, share):
    """Where the measurement is the path's, where that is in doubt, and where the path went unheard."""
    state, _, paths, ratios, model = evaluated
    table = paths.rays.table
    caused = ratios.responsible.sum(1) > 0.5
    row = np.flatnonzero((table[:, tables.BOUNCES] == 1) & caused)[0]
    quiet = replace(ratios, message=ratios.message.copy())
    quiet.message[tables.RESPONSIBLE] = 0.0
    quiet.message[tables.RESPONSIBLE, row] = ratios.message[tables.RESPONSIBLE, row]
    samples, s = state.samples, table[row, tables.LAST]
    exists, ray, missed, open_ = 0.6, 0.7, 0.2, 0.9
    known = np.where(np.arange(len(state.surfaces)) == s, exists, 1.0)
    quiet.message[tables.NU] *= share
    quiet = replace(quiet, odds=quiet.odds.copy())
    for name, value in (("SURFACES", exists), ("EXISTENCE", ray), ("DETECTED", 1 - missed), ("OPEN", open_)):
        quiet.odds[getattr(tables, name), row] = value
    logs, surfaces = sample_logs(samples, known, paths, quiet, model.places)
    # by mirrors and scipy's densities, as a sum over the surface, the ray, and what caused what
    place = model.places[0]
    image = mirror(samples.lines[s], place[:2])
    toward = image - samples.agent[:, :2]
    arrival = np.arctan2(toward[:, 1], toward[:, 0])
    values = [
        np.sqrt((toward**2).sum(-1) + place[3] ** 2),
        wrap(2 * samples.lines[s, :, 0] - arrival - place[2]),
        wrap(arrival - samples.agent[:, 4]),
    ]
    sides = (
        samples.agent[:, :2] * np.stack([np.cos(samples.lines[s, :, 0]), np.sin(samples.lines[s, :, 0])], -1)
    ).sum(-1)
    assert (sides < samples.lines[s, :, 1]).all()  # possible at all of them
    detected_there = np.zeros(len(samples))
    for n in range(ratios.pairs.start[row], ratios.pairs.start[row + 1]):
        pair, m = ratios.pairs.pair[n], ratios.pairs.index[n, 1]
        density = norm.pdf(values[0], pair[0], np.sqrt(pair[3]))
        for kind in (1, 2):
            density = density * norm.pdf(wrap(values[kind] - pair[kind]), scale=np.sqrt(pair[3 + kind]))
        detected_there += share * ratios.message[tables.NU, row, m] * pair[6] * density
    there = ray * (open_ * (detected_there + missed) + 1 - open_) + 1 - ray
    np.testing.assert_allclose(logs, np.log(exists * there + 1 - exists), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(surfaces[s], np.log(there), rtol=1e-6, atol=1e-9)
    assert not np.delete(surfaces, s, 0).any()


def test_moments_are_those_of_the_particles_and_headings_turn():
    draw = np.random.default_rng(0)
    agent = draw.standard_normal((4000, 5)) * [1, 2, 3, 4, 0.1] + [1, 2, 3, 4, np.pi]
    lines = draw.standard_normal((2, 4000, 2)) * 0.1 + [[[1, 2]], [[3, 4]]]
    samples = StateSamples(agent, lines, np.array([5, 9]))
    moments = StateSamples(agent - [0, 0, 0, 0, 2 * np.pi], lines, samples.identity).moments()
    whole = np.concatenate([agent, *lines], 1)
    off = moments.mean - whole.mean(0)
    off[4] = wrap(off[4])
    np.testing.assert_allclose(off, 0, atol=1e-9)
    apart = np.zeros((9, 9))
    for part in (slice(0, 5), slice(5, 7), slice(7, 9)):
        apart[part, part] = np.cov(whole[:, part].T, bias=True)
    np.testing.assert_allclose(moments.covariance, apart, atol=1e-8)


def test_surfaces_that_stay_keep_their_particles_and_new_ones_are_drawn():
    draw = np.random.default_rng(0)
    samples = StateSamples(np.zeros((5000, 5)), draw.standard_normal((2, 5000, 2)), np.array([5, 9]))
    mean = np.array([0, 0, 0, 0, 0, 1.0, 2.0, 0.3, -1.0])
    covariance = np.eye(9)
    covariance[5:7, 5:7] = [[0.04, 0.01], [0.01, 0.09]]
    after = samples.having(np.array([11, 5]), Belief(mean, covariance), draw)
    np.testing.assert_array_equal(after.lines[1], samples.lines[0])
    np.testing.assert_allclose(after.lines[0].mean(0), [1, 2], atol=0.03)
    np.testing.assert_allclose(np.cov(after.lines[0].T), covariance[5:7, 5:7], atol=0.01)


@pytest.mark.parametrize(
    ("settings", "form"),
    [
        ({}, JointGaussian),
        ({"correlated": False}, SeparateGaussians),
        ({"representation": "particles", "particles": 960}, SeparateParticles),
    ],
)
def test_a_state_meets_the_messages_of_its_representation(settings, form):
    slam = gs.AdaptiveSlam(gs.Scene.load("room").with_filter(**settings), seed=1)
    found = representation_of(slam.state, slam.model)
    assert type(found) is form
    after = found.with_surfaces(slam.state, slam.work)
    assert (after is slam.state) == (form is JointGaussian)
    paths = found.predict_paths(slam.state, 0, slam.model, work=slam.work)
    assert (paths.recipe.bandwidth == 0.0) == (form is SeparateParticles), "at the particles themselves"
