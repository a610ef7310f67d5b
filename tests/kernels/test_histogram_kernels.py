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
    length = draw.choice([0.0, 0.1, 3.0, 40.0], (3, paths)) + draw.uniform(0, 1, (3, paths))
    length[0, draw.random(paths) < 0.3] = -1.0
    kept, existence = histograms(draw, paths), draw.choice([0.005, 0.01, 0.5, 0.95], paths)
    ahead = np.full((paths, len(NODES)), np.nan)
    walk(kept, length, existence, TABLE, NUMBER, np.full(len(NODES), np.nan), ahead)
    wanted = reference.walk(kept, length, existence, TABLE, NUMBER)
    np.testing.assert_allclose(ahead, wanted, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(ahead.sum(1), 1, atol=1e-9)


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
