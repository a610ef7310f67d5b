"""The anchors' images that there were to be found, and how near the found ones are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array
from gridslam.estimates import Estimate
from gridslam.evaluation.metrics import gospa
from gridslam.simulation.image_source import Truth
from gridslam.world.geometry import mirror
from gridslam.world.scene import Scene

CUTOFF_M, ORDER = 2.0, 1.0
"""[LiangDirect], section IV."""
BELIEVED = 0.5
"""Existence from which on a path is believed in."""
LATELY = 100
"""Steps within which a path of an image must have been visible for the image to be asked for."""


def image_gospa(scene: Scene, estimates: Sequence[Estimate], truth: Truth, lately: int = LATELY) -> Array:
    """GOSPA of each anchor's images at every step, (J, N) m: 2 m, order 1.

    Asked for are the images whose single bounce was visible within the latest steps; found are those of
    detected surfaces whose single bounce the method believed in within them. An image that can't be seen now,
    but was, is neither missed nor false.

    Parameters
    ----------
    estimates : sequence of N
    truth : Truth
        With paths of these steps.
    lately : int
    """
    anchors, paths = scene.anchor_positions, truth.paths
    single = (paths.bounces == 1) & paths.of_walls
    surface = truth.segments.surface[paths.segment[:, 0]] if len(truth.segments) else paths.segment[:, 0]
    count = int(truth.segments.surface.max(initial=-1)) + 1
    seen = np.full((len(anchors), count), -np.inf)
    line = np.zeros((count, 2))
    line[truth.segments.surface] = truth.segments.line
    error, last_seen = np.zeros((len(anchors), len(estimates))), dict[tuple[int, int], int]()
    order = np.argsort(paths.step, kind="stable")
    edges = np.searchsorted(paths.step[order], np.arange(len(estimates) + 1))
    for step, estimate in enumerate(estimates):
        rows = order[edges[step] : edges[step + 1]]
        rows = rows[single[rows]]
        seen[paths.anchor[rows], surface[rows]] = step
        own = estimate.paths
        believed = (own.existence > BELIEVED) & (own.surfaces[:, 0] >= 0)
        believed &= own.surfaces[:, 0] == own.surfaces[:, 1]
        last_seen |= {
            (a, s): step
            for a, s in zip(own.anchor[believed].tolist(), own.surfaces[believed, 0].tolist(), strict=True)
        }
        for anchor, position in enumerate(anchors):
            there = seen[anchor] > step - lately
            latest = [last_seen.get((anchor, s), -lately) for s in estimate.surfaces.identity.tolist()]
            mine = estimate.detected & (np.array(latest, int) > step - lately)
            found = mirror(estimate.surfaces.line[mine], position)
            error[anchor, step] = gospa(found, mirror(line[there], position), CUTOFF_M, ORDER)
    return error
