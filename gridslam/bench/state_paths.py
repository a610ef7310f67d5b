"""The kernel that traces paths as functions of the state, for direct grid SLAM's mode, against its twin."""

from __future__ import annotations

import numpy as np

from gridslam import reference
from gridslam.bench.kernels import KernelSpeed, race
from gridslam.inference.messages.samples.state_mode import paths_at
from gridslam.inference.state.layout import AGENT

NAMES = ("trace_paths",)
SURFACES = 6
"""With a line of sight, single bounces and double bounces: 37 paths."""


def state_path_speed(seconds: float) -> KernelSpeed:
    """Time of the kernel for all paths of one anchor over some surfaces.

    Parameters
    ----------
    seconds : float
        At least so long; the kernel runs three times or more, its twin once.
    """
    draw, surfaces = np.random.default_rng(1), range(SURFACES)
    table = [[0, -1, -1, 0]] + [[1, s, s, 0] for s in surfaces]
    table += [[2, s, r, 0] for s in surfaces for r in surfaces if s != r]
    path = np.array(table, np.int32)
    lines = np.column_stack([draw.uniform(-3, 3, SURFACES), draw.uniform(1, 6, SURFACES)])
    mean = np.concatenate([draw.normal(size=AGENT), lines.ravel()])
    root = np.tril(draw.normal(size=(len(mean), len(mean))))
    spot = np.array([2.0, 1.0, 0.3, 0.0, 0.0])
    return race(
        "trace_paths", f"{SURFACES} surfaces", "path", len(path), seconds, 1.0,
        lambda: paths_at(mean, spot, path, AGENT, root),
        lambda: paths_at(mean, spot, path[:0], AGENT, root),
        lambda: reference.trace_paths(AGENT, mean, root, spot, path),
    )  # fmt: skip
