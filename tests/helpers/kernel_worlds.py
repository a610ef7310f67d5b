"""Random worlds for tests of kernels."""

import numpy as np
from hypothesis import strategies as st

from gridslam import reference
from gridslam.kernels.primitives.blocks import Hits
from gridslam.world.filter_model import FIXED

BINS = 20
SEEDS = st.integers(0, 2**32 - 1)


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
    return state, np.array(path, np.int32), random_places(draw, 1)[0].astype(kind)


UNKNOWN = st.sampled_from([(0, False), (2, False), (2, True)])
"""How many entries stand between pose and lines, and whether they are rises instead of clocks."""


def random_places(draw, anchors, rises=False):
    """Positions, orientations and heights of anchors; some stand as high as the agent."""
    heights = draw.choice([0.0, 1.0], anchors) * draw.uniform(-3, 3, anchors)
    known = heights, heights, np.full(anchors, -1.0)
    if rises:
        known = heights, heights + draw.uniform(-0.3, 0.3, anchors), draw.choice([FIXED, 0, 1], anchors)
    return np.column_stack([draw.uniform(-5, 5, (anchors, 2)), draw.uniform(-3, 3, anchors), *known])


def random_belief(draw, surfaces, clocks=0, rises=False):
    """Mean and correlated covariance of an agent, clocks (or rises) and surfaces, and all paths over them."""
    mean = np.concatenate([draw.uniform(-4, 4, 2), draw.normal(0, 0.1, 2), draw.uniform(-3, 3, 1)])
    mean = np.append(mean, draw.uniform(-30, 30, clocks) * (0.02 if rises else 1.0))
    lines = np.stack([draw.uniform(-3, 3, surfaces), draw.uniform(1, 6, surfaces)], -1)
    mean = np.concatenate([mean, lines.ravel()])
    root = 0.03 * draw.normal(size=(len(mean), len(mean)))
    path = [[0, -1, -1, 0]] + [[1, s, s, 0] for s in range(surfaces)]
    path += [[2, s, r, 0] for s in range(surfaces) for r in range(surfaces) if s != r]
    return mean, root @ root.T + 1e-5 * np.eye(len(mean)), np.array(path, np.int32)


def random_bank(draw, surfaces, anchors):
    """Existence, owners, detections, and existence of rays: by anchors, over one surface and over two."""
    existence = draw.choice([0.1, 0.5, 0.95, 0.999], surfaces) * draw.uniform(0.9, 1, surfaces)
    owner = draw.choice([-1, -1, *range(anchors)], surfaces)
    return (
        existence, owner.astype(np.int64), draw.integers(0, 60, surfaces), draw.uniform(0, 1, anchors),
        draw.uniform(0, 1, (anchors, surfaces)), draw.uniform(0, 1, (anchors, surfaces, surfaces)),
    )  # fmt: skip


def random_hits(draw, surfaces):
    """Where surfaces were hit: some never, of some it isn't known by which path."""
    extent = np.sort(draw.normal(0, 3, (surfaces, 2))) * draw.choice([np.nan, 1.0], (surfaces, 1))
    outermost = draw.normal(0, 4, (surfaces, 2, 4)) * draw.choice([np.nan, 1.0], (surfaces, 2, 1))
    outermost[np.isnan(extent)] = np.nan
    return Hits(
        draw.normal(size=surfaces), extent, draw.integers(0, 9, surfaces), outermost.reshape(surfaces, 8)
    )


def random_radio(draw, given_std=False, flat_array=False, anchors=2):
    """What kernels take of a radio, by anchors, the last of which may be an image of the first."""
    here = [0.0, 0.0] if flat_array else [0.3, 0.1]
    row = [0.5, 0.02 * given_std, 0.4, 0.2, *here, 30.0, draw.uniform(20, 90), 200.0, 2.0, 1.5, 0.0]
    radio = np.tile(row, (anchors, 1))
    radio[:, 11] = np.arange(anchors) % draw.integers(max(anchors - 1, 1), anchors + 1)
    radio[:, 2:4] *= draw.uniform(0.5, 2, (anchors, 1))  # arrays differ, the rest is the agent's
    return radio


def random_table(draw, count, near=None, off=0.05, anchors=2):
    """Measurements as kernels take them, every second one next to one of the values `near` (L, 3).

    Of some it is known which anchor sent them.
    """
    table = np.zeros((count, 10))
    table[:, :3] = draw.uniform([1, -3, -3], [9, 3, 3], (count, 3))
    if near is not None and len(near) and count:  # across the wrap of an angle, too
        chosen = near[draw.integers(0, len(near), len(table[::2]))]
        table[::2, :3] = chosen + np.array([off, 2 * off, 2 * np.pi - 2 * off])
    table[:, 3:6] = draw.choice([0.0, 0.0, -1.0, 0.05], (count, 3))
    table[:, :3][table[:, 3:6] < 0] = 0.0
    table[:, 6] = draw.choice([-1.0, 2.5, 8.0, 30.0], count)
    table[:, 7], table[:, 8] = draw.integers(0, 2, count), draw.uniform(0, 1, count)
    table[:, 9] = draw.choice([-1, -1, *range(anchors)], count)
    return table


def detection_table():
    """p_d over ``0, 0.5, ...``."""
    return 1 / (1 + np.exp(-(0.5 * np.arange(80) - 4))), 0.5


def some_rows(draw, shape, spread):
    """Coefficients of the cells that were hit, most of them: row of each cell, and log-likelihoods."""
    where = np.full(shape, -1, np.int32)
    known = draw.random(shape) < 0.7
    count = int(known.sum())
    where[known] = draw.permutation(count)
    return where, draw.normal(0, spread, (count, BINS)).astype(np.float32)


def predicted_of(mean, covariance, head, path, places):
    """Values, spreads and lengths of paths, and how well these are known, by the twin."""
    value, slope, spread = reference.predict(mean, covariance, head, path, places)
    late = reference.late(mean, head, path[:, 3], places)
    of_length = reference.of_length(slope[:, 0], covariance, head, places)
    return np.column_stack([value, spread.reshape(-1, 9), value[:, 0] - late, *of_length])
