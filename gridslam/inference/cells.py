"""Occupancy and coefficients of the grid (paper 003, eqs. (1), (2), (43)-(46)); owner of their kernels."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.belief import AGENT
from gridslam.inference.particles import Cloud
from gridslam.inference.polylines import Polylines
from gridslam.inference.rays import Rays
from gridslam.kernels import CELL_SLABS
from gridslam.signal import REFLECTION_BINS

Array = NDArray[np.float64]
BINS = len(REFLECTION_BINS)
EVIDENCE_CLIP = 12.0
CLEAR_ANCHOR_M = 0.35
OUTSIDE = 0.1
"""Factor of a hit outside the grid."""
OTHER_MATERIAL = 0.05
"""Share of the belief that a wall is of another material where it is hit next."""


class Cells:
    """Grid of cells: log odds of occupancy, and a log posterior of the reflection coefficient per hit cell.

    Attributes
    ----------
    origin, cell : (2,) m and m
        Lower-left corner and side of a cell.
    held : (ny, nx, BINS) float64
        Log-likelihood over `REFLECTION_BINS`, where kernels find it.
    """

    def __init__(
        self, origin: Array, cell: float, shape: tuple[int, int], free_path: float, anchors: Array
    ) -> None:
        self.origin, self.cell, self.shape = np.asarray(origin, float), cell, shape
        self._evidence = np.zeros(shape)
        self.observed = np.zeros(shape, dtype=bool)
        self.held = runtime.resident(np.zeros((*shape, BINS)))
        self.prior = 1 - np.exp(-cell / free_path)
        y, x = np.indices(shape)
        centre = self.origin + cell * (np.stack([x, y], -1) + 0.5)
        gap = np.linalg.norm(centre[:, :, None] - anchors, axis=-1).min(-1)
        self._clear = np.ascontiguousarray(gap < CLEAR_ANCHOR_M).view(np.uint8)
        slabs = CELL_SLABS[runtime.start()]
        from gridslam.kernels.bundles import LANES, LINES, PLACES

        self._pending, self._stale = False, True
        self._occupied = runtime.room((2, *shape))
        self._line = runtime.room((slabs, LINES, LANES), np.float64)
        self._place = runtime.room((slabs, PLACES, LANES), np.int32)
        self._scratch = runtime.resident(np.zeros((slabs, *shape, 3), np.float32))
        self._touched = runtime.resident(np.zeros((slabs, shape[0] * shape[1] + 1, 2), np.int32))
        self._met = runtime.resident(np.zeros((slabs, shape[0] * shape[1]), np.uint8))
        self._message = runtime.resident(np.zeros((slabs, *shape)))
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
        self.held = runtime.resident(np.ascontiguousarray(value, dtype=np.float64))

    def occupied(self) -> runtime.Resident:
        """Occupancy in both roles, crossed and met, (2, ny, nx) float32; it follows the evidence."""
        if self._stale:
            self._fold(np.zeros((0, *self.shape)))  # messages stay for `absorb`
        return self._occupied

    def frame(self, *more: float) -> Array:
        """Origin x and y, side of a cell, and what else a kernel wants to know, read-only."""
        if more not in self._frames:
            self._frames[more] = np.array([*self.origin, self.cell, *more])
            self._frames[more].setflags(write=False)
        return self._frames[more]

    def see(self, rays: Rays, cloud: Cloud, anchors: Array, surface: Array) -> tuple[Polylines, Array]:
        """Draw an anchor's rays at all states of a cloud, and cast them: V, eq. (1), and coefficients.

        What is told lasts until the same anchor's rays are seen again.

        Parameters
        ----------
        surface : (S, BINS)
            Beliefs about the surfaces' coefficients.

        Returns
        -------
        (drawn, belief)
            belief (L, 2 BINS): over the product of the coefficients along every path, eq. (2), by nodes
            ``(n + 1) / (2 BINS)``. A hit's own is made up of what surface and cells there believe, and of
            room for a surprise.
        """
        rays.check(len(surface))
        count, number = len(rays), rays.table[0, 3] if len(rays) else -1
        factor, belief = runtime.lasting(
            f"seen {number}", count, lambda: (np.zeros((count, 2)), np.empty((count, 2 * BINS)))
        )
        return self._cast(f"seen by {number}", rays, cloud, anchors, factor, 0.0, surface, belief), belief

    def glance(
        self, mean: Array, anchor: int, anchors: Array, born: NDArray[np.int32], told: Array, measured: Array
    ) -> None:
        """Weigh births, in place, by V of their paths at the mean (N,) of the belief.

        Parameters
        ----------
        born, told, measured : (1 + B, 3), (B, 3) and (4, M)
            As `gridslam.kernels.births.propose` leaves them.
        """
        from gridslam.kernels.births import glance

        glance(
            mean, anchor, anchors, self.occupied(), self.frame(OUTSIDE), self._line, self._place,
            runtime.scratch("glance state", ((len(mean) - AGENT) // 2 * 3 + 6, 1)),
            runtime.scratch("glance path", (1, 4), np.int32), runtime.scratch("glance drawn", (1, 14)),
            born, told, measured,
        )  # fmt: skip

    def tell(
        self, rays: Rays, cloud: Cloud, anchors: Array, worth: Array, send: NDArray[np.bool_], least: float
    ) -> Polylines:
        """Add the messages of paths to their cells, eqs. (43)-(45); `absorb` folds them in.

        What is drawn lasts until the next call.

        Parameters
        ----------
        worth : (L,)
            A of each path: what it is worth if it is not blocked.
        send : (L,)
            Which paths tell anything.
        least : float
            Share of the states at which a path must be possible to tell anything.
        """
        self._pending = True
        factor, none = runtime.scratch("told factor", (len(rays), 2)), _none()
        factor[:, 0], factor[:, 1] = worth, send
        return self._cast("told", rays, cloud, anchors, factor, least, none, none)

    def _cast(
        self, site: str, rays: Rays, cloud: Cloud, anchors: Array, factor: Array, least: float,
        surface: Array, belief: Array,
    ) -> Polylines:  # fmt: skip
        runtime.start()
        from gridslam.kernels.cells import cast

        rays.check(cloud.surfaces, len(anchors))
        state = cloud.state
        count, total = len(rays), len(rays) * state.shape[1]
        seen, drawn = np.empty((0, 6)), np.empty((0, 14))
        if count:
            seen, drawn = runtime.lasting(
                site, (count, total), lambda: (np.empty((count, 6)), runtime.room((total, 14), np.float64))
            )
            cast(
                state,
                rays.table,
                anchors,
                factor,
                self.occupied(),
                self.frame(OUTSIDE, EVIDENCE_CLIP, least, OTHER_MATERIAL),
                self.held,
                surface,
                drawn,
                seen,
                belief,
                self._line,
                self._place,
                self._scratch,
                self._touched,
                self._met,
                self._message,
            )
        return Polylines(rays.bounces, drawn, seen)

    def forget(self) -> None:
        """Drop messages that were never absorbed, since a step was interrupted."""
        if self._pending:
            self._message.fill(0)
            self._pending = False

    def absorb(self) -> None:
        """Fold the messages of all paths and anchors into the beliefs, eq. (46)."""
        self._fold(self._message)
        self._pending = False

    def _fold(self, message: runtime.Resident) -> None:
        runtime.start()
        from gridslam.kernels.occupancy import absorb

        fresh, odds = np.empty(self.shape), float(np.log(self.prior / (1 - self.prior)))
        self._stale = True  # until all of it is done
        absorb(
            message, self._evidence, self._clear, odds, EVIDENCE_CLIP, fresh,
            self.observed.view(np.uint8), self._occupied,
        )  # fmt: skip
        self._evidence, self._stale = fresh, False


@cache
def _none() -> Array:
    """No beliefs about coefficients."""
    return np.empty((0, BINS))
