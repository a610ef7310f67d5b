"""Every kernel against its plain NumPy twin: random inputs, and the edges where kernels go wrong."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of, state_of
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_stages import stages
from kernel_worlds import SEEDS, random_world

from gridslam import reference, runtime
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.particles import Sampling, draft_of
from gridslam.inference.messages.path_prediction import PathQuery
from gridslam.inference.workspace.workspace import SHAPES, SLOTS, Workspace
from gridslam.kernels import PATH_BLOCK
from gridslam.kernels.primitives.blocks import OFFSET, SHARE
from gridslam.kernels.primitives.tables import ODDS, OPEN


def launch_densities(state, path, start, pair, place, is_open=1.0):
    _, densities, _ = stages()
    out = np.full((len(path) + start[-1], state.shape[1] // PATH_BLOCK), np.nan, np.float32)
    pair = pair if len(pair) else np.zeros((1, 11), np.float32)
    odds = np.full((ODDS, len(path)), np.nan)
    odds[OPEN] = is_open
    densities(state, 5, with_anchor(path), place[None].astype(float), start, pair, odds, out)
    return out[len(path) :], out[: len(path)]


def with_anchor(path):
    return np.ascontiguousarray(np.pad(path, ((0, 0), (0, 1))))


def expected_densities(state, path, start, pair, place):
    return reference.densities(
        state, 5, with_anchor(path), place[None].astype(float), start, pair, PATH_BLOCK
    )


@pytest.mark.slow
@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_path_evaluation_equals_its_twin(seed):
    draw = np.random.default_rng(seed)
    state, path, place = random_world(draw, 2 * PATH_BLOCK, np.float32)
    agent = state[:3]
    per_path = draw.integers(0, 3, len(path))
    start = np.concatenate([[0], np.cumsum(per_path)]).astype(np.int32)
    pair = np.zeros((start[-1], 11), np.float32)
    surfaces = reference.lines_of(state).mean(1)
    for row, (bounces, last, first) in enumerate(path):
        drawn = reference.trace(
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
    weight, valid = launch_densities(state, path, start, pair, place)
    expected, possible = expected_densities(state, path, start, pair, place)
    # a particle on the edge of what is possible may fall on either side in single precision
    assert np.abs(valid - possible).max() <= 2
    sure = np.repeat(valid == possible, per_path, axis=0)
    np.testing.assert_allclose(weight[sure], expected[sure], rtol=5e-3, atol=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("surfaces", [1, 3])
def test_path_evaluation_without_any_measurement_still_tells_what_is_possible(surfaces):
    draw = np.random.default_rng(5)
    state, path, place = random_world(draw, PATH_BLOCK, np.float32, surfaces=surfaces)
    start = np.zeros(len(path) + 1, np.int32)
    weight, valid = launch_densities(state, path, start, np.zeros((0, 11), np.float32), place)
    assert weight.shape[0] == 0
    _, possible = expected_densities(state, path, start, np.zeros((0, 11)), place)
    np.testing.assert_allclose(valid, possible, atol=1)
    is_open = np.arange(len(path)) % 2
    _, asked = launch_densities(state, path, start, np.zeros((0, 11), np.float32), place, is_open)
    np.testing.assert_array_equal(asked, valid * is_open[:, None])


def test_a_wall_that_the_path_runs_along_or_stands_on_gives_no_reflection():
    # agent and anchor on either side of the first, and on the second: parallel and grazing rays
    state = np.tile(np.array([[2, 1, 0, 0, 1, 0, 0, 1, 1]], np.float32).T, PATH_BLOCK)
    path = np.array([[1, 0, 0], [1, 1, 1]], np.int32)
    place = np.array([0, -1, 0, 0], np.float32)
    _, valid = launch_densities(state, path, np.zeros(3, np.int32), np.zeros((0, 11), np.float32), place)
    assert (valid == 0).all()


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_drawn_polylines_equal_their_twin(seed):
    from gridslam.kernels.propagation.paths import polylines

    draw = np.random.default_rng(seed)
    state, path, place = random_world(draw, 7, np.float64)
    drawn = np.zeros((len(path) * 7, 13))
    path = np.pad(path, ((0, 0), (0, 1)))
    polylines(state, path, place[None], drawn)
    drawn = drawn.reshape(len(path), 7, 13)
    expected, possible = reference.polylines(state, path, place[None])
    near = np.abs(expected).max((2, 3)) < 1e3
    np.testing.assert_array_equal(drawn[near, 12], possible[near])
    np.testing.assert_allclose(drawn[near, :8].reshape(-1, 4, 2), expected[near], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(np.hypot(drawn[..., [8, 10]], drawn[..., [9, 11]]), 1, atol=1e-9)


def test_a_quick_launch_is_the_same_and_refuses_what_it_was_not_compiled_for():
    from gridslam.kernels.propagation.paths import polylines

    draw = np.random.default_rng(3)
    state, places = draw.normal(size=(9, 5)), np.zeros((1, 6))
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
    for _ in range(2):  # nothing isn't what was handed over before
        with pytest.raises(Exception, match=r"places|None"):
            polylines(state, path, None, fast)


def test_a_launch_takes_what_it_is_given_whatever_it_was_given_before():
    import taichi as ti

    from gridslam.kernels.propagation.paths import polylines

    draw, places = np.random.default_rng(4), np.zeros((1, 6))
    path = np.array([[1, 0, 0, 0], [2, 0, 1, 0]], np.int32)
    mine, out = draw.normal(size=(9, 5)), np.zeros((10, 13))
    for _ in range(2):  # the first may have to compile
        polylines(mine, path, places, out)
    first = out.copy()
    held = ti.ndarray(ti.f64, (9, 5))
    held.from_numpy(2 * mine)
    polylines(held, path, places, out)
    assert (out != first).any()
    polylines(mine, path, places, out)  # at the place that it had two launches before
    np.testing.assert_array_equal(out, first)
    with pytest.raises(Exception, match=r"path|float|array"):  # handed over in part
        polylines(3 * mine, path.astype(float), places, out)
    polylines(mine, path, places, out)
    np.testing.assert_array_equal(out, first)
    mine *= 2
    polylines(mine, path, places, out)
    assert (out != first).any()
    polylines(mine[:, :0].copy(), path, places, out[:0])
    polylines(0.5 * mine, path, places, out)
    np.testing.assert_array_equal(out, first)


def test_launches_that_are_kept_side_by_side_are_not_mixed_up():
    from gridslam.kernels.primitives.launching import MOST_LAUNCHES
    from gridslam.kernels.propagation.paths import polylines

    draw, places = np.random.default_rng(6), np.zeros((1, 6))
    worlds = [
        (draw.normal(size=(9, 3 + n % 2)), np.array([[1, n % 2, n % 2, 0]] * (1 + n % 3), np.int32))
        for n in range(MOST_LAUNCHES + 2)
    ]
    for turn in range(3):  # more of them than are kept, and the first twice as often
        for number, (state, path) in enumerate([*worlds, *worlds[:2]]):
            if turn == 2 and number % 2:
                state = state + 1.0
            slow, fast = np.zeros((2, len(path) * state.shape[1], 13))
            polylines.__wrapped__(state, path, places, slow)
            polylines(state, path, places, fast)
            np.testing.assert_array_equal(fast, slow)
            assert fast.any()


def test_buffers_last_by_maker_slot_and_shape_and_belong_to_one_workspace():
    model = model_of()
    work, other = Workspace(model, seed=1), Workspace(model, seed=1)

    def pair(rows, columns):
        return np.empty((rows, columns))

    first = work.buffers(pair, 0, 2, 3)
    assert work.buffers(pair, 0, 2, 3) is first
    assert work.buffers(pair, 1, 2, 3) is not first
    assert other.buffers(pair, 0, 2, 3) is not first
    assert work.buffers(pair, 0, 3, 2).shape == (3, 2)
    assert work.buffers(pair, 0, 2, 3) is first
    for rows in range(4, 4 + SHAPES):
        work.buffers(pair, 0, rows, 2)
    assert work.buffers(pair, 0, 2, 3) is not first
    some = work.first_rows(first, 1)
    assert np.shares_memory(some, first)
    assert some.shape == (1, 3)
    assert work.first_rows(first, 1) is some is not work.first_rows(first, 2)


def test_of_many_anchors_buffers_of_one_shape_last():
    work = Workspace(model_of(), seed=1)

    def same(slot):
        first = work.buffers(pair, slot, 2, 3)
        work.buffers(pair, slot, 3, 2)
        return work.buffers(pair, slot, 2, 3) is first

    def pair(*shape):
        return np.zeros(shape)

    assert all(same(slot) for slot in range(SLOTS))
    assert not any(same(slot) for slot in range(SLOTS, SLOTS + 3))


def test_a_kernel_of_another_taichi_is_launched_as_it_is():
    from gridslam.kernels.primitives.launching import quick

    def kernel():
        """Without what Taichi 1.7 keeps of a kernel."""

    assert quick(kernel) is kernel


@pytest.mark.parametrize("surfaces", [0, 1, 7])
@pytest.mark.parametrize("clocks", [0, 3])
@pytest.mark.parametrize("spread", [0.01, 3.0])
def test_particles_equal_their_twin_however_far_they_turn(surfaces, clocks, spread):
    from gridslam.kernels.messages.evaluation import evaluate

    random, size = np.random.default_rng(5), 5 + clocks + 2 * surfaces
    root = np.tril(spread * random.normal(size=(size, size)) / np.sqrt(size)).astype(np.float32)
    mean = random.normal(size=size) * 3
    base = np.stack([mean, np.cos(mean), np.sin(mean)], -1, dtype=np.float32)
    points = random.normal(size=(size + 2, 3 * PATH_BLOCK)).astype(np.float32)  # more than are needed
    state = np.full((3 + 3 * surfaces + clocks, points.shape[1]), np.nan, np.float32)
    none = np.zeros((0, 13))
    evaluate.named(
        spreading=0.0, step=1.0, head=5 + clocks, bandwidth=0.1,
        probability=np.zeros((0, 1)), nodes=np.zeros(1), chance=np.zeros(2),
        path=np.zeros((0, 4), np.int32), predicted=none, scan=none,
        places=np.zeros((1, 6)), radio=np.zeros((1, 12)), root=root, base=base, points=points, state=state,
        density=np.zeros((2, 0, 1)), strength=np.zeros((2, 0, 0)), table=np.zeros((1, 11), np.float32),
        start=np.zeros(1, np.int32), index=np.zeros((1, 2), np.int32), pair=np.zeros((1, 8)),
        blocks=np.zeros((0, 3), np.float32), odds=np.zeros((12, 0)), message=np.zeros((5, 0, 0)),
        measured=np.zeros((5, 0)),
    )  # fmt: skip
    np.testing.assert_allclose(state, reference.draw(root, base, points, 5 + clocks), atol=1e-5)


def drawn_by(belief, points, first, samples):
    """What the kernel that looks ahead makes ready of a belief: its draft."""
    from gridslam.kernels.propagation.rays import list_paths

    model = model_of(anchors=np.zeros((1, 4)))
    query = PathQuery.of(state_of(belief), 0, model, samples, 0, Workspace(model, seed=1))
    few = Sampling.of(belief, points, first, draft_of(belief.layout, samples))
    query.query.choice[OFFSET], query.query.weight[SHARE] = first, 0.9
    query = replace(query, sampling=few)
    for arguments in query.attempts():
        list_paths(*arguments)
    return few.draft


@given(SEEDS, st.integers(0, 6), st.sampled_from([0, 1, 48]))
@settings(max_examples=30, deadline=None)
def test_a_root_and_its_samples_equal_their_twin(seed, surfaces, count):
    draw, size = np.random.default_rng(seed), 5 + 2 * surfaces
    square = draw.normal(size=(size, size))
    mean, covariance = draw.normal(0, 3, size), square @ square.T + 1e-3 * np.eye(size)
    points, first = draw.normal(size=(size + 2, 64)).astype(np.float32), int(draw.integers(64))
    draft = drawn_by(Belief(mean, covariance), points, first, count)
    assert draft.failed[0] == 0
    taken = points[:size, (first + np.arange(count)) % 64].astype(float)  # after the last comes the first
    for found, wanted in zip(draft[1:], reference.prepare(mean, covariance, 5, 0.9, taken), strict=False):
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6)


def test_the_root_of_a_singular_covariance_is_taken_another_way():
    belief = Belief(np.arange(5.0), np.diag([0.1, 0.0, 0.3, 0.2, 0.0]))
    points = np.random.default_rng(2).standard_normal((5, 4000)).astype(np.float32)
    draft = drawn_by(belief, points, 0, 4000)
    np.testing.assert_allclose(
        draft.state, reference.draw(belief.root, draft.base, points.astype(float)), atol=1e-6
    )
    np.testing.assert_allclose(draft.state[1:], [[1.0] * 4000, [4.0] * 4000], atol=1e-7)
    np.testing.assert_allclose(draft.root, 0.9 * belief.root, rtol=1e-6)


def test_kernels_run_on_more_threads_than_cores_but_not_on_one_core():
    assert [runtime.threads_for(cores) for cores in (1, 2, 16)] == [1, 3, 17]
