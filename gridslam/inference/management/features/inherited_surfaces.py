"""Surfaces of an earlier agent's map after a run of hybrid SLAM, and those of learned mirrors, all together.

Images in surfaces were features of the run, and surfaces follow what became of these; docs/model.md, (M431).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.estimate_tables import FeatureEstimate, SurfaceEstimate
from gridslam.inference.management.features.mirror_cells import Mirrors
from gridslam.inference.management.features.surface_features import Images, between, facing, same_line
from gridslam.inference.state.features.sightings import Sightings
from gridslam.maps.feature_rows import entries, places_and_lengths, row_of, together
from gridslam.world.radio import BINS, REFLECTION_BINS


@dataclass(frozen=True, eq=False)
class KnownSurfaces:
    """Surfaces, what is believed of their coefficients, and how they hang together.

    Attributes
    ----------
    table : SurfaceEstimate
    reflection : (S, BINS) float64
        Rows sum to 1.
    covariance : (2 S, 2 S) float64
        Of all lines.
    """

    table: SurfaceEstimate
    reflection: Array
    covariance: Array

    @classmethod
    def of(cls, table: SurfaceEstimate | None, reflection: Array | None, covariance: Array | None) -> Self:
        """Those of a map: without beliefs about coefficients any is as likely, without a joint covariance
        they are independent."""
        table = SurfaceEstimate.empty() if table is None else table
        count = len(table)
        if covariance is None:
            covariance = together(table.line_cov)
        rows = np.full((count, BINS), 1 / BINS) if reflection is None else reflection
        return cls(table, np.asarray(rows, np.float64), covariance)


@dataclass(eq=False)
class _Lines:
    """Lines as functions of features, ``slope @ features + rest``; arrays are written to.

    Attributes
    ----------
    mean : (2 S,)
    slope : (2 S, 3 F)
        By x, y, b of all features of the run, as they are in the end.
    rest : (2 S, 2 S)
        Covariance of what doesn't depend on these.
    """

    mean: Array
    slope: Array
    rest: Array

    def pulled(self, row: int, line: Array, slope: Array, gain: Array) -> None:
        """Move all by a gain (2 S, 2) times what a line of a mirror, of given slopes (2, 3 F), misses one."""
        at = slice(2 * row, 2 * row + 2)
        gap = line - self.mean[at]
        gap[0] = np.angle(np.exp(1j * gap[0]))
        keep = np.eye(len(self.mean))
        keep[:, at] -= gain
        self.mean = self.mean + gain @ gap
        self.slope = keep @ self.slope + gain @ slope
        self.rest = keep @ self.rest @ keep.T


def surfaces_after(
    known: KnownSurfaces, start: Images | None, mirrors: Mirrors, table: FeatureEstimate, joint: Array,
    sightings: Sightings,
) -> KnownSurfaces:  # fmt: skip
    """All surfaces that are known after a run.

    Parameters
    ----------
    known : KnownSurfaces
        Of the map that it began with.
    start : Images, optional
        The features that it began with, of a map; None: there was none.
    mirrors : Mirrors
        What learned mirrors say.
    table, joint : FeatureEstimate, (3 F, 3 F)
        Features in the end; those that it began with have the numbers of their rows then.
    sightings : Sightings
        What was heard in this run.

    A surface follows its images, if it has any in the belief. Else a mirror of the same line stands for it
    if that was known already, and is another estimate of it if not. Mirrors that are none of them are new.
    """
    count, size = len(known.table), 3 * len(table)
    lines = _Lines(known.table.line.ravel().copy(), np.zeros((2 * count, size)), known.covariance.copy())
    imaged = np.zeros((0, count), bool) if start is None else _surfaces_of(start, count)
    followed = np.zeros(count, bool)
    if start is not None:
        rows = np.flatnonzero(np.isin(table.identity, np.flatnonzero(imaged.any(1))))
        followed = imaged[table.identity[rows]].any(0)
        _follow(lines, start, table, rows)
    owner = _owners(mirrors.surfaces, lines.mean.reshape(-1, 2), imaged)
    slopes, places = _by_features(mirrors.surfaces, table, size)
    for m, s in enumerate(owner):
        if s < 0 or followed[s]:
            continue
        at = slice(2 * s, 2 * s + 2)
        line, sign = facing(places[m], lines.mean[at])
        slope = slopes[m] * np.array([[1.0], [sign]])
        gain = np.zeros((2 * count, 2))
        gain[at] = np.eye(2)
        if mirrors.surfaces.identity[m] >= len(imaged):  # learned by this agent: another estimate
            whole = lines.rest + lines.slope @ joint @ lines.slope.T
            gain = np.asarray(np.linalg.solve(whole[at, at] + slope @ joint @ slope.T, whole[at]).T)
        lines.pulled(int(s), line, slope, gain)
    reflection, existence, extent = _borne_out(known, mirrors, owner, imaged, sightings)
    new = np.flatnonzero(owner < 0)
    mean = np.concatenate([lines.mean, places[new].ravel()])
    slope = np.concatenate([lines.slope, slopes[new].reshape(2 * len(new), size)])
    covariance = slope @ joint @ slope.T
    covariance[: 2 * count, : 2 * count] += lines.rest
    number = known.table.identity.max(initial=-1) + 1 + np.arange(len(new))
    fresh = replace(mirrors.surfaces.take(new), identity=number)
    every = SurfaceEstimate.stack([replace(known.table, existence=existence, extent_m=extent), fresh])
    touched = np.concatenate([(reflection != known.reflection).any(1), np.zeros(len(new), bool)])
    weights = np.concatenate([reflection, mirrors.reflection[new]])
    return _collected(every, mean, covariance, weights, touched)


def _surfaces_of(start: Images, count: int) -> NDArray[np.bool_]:
    """Which of so many surfaces each feature is an image in, (G, S)."""
    return np.asarray((start.slopes.reshape(len(start.table), 3, count, 2) != 0).any((1, 3)))


def _follow(lines: _Lines, start: Images, table: FeatureEstimate, rows: NDArray[np.intp]) -> None:
    """Surfaces after what became of these features, their images: by regression."""
    then, now = entries(table.identity[rows]), entries(rows)
    after, before = places_and_lengths(table).ravel(), places_and_lengths(start.table).ravel()
    slopes = start.slopes[then]
    cross = slopes @ lines.rest
    gain = np.linalg.solve(start.covariance[np.ix_(then, then)], cross).T
    lines.mean = lines.mean + gain @ (after[now] - before[then])
    rest = lines.rest - gain @ cross
    lines.rest = 0.5 * (rest + rest.T)
    lines.slope[:, now] = gain


def _owners(mirrors: SurfaceEstimate, lines: Array, imaged: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Which surface each mirror is (M,), by what it is an image in or by its line; -1: a new one."""
    owner = np.full(len(mirrors), -1)
    for m, (number, line) in enumerate(zip(mirrors.identity, mirrors.line, strict=True)):
        if number < len(imaged) and imaged[number].sum() == 1:
            owner[m] = int(imaged[number].argmax())
            continue
        same = [s for s, other in enumerate(lines) if same_line(line, other)]
        owner[m] = same[0] if same else -1
    return owner


def _by_features(mirrors: SurfaceEstimate, table: FeatureEstimate, size: int) -> tuple[Array, Array]:
    """Slopes (M, 2, 3 F) of mirrors' lines by all features, and the lines (M, 2)."""
    slopes, places = np.zeros((len(mirrors), 2, size)), np.zeros((len(mirrors), 2))
    for m, number in enumerate(mirrors.identity):
        row = row_of(table, number)
        places[m], slopes[m, :, 3 * row : 3 * row + 2] = between(table.anchor_m[row], table.position_m[row])
    return slopes, places


def _borne_out(
    known: KnownSurfaces,
    mirrors: Mirrors,
    owner: NDArray[np.int64],
    imaged: NDArray[np.bool_],
    sightings: Sightings,
) -> tuple[Array, Array, Array]:
    """Coefficients (S, BINS), existence (S,) and extents (S, 2) with what was heard of them in this run.

    Parameters
    ----------
    imaged : (G, S) bool
        Which of the features that it began with are images in which of them. What the others tell is known.
    """
    reflection, existence = known.reflection.copy(), known.table.existence.copy()
    extent = known.table.extent_m.copy()
    for m in np.flatnonzero(owner >= 0):
        one, s, number = mirrors.surfaces.take([int(m)]), owner[m], int(mirrors.surfaces.identity[m])
        if not len(sightings.of(number)):
            continue
        weight = reflection[s] * mirrors.reflection[m]
        reflection[s] = weight / weight.sum() if weight.sum() > 0 else reflection[s]
        if number >= len(imaged) or imaged[number].any():
            existence[s] = 1 - (1 - existence[s]) * (1 - one.existence[0])
        both = np.concatenate([extent[s], one.extent_m[0]])
        if np.isfinite(both).any():
            extent[s] = np.nanmin(both), np.nanmax(both)
    return reflection, existence, extent


def _collected(
    every: SurfaceEstimate, mean: Array, covariance: Array, reflection: Array, touched: NDArray[np.bool_]
) -> KnownSurfaces:
    """Surfaces of these lines (2 S,), normals such that offsets aren't negative."""
    line, extent = mean.reshape(-1, 2).copy(), every.extent_m.copy()
    turned = line[:, 1] < 0
    line[turned] = line[turned] * [1.0, -1.0] + [np.pi, 0.0]
    line[:, 0] = np.angle(np.exp(1j * line[:, 0]))
    extent[turned] = -extent[turned][:, ::-1]
    sign = np.column_stack([np.ones(len(line)), np.where(turned, -1.0, 1.0)]).ravel()
    covariance = 0.5 * (covariance + covariance.T) * sign * sign[:, None]
    own = np.array([covariance[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] for n in range(len(line))])
    average = np.where(touched, reflection @ REFLECTION_BINS, every.reflection)
    spread = (reflection * (REFLECTION_BINS - average[:, None]) ** 2).sum(1)
    table = SurfaceEstimate.from_lines(
        line, own.reshape(-1, 2, 2), average, np.where(touched, spread, every.reflection_var),
        every.existence, extent, every.identity, every.owner,
    )  # fmt: skip
    return KnownSurfaces(table, reflection, covariance)
