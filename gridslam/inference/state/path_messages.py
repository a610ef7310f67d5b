"""Messages of all paths of a step to coefficients and cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels.primitives.blocks import Messages

PORTION = 64
"""Capacity for paths, and for pairs, grows in portions, so that arrays last."""


class PathMessages:
    """Paths of all anchors, one anchor after the other, as the updates' kernel appends them.

    Part of a workspace: a step begins it anew, and nothing of it outlives the step.

    Parameters
    ----------
    records : bool
        False for a system that needs none: there is never any capacity, and nothing is appended.

    Attributes
    ----------
    count : (2,) int32
        L paths and K pairs so far.
    path : (L or more, 4) int32
        Rows as in `Rays.table`.
    factor : (L or more, 2)
        A of each path: what it is worth if it is not blocked; whether it is likely enough to send to cells.
    summary : (4, L or more)
        See `gridslam.kernels.propagation.path_messages`.
    begin : (L + 1 or more,) int32
        Where the pairs of each path begin.
    pairs : (2, K or more)
        Measured amplitude, negative for none, and probability of each pair.
    among : (int, int)
        No path names more surfaces and anchors.
    """

    def __init__(self, records: bool = True) -> None:
        self.count, self.among, self._records = np.zeros(2, np.int32), (0, 0), records
        self.path, self.factor = np.zeros((0, 4), np.int32), np.zeros((0, 2))
        self.summary, self.begin, self.pairs = np.zeros((4, 0)), np.zeros(1, np.int32), np.zeros((2, 0))

    def block(self) -> Messages:
        """All of them, as kernels take them."""
        return Messages(self.count, self.path, self.factor, self.summary, self.begin, self.pairs)

    def clear(self) -> None:
        """Begin a new step."""
        self.count[:], self.among = 0, (0, 0)

    def append(self, path: NDArray[np.int32], factor: Array, summary: Array, among: tuple[int, int]) -> None:
        """Append L paths without pairs: rows of `path`, `factor` and, transposed, `summary` (4, L)."""
        first, last = int(self.count[0]), int(self.count[0]) + len(path)
        self.reserve(len(path), 0, among)
        rows = slice(first, last)
        self.path[rows], self.factor[rows], self.summary[:, rows] = path, factor, summary
        self.begin[first + 1 : last + 1] = self.count[1]
        self.count[0] = last

    def reserve(self, paths: int, pairs: int, among: tuple[int, int]) -> None:
        """Have capacity for so many more, which name surfaces and anchors below these."""
        if not self._records:
            return
        self.among = max(self.among[0], among[0]), max(self.among[1], among[1])
        listed, paired = self.count.tolist()
        if listed + paths > len(self.path):
            more = _portions(listed + paths) - len(self.path)
            self.factor, self.begin = _longer(self.factor, more), _longer(self.begin, more)
            self.summary = _longer(self.summary.T, more).T.copy()
            self.path = _longer(self.path, more)  # last: its length says what there is capacity for
        if paired + pairs > self.pairs.shape[1]:
            more = _portions(paired + pairs) - self.pairs.shape[1]
            self.pairs = _longer(self.pairs.T, more).T.copy()


def _portions(count: int) -> int:
    return -(-count // PORTION) * PORTION


def _longer(array: NDArray[Any], more: int) -> NDArray[Any]:
    return np.concatenate([array, np.zeros((more, *array.shape[1:]), array.dtype)])
