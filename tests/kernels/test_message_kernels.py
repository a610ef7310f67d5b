"""Kernels that pick, weigh, associate and take in pairs of a path and a measurement, against their twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_stages import stages
from kernel_worlds import (
    UNKNOWN,
    detection_table,
    random_bank,
    random_belief,
    random_places,
    random_radio,
    random_table,
)
from scipy.special import i0e

from gridslam import reference, runtime
from gridslam.bench.kernels import twin_arguments
from gridslam.kernels import PATH_BLOCK, SUMS
from gridslam.kernels.primitives.blocks import Amplitudes, Anchors, Drawing, Gating, Pairs, PathRows, Ratios

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
seeds = st.integers(0, 2**32 - 1)


def predicted_of(mean, covariance, head, path, places):
    """Values, spreads and lengths of paths, by the twin."""
    value, _, spread = reference.predict(mean, covariance, head, path, places)
    late = reference.late(mean, head, path[:, 3], places)
    return np.column_stack([value, spread.reshape(-1, 9), value[:, 0] - late])


def predictions(draw, paths):
    value = draw.uniform([1, -3, -3], [9, 3, 3], (paths, 3))
    root = 0.1 * draw.normal(size=(paths, 3, 3))
    spread = (root @ root.transpose(0, 2, 1)).reshape(-1, 9)
    late = draw.choice([0.0, 1.0]) * np.repeat(draw.normal(0, 3, 2), [paths - paths // 2, paths // 2])
    return np.column_stack([value[:, 0] + late, value[:, 1:], spread, value[:, 0]])


@pytest.mark.slow
@given(seeds, st.booleans(), st.booleans(), st.booleans())
@settings(max_examples=60, deadline=None)
def test_gated_pairs_equal_their_twin(seed, given_std, flat_array, spreading):
    gate, _, _ = stages()
    draw = np.random.default_rng(seed)
    paths, count, nodes = int(draw.integers(0, 7)), int(draw.integers(0, 9)), 12
    predicted = predictions(draw, paths)
    path = np.zeros((paths, 4), np.int32)
    path[paths - paths // 2 :, 3] = 1
    heard, radio = random_table(draw, count, predicted[:, :3]), random_radio(draw, given_std, flat_array)
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
    given_to = belief, level, float(spreading), path, predicted, heard, chance, step, places, radio, 0.1
    measured = np.full((5, count), np.nan)
    chosen, expected, inverse, sure, weight = reference.gate(*given_to, odds)
    gate(
        float(spreading), step, 0.1, Amplitudes(belief, level, chance), PathRows(path, predicted), heard,
        places, radio, Gating(np.empty((2, count, nodes)), strength, table),
        Pairs(start, index, pair, np.zeros((0, 0), np.float32)), Ratios(odds, np.zeros((0, 0, 0)), measured),
    )  # fmt: skip
    found = start[-1]
    np.testing.assert_allclose(odds[3], sure, rtol=1e-6)
    np.testing.assert_allclose(strength, weight, rtol=1e-5, atol=1e-250)
    np.testing.assert_array_equal(index[:found], chosen)
    np.testing.assert_array_equal(measured[1], heard[:, 8])
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
@given(seeds)
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


@given(seeds, st.booleans(), UNKNOWN)
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
    heard, radio = random_table(draw, count, predicted[:, :3]), random_radio(draw)
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
        PathRows(path, predicted), heard, Anchors(places, radio), Drawing(root, base, points, state),
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


@given(seeds, st.integers(0, 6), st.integers(0, 6))
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


@given(seeds, st.integers(0, 3), st.sampled_from([0, 100]), st.booleans(), UNKNOWN)
@settings(max_examples=60, deadline=None)
def test_updates_equal_their_twin(seed, surfaces, rounds, noted, unknown):
    from gridslam.kernels.messages.updates import update, update_with_clocks, update_with_rises

    draw, (clocks, rises) = np.random.default_rng(seed), unknown
    mean, covariance, path = random_belief(draw, surfaces, clocks, rises)
    places = random_places(draw, 2, rises)
    path[:, 3] = np.sort(draw.integers(0, 2, len(path)))
    predicted = predicted_of(mean, covariance, 5 + clocks, path, places)
    far = predicted[:, 12] > 0.5  # next to its image, an agent has no direction to it
    path, predicted = path[far], predicted[far]
    value = predicted[:, :3]
    count, anchors = 4, 2
    chosen = np.argwhere(draw.random((len(path), count)) < 0.4).astype(np.int32)
    start = np.searchsorted(chosen[:, 0], np.arange(len(path) + 1)).astype(np.int32)
    pair = np.ones((len(chosen), 8))
    pair[:, :3] = value[chosen[:, 0]] + 0.1 * draw.normal(size=(len(chosen), 3))
    pair[:, 3:6] = np.where(draw.random((len(chosen), 3)) < 0.2, 1e12, 0.01)
    pair[:, 6] = draw.exponential(10.0 ** draw.integers(-2, 3), len(chosen))
    message = np.zeros((5, len(path), count))
    message[:2, chosen[:, 0], chosen[:, 1]] = draw.exponential(1.0, (2, len(chosen)))
    message[3] = draw.uniform(0.2, 1, (len(path), count))
    odds, measured = draw.uniform(0.05, 0.95, (12, len(path))), draw.uniform(0, 1, (5, count))
    measured[2] = 1 + draw.exponential(1.0, count)
    heard = random_table(draw, count)
    blocks = draw.uniform(0, PATH_BLOCK, (len(path) + len(chosen), 3)).astype(np.float32)
    surface, _, _, sight, single, double = random_bank(draw, surfaces, anchors)
    sums = draw.uniform(0, 1, (anchors, SUMS))
    sums[:, -1] = 150.0
    into = {
        "mean": mean, "covariance": covariance, "head": 5 + clocks, "path": path, "start": start,
        "index": chosen, "pair": pair, "odds": odds, "rounds": rounds, "places": places,
        "predicted": predicted, "scan": heard, "blocks": blocks, "radio": random_radio(draw),
        "turned": np.array([-0.02, 0.01]),
    }  # fmt: skip
    messages = {"message": message, "measured": measured}
    kept = {"surface": surface, "sight": sight, "single": single, "double": double}
    rows, pairs = len(path), len(chosen)
    notes = {
        "count": np.array([2, 3], np.int32), "noted": np.full((rows + 4, 4), 7, np.int32),
        "factor": draw.normal(size=(rows + 4, 2)), "summary": draw.normal(size=(4, rows + 4)),
        "begin": np.full(rows + 5, 3, np.int32), "detection": draw.normal(size=(2, pairs + 5)),
    }  # fmt: skip
    if not noted:
        notes["noted"] = np.empty((0, 4), np.int32)
    out = {"share": np.full(len(chosen), np.nan), "sums": sums} | notes
    flat = into | messages | kept | out | {"scratch": np.empty((len(mean), 6))}
    expected = reference.update(**twin_arguments(reference.update, flat))
    launch = update_with_rises() if rises else update_with_clocks() if clocks else update
    launch.named(**flat)
    found = into | messages | kept | out
    found["worth"], found["total"] = odds[8], odds[11]
    for name, wanted in expected.items():
        # directions are worked out to 1e-6 rad: in means at most that, in densities times gap over variance
        rtol = 1e-4 if name in ("share", "message", "total") else 1e-5
        np.testing.assert_allclose(found[name], wanted, rtol=rtol, atol=1e-6, err_msg=name)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9
    assert (surface < 1).all()


def test_equally_sure_paths_are_taken_as_they_stand():
    import taichi as ti

    from gridslam.kernels.primitives.corrections import sorted_by

    @ti.kernel
    def order_of(rank: ti.types.ndarray(dtype=ti.f64, ndim=2)) -> ti.i32:
        count = 0
        for _ in range(1):
            count = sorted_by(rank, 0.25, rank.shape[1])
        return count

    rank = np.full((12, 7), -1.0)
    rank[9] = [0.5, 0.1, 0.9, 0.5, 0.25, 0.9, 0.0]
    assert order_of(rank) == 5
    assert rank[10].tolist() == [2, 5, 0, 3, 4, -1, -1]


def test_effective_sample_size_is_all_of_equal_weights_and_follows_their_spread():
    draw, size = np.random.default_rng(1), reference.effective_sample_size
    assert size(np.full((1, 20), 7.0, np.float32)) == pytest.approx(20 * PATH_BLOCK)
    assert size(np.zeros((1, 20), np.float32)) == 20 * PATH_BLOCK
    # exponential weights: E[w]^2 / E[w^2] = 1 / 2; 4000 blocks tell their variance to 1 / sqrt(2000)
    blocks = draw.exponential(1.0, (1, 4000, PATH_BLOCK)).sum(2).astype(np.float32)
    assert size(blocks)[0] / (4000 * PATH_BLOCK) == pytest.approx(0.5, abs=0.5 * 4 / np.sqrt(2000))


@pytest.fixture(scope="module")
def bent():
    """A kernel that writes what `bend_of` says of a line of sight, its value and derivatives by x and y."""
    import taichi as ti

    from gridslam.kernels.primitives.gaussian import bend_of, path_of

    @ti.kernel
    def bent(
        mean: ti.types.ndarray(dtype=ti.f64, ndim=1),
        covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),
        place: ti.types.ndarray(dtype=ti.f64, ndim=1),
        out: ti.types.ndarray(dtype=ti.f64, ndim=2),
    ):
        for _ in range(1):
            own = ti.Vector([place[0], place[1], place[2], 0.0, place[3]], dt=ti.f64)
            value, slope = path_of(mean, 5, own, 0, 0, 0)
            more, spread = bend_of(slope, value[0], covariance)
            for i in ti.static(range(3)):
                out[0, i], out[4, i] = more[i], value[i]
                for j in ti.static(range(3)):
                    out[1 + i, j] = spread[i, j]
                for j in ti.static(range(2)):
                    out[5 + i, j] = slope[i, j]

    return bent


@given(seeds, st.booleans())
@settings(max_examples=40, deadline=None)
def test_what_derivatives_leave_out_equals_its_twin_and_is_what_samples_show(bent, seed, high):
    draw = np.random.default_rng(seed)
    level, toward = draw.uniform(0.03, 0.45), draw.uniform(-np.pi, np.pi)
    place = np.array([*draw.normal(size=2), draw.uniform(-3, 3), 0.2 * high])
    mean = np.zeros(5)
    mean[:2] = place[:2] + level * np.array([np.cos(toward), np.sin(toward)])
    root = 0.03 * level * (np.eye(2) + 0.2 * draw.normal(size=(2, 2)))
    covariance = np.zeros((5, 5))
    covariance[:2, :2] = root @ root.T
    found = np.zeros((8, 5))
    bent(mean, covariance, place, found)
    more, spread = reference.bend(mean, covariance, place, place[3])
    np.testing.assert_allclose(found[0, :3], more, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found[1:4, :3], spread, rtol=1e-4, atol=1e-12)

    moved = (root @ draw.standard_normal((2, 20_000))).T
    away = mean[:2] + moved - place[:2]
    turn = np.angle(np.exp(1j * (np.arctan2(away[:, 1], away[:, 0]) - toward)))
    exact = np.stack([np.hypot(np.hypot(*away.T), place[3]), turn, turn], -1)
    exact[:, 0] -= np.hypot(level, place[3])
    rest = exact - moved @ found[5:8, :2].T
    scale = np.sqrt(np.diag(spread)) + 1e-12
    np.testing.assert_allclose(rest.mean(0) / scale, more / scale, atol=0.15)
    assert rest.std(0) / scale == pytest.approx(np.ones(3), abs=0.1)


def test_nothing_is_bent_further_off():
    more, spread = reference.bend(np.zeros(5), np.eye(5), np.array([0.6, 0.0, 0.0]), 0.0)
    assert not more.any()
    assert not spread.any()
