"""Kernels that pick, weigh, associate and take in pairs of a path and a measurement, against their twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import detection_table, random_bank, random_belief, random_radio, random_table
from scipy.special import i0e

from gridslam import runtime, twins
from gridslam.kernels import PATH_BLOCK, SUMS

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
seeds = st.integers(0, 2**32 - 1)


def predictions(draw, paths):
    value = draw.uniform([1, -3, -3], [9, 3, 3], (paths, 3))
    root = 0.1 * draw.normal(size=(paths, 3, 3))
    return np.concatenate([value, (root @ root.transpose(0, 2, 1)).reshape(-1, 9)], 1)


@given(seeds, st.booleans(), st.booleans(), st.booleans())
@settings(max_examples=60, deadline=None)
def test_gated_pairs_equal_their_twin(seed, given_std, flat_array, spreading):
    from gridslam.kernels.gating import gate

    draw = np.random.default_rng(seed)
    paths, count, nodes = int(draw.integers(0, 7)), int(draw.integers(0, 9)), 12
    predicted = predictions(draw, paths)
    heard, radio = random_table(draw, count, predicted[:, :3]), random_radio(draw, given_std, flat_array)
    belief = draw.dirichlet(np.full(nodes, 0.3), paths).reshape(paths, nodes)
    belief[: paths // 2, ::2] = 0.0  # nodes that can't be
    level = np.linspace(2, 80, nodes) if spreading else np.linspace(0.4, 12, nodes)
    worth, (chance, step) = draw.choice([0.0, 0.7], paths), detection_table()
    start, room = np.zeros(paths + 1, np.int32), max(paths * count, 1)
    index, pair, table = np.zeros((room, 2), np.int32), np.zeros((room, 8)), np.zeros((room, 11), np.float32)
    detected, strength = np.full(paths, np.nan), np.full((2, paths, count), np.nan)
    given_to = belief, level, float(spreading), predicted, worth, heard, chance, step, radio, 0.1
    gate(*given_to, np.empty((2, count, nodes)), detected, strength, start, index, pair, table)
    chosen, expected, inverse, sure, weight = twins.gate(*given_to)
    found = start[-1]
    np.testing.assert_allclose(detected, sure, rtol=1e-6)
    np.testing.assert_allclose(strength, weight, rtol=1e-5, atol=1e-250)
    np.testing.assert_array_equal(index[:found], chosen)
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

    from gridslam.kernels.radio import scaled_bessel

    @ti.kernel
    def tabulate(x: ti.types.ndarray(dtype=ti.f64, ndim=1), y: ti.types.ndarray(dtype=ti.f64, ndim=1)):
        for n in range(x.shape[0]):
            y[n] = scaled_bessel(x[n])

    x = np.concatenate([[0.0, 3.75], np.geomspace(1e-6, 1e6, 3000)])
    y = np.empty_like(x)
    tabulate(x, y)
    np.testing.assert_allclose(y, i0e(x), rtol=5e-7)


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_messages_into_the_association_equal_their_twin(seed):
    from gridslam.kernels.association import enter

    draw = np.random.default_rng(seed)
    paths, count = int(draw.integers(0, 6)), int(draw.integers(0, 6))
    chosen = np.argwhere(draw.random((paths, count)) < 0.5).astype(np.int32)
    blocks = draw.uniform(0, 64, (paths + len(chosen), 3)).astype(np.float32)
    blocks[: paths // 3] = 0.0  # possible nowhere
    index = np.zeros((len(chosen) + 2, 2), np.int32)  # longer than need be
    index[: len(chosen)] = chosen
    pair, prior = draw.uniform(0.1, 2, (len(index), 8)), draw.uniform(0, 1, (4, paths))
    ratio, beta = np.full((2, paths, count), np.nan)
    odds, explained = np.full((4, paths), np.nan), np.full(count, np.nan)
    enter(blocks, index, pair, prior, ratio, beta, odds, explained)
    expected = twins.enter(blocks, index, pair, prior, ratio)
    for found, wanted in zip((ratio, beta, odds, explained), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-12)


@given(seeds, st.integers(0, 6), st.integers(0, 6))
@settings(max_examples=40, deadline=None)
def test_association_messages_equal_their_twin(seed, paths, count):
    from gridslam.kernels.association import associate

    draw = np.random.default_rng(seed)
    beta = draw.exponential(10.0 ** draw.integers(-2, 4), (paths, count)) * (
        draw.random((paths, count)) < 0.6
    )
    missed, new = draw.uniform(1e-6, 1, paths), 1 + draw.exponential(1.0, count)
    rounds = int(draw.choice([1, 7, 100]))
    message, claimed = np.full((2, paths, count), np.nan), np.full(count, np.nan)
    associate(beta, missed[None], new, rounds, message, claimed)
    expected = twins.associate(beta, missed[None], new, rounds)
    for found, wanted in zip((*message, claimed), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-9)


@given(seeds, st.integers(0, 3), st.sampled_from([0, 100]))
@settings(max_examples=60, deadline=None)
def test_updates_equal_their_twin(seed, surfaces, rounds):
    from gridslam.kernels.updates import update

    draw = np.random.default_rng(seed)
    mean, covariance, path = random_belief(draw, surfaces)
    place = np.array([*draw.uniform(-5, 5, 2), draw.uniform(-3, 3)])
    value, _, spread = twins.predict(mean, covariance, path, place[None])
    far = value[:, 0] > 0.5  # next to its image, an agent has no direction to it
    path, value, spread = path[far], value[far], spread[far]
    count, anchors = 4, 2
    chosen = np.argwhere(draw.random((len(path), count)) < 0.4).astype(np.int32)
    start = np.searchsorted(chosen[:, 0], np.arange(len(path) + 1)).astype(np.int32)
    pair = np.ones((len(chosen), 8))
    pair[:, :3] = value[chosen[:, 0]] + 0.1 * draw.normal(size=(len(chosen), 3))
    pair[:, 3:6] = np.where(draw.random((len(chosen), 3)) < 0.2, 1e12, 0.01)
    pair[:, 6] = draw.exponential(10.0 ** draw.integers(-2, 3), len(chosen))
    beta, ratio, nu = (
        np.zeros((len(path), count)),
        np.zeros((len(path), count)),
        draw.uniform(0.2, 1, (len(path), count)),
    )
    beta[tuple(chosen.T)] = draw.exponential(1.0, len(chosen))
    ratio[tuple(chosen.T)] = draw.exponential(1.0, len(chosen))
    prior, odds = draw.uniform(0.05, 0.95, (2, 4, len(path)))
    heard = random_table(draw, count)
    blocks = draw.uniform(0, 64, (len(path) + len(chosen), 3)).astype(np.float32)
    surface, _, _, sight, single, double = random_bank(draw, surfaces, anchors)
    predicted = np.concatenate([value, spread.reshape(-1, 9)], 1)
    sums = np.append(draw.uniform(0, 1, SUMS - 1), 150.0)
    into = {
        "mean": mean, "covariance": covariance, "path": path, "start": start, "index": chosen, "pair": pair,
        "prior": prior, "odds": odds, "ratio": ratio, "beta": beta, "new": 1 + draw.exponential(1.0, count),
        "rounds": rounds, "place": place, "predicted": predicted, "heard": heard, "blocks": blocks,
        "radio": random_radio(draw), "turned": 0.01,
    }  # fmt: skip
    messages = {"message": np.stack([nu, nu, nu]), "claimed": draw.uniform(0, 1, count)}
    kept = {"surface": surface, "sight": sight, "single": single, "double": double}
    out = {
        "share": np.full(len(chosen), np.nan), "worth": np.full((3, len(path)), np.nan), "sums": sums,
    }  # fmt: skip
    expected = twins.update(**into, **messages, **kept, sums=sums)
    scratch = np.empty((len(mean), 6))
    update(*into.values(), scratch, *messages.values(), *kept.values(), *out.values())
    found = into | messages | kept | out
    found["worth"], found["message"] = found["worth"][0], found["message"][1:]
    for name, wanted in expected.items():
        np.testing.assert_allclose(found[name], wanted, rtol=1e-5, atol=1e-7, err_msg=name)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9
    assert (surface < 1).all()


def test_equally_sure_paths_are_taken_as_they_stand():
    import taichi as ti

    from gridslam.kernels.gaussian import sorted_by

    @ti.kernel
    def order_of(rank: ti.types.ndarray(dtype=ti.f64, ndim=2)) -> ti.i32:
        count = 0
        for _ in range(1):
            count = sorted_by(rank, 0.25, rank.shape[1])
        return count

    rank = np.full((3, 7), -1.0)
    rank[1] = [0.5, 0.1, 0.9, 0.5, 0.25, 0.9, 0.0]
    assert order_of(rank) == 5
    assert rank[2].tolist() == [2, 5, 0, 3, 4, -1, -1]


def test_effective_sample_size_is_all_of_equal_weights_and_follows_their_spread():
    draw, size = np.random.default_rng(1), twins.effective_sample_size
    assert size(np.full((1, 20), 64.0, np.float32)) == pytest.approx(20 * PATH_BLOCK)
    assert size(np.zeros((1, 20), np.float32)) == 20 * PATH_BLOCK
    # exponential weights: E[w]^2 / E[w^2] = 1 / 2; 4000 blocks tell their variance to 1 / sqrt(2000)
    blocks = draw.exponential(1.0, (1, 4000, PATH_BLOCK)).sum(2).astype(np.float32)
    assert size(blocks)[0] / (4000 * PATH_BLOCK) == pytest.approx(0.5, abs=0.5 * 4 / np.sqrt(2000))
