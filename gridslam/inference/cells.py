"""Occupancy and reflection beliefs of the grid (paper 003, eqs. (1), (43)-(46)); owner of the ray kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.particles import Cloud
from gridslam.inference.polylines import Polylines
from gridslam.inference.rays import Rays
from gridslam.kernels import CELL_SLABS
from gridslam.signal import REFLECTION_BINS

Array = NDArray[np.float64]
BINS = len(REFLECTION_BINS)
EVIDENCE_CLIP = 12.0
CLEAR_ANCHOR_M = 0.35
TOUCHED = 0.01
"""Message from which on a cell counts as observed; what leaks through a wall's last doubt is fainter."""
OUTSIDE = 0.1
"""Factor of a hit outside the grid."""


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
        self._occupied: runtime.Resident | None = None
        self.observed = np.zeros(shape, dtype=bool)
        self.held = runtime.resident(np.zeros((*shape, BINS)))
        self.prior = 1 - np.exp(-cell / free_path)
        y, x = np.indices(shape)
        centre = self.origin + cell * (np.stack([x, y], -1) + 0.5)
        gap = np.linalg.norm(centre[:, :, None] - anchors, axis=-1).min(-1)
        self._clear = gap < CLEAR_ANCHOR_M
        slabs = CELL_SLABS[runtime.start()]
        from gridslam.kernels.bundles import LANES, LINES, PLACES

        self._pending = False
        self._line = runtime.room((slabs, LINES, LANES), np.float64)
        self._place = runtime.room((slabs, PLACES, LANES), np.int32)
        self._scratch = runtime.resident(np.zeros((slabs, *shape, 3), np.float32))
        self._touched = runtime.resident(np.zeros((slabs, shape[0] * shape[1] + 1, 2), np.int32))
        self._message = runtime.resident(np.zeros((slabs, *shape)))
        self._frame = (*self.origin.tolist(), cell, OUTSIDE, EVIDENCE_CLIP)

    @property
    def evidence(self) -> Array:
        """Log odds of every cell, 0 where untouched, (ny, nx); replace it whole, never in place."""
        return self._evidence

    @evidence.setter
    def evidence(self, value: Array) -> None:
        self._evidence, self._occupied = value, None

    @property
    def coefficient(self) -> Array:
        """Log-likelihood over `REFLECTION_BINS` of every cell, (ny, nx, BINS)."""
        return runtime.on_host(self.held)

    @coefficient.setter
    def coefficient(self, value: Array) -> None:
        self.held = runtime.resident(np.ascontiguousarray(value, dtype=np.float64))

    def occupied(self) -> runtime.Resident:
        """Occupancy in both roles, crossed and met, kept until the evidence changes, (2, ny, nx)."""
        if self._occupied is None:
            both = np.stack([self.traversed(), self.hit()], dtype=np.float32)
            self._occupied = runtime.resident(both)
        return self._occupied

    def traversed(self) -> Array:
        """Occupancy probability of a cell in the role of being crossed."""
        o = 1 / (1 + np.exp(-(self.evidence + np.log(self.prior / (1 - self.prior)))))
        return np.where(self._clear, 1e-6, np.clip(o, 1e-3 * 0.1, 0.99))

    def hit(self) -> Array:
        """Occupancy probability of a cell in the role of being hit, inside V."""
        return np.where(self._clear, 1e-6, np.clip(1 / (1 + np.exp(-self.evidence)), 1e-3, 0.99))

    def see(self, rays: Rays, cloud: Cloud, anchors: Array) -> Polylines:
        """Draw rays at all states of a cloud, and cast them: V of every path, eq. (1)."""
        return self._cast(rays, cloud, anchors, np.zeros((len(rays), 2)), 0.0)

    def tell(
        self, rays: Rays, cloud: Cloud, anchors: Array, worth: Array, send: NDArray[np.bool_], least: float
    ) -> Polylines:
        """Add the messages of paths to their cells, eqs. (43)-(45); `absorb` folds them in.

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
        return self._cast(rays, cloud, anchors, np.stack([worth, send.astype(np.float64)], -1), least)

    def _cast(self, rays: Rays, cloud: Cloud, anchors: Array, factor: Array, least: float) -> Polylines:
        runtime.start()
        from gridslam.kernels.cells import cast

        rays.check(cloud.surfaces, len(anchors))
        state = cloud.state
        drawn = np.empty((len(rays), state.shape[1], 14))
        if len(rays):
            cast(
                state,
                rays.table,
                anchors,
                np.ascontiguousarray(factor, dtype=np.float64),
                self.occupied(),
                np.array([*self._frame, least]),
                drawn.reshape(-1, 14),
                self._line,
                self._place,
                self._scratch,
                self._touched,
                self._message,
            )
        return Polylines(rays.bounces, drawn)

    def forget(self) -> None:
        """Drop messages that were never absorbed, since a step was interrupted."""
        if self._pending:
            self._message.fill(0)
            self._pending = False

    def absorb(self) -> None:
        """Fold the messages of all paths and anchors into the beliefs, eq. (46)."""
        total = runtime.on_host(self._message).sum(0)
        self.observed |= np.abs(total) > TOUCHED
        self.evidence = np.clip(self.evidence + total, -EVIDENCE_CLIP, EVIDENCE_CLIP)
        self._message.fill(0)
        self._pending = False

    def weigh_coefficient(self, rays: Rays, drawn: Polylines, where: NDArray[np.intp], factor: Array) -> None:
        """Multiply log-likelihoods (n, BINS) over the coefficient into the cells that rays meet.

        Parameters
        ----------
        where : (n, 2) int
            Path and corner, counted from the anchor, that each is of.
        """
        from gridslam.kernels.coefficients import learn

        if len(where):
            frame = np.array([*self.origin, self.cell, 0.0])
            learn(drawn.flat, rays.table, where.astype(np.int32), factor, frame, self.held)
