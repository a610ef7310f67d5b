"""Kernels that pick, weigh and associate pairs of a path and a measurement, against their twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_stages import stages
from kernel_worlds import (
    SEEDS,
    UNKNOWN,
    detection_table,
    predicted_of,
    random_belief,
    random_places,
    random_radio,
    random_table,
)
from scipy.special import i0e

from gridslam import reference
from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.primitives.blocks import Amplitudes, Anchors, Drawing, Gating, Pairs, PathRows, Ratios


def predictions(draw, paths):
    value = draw.uniform([1, -3, -3], [9, 3, 3], (paths, 3))
    root = 0.1 * draw.normal(size=(paths, 3, 3))
    spread = (root @ root.transpose(0, 2, 1)).reshape(-1, 9)
    late = draw.choice([0.0, 1.0]) * np.repeat(draw.normal(0, 3, 2), [paths - paths // 2, paths // 2])
    unclear = draw.choice([1e-4, 0.1, 2.0], paths)
    learnt = draw.uniform(-0.99, 0.99, paths) * np.sqrt(unclear * spread[:, 0])
    if draw.random() < 0.5:  # known clocks
        unclear = learnt = spread[:, 0]
    return np.column_stack([value[:, 0] + late, value[:, 1:], spread, value[:, 0], unclear, learnt])


@pytest.mark.slow
@given(SEEDS, st.booleans(), st.booleans(), st.booleans())
@settings(max_examples=60, deadline=None)
def test_gated_pairs_equal_their_twin(seed, given_std, flat_array, spreading):
    gate, _, _ = stages()
    draw = np.random.default_rng(seed)
    paths, count, nodes = int(draw.integers(0, 7)), int(draw.integers(0, 9)), 12
    predicted = predictions(draw, paths)
    path = np.zeros((paths, 4), np.int32)
    path[paths - paths // 2 :, 3] = 1
    scan, radio = random_table(draw, count, predicted[:, :3]), random_radio(draw, given_std, flat_array)
    belief = draw.dirichlet(np.full(nodes, 0.3), paths).reshape(paths, nodes)
    belief[: paths // 2, ::2] = 0.0  # nodes that can't be
    level = np.linspace(2, 80, nodes) if spreading else np.linspace(0.4, 12, nodes)
    chance, step = detection_table()
    odds = np.full((12, paths), np.nan)
    odds[:3] = draw.choice([0.0, 0.7, 1.0], (3, paths))
    start, room = np.zeros(paths + 1, np.int32), max(paths * count, 1)
    index, pair, table = np.zeros((room, 2), np.int32), np.zeros((room, 8)), np.zeros((room, 11), np.float32)
    strength = np.full((2, paths, count), np.nan)
    places = random_places(draw, 2)
    given_to = belief, level, float(spreading), path, predicted, scan, chance, step, places, radio, 0.1
    measured = np.full((5, count), np.nan)
    chosen, expected, inverse, sure, weight = reference.gate(*given_to, odds)
    gate(
        float(spreading), step, 0.1, Amplitudes(belief, level, chance), PathRows(path, predicted), scan,
        places, radio, Gating(np.empty((2, count, nodes)), strength, table),
        Pairs(start, index, pair, np.zeros((0, 0), np.float32)), Ratios(odds, np.zeros((0, 0, 0)), measured),
    )  # fmt: skip
    found = start[-1]
    np.testing.assert_allclose(odds[3], sure, rtol=1e-6)
    np.testing.assert_allclose(strength, weight, rtol=1e-5, atol=1e-250)
    np.testing.assert_array_equal(index[:found], chosen)
    np.testing.assert_array_equal(measured[1], scan[:, 8])
    np.testing.assert_array_equal(start, np.searchsorted(chosen[:, 0], np.arange(paths + 1)))
    np.testing.assert_allclose(pair[:found], expected, rtol=1e-5)
    np.testing.assert_allclose(table[:found, :3], expected[:, :3], rtol=1e-6)
    np.testing.assert_allclose(table[:found, 3:6], np.diagonal(inverse, axis1=1, axis2=2), rtol=1e-4)
    off = inverse[:, [0, 0, 1], [1, 2, 2]]
    np.testing.assert_allclose(table[:found, 6:9], off, rtol=1e-4, atol=1e-6 * np.abs(inverse).max(initial=1))
    middle = table[:found, 9:].mean(1)
    np.testing.assert_allclose(middle[expected[:, 3] < 1e9], expected[expected[:, 3] < 1e9, 0], rtol=1e-5)


def test_the_scaled_bessel_function_is_as_precise_as_it_says():
    import taichi as ti

    from gridslam.kernels.primitives.radio import scaled_bessel

    @ti.kernel
    def tabulate(x: ti.types.ndarray(dtype=ti.f64, ndim=1), y: ti.types.ndarray(dtype=ti.f64, ndim=1)):
        for n in range(x.shape[0]):
            y[n] = scaled_bessel(x[n])

    x = np.concatenate([[0.0, 3.75], np.geomspace(1e-6, 1e6, 3000)])
    y = np.empty_like(x)
    tabulate(x, y)
    np.testing.assert_allclose(y, i0e(x), rtol=5e-7)


@pytest.mark.slow
@given(SEEDS)
@settings(max_examples=40, deadline=None)
def test_messages_into_the_association_equal_their_twin(seed):
    _, _, enter = stages()
    draw = np.random.default_rng(seed)
    paths, count = int(draw.integers(0, 6)), int(draw.integers(0, 6))
    chosen = np.argwhere(draw.random((paths, count)) < 0.5).astype(np.int32)
    start = np.searchsorted(chosen[:, 0], np.arange(paths + 1)).astype(np.int32)
    blocks = draw.uniform(0, PATH_BLOCK, (paths + len(chosen) + 1, 3)).astype(np.float32)
    blocks[: paths // 3] = 0.0  # possible nowhere
    index = np.zeros((len(chosen) + 2, 2), np.int32)  # longer than need be, like the blocks
    index[: len(chosen)] = chosen
    pair, odds = draw.uniform(0.1, 2, (len(index), 8)), np.full((12, paths), 7.0)
    odds[:4] = draw.uniform(0, 1, (4, paths))
    message, measured = np.full((5, paths, count), 7.0), np.full((5, count), 7.0)
    given_to = blocks, start, index, pair, odds, message, measured
    expected = reference.enter(*given_to)
    enter(*given_to)
    for found, wanted in zip((odds, message, measured), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-12)


@given(SEEDS, st.booleans(), UNKNOWN)
@settings(max_examples=25, deadline=None)
def test_evaluation_equals_its_twin(seed, spreading, unknown):
    from gridslam.kernels.messages.evaluation import evaluate

    draw, (clocks, rises) = np.random.default_rng(seed), unknown
    surfaces, count, nodes, blocks = int(draw.integers(0, 4)), int(draw.integers(0, 9)), 12, 3
    mean, covariance, path = random_belief(draw, surfaces, clocks, rises)
    places = random_places(draw, 2, rises)
    path[:, 3] = np.sort(draw.integers(0, 2, len(path)))
    predicted = predicted_of(mean, covariance, 5 + clocks, path, places)
    rows = predicted[:, 12] > 0.5  # next to its image, an agent has no direction to it
    path, predicted = path[rows], predicted[rows]
    paths, most = len(path), max(len(path) * count, 1)
    scan, radio = random_table(draw, count, predicted[:, :3]), random_radio(draw)
    belief = draw.dirichlet(np.full(nodes, 0.3), paths).reshape(paths, nodes)
    level = np.linspace(2, 80, nodes) if spreading else np.linspace(0.4, 12, nodes)
    kept, points = 0.1, draw.normal(size=(len(mean) + 1, blocks * PATH_BLOCK)).astype(np.float32)
    root = (np.sqrt(1 - kept) * np.linalg.cholesky(covariance)).astype(np.float32)
    base = np.stack([mean, np.cos(mean), np.sin(mean)], -1, dtype=np.float32)
    odds, message = np.full((12, paths), 7.0), np.full((5, paths, count), 7.0)
    odds[:3] = draw.choice([0.0, 0.7, 1.0], (3, paths), p=[0.1, 0.5, 0.4])
    measured, state = (
        np.full((5, count), 7.0),
        np.empty((3 + 3 * surfaces + clocks, points.shape[1]), np.float32),
    )
    chance, step = detection_table()
    given_to = (
        float(spreading), step, 5 + clocks, kept, Amplitudes(belief, level, chance),
        PathRows(path, predicted), scan, Anchors(places, radio), Drawing(root, base, points, state),
    )  # fmt: skip
    expected = reference.evaluate(*given_to, Ratios(odds, message, measured))
    out = {
        "odds": odds, "start": np.full(paths + 1, -1, np.int32), "index": np.full((most, 2), -1, np.int32),
        "pair": np.full((most, 8), np.nan), "state": state,
        "blocks": np.full((paths + most, blocks), np.nan, np.float32), "message": message,
        "measured": measured,
    }  # fmt: skip
    scratch = Gating(
        np.empty((2, count, nodes)), np.empty((2, paths, count)), np.empty((most, 11), np.float32)
    )
    pairs = Pairs(out["start"], out["index"], out["pair"], out["blocks"])
    evaluate(*given_to, scratch, pairs, Ratios(odds, message, measured))
    np.testing.assert_array_equal(out["start"], expected["start"])
    # a particle on the edge of what is possible may fall on either side in single precision
    steady = (out["blocks"][:paths] == expected["blocks"][:paths]).all(1)
    for name in ("index", "pair", "blocks"):
        out[name] = out[name][: len(expected[name])]
    np.testing.assert_array_equal(out["index"], expected["index"])
    np.testing.assert_allclose(out["pair"], expected["pair"], rtol=1e-5)
    np.testing.assert_allclose(out["state"], expected["state"], atol=1e-5)
    weights = out["blocks"][paths:], expected["blocks"][paths:]
    sure = steady[expected["index"][:, 0]]
    np.testing.assert_allclose(*(weight[sure] for weight in weights), rtol=5e-3, atol=5e-3)
    np.testing.assert_allclose(odds[:, steady], expected["odds"][:, steady], rtol=1e-5)
    # what enters the association follows from these blocks, whose least weights only the twin keeps
    own = (out[name] for name in ("blocks", "start", "index", "pair"))
    before = odds, np.full_like(message, 7.0), np.full_like(measured, 7.0)
    _, entered, explained = reference.enter(*own, *before)
    explained[1] = expected["measured"][1]
    np.testing.assert_allclose(message, entered, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(measured, explained, rtol=1e-5, atol=1e-12)


@given(SEEDS, st.integers(0, 6), st.integers(0, 6))
@settings(max_examples=40, deadline=None)
def test_association_messages_equal_their_twin(seed, paths, count):
    from gridslam.kernels.messages.association import associate

    draw = np.random.default_rng(seed)
    odds, message, measured = (
        np.full(shape, np.nan) for shape in ((12, paths), (5, paths, count), (5, count))
    )
    message[1] = draw.exponential(10.0 ** draw.integers(-2, 4), (paths, count))
    message[1] *= draw.random((paths, count)) < 0.6
    odds[7], measured[2] = draw.uniform(1e-6, 1, paths), 1 + draw.exponential(1.0, count)
    rounds = int(draw.choice([1, 7, 100]))
    expected = reference.associate(odds, message, measured, rounds)
    associate(odds, message, measured, rounds)
    for found, wanted in zip((message[2], message[3], measured[3]), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-9)
