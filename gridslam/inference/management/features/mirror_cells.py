"""Mirrors that were learned, as surfaces with coefficients and cells; docs/model.md, (M322), (M323).

So a map of hybrid SLAM serves methods that map surfaces and cells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit, ndtr

from gridslam.arrays import Array
from gridslam.estimate_tables import FeatureEstimate, SurfaceEstimate
from gridslam.inference.management.features.feature_tables import POWER_STD
from gridslam.inference.management.features.surface_features import mirror_surfaces
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.inference.state.grid import Grid
from gridslam.maps.feature_rows import row_of
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import crossing, mirror, unit
from gridslam.world.radio import BINS, REFLECTION_BINS
from gridslam.world.scene_parts import GridSpec

SURE = 0.95
"""Probability that a path which was heard is what it is taken for."""
NEAR_M = 0.35
"""About anchors, agents and walls nothing is free for it."""
SAMPLED = 0.25
"""Of a cell: steps in which paths are followed."""
MOST_STEPS = 100_000
"""Of one path: on longer ones, kilometres, they are larger."""
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Mirrors:
    """What learned mirrors say for methods that map surfaces and cells.

    Attributes
    ----------
    surfaces : SurfaceEstimate
    reflection : (S, BINS) float64
        Beliefs about their coefficients; rows sum to 1.
    grid : Grid
    """

    surfaces: SurfaceEstimate
    reflection: Array
    grid: Grid


def mirrors_of(table: FeatureEstimate, joint: JointBelief, model: FilterModel) -> Mirrors:
    """Surfaces and cells that mirrors among a belief's features, and lines of sight, tell.

    Without a mirror nothing is told of cells. Features of a crowd stand for scatterers and aren't mirrors.
    """
    found, anchors = mirror_surfaces(table), model.anchors[:, :2]
    if joint.extent > 0:
        found = SurfaceEstimate.empty()
    if not len(found):
        return Mirrors(found, np.zeros((0, BINS)), Grid.empty(model.grid.shape))
    log = np.array([coefficient_of(table, joint, int(one)) for one in found.identity])
    weight = np.exp(log - log.max(1, keepdims=True))
    weight /= weight.sum(1, keepdims=True)
    mean = weight @ REFLECTION_BINS
    variance = (weight * (REFLECTION_BINS - mean[:, None]) ** 2).sum(1)
    traced = _Traced.none(model)
    for j, anchor in enumerate(anchors):
        for place in joint.sightings.of(-1 - j):
            traced.open(anchor, place)
    extent = np.full((len(found), 2), np.nan)
    for row, identity in enumerate(found.identity):
        anchor = table.anchor_m[row_of(table, identity)]
        at, places = reflections(found.line[row], anchor, joint.sightings.of(int(identity)))
        along = at @ unit(found.line[row, 0] + 0.5 * np.pi)
        if len(at):
            extent[row] = along.min(), along.max()
        for place, point, reach in zip(places, at, along, strict=True):
            slope = np.array([-reach, 1.0])  # of the wall's place there, along its normal
            std = float(np.sqrt(slope @ found.line_cov[row] @ slope))
            traced.open(anchor, point)
            traced.open(place, point)
            traced.meet(point, std, log[row] - log[row].max())
    surfaces = replace(found, reflection=mean, reflection_var=variance, extent_m=extent)
    return Mirrors(surfaces, weight, traced.drawn())


def coefficient_of(table: FeatureEstimate, joint: JointBelief, identity: int) -> Array:
    """Log-likelihood (BINS,) of the coefficient of a mirror, by its power in that of the line of sight."""
    row, anchor = row_of(table, identity), joint.features.anchor[row_of(joint.features, identity)]
    if not len(joint.sightings.of(-1 - int(anchor))):  # how loud the line of sight is isn't known
        return np.zeros(BINS)
    ratio = 0.5 * np.log(table.variance[row] / joint.los_power[anchor])
    far: Array = (np.log(REFLECTION_BINS) - min(ratio, 0.0)) / (POWER_STD / np.sqrt(2))
    return -0.5 * far**2


def reflections(line: Array, anchor_m: Array, places_m: Array) -> tuple[Array, Array]:
    """Where paths from an anchor by way of a line to places (n, 2) meet it, and those places; (m, 2) each."""
    image = mirror(line, anchor_m)
    share = crossing(places_m, image, line)
    there = np.isfinite(share) & (share > 0) & (share < 1)
    places = places_m[there]
    return places + share[there, None] * (image - places), places


@dataclass(frozen=True, eq=False)
class _Traced:
    """What paths met and crossed on a map's cells; arrays are written to.

    Attributes
    ----------
    spec : GridSpec
    prior : float
        Of a cell that a path crosses, that it is occupied.
    free : (ny, nx) bool
        Whether a path crossed it.
    share : (ny, nx)
        Probability that a wall was met there, as the surest of the paths says it.
    coefficient : (ny, nx, BINS)
        Of that wall.
    """

    spec: GridSpec
    prior: float
    free: NDArray[np.bool_]
    share: Array
    coefficient: Array

    @classmethod
    def none(cls, model: FilterModel) -> Self:
        """Nothing was met or crossed yet."""
        spec = model.grid
        prior = -np.expm1(-spec.cell_m / model.settings.mean_free_path_m)
        return cls(
            spec,
            float(prior),
            np.zeros(spec.shape, bool),
            np.zeros(spec.shape),
            np.zeros((*spec.shape, BINS)),
        )

    def cells(self, points_m: Array) -> tuple[Indices, Indices]:
        """Rows and columns of the cells in which points (n, 2) lie that are on the grid."""
        cell = np.floor((points_m - self.spec.origin_m) / self.spec.cell_m)[:, ::-1]
        cell = cell[((cell >= 0) & (cell < self.spec.shape)).all(1)].astype(np.int64)
        return cell[:, 0], cell[:, 1]

    def open(self, start_m: Array, end_m: Array) -> None:
        """Nothing stands between two points, but for what is near to them."""
        way = end_m - start_m
        far = float(np.hypot(*way))
        count = int(min(np.ceil(max(far - 2 * NEAR_M, 0.0) / (SAMPLED * self.spec.cell_m)), MOST_STEPS))
        if not count:
            return
        steps = np.linspace(NEAR_M, far - NEAR_M, count + 1)
        self.free[self.cells(start_m + steps[:, None] * way / far)] = True

    def meet(self, point_m: Array, std_m: float, log: Array) -> None:
        """A wall was met at a point that is known so well, with a coefficient of this log-likelihood."""
        share = SURE * float(2 * ndtr(0.5 * self.spec.cell_m / max(std_m, 1e-9)) - 1)
        cell = self.cells(point_m[None])
        if (share > self.share[cell]).any():
            self.share[cell], self.coefficient[cell] = share, log

    def drawn(self) -> Grid:
        """The grid with what they say of cells."""
        met, prior = self.share > 0, self.prior
        occupied = self.share + (1 - self.share) * prior
        crossed = np.where(self.free, np.log1p(-SURE), 0.0)
        evidence = np.where(met, logit(occupied) - logit(prior), crossed)
        return Grid.of(evidence, met | self.free, self.coefficient.astype(np.float32))
