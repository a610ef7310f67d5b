"""Direct SLAM on short recordings of the scene `overlap`."""

from dataclasses import fields, replace

import numpy as np
import pytest
from delay_snapshots import BAND, noise, received
from image_states import with_images
from scene_samples import short

import gridslam as gs
from gridslam.inference.health import reasons
from gridslam.inference.messages.samples.distance_mode import PathPrior
from gridslam.inference.messages.samples.image_births import birth_rate, find_births
from gridslam.inference.messages.samples.noise_levels import median_noise
from gridslam.inference.messages.samples.path_levels import first_noise
from gridslam.inference.messages.samples.signal_likelihood import Band
from gridslam.inference.state.samples.images import DirectState
from gridslam.systems.direct import start, step
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

STEPS = 60


@pytest.fixture(scope="module")
def overlap():
    """The scene made short, what its agent received, and all that a filter may know."""
    scene = short("overlap", STEPS)
    recording = gs.simulate(scene, "agent1", seed=3, what="signal")
    return recording, SignalModel.of(scene.filter_model("agent1"), recording.waveform)


def run(recording, model, steps=STEPS, change=lambda samples: samples):
    """States after each step, of samples that are changed before."""
    state, states = start(model), []
    for scan in list(recording)[:steps]:
        state, _ = step(state, replace(scan, samples=change(scan.samples)), model)
        states.append(state)
    return states


@pytest.fixture(scope="module")
def states(overlap):
    return run(*overlap)


@pytest.mark.slow
def test_agent_is_followed_and_images_settle(overlap, states):
    truth = overlap[0].truth.position_m
    error = np.array([state.belief.mean[:2] for state in states]) - truth
    squared = [
        e @ np.linalg.solve(s.belief.covariance[:2, :2], e) for s, e in zip(states, error, strict=True)
    ]
    assert np.linalg.norm(error[10:], axis=1).max() < 0.15
    assert np.mean(squared) < 6
    assert len(states[-1].images) >= 1
    assert states[-1].links.noise == pytest.approx(1.0, rel=0.15)
    assert (states[-1].links.visible > 0.9).all()


@pytest.mark.slow
def test_settled_images_are_mirror_images_of_their_anchors(overlap, states):
    scene, state = gs.Scene.load("overlap"), states[-1]
    walls = scene.segments()
    for place, covariance, anchor in zip(
        state.places, state.place_covariances, state.images.anchor, strict=True
    ):
        true = np.array([gs_mirror(line, scene.anchor_positions[anchor]) for line in walls.line])
        off = true - place
        assert min(o @ np.linalg.solve(covariance, o) for o in off) < 16


def gs_mirror(line, point):
    """The mirror image, by hand."""
    normal = np.array([np.cos(line[0]), np.sin(line[0])])
    return point + 2 * (line[1] - normal @ point) * normal


@pytest.mark.slow
@pytest.mark.parametrize("turn", [1e3, np.exp(2j)], ids=["louder", "turned"])
def test_scale_and_phase_of_samples_mean_nothing(overlap, states, turn):
    changed = run(*overlap, 25, lambda samples: turn * samples)[-1]
    np.testing.assert_allclose(changed.belief.mean, states[24].belief.mean, atol=1e-6)
    np.testing.assert_allclose(changed.links.noise, np.abs(turn) ** 2 * states[24].links.noise, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("level", [(1.0, 1.0), (1e3, 0.02)], ids=["turned", "of another noise, too"])
def test_each_anchor_may_have_a_scale_and_at_every_step_a_phase_of_its_own(overlap, states, level):
    rng, level = np.random.default_rng(5), np.array(level)

    def change(samples):
        return samples * (level * np.exp(2j * np.pi * rng.uniform(size=2)))[:, None, None, None]

    changed, plain = run(*overlap, 12, change)[-1], states[11]
    np.testing.assert_allclose(changed.belief.mean, plain.belief.mean, atol=1e-6)
    np.testing.assert_allclose(changed.belief.covariance, plain.belief.covariance, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(changed.links.noise, level**2 * plain.links.noise, rtol=1e-6)
    rings, own = changed.tentative, plain.tentative
    np.testing.assert_array_equal(rings.rings.anchor, own.rings.anchor)
    np.testing.assert_allclose(rings.rings.existence, own.rings.existence, atol=1e-5)
    np.testing.assert_allclose(rings.intensity, level[own.rings.anchor] ** 2 * own.intensity, rtol=1e-5)


@pytest.mark.slow
def test_a_step_changes_nothing_of_the_state_before(overlap, states):
    before = states[-2]
    kept = [np.copy(getattr(part, f.name)) for part in (before.belief, before.images, before.links)
            for f in fields(part)]  # fmt: skip
    step(before, overlap[0].scan(STEPS - 1), overlap[1])
    now = [
        getattr(part, f.name) for part in (before.belief, before.images, before.links) for f in fields(part)
    ]
    for was, is_ in zip(kept, now, strict=True):
        np.testing.assert_array_equal(was, is_)


def test_a_step_goes_on_where_an_image_was_the_line_of_sight_itself(overlap):
    """The image's row goes while walls that other images show put images of the same anchor elsewhere."""
    model = replace(overlap[1], max_bounces=2)
    position = model.anchor_positions
    agent = model.start_mean[:2]
    far = np.linalg.norm(agent - position, axis=1)
    floor = position[0] * [1, -1]  # anchor 0 in the wall y = 0
    state = with_images(model, (0, floor, 1), (1, agent + (far[1] + 0.05) * np.array([0.6, -0.8]), 0))
    links = replace(
        state.links, visible=np.array([0.9, 0.01]), intensity=np.full(2, 200.0), heard=np.full(2, 9.0),
        usurped=np.array([0, 4]),
    )  # fmt: skip
    state = replace(state, links=links, time_s=0.0, step=50)
    band = Band.of(model.waveform.offset_hz, model.waveform.pulse)
    samples = 15 * band.response(far)[:, None, None]
    after, _ = step(state, SignalScan(0, 0.0, samples, np.ones(2, bool)), model)
    assert 1 not in after.images.identity
    assert after.links.visible[1] > 0.8


def test_a_step_whose_anchors_fit_both_sides_says_so(overlap):
    """An agent known to 1 cm along its one line of sight and to 0.5 m across it."""
    model = overlap[1]
    place = model.anchor_positions[0] - [0.0, 3.0]
    variance = np.array([0.25, 1e-4, 1e-4, 1e-4])
    state = DirectState.start(np.array([*place, 0.0, 0.0]), variance, 2, np.ones(2))
    band = Band.of(model.waveform.offset_hz, model.waveform.pulse)
    samples = 20 * band.response(np.full(2, 3.0))[:, None, None]
    after, info = step(state, SignalScan(0, 0.0, samples, np.array([True, False])), model)
    assert after.one_sided[0]
    assert info.health.why == reasons.MIRRORED


def test_a_first_snapshot_of_many_paths_is_taken_apart_at_once():
    """Ten paths over two bounces; a rate of few, or four births at most, would drag the line of sight."""
    rng = np.random.default_rng(4)
    distance = 4 + np.array([0.0, 0.7, 1.6, 2.5, 3.2, 4.4, 5.3, 6.9, 8.1, 9.6])
    amplitude = 10 ** (np.linspace(32, 18, 10) / 20) * np.exp(2j * np.pi * rng.random(10))
    prior = PathPrior(distance[:1] + 0.05, np.array([[100.0]]), np.array([1500.0]))
    found = find_births(BAND, received(rng, distance, amplitude), prior, 1.0, birth_rate(0, 2))
    assert np.abs(found.mode.distance[:, None] - distance).min(0).max() < 0.15
    assert abs(found.mode.distance[0] - 4) < 0.03
    assert len(found.mode.distance) < 13
    assert birth_rate(0, 1) < 0.2 * birth_rate(0, 2)
    assert birth_rate(99, 1) < birth_rate(99, 2) < 1e-3


def test_the_first_noise_is_not_what_many_paths_leave_in_every_cell():
    rng, response = np.random.default_rng(5), np.conj(BAND.response(BAND.folding_m / 41 * np.arange(41)))
    cells, alone, many, plain, quiet = BAND.folding_m / 41 * np.arange(41), [], [], [], []
    for _ in range(200):
        distance, power = rng.uniform(3, 18, 10), 10 ** rng.uniform(1, 3.5, 10)
        amplitude = np.sqrt(power) * np.exp(2j * np.pi * rng.random(10))
        silence = noise(rng)
        samples = amplitude @ BAND.response(distance) + silence
        alone.append(first_noise(BAND, silence, cells))
        many.append(first_noise(BAND, samples, cells))
        plain.append(median_noise(np.abs(response @ samples) ** 2))
        quiet.append(median_noise(np.abs(response @ silence) ** 2))
    assert np.mean(alone) == pytest.approx(1.0, abs=0.25)
    assert np.mean(quiet) == pytest.approx(1.0, abs=0.1)
    assert np.median(many) < 0.4 * np.median(plain)
    assert np.median(many) < 2.5


def test_no_path_is_born_in_front_of_the_line_of_sight_by_folding():
    prior = PathPrior(np.array([5.0]), np.array([[1e4]]), np.array([400.0]))
    samples = 20 * BAND.response(5.0) + 20j * BAND.response(4.7)
    found = find_births(BAND, samples, prior, 1.0, birth_rate(0, 2))
    assert all(path.distance < 5.0 + BAND.folding_m - 0.5 for path in found.new)


@pytest.mark.slow
def test_an_anchor_that_is_not_heard_changes_nothing_but_time(overlap, states):
    scan = overlap[0].scan(STEPS - 1)
    silent = SignalScan(scan.step, scan.time_s, scan.samples, np.zeros(2, bool))
    after, _ = step(states[-2], silent, overlap[1])
    assert len(after.images) == len(states[-2].images)
    assert after.belief.covariance[0, 0] > states[-2].belief.covariance[0, 0]
    np.testing.assert_array_equal(after.links.noise, states[-2].links.noise)


@pytest.mark.slow
def test_noise_gives_birth_to_nothing_that_joins(overlap):
    _, model = overlap
    rng, state, begun = np.random.default_rng(0), start(model), 0
    for number in range(80):
        samples = (rng.normal(size=(2, 1, 1, 41)) + 1j * rng.normal(size=(2, 1, 1, 41))) / np.sqrt(2)
        state, info = step(state, SignalScan(number, float(number), samples, np.ones(2, bool)), model)
        begun += sum(len(found.new) for found in info.found) if number > 40 else 0
    assert not len(state.images)
    assert begun < 5


@pytest.mark.parametrize(("steps", "louder"), [(0, True), (7, True), (8, False)])
def test_the_line_of_sight_may_be_louder_than_guessed_in_the_first_steps_alone(overlap, steps, louder):
    recording, model = overlap
    state = start(model)
    links = replace(state.links, intensity=np.full(2, 2.0), noise=np.ones(2))
    _, info = step(replace(state, links=links, step=steps), recording.scan(0), model)
    weight = np.array([one.prior.weight[0] for one in info.found])
    assert (weight > 5.0).any() == louder
