"""Distances alone: exact association, rings of hypotheses, and the radio that measures nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from enumeration import enumerate_marginals, random_association
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import shortened

import gridslam as gs
from gridslam.evaluation.path_slopes import whitened_jacobian
from gridslam.inference.beliefs.belief import Belief, append, update
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.messages import ranging
from gridslam.inference.messages.amplitudes import DetectionTable
from gridslam.inference.messages.association import associate
from gridslam.inference.messages.exact_association import MOST_CONTESTED, associate_exactly
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state import rings
from gridslam.simulation.image_source import simulate_labelled, true_paths
from gridslam.systems.virtual_anchor import VirtualAnchorSlam
from gridslam.world.geometry import mirror, mirror_derivative

PLACE = np.array([0.5, 3.0])


@pytest.fixture(scope="module")
def scene():
    return gs.Scene.load("seminar")


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_exact_association_equals_enumeration(seed):
    draw = np.random.default_rng(seed)
    paths, measured = draw.integers(0, 5, 2)
    beta, missed, new = random_association(draw, paths, measured, 0.7)
    nu, claimed = associate_exactly(beta, missed, new)
    expected = enumerate_marginals(beta, missed, new)
    weight = beta * nu
    found = weight / (missed[:, None] + weight.sum(1, keepdims=True))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(new / (new + claimed), 1 - expected.sum(0), atol=1e-6)


def test_too_many_measurements_fall_back_on_belief_propagation():
    draw = np.random.default_rng(0)
    beta = draw.exponential(1.0, (3, MOST_CONTESTED + 1))
    missed, new = np.full(3, 0.2), np.ones(MOST_CONTESTED + 1)
    for found, expected in zip(
        associate_exactly(beta, missed, new), associate(beta, missed, new), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


def test_exact_association_pushes_paths_of_nearly_equal_length_neither_together_nor_apart():
    draw, runs, noise, clutter = np.random.default_rng(1), 600, 0.1, 1 / 30
    known = np.array([0.0, 0.5 * noise])
    push = np.zeros((2, runs, 2))  # mean innovation, of a filter that knows the truth
    for run in range(runs):
        measured = (known + noise * draw.standard_normal(2))[draw.random(2) < 0.95]
        gap = measured - known[:, None]
        density = np.exp(-0.5 * (gap / noise) ** 2) / (noise * np.sqrt(2 * np.pi))
        beta, missed, new = 0.95 * density / clutter, np.full(2, 0.05), np.ones(len(measured))
        for row, method in enumerate((associate_exactly, associate)):
            weight = beta * method(beta, missed, new)[0]
            push[row, run] = (weight * gap).sum(1) / (missed + weight.sum(1))
    error = push.std(1) / np.sqrt(runs)
    assert (np.abs(push[0].mean(0)) < 4 * error[0]).all()
    assert push[1].mean(0)[0] < -4 * error[1][0]  # why the exact marginals are needed
    assert push[1].mean(0)[1] > 4 * error[1][1]


def hears(distances):
    count = len(distances)
    value = np.full((count, 3), np.nan)
    value[:, 0] = distances
    return AnchorScan.of(0, PLACE, 0.0, value, np.full((count, 3), np.nan), np.full(count, np.nan))


def believed(position, deviation):
    mean = np.array([*position, 0.0, 0.0, 0.0])
    return Belief(mean, np.diag([deviation**2, deviation**2, 1e-8, 1e-8, 1.0]))


def walk(scene, positions, image, seed, known=1e-3):
    """One ring along a way that the agent knows, with noisy distances to `image`."""
    signal, draw = scene.signal_model(), np.random.default_rng(seed)
    table, bank = DetectionTable(signal), rings.Rings.empty()
    for step, position in enumerate(positions):
        belief = believed(position, known)
        scan = hears([np.linalg.norm(image - position) + 0.1 * draw.standard_normal()])
        if not step:
            ratio, weight = ranging.expected(belief, scan, signal, 0.02, np.zeros(2), 10.0)
            assert ratio > 0
            bank = ranging.begin(bank, belief, scan, signal, np.array([0.5]), weight)
            continue
        mean = bank.mean.copy()
        mean[..., : rings.MOVING] = belief.mean[: rings.MOVING]
        covariance = bank.covariance.copy()
        covariance[..., : rings.MOVING, :] = covariance[..., :, : rings.MOVING] = 0.0
        covariance[..., : rings.MOVING, : rings.MOVING] = belief.covariance[: rings.MOVING, : rings.MOVING]
        bank = rings.Rings(*(bank.anchor, bank.existence, bank.age, bank.seen, bank.weight, mean, covariance))
        worth = ranging.judge(bank, scan, table, signal)
        beta, missed = ranging.claims(bank, worth)
        bank = ranging.learn(bank, worth, associate_exactly(beta, missed, np.ones(1))[0])
    return bank


AHEAD = np.stack([np.linspace(0, 1.5, 100), np.zeros(100)], -1)
ROUND = np.concatenate([AHEAD, np.stack([np.full(120, 1.5), np.linspace(0, 1.8, 120)], -1)])


def test_a_straight_way_leaves_the_image_and_its_mirror_image_equally_likely(scene):
    image = np.array([3.0, 4.0])
    bank = walk(scene, AHEAD, image, seed=1)
    weight, place = bank.weight[0], bank.mean[0, :, rings.MOVING :]
    above, below = place[:, 1] > 0.5, place[:, 1] < -0.5
    # the bearings are spread evenly, but the prior weighs them by their distance to the anchor
    assert weight[above].sum() > 0.1
    assert weight[below].sum() > 0.1
    for side, sign in ((above, 1.0), (below, -1.0)):
        middle = weight[side] @ place[side] / weight[side].sum()
        np.testing.assert_allclose(middle, image * [1, sign], atol=0.8)
    assert not len(rings.shrunk(bank, np.array([[*PLACE, 0.0, 0.0]]), scene.signal_model()))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_turn_shrinks_the_ring_to_the_true_image(scene, seed):
    image = np.array([3.0, 4.0])
    bank = walk(scene, ROUND, image, seed)
    mean, covariance = (part[0, rings.MOVING :] for part in bank.matched)
    covariance = covariance[:, rings.MOVING :]
    gap = mean - image
    assert gap @ np.linalg.solve(covariance, gap) < 18.4  # chi square of 2, one in 10 000
    assert np.sqrt(np.linalg.eigvalsh(covariance)[-1]) < 0.25
    assert bank.existence[0] > 0.99
    assert len(rings.shrunk(bank, np.array([[-9.0, 9.0, 0.0, 0.0]]), scene.signal_model())) == 1


def test_misses_end_a_ring(scene):
    signal = scene.signal_model()
    bank = walk(scene, AHEAD[:2], np.array([3.0, 4.0]), seed=0)
    for _ in range(12):
        worth = ranging.judge(bank, hears([]), DetectionTable(signal), signal)
        bank = rings.prune(ranging.learn(bank, worth, np.zeros((len(worth.rows), 0))), 1.0)
    assert not len(bank)


def some_rings(draw, count=2):
    """One ring whose first hypotheses are random, and a belief."""
    size = rings.MOVING + 2
    root = draw.normal(size=(size, size))
    joint = root @ root.T + 0.1 * np.eye(size)
    mean = np.zeros((1, rings.BEARINGS, size))
    mean[0, :count] = draw.normal(size=(count, size))
    weight = np.zeros((1, rings.BEARINGS))
    weight[0, :count] = 1 / count
    one = np.ones(1, np.int64)
    covariance = np.broadcast_to(joint, (1, rings.BEARINGS, size, size)).copy()
    bank = rings.Rings(np.zeros(1, np.intp), np.ones(1), one, one, weight, mean, covariance)
    agent = np.zeros((AGENT, AGENT))
    agent[:4, :4], agent[4, 4] = joint[:4, :4], 1.0
    return bank, Belief(np.concatenate([draw.normal(size=4), [0.3]]), agent)


def test_the_likeliest_rings_of_each_anchor_are_kept():
    one, _ = some_rings(np.random.default_rng(1))
    bank = one.take(np.zeros(rings.MOST_RINGS + 8, np.intp))
    existence = np.random.default_rng(2).permutation(np.linspace(0.1, 0.9, len(bank)))
    anchor = np.where(np.arange(len(bank)) < 5, 1, 0)  # of anchor 1 there are few, of the other 3 too many
    kept = rings.prune(replace(bank, existence=existence, anchor=anchor), 1.0)
    assert np.bincount(kept.anchor).tolist() == [rings.MOST_RINGS, 5]
    np.testing.assert_array_equal(kept.existence[kept.anchor == 1], existence[:5])
    dropped = np.setdiff1d(existence, kept.existence)
    assert dropped.max() < kept.existence[kept.anchor == 0].min()


@pytest.mark.parametrize("seed", range(5))
def test_what_the_belief_learns_of_the_agent_reaches_every_hypothesis_as_if_measured_there(seed):
    draw = np.random.default_rng(seed)
    bank, before = some_rings(draw)
    slope, noise, measured = draw.normal(size=4), 0.3, 0.7
    jacobian = np.append(slope, 0.0)[None]
    gap = np.array([[measured - slope @ before.mean[:4]]])
    after = update(before, jacobian, gap, np.array([[noise]]), np.ones(1))
    found = rings.follow(bank, before, after)
    evidence = []
    wide = np.append(slope, [0.0, 0.0])
    for mean, covariance, got, spread in zip(
        bank.mean[0, :2], bank.covariance[0, :2], found.mean[0], found.covariance[0], strict=False
    ):
        total = wide @ covariance @ wide + noise
        gain = covariance @ wide / total
        np.testing.assert_allclose(got, mean + gain * (measured - wide @ mean), atol=1e-8)
        np.testing.assert_allclose(spread, covariance - np.outer(gain, gain) * total, atol=1e-8)
        evidence.append(np.exp(-0.5 * (measured - wide @ mean) ** 2 / total))
    np.testing.assert_allclose(found.weight[0, :2], np.array(evidence) / sum(evidence), atol=1e-8)


def test_a_ring_that_joins_leaves_the_belief_with_its_agent_and_its_image():
    draw = np.random.default_rng(3)
    bank, belief = some_rings(draw, 1)
    bank.mean[0, 0, rings.MOVING :] = [6.0, -2.0]
    bank.covariance[0, 0] *= 0.01
    belief = append(belief, np.array([0.4, 2.0]), np.diag([0.01, 0.02]))
    joined = rings.join(bank, 0, belief, PLACE)
    line, entry = joined.lines[-1], joined.layout.line(1)
    np.testing.assert_allclose(mirror(line, PLACE), [6.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(joined.mean[:4], bank.mean[0, 0, :4], atol=1e-9)
    derivative = np.zeros((6, len(joined.mean)))
    derivative[:4, :4] = np.eye(4)
    derivative[4:, entry] = mirror_derivative(line, PLACE)
    np.testing.assert_allclose(
        derivative @ joined.covariance @ derivative.T, bank.covariance[0, 0], atol=1e-9
    )
    assert np.linalg.eigvalsh(joined.covariance).min() > -1e-12


@pytest.mark.slow
def test_silence_begins_no_ring_and_clutter_joins_none(scene):
    scene = shortened(scene, 40).with_filter(particles=256)
    silent = gs.Measurements.from_arrays({"A": [[]] * 3, "B": [[]] * 3})
    slam = VirtualAnchorSlam(scene, seed=1)
    for scan in silent:
        slam.step(scan)
    assert not len(slam.state.rings)
    draw = np.random.default_rng(2)
    clutter = {name: [draw.uniform(0, 30, 1) for _ in range(40)] for name in ("A", "B")}
    slam = VirtualAnchorSlam(scene, seed=1)
    for scan in gs.Measurements.from_arrays(clutter):
        assert not slam.step(scan).detected.any()


@pytest.mark.slow
def test_virtual_anchors_are_found_by_distances_alone(scene):
    scene = shortened(scene, 230)
    paths, lines = true_paths(scene, "agent1"), scene.segments().line
    images = np.concatenate(
        [
            mirror(lines[np.unique(paths.segment[paths.anchor == a])[1:]], scene.anchor_positions[a])
            for a in (0, 1)
        ]
    )
    run = gs.map_scene(scene, gs.simulate(scene, "agent1", 2), "va", seed=2, particles=256)
    assert len(run.surfaces) >= 3
    for line in run.surfaces.line:
        found = mirror(line, scene.anchor_positions)
        assert np.linalg.norm(images[:, None] - found, axis=-1).min() < 0.8
    score = run.score(gs.ground_truth(scene, "agent1"))
    assert score["position_rmse_m"] < 0.12
    assert score["heading_rmse_deg"] is None


@pytest.mark.slow
@pytest.mark.parametrize("method", ["grid", "adaptive"])
def test_other_methods_take_distances_alone_too(scene, method):
    scene = shortened(scene, 15)
    run = gs.map_scene(scene, gs.simulate(scene, "agent1", 3), method, seed=3, particles=256)
    assert np.isfinite(run.trajectory.position_m).all()
    assert np.linalg.norm(run.trajectory.position_m - scene.track("agent1").position_m, axis=1).max() < 0.5


@pytest.mark.slow
def test_a_radio_of_distances_alone_is_simulated_as_it_is_described(scene):
    measurements, label = simulate_labelled(scene, "agent1", 1)
    paths = true_paths(scene, "agent1")
    for column in (measurements.aod_rad, measurements.aoa_rad, measurements.amplitude):
        assert np.isnan(column).all()
    true = label >= 0
    share = true.sum() / len(paths)
    assert abs(share - 0.95) < 4 * np.sqrt(0.95 * 0.05 / len(paths))
    error = measurements.distance_m[true] - paths.distance_m[label[true]]
    assert abs(error.std() / 0.1 - 1) < 4 / np.sqrt(2 * true.sum())
    steps = 2 * len(scene.track("agent1"))
    assert abs((~true).sum() / steps - 1) < 4 / np.sqrt(steps)


@pytest.mark.slow
def test_distances_alone_inform_of_one_direction_and_of_no_heading(scene):
    paths = true_paths(scene, "agent1").at(100)
    surfaces = np.unique(scene.segments().surface)
    rows = whitened_jacobian(scene, "agent1", paths, surfaces)[:, :, :AGENT]
    information = rows.transpose(0, 2, 1) @ rows
    assert not information[:, :, 4].any()
    np.testing.assert_allclose(np.trace(information, axis1=1, axis2=2), 1 / 0.1**2)
    assert (np.linalg.matrix_rank(information) == 1).all()
