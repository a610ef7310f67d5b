"""What a map is made of: cells of a grid, what is believed of them, and surfaces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, logit

from gridslam.errors import InputError
from gridslam.estimate_tables import FeatureEstimate, SurfaceEstimate, SurfaceStretches
from gridslam.io.covariances import require_covariance
from gridslam.maps.lattices import ON_LATTICE, Lattices
from gridslam.maps.map_anchors import MapAnchors
from gridslam.world.given import finite
from gridslam.world.levels import COEFFICIENTS
from gridslam.world.radio import REFLECTION_BINS

ANCHOR_KEYS = ("anchors", "anchor_x_m", "anchor_y_m")
"""Parallel lists in a map's provenance."""
LEVELS = ("floor", "ceiling")
"""Whose coefficients a map may hold."""
BELIEVED = 1e-6
"""By which a sum of probabilities may differ from 1."""
SAME_BLOCKS = 1e-6
"""By which a joint covariance may differ from those of the surfaces, as a share."""


def _level(name: str, belief: ArrayLike) -> np.ndarray:
    """A belief about the coefficient of floor or ceiling, or an error."""
    row = np.ascontiguousarray(belief, dtype=np.float64)
    _require(name in LEVELS, "levels", repr(name), " or ".join(LEVELS))
    _require(row.shape == COEFFICIENTS.shape, f"levels: {name}", row.shape, f"{COEFFICIENTS.shape}")
    likely = bool(np.isfinite(row).all() and (row >= 0).all() and abs(row.sum() - 1) < BELIEVED)
    _require(likely, f"levels: {name}", "no probabilities", "numbers from 0 on whose sum is 1")
    return row


@dataclass(frozen=True, eq=False)
class MapCells:
    """What `gridslam.maps.map.Map` holds (see there), without its walls and files."""

    origin_m: np.ndarray
    cell_m: float
    evidence: np.ndarray
    coefficient: np.ndarray
    observed: np.ndarray
    prior: float
    surfaces: SurfaceEstimate | None = None
    surface_reflection: np.ndarray | None = None
    provenance: dict[str, str | int | float | list] = field(default_factory=dict)
    features: FeatureEstimate | None = None
    feature_covariance: np.ndarray | None = None
    surface_covariance: np.ndarray | None = None
    levels: dict[str, np.ndarray] = field(default_factory=dict)
    stretches: SurfaceStretches | None = None
    anchors: MapAnchors | None = None

    def __post_init__(self) -> None:
        types = {
            "origin_m": np.float64,
            "evidence": np.float32,
            "coefficient": np.float32,
            "observed": np.bool_,
        }
        for name, dtype in types.items():
            object.__setattr__(self, name, np.ascontiguousarray(getattr(self, name), dtype=dtype))
        bins, surfaces = len(REFLECTION_BINS), len(self.surfaces) if self.surfaces is not None else 0
        _require(
            self.origin_m.shape == (2,) and bool(np.isfinite(self.origin_m).all()), "origin_m", self.origin_m
        )
        _require(0 < self.cell_m < np.inf, "cell_m", self.cell_m, "a length above 0 m")
        _require(0 < self.prior < 1, "prior", self.prior, "between 0 and 1")
        _require(
            self.evidence.ndim == 2 and self.evidence.size > 0, "evidence", self.evidence.shape, "(ny, nx)"
        )
        _require(self.observed.shape == self.shape, "observed", self.observed.shape, f"{self.shape}")
        cube = (*self.shape, bins)
        _require(self.coefficient.shape == cube, "coefficient", self.coefficient.shape, f"{cube}")
        if self.surface_reflection is not None:
            table = np.ascontiguousarray(self.surface_reflection, dtype=np.float64)
            object.__setattr__(self, "surface_reflection", table)
            _require(
                table.shape == (surfaces, bins), "surface_reflection", table.shape, f"{(surfaces, bins)}"
            )
        if self.feature_covariance is not None:
            size = 3 * (len(self.features) if self.features is not None else 0)
            square = np.ascontiguousarray(self.feature_covariance, dtype=np.float64)
            object.__setattr__(self, "feature_covariance", square)
            _require(square.shape == (size, size), "feature_covariance", square.shape, f"{(size, size)}")
        if self.stretches is not None:
            rows, extent = self.stretches.surface, self.stretches.extent_m
            good = extent.shape == (len(rows), 2) and bool(np.isfinite(extent).all())
            _require(good, "stretches", f"extents {extent.shape}", f"{(len(rows), 2)}, finite")
            _require(
                not len(rows) or 0 <= rows.min() <= rows.max() < surfaces,
                "stretches", "rows that aren't there", f"rows of the {surfaces} surfaces",
            )  # fmt: skip
        object.__setattr__(self, "levels", {n: _level(n, one) for n, one in self.levels.items()})
        if self.surface_covariance is not None:
            self._require_joint(np.ascontiguousarray(self.surface_covariance, dtype=np.float64))
        if self.anchors is not None:
            self.anchors.require(self.lines_covariance)

    def _require_joint(self, joint: np.ndarray) -> None:
        """Refuse a joint covariance of other surfaces, or none at all."""
        size = 2 * (len(self.surfaces) if self.surfaces is not None else 0)
        _require(joint.shape == (size, size), "surface_covariance", joint.shape, f"{(size, size)}")
        require_covariance(joint, "map: surface_covariance")
        if self.surfaces is not None:
            own = blocks_of(joint)
            _require(
                np.allclose(own, self.surfaces.line_cov, rtol=SAME_BLOCKS, atol=1e-12), "surface_covariance",
                "blocks on its diagonal that aren't the surfaces' own covariances", "the same as line_cov",
            )  # fmt: skip
        object.__setattr__(self, "surface_covariance", joint)

    @classmethod
    def blank(cls, origin_m: ArrayLike, cell_m: float, shape: tuple[int, int], prior: float) -> Self:
        """Return a map of `shape` (ny, nx) in which nothing was observed yet; the rest as its attributes."""
        cube = np.zeros((*shape, len(REFLECTION_BINS)), np.float32)
        return cls(np.asarray(origin_m), cell_m, cube[..., 0], cube, np.zeros(shape, bool), prior)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells (ny, nx)."""
        return self.evidence.shape[0], self.evidence.shape[1]

    @property
    def lines_covariance(self) -> np.ndarray:
        """Covariance of all surfaces' angles and offsets: (2 S, 2 S) float64."""
        if self.surface_covariance is not None:
            return self.surface_covariance
        return joint_of(self.surfaces.line_cov if self.surfaces is not None else np.zeros((0, 2, 2)))

    @property
    def truth_given(self) -> str:
        """What of the truth a reference was told that had a part in it; mostly nothing."""
        return self._names("told")

    @property
    def lost(self) -> str:
        """Which of the agents that made it noticed in the end that they were lost: nobody goes on from it.

        Hybrid SLAM alone notices, by paths that arrive before its lines of sight. Of any other map it is
        empty, though the maker may have been lost by its true track, as notes of `run` say.
        """
        return self._names("lost")

    def _names(self, key: str) -> str:
        """What a list of the provenance says, each once."""
        names = self.provenance.get(key)
        return ", ".join(dict.fromkeys(map(str, names))) if isinstance(names, list) else ""

    @property
    def corner_m(self) -> np.ndarray:
        """Upper-right corner of the upper-right cell: (2,) float64, m."""
        return self.origin_m + self.cell_m * np.array(self.shape[::-1])

    @property
    def mean_free_path_m(self) -> float:
        """Mean free path that the prior stands for, m."""
        return float(-self.cell_m / np.log1p(-self.prior))

    @cached_property
    def occupancy(self) -> np.ndarray:
        """Probability that a cell is occupied: (ny, nx) float32, NaN where unobserved."""
        picture = np.full(self.shape, np.nan, np.float32)
        picture[self.observed] = expit(self.evidence[self.observed].astype(float) + logit(self.prior))
        return picture

    @cached_property
    def occupied(self) -> np.ndarray:
        """Cells called occupied, probability above one half: (ny, nx) bool."""
        return self.observed & (self.evidence + logit(self.prior) > 0)

    @cached_property
    def free(self) -> np.ndarray:
        """Cells called free, observed and not occupied: (ny, nx) bool."""
        return self.observed & ~self.occupied

    @cached_property
    def reflection(self) -> np.ndarray:
        """Posterior mean of the amplitude reflection coefficient: (ny, nx) float32, NaN without hits."""
        return self._moments[0]

    @cached_property
    def reflection_std(self) -> np.ndarray:
        """Posterior deviation of the reflection coefficient: (ny, nx) float32, NaN without hits."""
        return self._moments[1]

    @cached_property
    def _moments(self) -> tuple[np.ndarray, np.ndarray]:
        hit = self.observed & self.coefficient.any(axis=-1)
        weight = self.coefficient[hit].astype(float)
        weight = np.exp(weight - weight.max(axis=-1, keepdims=True))
        weight /= weight.sum(axis=-1, keepdims=True)
        mean = weight @ REFLECTION_BINS
        variance = (weight * (REFLECTION_BINS - mean[:, None]) ** 2).sum(axis=-1)
        pictures = np.full((2, *self.shape), np.nan, np.float32)
        pictures[0][hit], pictures[1][hit] = mean, np.sqrt(variance)
        return pictures[0], pictures[1]

    def index(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Find the cells of points.

        Parameters
        ----------
        points : (..., 2) float, m

        Returns
        -------
        cell : (..., 2) int64
            Row and column ``[iy, ix]``; also beyond the grid's edge.
        inside : (...) bool
            Whether the point lies on the grid.
        """
        share = (np.asarray(points, float)[..., ::-1] - self.origin_m[::-1]) / self.cell_m
        inside = ((share >= 0) & (share < self.shape)).all(axis=-1)  # False for NaN
        bounded = np.clip(np.nan_to_num(share, nan=-1.0), -1, max(self.shape))
        return np.floor(bounded).astype(np.int64), inside

    def query(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Look up points.

        Parameters
        ----------
        points : (..., 2) float, m

        Returns
        -------
        occupancy, reflection : (...) float32
            NaN off the grid, where nothing was observed, and (reflection) without hits.

        Raises
        ------
        InputError
            No points of two numbers each.
        """
        try:
            asked = np.asarray(points, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError("points", repr(points)[:60], "x, y in m of one point or more") from None
        if asked.shape[-1:] != (2,):
            raise InputError("points", f"shape {asked.shape}", "(..., 2): x, y in m of one point or more")
        cell, inside = self.index(asked)
        row, column = (
            np.where(inside[..., None], cell, 0)[..., 0],
            np.where(inside[..., None], cell, 0)[..., 1],
        )
        nothing = np.float32(np.nan)
        return (
            np.where(inside, self.occupancy[row, column], nothing),
            np.where(inside, self.reflection[row, column], nothing),
        )

    def resample(self, origin_m: ArrayLike, cell_m: float, shape: tuple[int, int]) -> Self:
        """Carry the map over to another grid, without interpolation.

        A finer cell takes over the cell that its centre lies in; a coarser one takes over the most occupied
        of the observed cells whose centres lie in it (docs/model/grid.md). Cells beyond the old edge are
        unobserved. The prior follows the cell size.

        Parameters
        ----------
        origin_m : (2,) float, m
            Lower-left corner of the new grid.
        cell_m : float, m
            New cell side.
        shape : (int, int)
            New number of cells (ny, nx).

        Raises
        ------
        InputError
            The grids don't overlap, or numbers aren't finite.
        """
        origin, _ = finite(origin_m, "map: origin_m"), finite(cell_m, "map: cell_m")
        _require(cell_m > 0, "cell_m", cell_m, "a length above 0 m")
        same = np.allclose(origin, self.origin_m, rtol=0, atol=1e-12) and tuple(shape) == self.shape
        if same and cell_m == self.cell_m:
            return self
        corner = origin + cell_m * np.array(shape[::-1])
        slack = ON_LATTICE * min(cell_m, self.cell_m)
        if (np.minimum(corner, self.corner_m) - np.maximum(origin, self.origin_m) < slack).any():
            allowed = f"a grid that overlaps {self.origin_m.tolist()} to {self.corner_m.tolist()} m"
            raise InputError("map: extent", f"{origin.tolist()} to {corner.tolist()} m", allowed)

        lattices = Lattices.of((self.origin_m, self.cell_m), (origin, float(cell_m)))
        # row, column: (ny, nx, k), the k-th old cell that a new one may take over
        rows, there_y = lattices.taken_over(1, self.shape[0], shape[0])
        columns, there_x = lattices.taken_over(0, self.shape[1], shape[1])
        inside = (there_y[:, None, :, None] & there_x[None, :, None, :]).reshape(*shape, -1)
        row, column = np.broadcast_arrays(rows[:, None, :, None], columns[None, :, None, :])
        row, column = (np.reshape(a, (*shape, -1)) for a in (row, column))
        seen = inside & self.observed[row, column]
        chosen = np.where(seen, self.evidence[row, column], -np.inf).argmax(axis=-1)[..., None]
        row, column = (np.take_along_axis(a, chosen, axis=-1)[..., 0] for a in (row, column))
        observed = seen.any(axis=-1)
        return replace(
            self,
            origin_m=origin,
            cell_m=float(cell_m),
            evidence=np.where(observed, self.evidence[row, column], 0),
            coefficient=np.where(observed[..., None], self.coefficient[row, column], 0),
            observed=observed,
            prior=self.prior if lattices.ratio == 1 else float(-np.expm1(-cell_m / self.mean_free_path_m)),
        )


def anchors_of(provenance: Mapping[str, object]) -> Iterator[tuple[str, tuple[float, float]]]:
    """Names and places of a map's anchors; nothing if other software kept something else there."""
    lists = [provenance.get(key) for key in ANCHOR_KEYS]
    if all(isinstance(column, list) for column in lists):
        for name, x, y in zip(*lists, strict=False):
            if isinstance(x, float | int) and isinstance(y, float | int):
                yield str(name), (x, y)


def blocks_of(joint: np.ndarray) -> np.ndarray:
    """Blocks on the diagonal of a joint covariance of lines (2 S, 2 S): (S, 2, 2)."""
    entry = np.arange(len(joint)).reshape(-1, 2)
    return joint[entry[:, :, None], entry[:, None, :]]


def joint_of(blocks: np.ndarray) -> np.ndarray:
    """Joint covariance (2 S, 2 S) of lines that are independent of one another, of covariances (S, 2, 2)."""
    entry = np.arange(2 * len(blocks)).reshape(-1, 2)
    joint = np.zeros((entry.size, entry.size))
    joint[entry[:, :, None], entry[:, None, :]] = blocks
    return joint


def _require(good: bool, name: str, found: object, allowed: str = "two finite numbers") -> None:
    if not good:
        raise InputError(f"map: {name}", f"{found}", allowed)
