"""Proposals of births: how well a new surface would explain each measurement; owner of that kernel."""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.cells import Cells
from gridslam.inference.messages.likelihood_ratios import PORTION, Evaluation
from gridslam.inference.state.anchor_measurements import Heard
from gridslam.inference.state.belief import AGENT, Belief
from gridslam.inference.state.particles import Cloud
from gridslam.inference.state.surface_bank import Bank

Array = NDArray[np.float64]
CONVERGED_STD_M = 0.3
SAMPLES = 256


def partners(bank: Bank, belief: Belief, most_bounces: int) -> NDArray[np.int32]:
    """Pairs (last, first) of known surfaces with which a new one may form a path, -1 for the new, (H, 2)."""
    if most_bounces < 2:
        return _known(b"", most_bounces)
    sure = belief.covariance.diagonal()[AGENT + 1 :: 2] < CONVERGED_STD_M**2
    return _known((sure & (bank.existence > 0.9) & (bank.seen >= 3)).tobytes(), most_bounces)


@lru_cache(64)
def _known(sure: bytes, most_bounces: int) -> NDArray[np.int32]:
    surfaces = np.flatnonzero(np.frombuffer(sure, np.bool_)).tolist()
    pairs = [(-1, -1)] if most_bounces >= 1 else []
    pairs += [pair for s in surfaces for pair in ((-1, s), (s, -1))]
    known = np.array(pairs, np.int32).reshape(-1, 2)
    known.setflags(write=False)
    return known


def propose(
    heard: Heard, belief: Belief, bank: Bank, cloud: Cloud, said: Evaluation, cells: Cells | None,
    radio: Array, anchors: Array, rate: float, most_bounces: int,
) -> Births:  # fmt: skip
    """All birth hypotheses worth a look, of the measurements that carry distance and AoA.

    Surfaces are born uniformly over all lines that cross the region (angle and offset): a measure that
    doesn't depend on the frame. The sums over each measurement's are told to
    `said.new`. What is told lasts until the next call.

    Parameters
    ----------
    cells : Cells, optional
        What may stand between; without it every path is open.
    radio : (11,)
        `SignalModel.radio` of the anchor.
    anchors : (J, 3)
        x, y (m) and orientation (rad).
    rate : float
        Births per anchor, step and unit of such lines (rad m).
    """
    runtime.start()
    from gridslam.kernels.management.births import propose as launch

    known, count, surfaces = partners(bank, belief, most_bounces), len(heard), len(belief.lines)
    if len(bank) != surfaces or cloud.surfaces != surfaces or not 0 <= heard.anchor < len(anchors):
        raise ValueError("surfaces or anchors don't belong together")
    room, hypotheses = -(-count // PORTION) * PORTION, len(known)
    born, told, ratio = runtime.lasting("births", (room, hypotheses), lambda: _room(room, hypotheses))
    launch(
        cloud.state, _noise(hypotheses), belief.mean, heard.table, known, heard.anchor, anchors, radio,
        rate, ratio, said.measured, born, told,
    )  # fmt: skip
    if cells is not None and born[0, 0]:
        cells.glance(belief.mean, heard.anchor, anchors, born, told, said.measured)
    found = int(born[0, 0])
    if not found:
        return Births.none()
    return Births(born[1 : 1 + found, 0], born[1 : 1 + found, 1:], told[:found, :2], told[:found, 2])


def _room(measurements: int, hypotheses: int) -> tuple[NDArray[np.int32], Array, Array]:
    """What the kernel fills in: births and their number, what they are, and scratch."""
    most = measurements * hypotheses
    return np.empty((1 + most, 3), np.int32), np.empty((most, 3)), np.empty((measurements, hypotheses))


@cache
def _noise(seed: int) -> Array:
    """Standard normal noise of distance and AoA, (2, SAMPLES)."""
    return np.random.default_rng(seed).standard_normal((2, SAMPLES))
