"""Occupancy and coefficients of the grid (paper 003, eqs. (1), (2), (43)-(46)); owner of their kernels."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.messages.prediction import Ahead
from gridslam.inference.state.belief import AGENT
from gridslam.inference.state.particles import Sampling
from gridslam.inference.state.path_messages import Notes
from gridslam.inference.state.polylines import Polylines
from gridslam.kernels import ALREADY_LISTED, CELL_SLABS
from gridslam.world.grid_memory import check_room, slabs_for
from gridslam.world.radio import REFLECTION_BINS

Array = NDArray[np.float64]
BINS = len(REFLECTION_BINS)
EVIDENCE_CLIP = 12.0
CLEAR_ANCHOR_M = 0.35
OUTSIDE = 0.1
"""Factor of a hit outside the grid."""
OTHER_MATERIAL = 0.05
"""Share of the belief that a wall is of another material where it is hit next."""
NO_BANK = np.empty(0), np.empty(0, np.int64), np.empty(0), np.empty((0, 0)), np.empty((0, 0, 0))
NO_PATHS = np.empty(0), np.empty(0), np.empty((0, 12))
"""What is told of surfaces, and of paths to be listed, where there are none to list."""


class Cells:
    """Grid of cells: log odds of occupancy, and a log posterior of the reflection coefficient per hit cell.

    Attributes
    ----------
    origin, cell : (2,) m and m
        Lower-left corner and side of a cell.
    held : (ny, nx, BINS) float32
        Log-likelihood over `REFLECTION_BINS`, where kernels find it; 0 at the best and `EVIDENCE_CLIP` below
        at the worst, so that another material can be learned.
    """

    def __init__(
        self, origin: Array, cell: float, shape: tuple[int, int], free_path: float, anchors: Array
    ) -> None:
        self.origin, self.cell, self.shape = np.asarray(origin, float), cell, shape
        count = shape[0] * shape[1]
        check_room(count)
        self._evidence = np.zeros(shape)
        self.observed = np.zeros(shape, dtype=bool)
        self.held = runtime.resident(np.zeros((*shape, BINS), np.float32))
        self.prior = 1 - np.exp(-cell / free_path)
        self._clear = _clear(self.origin, cell, shape, anchors).view(np.uint8).reshape(-1)
        slabs = slabs_for(CELL_SLABS[runtime.start()], count)
        from gridslam.kernels.propagation.bundles import LANES, LINES, PLACES
        from gridslam.kernels.propagation.occupancy import CELLS

        self._pending, self._stale = False, True
        self._occupied = runtime.room((2, count))
        self._line = runtime.room((slabs, LINES, LANES), np.float64)
        self._place = runtime.room((slabs, PLACES, LANES), np.int32)
        self._sums = runtime.resident(np.zeros((3 * slabs, count), np.float32))
        self._touched = runtime.resident(np.zeros((2 * slabs, count + 1), np.int32))
        self._met = runtime.resident(np.zeros((slabs, count), np.uint8))
        self._message = runtime.resident(np.zeros((slabs, count), np.float32))
        self._news = runtime.resident(np.zeros((slabs, -(-count // CELLS)), np.uint8))
        self._frames: dict[tuple[float, ...], Array] = {}

    @property
    def evidence(self) -> Array:
        """Log odds of every cell, 0 where untouched, (ny, nx); replace it whole, never in place."""
        return self._evidence

    @evidence.setter
    def evidence(self, value: Array) -> None:
        self._evidence, self._stale = value, True

    @property
    def coefficient(self) -> Array:
        """Log-likelihood over `REFLECTION_BINS` of every cell, (ny, nx, BINS)."""
        return runtime.on_host(self.held)

    @coefficient.setter
    def coefficient(self, value: Array) -> None:
        self.held = runtime.resident(np.ascontiguousarray(value, dtype=np.float32))

    def occupied(self) -> runtime.Resident:
        """Occupancy in both roles, crossed and met, (2, ny nx) float32; it follows the evidence."""
        if self._stale:
            cells, groups = self._message.shape[1], self._news.shape[1]
            self._fold(np.empty((0, cells), np.float32), np.empty((0, groups), np.uint8))  # messages stay
        return self._occupied

    def frame(self, *more: float) -> Array:
        """Origin x and y, side of a cell, and what else a kernel wants to know, read-only."""
        if more not in self._frames:
            self._frames[more] = np.array([*self.origin, self.cell, *more])
            self._frames[more].setflags(write=False)
        return self._frames[more]

    def see(self, ahead: Ahead, surface: Array) -> tuple[Array, Array]:
        """List and predict an anchor's paths, and cast them at its samples: V, eq. (1), and coefficients.

        What is told lasts until the same anchor's rays are seen again.

        Parameters
        ----------
        surface : (S, BINS)
            Beliefs about the surfaces' coefficients.

        Returns
        -------
        (validity, belief)
            validity (L,): V of every path. belief (L, 2 BINS): over the product of the coefficients along
            every path, eq. (2), by nodes ``(n + 1) / (2 BINS)``. A hit's own is made up of what surface and
            cells there believe, and of room for a surprise.
        """
        if len(surface) != ahead.among[0]:
            raise ValueError("coefficients don't belong to these surfaces")
        most, rays = len(ahead.table), ahead.sampling.draft.state.shape[1]
        factor, seen, belief, drawn = runtime.lasting(
            f"seen {ahead.site}", (most, rays), lambda: (np.zeros((most, 2)), *_room(most, rays))
        )
        self._cast(ahead.attempts(), factor, 0.0, surface, drawn, seen, belief)
        count = int(ahead.found[0])
        return runtime.lasting(
            f"seen of {ahead.site}", (id(seen), count), lambda: (seen[:count, 0], belief[:count])
        )

    def glance(
        self, mean: Array, anchor: int, anchors: Array, born: NDArray[np.int32], told: Array, measured: Array
    ) -> None:
        """Weigh births, in place, by V of their paths at the mean (N,) of the belief.

        Parameters
        ----------
        born, told, measured : (1 + B, 3), (B, 3) and (4, M)
            As `gridslam.kernels.management.births.propose` leaves them.
        """
        from gridslam.kernels.management.births import glance

        glance(
            mean, anchor, anchors, self.shape[1], self.occupied(), self.frame(OUTSIDE), self._line,
            self._place, runtime.scratch("glance state", ((len(mean) - AGENT) // 2 * 3 + 6, 1)),
            runtime.scratch("glance path", (1, 4), np.int32), runtime.scratch("glance drawn", (1, 14)),
            born, told, measured,
        )  # fmt: skip

    def tell(self, notes: Notes, samples: Sampling, anchors: Array, least: float) -> Polylines:
        """Add the messages of paths to their cells, eqs. (43)-(45); `absorb` folds them in.

        What is drawn lasts until the next call.

        Parameters
        ----------
        notes : Notes
            The paths.
        samples : Sampling
            States at which the rays are cast.
        least : float
            Share of the states at which a path must be possible to tell anything.
        """
        state, most = samples.draft.state, len(notes.path)
        if notes.among[0] > len(state) // 3 - 1 or notes.among[1] > len(anchors):
            raise ValueError("notes are of surfaces or anchors that don't exist")
        self._pending = True
        seen, none, drawn = runtime.lasting(
            "told by", (most, state.shape[1]), lambda: _room(most, state.shape[1], 0)
        )
        before = (
            ALREADY_LISTED, 0, 0.0, 0.0, samples.belief.mean, samples.belief.covariance, anchors, *NO_BANK,
            1.0, samples.points, samples.first,
        )  # fmt: skip
        after = notes.path, *NO_PATHS, notes.count
        asked = ((*before, *way, *after) for way in samples.attempts())
        self._cast(asked, notes.factor, least, none, drawn, seen, none, samples.given)
        return Polylines(int(notes.count[0]), drawn, seen)

    def hits(self, least: float) -> Array:
        """What kernels that cast rays and learn from their hits want to know; `least` as of `tell`."""
        return self.frame(OUTSIDE, EVIDENCE_CLIP, least, OTHER_MATERIAL)

    def _cast(
        self, asked: Iterable[tuple[Any, ...]], factor: Array, least: float, surface: Array,
        drawn: runtime.Resident, seen: Array, belief: Array, given: bool = False,
    ) -> None:  # fmt: skip
        """Cast; `given` says that paths and samples are there already."""
        device = runtime.start()
        from gridslam.kernels.propagation.cells import cast
        from gridslam.kernels.propagation.rays import foresee

        frame = self.hits(least)
        for arguments in asked:
            if device == "gpu" and not given:
                foresee(*arguments)
            cast(
                *arguments, factor, self.occupied(), frame, self.held, surface, drawn, seen, belief,
                self._line, self._place, self._sums, self._touched, self._met, self._message, self._news,
            )  # fmt: skip

    def forget(self) -> None:
        """Drop messages that were never absorbed, since a step was interrupted."""
        if self._pending:
            self._message.fill(0)
            self._news.fill(0)
            self._pending = False

    def absorb(self) -> None:
        """Fold the messages of all paths and anchors into the beliefs, eq. (46)."""
        self._fold(self._message, self._news)
        self._pending = False

    def _fold(self, message: runtime.Resident, news: runtime.Resident) -> None:
        runtime.start()
        from gridslam.kernels.propagation.occupancy import absorb

        fresh, odds = np.empty(self.shape), float(np.log(self.prior / (1 - self.prior)))
        every, self._stale = int(self._stale), True  # until all of it is done
        self.observed = np.ascontiguousarray(self.observed)  # which is written to in place
        absorb(
            message, news, self._evidence.reshape(-1), self._clear, every, odds, EVIDENCE_CLIP,
            fresh.reshape(-1), self.observed.view(np.uint8).reshape(-1), self._occupied,
        )  # fmt: skip
        self._evidence, self._stale = fresh, False


def _clear(origin: Array, cell: float, shape: tuple[int, int], anchors: Array) -> NDArray[np.bool_]:
    """Which cells (ny, nx) have their centre next to one of the anchors (J, 2), without room for all J."""
    clear = np.zeros(shape, dtype=bool)
    for place in anchors:
        x, y = (
            (origin[axis] + cell * (np.arange(shape[1 - axis]) + 0.5) - place[axis]) ** 2 for axis in (0, 1)
        )
        near_x, near_y = np.flatnonzero(x < CLEAR_ANCHOR_M**2), np.flatnonzero(y < CLEAR_ANCHOR_M**2)
        near = np.sqrt(x[near_x] + y[near_y, None]) < CLEAR_ANCHOR_M
        clear[np.ix_(near_y, near_x)] |= near
    return clear


def _room(paths: int, rays: int, told: int | None = None) -> tuple[Array, Array, runtime.Resident]:
    """What casting fills in: means of each path, beliefs about coefficients of `told` paths, and rays."""
    belief = np.empty((paths if told is None else told, 2 * BINS))
    return np.empty((paths, 6)), belief, runtime.room((paths * rays, 14), np.float64)
