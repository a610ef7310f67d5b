"""Kernels that keep histograms of amplitudes, against their twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_worlds import SEEDS, random_table

import gridslam as gs
from gridslam import reference
from gridslam.inference.messages.ray_amplitudes import AmplitudeModel

SIGNAL = gs.Scene.load("room").signal_model("agent1")
MODEL = AmplitudeModel.of(SIGNAL)
TABLE, NUMBER, NODES = MODEL.table, MODEL.number, MODEL.nodes


def histograms(draw, paths):
    """As sharp as one node, or as flat as can be."""
    belief = draw.dirichlet(np.full(len(NODES), draw.choice([0.01, 1.0])), paths)
    return belief.reshape(paths, len(NODES))


@given(SEEDS, st.integers(0, 5))
@settings(max_examples=40, deadline=None)
def test_walking_histograms_equal_their_twin(seed, paths):
    from gridslam.kernels.messages.histograms import walk

    draw = np.random.default_rng(seed)
    length = draw.choice([0.0, 0.1, 3.0, 40.0], (4, paths)) + draw.uniform(0, 1, (4, paths))
    length[[0, 3]] = np.where(draw.random((2, paths)) < 0.3, -1.0, length[[0, 3]])
    kept, existence = histograms(draw, paths), draw.choice([0.005, 0.01, 0.5, 0.95], paths)
    ahead = np.full((paths, len(NODES)), np.nan)
    walk(kept, length, existence, TABLE, NUMBER, np.full(len(NODES), np.nan), ahead)
    wanted = reference.walk(kept, length, existence, TABLE, NUMBER)
    np.testing.assert_allclose(ahead, wanted, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(ahead.sum(1), 1, atol=1e-9)


def test_a_line_of_sight_that_appears_is_as_loud_as_free_space_leaves_it():
    """100 at a metre is 20 at five, give or take a decibel; one in fifty is anything up to that."""
    from gridslam.kernels.messages.histograms import walk

    number = np.array([11.7, 0.03, 100.0, 0.95, 0.01, 1e-9, 0.12, 0.02])
    length = np.array([[-1.0, -1.0, -1.0], [5.0, 5.0, 5.0], [5.0, 2.5, 5.0], [0.0, 2.5, -1.0]])
    ahead = np.full((3, len(NODES)), np.nan)
    walk(np.zeros_like(ahead), length, np.full(3, 0.01), TABLE, number, np.empty(len(NODES)), ahead)
    sure, vague, reflected = ahead
    np.testing.assert_allclose(ahead @ NODES, [20.0, 20.0, 10.0], rtol=0.05)
    assert sure[(NODES > 15) & (NODES < 25)].sum() > 0.9
    np.testing.assert_allclose(sure[NODES < 10].sum(), 0.02 * reflected[NODES < 10].sum(), rtol=0.1)
    assert 0.1 < vague[NODES > 30].sum() < 0.25, "half the length is one deviation off: amplitudes are linear"
    assert not reflected[NODES > 21].any()


@given(SEEDS, st.integers(0, 5), st.integers(0, 6))
@settings(max_examples=40, deadline=None)
def test_histograms_that_listened_equal_their_twin(seed, paths, count):
    from gridslam.kernels.messages.histograms import listen

    draw = np.random.default_rng(seed)
    ahead, scan = histograms(draw, paths), random_table(draw, count)
    responsible = draw.dirichlet(np.full(count + 1, 0.3), paths)[:, :count].reshape(paths, count).copy()
    responsible[draw.random((paths, count)) < 0.3] = 0.0
    density, after = np.full((count, len(NODES)), np.nan), np.full(ahead.shape, np.nan)
    listen(ahead, scan, responsible, TABLE, NUMBER, float(SIGNAL.samples), density, after)
    wanted = reference.listen(ahead, scan, responsible, TABLE, NUMBER, SIGNAL.samples)
    np.testing.assert_allclose(after, wanted, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(after.sum(1), 1, atol=1e-9)
