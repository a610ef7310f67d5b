"""The scans and the particles of the filter that follows an agent by lines of sight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels.primitives import sights as column
from gridslam.world.scene import Scene

PARTICLES = 300
TOLD_APART = 12
"""Steps after which as many particles as usual go on from many starts."""
PAUSE, PAUSE_S, ENOUGH = 30.0, 3.0, 30
"""Usual intervals a step, and seconds, from which on a pause is a hole in time; steps before it that are
enough to judge a table by."""
FOR_EVER = 2**31


@dataclass(frozen=True, eq=False)
class Scans:
    """The rows of a table's first steps, by step and anchor.

    Attributes
    ----------
    rows : (R,) int
        Indices into the table.
    step, anchor, count : (S,) int
        Of each scan, and how many rows it has.
    begin : int
        The table's first step.
    steps : int
        How many of the table's steps are looked at.
    """

    rows: NDArray[np.intp]
    step: NDArray[np.intp]
    anchor: NDArray[np.intp]
    count: NDArray[np.intp]
    begin: int
    steps: int

    @classmethod
    def of(cls, columns: Mapping[str, NDArray], steps: int, across: bool = False) -> Scans:
        """Those of so many steps of a table, from its first.

        Parameters
        ----------
        columns : dict of (K,) arrays
            Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
        steps : int
        across : bool
            Those after a hole in time, too.
        """
        step, anchor = np.asarray(columns["step"], np.intp), np.asarray(columns["anchor"], np.intp)
        begin = int(step[0]) if len(step) else 0
        steps = steps if across else min(steps, _before_hole(step, columns.get("time_s")))
        rows = np.flatnonzero(step < begin + steps)
        rows = rows[np.lexsort((anchor[rows], step[rows]))]
        first = np.flatnonzero(np.diff(step[rows], prepend=-1) | np.diff(anchor[rows], prepend=-1))
        count = np.diff(first, append=len(rows))
        return cls(rows, step[rows[first]], anchor[rows[first]], count, begin, steps)

    @property
    def by_scan(self) -> NDArray[np.int32]:
        """Scans as the kernel takes them, (Q + 1, 2): `gridslam.kernels.primitives.sights.Sights.scan`."""
        first = np.concatenate([[0], np.cumsum(self.count)])
        return np.column_stack([np.append(self.anchor, 0), first]).astype(np.int32)

    def by_step(
        self, count: int, many: int, sized: bool, draw: np.random.Generator
    ) -> tuple[NDArray[np.int32], Array]:
        """Steps and random numbers as the kernel takes them: `Sights.step` (S + 1, 4) and `Sights.draw`.

        Parameters
        ----------
        count : int
            Particles at first.
        many : int
            Steps after which there are as few as usual.
        sized : bool
            Whether the size of an error is looked for, too.
        """
        first = np.flatnonzero(np.diff(self.step, prepend=-1))
        after = np.maximum(np.diff(self.step[first], prepend=self.begin), 1)
        number = np.arange(len(first) + 1)
        counts = np.where(number < many, count, PARTICLES)
        begin, drawn = _drawn(tuple(counts.tolist()), sized, **draw.bit_generator.state["state"])
        table = np.column_stack([np.append(after, 0), np.append(first, len(self.step)), begin, counts])
        return table.astype(np.int32), drawn


def _before_hole(step: NDArray[np.intp], time_s: Array | None) -> int:
    """Steps before the first hole in time that steps don't count, if they are enough to judge a table by.

    The agent goes on meanwhile, and is followed by the numbers of steps: it would get lost there.
    """
    number, first = np.unique(step, return_index=True)
    if time_s is None or len(number) <= ENOUGH or not np.isfinite(time_s).all():
        return FOR_EVER
    with np.errstate(over="ignore"):  # of times that are no seconds, which is told elsewhere
        gap = np.diff(time_s[first]) / np.diff(number)
    usual = float(np.median(gap))
    hole = np.flatnonzero(gap > max(PAUSE * usual, PAUSE_S))
    if not usual > 0 or not len(hole) or hole[0] < ENOUGH - 1:
        return FOR_EVER
    return int(number[hole[0]] + 1 - number[0])


@lru_cache(maxsize=8)
def _drawn(counts: tuple[int, ...], sized: bool, state: int, inc: int) -> tuple[Array, Array]:
    """Where each step's numbers begin (S + 1,), and all of them, of a generator that has come so far.

    Readings of the same table are followed by the same numbers, which takes long enough to draw them once.
    """
    bits = np.random.PCG64()
    bits.state = {**bits.state, "state": {"state": state, "inc": inc}}
    draw = np.random.Generator(bits)
    drawn = [
        np.concatenate([draw.standard_normal(3 * now), [draw.random()], draw.standard_normal(sized * left)])
        for now, left in pairwise(counts)
    ]
    numbers = np.concatenate([*drawn, np.zeros(0)])
    numbers.flags.writeable = False
    return np.cumsum([0, *map(len, drawn)]), numbers


def particles_at(position: Array, heading: Array, pace: Array) -> Array:
    """Particles (P, 10) that begin there, as `gridslam.kernels.primitives.sights` has them.

    Parameters
    ----------
    position : (P, 2) m
    heading : (P,) rad
    pace : (P,) m
        Deviation of a step.
    """
    some = np.zeros((len(position), column.PARTICLE))
    some[:, column.PLACE : column.HEADING] = some[:, column.BEGUN : column.BEGUN + 2] = position
    some[:, column.HEADING] = some[:, column.BEGUN + 2] = heading
    some[:, column.PACE] = pace
    return some


def particles_of(scene: Scene, agent: str | None, draw: np.random.Generator, times: int) -> Array:
    """Particles (P, 10) about the agent's start, or anywhere in the grid without an agent.

    Parameters
    ----------
    times : int
        Times as many as usual, of an agent.
    """
    if agent is None:
        low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
        count = 10 * PARTICLES
        position = draw.uniform(low, high, (count, 2))
        return particles_at(position, draw.uniform(-np.pi, np.pi, count), np.full(count, 0.1))
    body = scene.agent(agent)
    wide = max(body.prior.position_m, 0.1)
    count = times * PARTICLES
    position = body.start_m + draw.uniform(-wide, wide, (count, 2))
    facing = np.radians(body.start_heading_deg + body.prior.heading_deg * draw.uniform(-1, 1, count))
    return particles_at(position, facing, paces(body.step_m, count))


def paces(step_m: float, count: int) -> Array:
    """Standard deviations (count,) of a step in m.

    A quarter of the particles hurries, since a table of one's own needn't keep to the scene's step.
    """
    return step_m * np.where(np.arange(count) % 4 == 0, 4.0, 0.8)
