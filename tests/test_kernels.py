"""Every kernel against its plain NumPy twin: random inputs, and the edges where kernels go wrong."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam import runtime, twins
from gridslam.geometry import wrap
from gridslam.inference.proposals import SAMPLES
from gridslam.kernels import PATH_BLOCK
from gridslam.signal import REFLECTION_BINS

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
seeds = st.integers(0, 2**32 - 1)


def random_world(draw, particles, kind, spread=0.05, surfaces=4):
    """States of agents near one place and lines near some walls, and all paths over them."""
    agent = np.concatenate([draw.uniform(-4, 4, (2, 1)), draw.uniform(-3, 3, (1, 1))])
    agent = (agent + spread * draw.normal(size=(3, particles))).astype(kind)
    angle = draw.uniform(-np.pi, np.pi, (surfaces, 1)) + 0.02 * draw.normal(size=(surfaces, particles))
    offset = draw.uniform(-6, 6, (surfaces, 1)) + spread * draw.normal(size=(surfaces, particles))
    state = np.empty((3 + 3 * surfaces, particles), kind)
    state[:3], state[3::3], state[4::3], state[5::3] = agent, np.cos(angle), np.sin(angle), offset
    path = [[0, -1, -1]] + [[1, s, s] for s in range(surfaces)]
    path += [[2, s, r] for s in range(surfaces) for r in range(surfaces) if s != r]
    place = np.array([*draw.uniform(-5, 5, 2), draw.uniform(-3, 3)], kind)
    return state, np.array(path, np.int32), place


def launch_evaluate(state, path, start, pair, place):
    from gridslam.kernels.paths import evaluate

    out = np.full((len(path) + start[-1], state.shape[1] // PATH_BLOCK), np.nan, np.float32)
    path = np.ascontiguousarray(np.pad(path, ((0, 0), (0, 1))))
    none = np.zeros((0, 3), np.float32)
    evaluate(
        none, none, none, state, path, start, pair if len(pair) else np.zeros((1, 11), np.float32), place, out
    )
    return out[len(path) :], out[: len(path)]


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_path_evaluation_equals_its_twin(seed):
    draw = np.random.default_rng(seed)
    state, path, place = random_world(draw, 2 * PATH_BLOCK, np.float32)
    agent = state[:3]
    per_path = draw.integers(0, 3, len(path))
    start = np.concatenate([[0], np.cumsum(per_path)]).astype(np.int32)
    pair = np.zeros((start[-1], 11), np.float32)
    surfaces = twins.lines_of(state).mean(1)
    for row, (bounces, last, first) in enumerate(path):
        drawn = twins.trace(
            agent[None, :2].mean(2).astype(float), place[None, :2].astype(float), surfaces[[max(last, 0)]],
            surfaces[[max(first, 0)]], np.array([bounces]),
        )  # fmt: skip
        near = [drawn.distance[0], drawn.departure[0] - place[2], drawn.arrival[0] - agent[2].mean()]
        for n in range(start[row], start[row + 1]):
            root = np.diag([0.1, 0.1, 0.1]) + 0.03 * draw.normal(size=(3, 3))
            inverse = np.linalg.inv(root @ root.T)
            pair[n, :3] = near + 0.1 * draw.normal(size=3)
            pair[n, 3:6] = np.diagonal(inverse)
            pair[n, 6:9] = inverse[0, 1], inverse[0, 2], inverse[1, 2]
            reach = 8 * np.sqrt((root @ root.T)[0, 0])
            pair[n, 9:] = pair[n, 0] - reach, pair[n, 0] + reach
    weight, valid = launch_evaluate(state, path, start, pair, place)
    expected, possible = twins.evaluate([], [], [], state, path, start, pair, place, PATH_BLOCK)
    # a particle on the edge of what is possible may fall on either side in single precision
    assert np.abs(valid - possible).max() <= 2
    sure = np.repeat(valid == possible, per_path, axis=0)
    np.testing.assert_allclose(weight[sure], expected[sure], rtol=5e-3, atol=5e-3)


@pytest.mark.parametrize("surfaces", [1, 3])
def test_path_evaluation_without_any_measurement_still_tells_what_is_possible(surfaces):
    draw = np.random.default_rng(5)
    state, path, place = random_world(draw, PATH_BLOCK, np.float32, surfaces=surfaces)
    start = np.zeros(len(path) + 1, np.int32)
    weight, valid = launch_evaluate(state, path, start, np.zeros((0, 11), np.float32), place)
    assert weight.shape[0] == 0
    _, possible = twins.evaluate([], [], [], state, path, start, np.zeros((0, 11)), place, PATH_BLOCK)
    np.testing.assert_allclose(valid, possible, atol=1)


def test_a_wall_that_the_path_runs_along_or_stands_on_gives_no_reflection():
    # agent and anchor on either side of the first, and on the second: parallel and grazing rays
    state = np.tile(np.array([[2, 1, 0, 0, 1, 0, 0, 1, 1]], np.float32).T, PATH_BLOCK)
    path = np.array([[1, 0, 0], [1, 1, 1]], np.int32)
    place = np.array([0, -1, 0], np.float32)
    _, valid = launch_evaluate(state, path, np.zeros(3, np.int32), np.zeros((0, 11), np.float32), place)
    assert (valid == 0).all()


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_drawn_polylines_equal_their_twin(seed):
    from gridslam.kernels.paths import polylines

    draw = np.random.default_rng(seed)
    state, path, place = random_world(draw, 7, np.float64)
    drawn = np.zeros((len(path) * 7, 13))
    path = np.pad(path, ((0, 0), (0, 1)))
    polylines(state, path, place[None], drawn)
    drawn = drawn.reshape(len(path), 7, 13)
    expected, possible = twins.polylines(state, path, place[None])
    near = np.abs(expected).max((2, 3)) < 1e3
    np.testing.assert_array_equal(drawn[near, 12], possible[near])
    np.testing.assert_allclose(drawn[near, :8].reshape(-1, 4, 2), expected[near], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.hypot(drawn[..., [8, 10]], drawn[..., [9, 11]]), 1, atol=1e-9)


@given(seeds, st.booleans(), st.sampled_from([SAMPLES // 2, SAMPLES, 2 * SAMPLES]))
@settings(max_examples=15, deadline=None)
def test_birth_proposals_equal_their_twin(seed, with_departure, particles):
    from gridslam.kernels.births import propose

    draw = np.random.default_rng(seed)
    state, _, place = random_world(draw, particles, np.float32, surfaces=2)
    place = place.astype(np.float64)
    heard = np.array([[draw.uniform(1, 15), *draw.uniform(-3, 3, 2), 0.05, 0.3, 0.1] for _ in range(3)])
    heard[:, 4] = 0.3 if with_departure else 1e9
    known = np.array([[-1, -1], [-1, 0], [0, -1], [1, -1], [-1, 1]], np.int32)
    noise, weight = draw.normal(size=(2, SAMPLES)), np.zeros((3, 5))
    propose(state, noise, heard, known, place, weight)
    expected = twins.propose(state, noise, heard, known, place)
    np.testing.assert_allclose(weight, expected, rtol=2e-3, atol=1e-6)


def random_belief(draw, surfaces):
    """Mean and correlated covariance of an agent and some surfaces, and all paths over them."""
    mean = np.concatenate([draw.uniform(-4, 4, 2), draw.normal(0, 0.1, 2), draw.uniform(-3, 3, 1)])
    lines = np.stack([draw.uniform(-3, 3, surfaces), draw.uniform(1, 6, surfaces)], -1)
    mean = np.concatenate([mean, lines.ravel()])
    root = 0.03 * draw.normal(size=(len(mean), len(mean)))
    path = [[0, -1, -1]] + [[1, s, s] for s in range(surfaces)]
    path += [[2, s, r] for s in range(surfaces) for r in range(surfaces) if s != r]
    return mean, root @ root.T + 1e-5 * np.eye(len(mean)), np.array(path, np.int32)


@given(seeds, st.integers(0, 4))
@settings(max_examples=25, deadline=None)
def test_predicted_paths_equal_their_twin(seed, surfaces):
    from gridslam.kernels.gaussian import predict

    draw = np.random.default_rng(seed)
    mean, covariance, path = random_belief(draw, surfaces)
    place, out = np.array([*draw.uniform(-5, 5, 2), draw.uniform(-3, 3)]), np.zeros((len(path), 12))
    path = np.pad(path, ((0, 0), (0, 1)))
    predict(mean, covariance, path, place[None], out)
    value, _, spread = twins.predict(mean, covariance, path, place[None])
    far = value[:, 0] > 0.1  # next to its image, an agent has no direction to it
    np.testing.assert_allclose(out[far, 0], value[far, 0], rtol=1e-9)
    np.testing.assert_allclose(wrap(out[far, 1:3] - value[far, 1:]), 0, atol=1e-6)
    np.testing.assert_allclose(out[far, 3:].reshape(-1, 3, 3), spread[far], rtol=1e-6, atol=1e-9)


@given(seeds, st.integers(0, 3))
@settings(max_examples=25, deadline=None)
def test_correction_equals_its_twin(seed, surfaces):
    from gridslam.kernels.gaussian import correct

    draw = np.random.default_rng(seed)
    mean, covariance, path = random_belief(draw, surfaces)
    place = np.array([*draw.uniform(-5, 5, 2), draw.uniform(-3, 3)])
    value, _, spread = twins.predict(mean, covariance, np.pad(path, ((0, 0), (0, 1))), place[None])
    path, value, spread = path[value[:, 0] > 0.5], value[value[:, 0] > 0.5], spread[value[:, 0] > 0.5]
    start = np.append(0, np.cumsum(draw.integers(0, 3, len(path)))).astype(np.int32)
    path = np.pad(path, ((0, 0), (0, 1)))
    pair = np.zeros((int(start[-1]), 9))
    for row in range(len(path)):
        for k in range(start[row], start[row + 1]):
            std = np.array([0.1, 0.1, 0.1])
            pair[k, :3] = value[row] + draw.normal(size=3) * std
            pair[k, 3:6] = np.where(draw.random(3) < 0.2, 1e12, std**2)
            pair[k, 6:8] = draw.exponential(0.01), draw.uniform(0.2, 1)
    prior, order = (
        draw.uniform(0.1, 0.9, (2, len(path))),
        draw.permutation(len(path))[: len(path) - 1].astype(np.int32),
    )
    expected = twins.correct(mean, covariance, path, start, order, prior, pair, place, 1e-6)
    share, scratch = np.zeros(len(pair)), np.zeros((len(mean), 6))
    correct(mean, covariance, path, start, order, prior, pair, place, 1e-6, scratch, share)
    for found, wanted in zip((mean, covariance, share), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-7)
    assert np.linalg.eigvalsh(covariance).min() > -1e-9


@given(seeds, st.booleans(), st.booleans())
@settings(max_examples=40, deadline=None)
def test_gated_pairs_equal_their_twin(seed, given_std, flat_array):
    from gridslam.kernels.gating import gate

    draw = np.random.default_rng(seed)
    paths, count = draw.integers(0, 7), draw.integers(0, 9)
    value = draw.uniform([1, -3, -3], [9, 3, 3], (paths, 3))
    root = 0.1 * draw.normal(size=(paths, 3, 3))
    predicted = np.concatenate([value, (root @ root.transpose(0, 2, 1)).reshape(-1, 9)], 1)
    heard = np.concatenate([draw.uniform([1, -3, -3], [9, 3, 3], (count, 3)), np.zeros((count, 3))], 1)
    if paths and count:  # some next to a path, across the wrap of an angle, too
        heard[::2, :3] = value[draw.integers(0, paths, len(heard[::2]))] + [0.05, 0.1, 2 * np.pi - 0.1]
    heard[:, 3:] = draw.choice([0.0, -1.0, 0.05], (count, 3))
    strength = draw.exponential(1.0, (2, paths, count)) * draw.choice([0.0, 1.0], (2, paths, count))
    aperture = [0.0, 0.0] if flat_array else [0.3, 0.1]
    radio = np.array(
        [0.5, 0.02 * given_std, 0.4, 0.2, *aperture, 30.0, 0.1, 6.0, 0.3, 0.3, 1e12, 0.3]
    )  # fmt: skip
    worth = draw.choice([0.0, 0.7], paths)
    start, room = np.zeros(paths + 1, np.int32), max(paths * count, 1)
    index, pair, table = np.zeros((room, 2), np.int32), np.zeros((room, 9)), np.zeros((room, 11), np.float32)
    gate(predicted, worth, heard, strength, radio, start, index, pair, table)
    chosen, expected, inverse = twins.gate(predicted, worth, heard, strength, radio)
    found = start[-1]
    np.testing.assert_array_equal(index[:found], chosen)
    np.testing.assert_array_equal(start, np.searchsorted(chosen[:, 0], np.arange(paths + 1)))
    np.testing.assert_allclose(pair[:found], expected, rtol=1e-6)
    np.testing.assert_allclose(table[:found, :3], expected[:, :3], rtol=1e-6)
    np.testing.assert_allclose(table[:found, 3:6], np.diagonal(inverse, axis1=1, axis2=2), rtol=1e-4)
    off = inverse[:, [0, 0, 1], [1, 2, 2]]
    np.testing.assert_allclose(table[:found, 6:9], off, rtol=1e-4, atol=1e-6 * np.abs(inverse).max(initial=1))
    middle = table[:found, 9:].mean(1)
    np.testing.assert_allclose(middle[expected[:, 3] < 1e9], expected[expected[:, 3] < 1e9, 0], rtol=1e-5)


def test_a_quick_launch_is_the_same_and_refuses_what_it_was_not_compiled_for():
    from gridslam.kernels.paths import polylines

    draw = np.random.default_rng(3)
    state, places = draw.normal(size=(9, 5)), np.zeros((1, 3))
    path = np.array([[0, -1, -1, 0], [1, 0, 0, 0], [2, 0, 1, 0]], np.int32)
    slow, fast = np.zeros((15, 13)), np.zeros((15, 13))
    polylines.__wrapped__(state, path, places, slow)
    polylines(state, path, places, fast)
    assert slow.any()
    np.testing.assert_array_equal(slow, fast)
    polylines(state[:, :0], path, places, fast[:0])
    for wrong in (state.astype(np.float32), state[:, ::2], state[0], state.tolist()):
        with pytest.raises(Exception, match=r"state|contiguous|float|list|ndarray"):
            polylines(wrong, path, places, fast)
    with pytest.raises(Exception, match="missing"):
        polylines(state, path, places)


def test_a_kernel_of_another_taichi_is_launched_as_it_is():
    from gridslam.kernels.launching import quick

    def kernel():
        """Without what Taichi 1.7 keeps of a kernel."""

    assert quick(kernel) is kernel


@pytest.mark.parametrize("surfaces", [0, 1, 7])
@pytest.mark.parametrize("spread", [0.01, 3.0])
def test_particles_equal_their_twin_however_far_they_turn(surfaces, spread):
    from gridslam.kernels.paths import evaluate

    random, size = np.random.default_rng(5), 5 + 2 * surfaces
    root = np.tril(spread * random.normal(size=(size, size)) / np.sqrt(size)).astype(np.float32)
    mean = random.normal(size=size) * 3
    base = np.stack([mean, np.cos(mean), np.sin(mean)], -1, dtype=np.float32)
    points = random.normal(size=(size + 2, 3 * PATH_BLOCK)).astype(np.float32)  # more than are needed
    state = np.full((3 + 3 * surfaces, points.shape[1]), np.nan, np.float32)
    pair, out = np.zeros((1, 11), np.float32), np.zeros((0, 3), np.float32)
    table, start, place = np.zeros((0, 4), np.int32), np.zeros(1, np.int32), np.zeros(3, np.float32)
    evaluate(root, base, points, state, table, start, pair, place, out)
    np.testing.assert_allclose(state, twins.draw(root, base, points), atol=1e-5)


@given(seeds, st.sampled_from([1, 5, 48]))
@settings(max_examples=25, deadline=None)
def test_coefficients_recalled_and_learned_equal_their_twins(seed, rays):
    from gridslam.kernels.coefficients import BINS, learn, recall
    from gridslam.kernels.paths import polylines

    assert len(REFLECTION_BINS) == BINS, "kernels can't import it, and hold so many on the stack"
    draw = np.random.default_rng(seed)
    state, path, place = random_world(draw, rays, np.float64, surfaces=3)
    path, drawn = np.pad(path, ((0, 0), (0, 1))), np.zeros((len(path) * rays, 13))
    polylines(state, path, place[None], drawn)
    drawn = np.pad(drawn, ((0, 0), (0, 1)))
    held = draw.normal(0, draw.choice([0.1, 30.0]), (9, 11, 20))  # some so sure that all else is impossible
    surface = draw.dirichlet(np.full(20, 0.2), 3)
    frame = np.array([-3.0, -2.0, 0.7, 0.05])  # some hits are outside
    belief = np.full((len(path), 40), np.nan)
    recall(drawn, path, held, surface, frame, belief)
    np.testing.assert_allclose(belief.sum(1), 1, rtol=1e-9)
    np.testing.assert_allclose(belief, twins.recall(drawn, path, held, surface, frame), atol=1e-9)
    where = np.array([[r, c] for r in range(len(path)) for c in range(1, path[r, 0] + 1)], np.int32)
    factor = draw.normal(size=(len(where), 20))
    expected = twins.learn(drawn, path, where, factor, frame, held)
    learn(drawn, path, where, factor, frame, held)
    np.testing.assert_allclose(held, expected, atol=1e-9)


@given(seeds, st.integers(0, 6), st.integers(0, 6))
@settings(max_examples=40, deadline=None)
def test_association_messages_equal_their_twin(seed, paths, count):
    from gridslam.kernels.association import associate

    draw = np.random.default_rng(seed)
    beta = draw.exponential(10.0 ** draw.integers(-2, 4), (paths, count)) * (
        draw.random((paths, count)) < 0.6
    )
    missed, new = draw.uniform(1e-6, 1, paths), 1 + draw.exponential(1.0, count)
    limit = np.array([draw.choice([1, 7, 100]), 1e-6])
    claim, nu = np.full((2, paths, count), np.nan)
    associate(beta, missed, new, limit, claim, nu)
    for found, wanted in zip((claim, nu), twins.associate(beta, missed, new, limit), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-9)
