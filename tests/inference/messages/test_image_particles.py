"""Messages of the published virtual-anchor SLAM against densities and sums written another way."""

import numpy as np
import pytest
from scipy.stats import norm, rice

import gridslam as gs
from gridslam.inference.messages.published.image_particles import (
    SPREAD,
    agent_logs,
    associate_images,
    born_images,
    evaluate_images,
    path_values,
    propose_images,
    pruned,
    updated_images,
)
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.published.feature_particles import Features, ImageState
from gridslam.world.geometry import mirror, trace, wrap

COUNT = 300
MODEL = gs.Scene.load("room").filter_model()
RADIO, ANCHOR = MODEL.radio, MODEL.anchors[1]
WALL = np.array([np.pi, 4.0])
UNMEASURED = np.full((1, 3), np.nan)


def state_of(seed, spread=0.03, features=1):
    """Agents about one place, and virtual anchors of anchor 1 about its image at the left wall."""
    draw = np.random.default_rng(seed)
    agent = np.array([-1.0, 0.5, 0, 0, 0.3]) + np.array([spread, spread, 0, 0, 0.02]) * draw.standard_normal(
        (COUNT, 5)
    )
    place = mirror(WALL, ANCHOR[:2]) + spread * draw.standard_normal((features, COUNT, 2))
    known = Features(
        np.arange(features), np.ones(features, np.int64), np.zeros(features, bool), np.full(features, 0.6),
        place, 3.0 + 0.1 * draw.standard_normal((features, COUNT)),
    )  # fmt: skip
    return ImageState(agent, known, 3, features), draw


def scan_of(state, shift=(0.01, 0.05, -0.04), amplitude=3.2):
    """One measurement near what the mean of the first virtual anchor predicts."""
    mean = path_values(
        state.agent.mean(0)[None],
        state.features.position[:1].mean(1, keepdims=True),
        np.zeros(1, bool),
        ANCHOR,
    )[:, 0, 0]
    return AnchorScan.of(1, ANCHOR[:2], ANCHOR[2], (mean + shift)[None], UNMEASURED, np.array([amplitude]))


def by_hand(state, scan):
    """The first feature's ratio to clutter at all particles, by scipy's densities; and detection, (P,)."""
    level = state.features.intensity[0]
    values = path_values(state.agent, state.features.position[:1], np.zeros(1, bool), ANCHOR)[:, 0]
    mean = level.mean()
    scales = [RADIO.distance_scale / mean]
    for angle, array in ((values[1], RADIO.anchor_aperture[1]), (values[2], RADIO.agent_aperture)):
        middle = np.angle(np.exp(1j * angle).mean())
        square = np.sin(middle) ** 2 * array[0] + np.cos(middle) ** 2 * array[1]
        scales.append(1 / (np.sqrt(8) * np.pi * mean * np.sqrt(square)))
    density = np.ones(COUNT)
    for kind in range(3):
        off = scan.value[0, kind] - values[kind]
        density *= norm.pdf(wrap(off) if kind else off, scale=scales[kind])
    noise = np.sqrt(0.5 + level**2 / (4 * RADIO.samples))
    density *= rice.pdf(scan.amplitude[0], level / noise, scale=noise)
    clutter = RADIO.false_alarms * np.exp(RADIO.log_clutter(scan.amplitude[:1]))[0]
    return density / clutter, rice.sf(RADIO.threshold, level / noise, scale=noise)


def test_paths_are_those_of_the_shared_geometry():
    state, _ = state_of(0)
    for count, place in ((0, ANCHOR[:2]), (1, mirror(WALL, ANCHOR[:2]))):
        values = path_values(state.agent, np.tile(place, (1, COUNT, 1)), np.array([count == 0]), ANCHOR)[:, 0]
        lines = np.tile(WALL, (COUNT, 1))
        path = trace(state.agent[:, :2], np.tile(ANCHOR[:2], (COUNT, 1)), lines, lines, np.full(COUNT, count))
        np.testing.assert_allclose(values[0], path.distance)
        np.testing.assert_allclose(wrap(values[1] + ANCHOR[2] - path.departure), 0, atol=1e-9)
        np.testing.assert_allclose(wrap(values[2] + state.agent[:, 4] - path.arrival), 0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_one_feature_and_one_measurement_weigh_as_all_their_events_say(seed):
    state, draw = state_of(seed)
    scan = scan_of(state)
    new = propose_images(state, scan, RADIO, MODEL, draw)
    seen = evaluate_images(state, scan, RADIO, ANCHOR)
    found = associate_images(state, seen, new)
    ratio, detected = by_hand(state, scan)
    np.testing.assert_allclose(seen.ratio[0, 0], ratio, rtol=1e-6, atol=1e-6 * ratio.max())
    np.testing.assert_allclose(1 - seen.missed[0], detected, atol=1e-4)
    exists, birth = state.features.existence[0], new.odds[0]
    # events: no feature, one unheard, one heard; a measurement without cause is clutter or new
    weight = (1 - exists + exists * (1 - detected)) * (1 + birth) + exists * ratio
    logs = agent_logs(state, seen, found)
    np.testing.assert_allclose(logs - logs.max(), np.log(weight / weight.max()), atol=1e-3)
    there = exists * ((1 - detected) * (1 + birth) + ratio).mean()
    updated = updated_images(state, seen, found, draw)
    odds = updated.existence[0] / (1 - updated.existence[0])
    assert odds == pytest.approx(there / ((1 - exists) * (1 + birth)), rel=1e-3)
    easy = type(MODEL.settings)(prune_below=1e-12)
    born = born_images(state, scan, new, found, _with(easy), draw)
    undetected = 1 - exists * detected.mean()
    expected = birth * undetected / ((1 + birth) * undetected + exists * ratio.mean())
    assert born.existence[0] == pytest.approx(expected, rel=1e-3)


def test_updated_particles_follow_their_weights():
    state, draw = state_of(5, 0.2)
    scan = scan_of(state)
    seen = evaluate_images(state, scan, RADIO, ANCHOR)
    found = associate_images(state, seen, propose_images(state, scan, RADIO, MODEL, draw))
    updated = updated_images(state, seen, found, draw)
    weight = found.bracket[0] / found.bracket[0].sum()
    where = state.features.position[0]
    assert np.ptp(where[:, 0]) > 0.5
    np.testing.assert_allclose(updated.position[0].mean(0), weight @ where, atol=0.01)
    np.testing.assert_array_equal(state.features.position[0], where)


def test_odds_of_a_birth_are_the_integral_over_where_it_may_be():
    """One known agent: the integral over places by a fine grid, over amplitudes by their density."""
    state, draw = state_of(7)
    count = 20_000
    state = ImageState(np.tile(state.agent[:1], (count, 1)), state.features, 3, 1)
    scan = scan_of(state_of(7)[0])
    odds = propose_images(state, scan, RADIO, MODEL, draw).odds[0]
    value, level = scan.value[0], scan.amplitude[0]
    angle = [1 / (np.sqrt(8) * np.pi * level * np.sqrt(array[0])) for array in (
        RADIO.anchor_aperture[1], RADIO.agent_aperture)]  # fmt: skip
    distance = value[0] + RADIO.distance_scale / level * np.linspace(-6, 6, 241)
    bearing = state.agent[0, 4] + value[2] + angle[1] * np.linspace(-6, 6, 801)
    far, turn = np.meshgrid(distance, bearing, indexing="ij")
    place = state.agent[0, :2] + far[..., None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    values = path_values(state.agent[:1], place.reshape(-1, 1, 2), np.zeros(place[..., 0].size, bool), ANCHOR)
    values = values.reshape(3, *far.shape)
    density = norm.pdf(values[0], value[0], RADIO.distance_scale / level)
    for kind in (1, 2):
        density = density * norm.pdf(wrap(values[kind] - value[kind]), scale=angle[kind - 1])
    cell = (distance[1] - distance[0]) * (bearing[1] - bearing[0])
    noise = np.sqrt(0.5 + level**2 / (4 * RADIO.samples))
    u = np.linspace(max(level - 8 * noise, 1e-3), level + 8 * noise, 2001)
    own = np.sqrt(0.5 + u**2 / (4 * RADIO.samples))
    strength = norm.pdf(u, level, noise) @ rice.pdf(level, u / own, scale=own) * (u[1] - u[0])
    side = np.array(MODEL.grid.shape) * MODEL.grid.cell_m
    clutter = RADIO.false_alarms * np.exp(RADIO.log_clutter(scan.amplitude))[0]
    expected = (
        MODEL.settings.births / (SPREAD**2 * side.prod()) * (density * far).sum() * cell * strength / clutter
    )
    assert odds == pytest.approx(expected, rel=0.05)


def test_lines_of_sight_are_never_pruned():
    state, _ = state_of(0, features=2)
    faint = Features(**(vars(state.features) | {"existence": np.zeros(2), "fixed": np.array([True, False])}))
    assert pruned(faint, 0.1).identity.tolist() == [0]


def _with(settings):
    from dataclasses import replace

    return replace(MODEL, settings=settings)
