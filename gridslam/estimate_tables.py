"""Tables of what a filter believes at one step: surfaces, features, paths, hypotheses, rings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from gridslam.world.geometry import sfv, sfv_covariance, unit
from gridslam.world.radio import REFLECTION_BINS

ALIKE = 1e-7
"""Moments of a coefficient that differ by less are the same."""


class _Rows(ABC):
    """Rows of parallel arrays: length, selection and stacking, shared by the tables below."""

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """Names of the arrays, in the order of the fields."""
        return tuple(field.name for field in fields(cls))  # type: ignore[arg-type]

    def __len__(self) -> int:
        return len(getattr(self, self.columns()[0]))

    def __repr__(self) -> str:
        """One line."""
        return f"<{type(self).__name__} of {len(self)}: {', '.join(self.columns())}>"

    def take(self, rows: np.ndarray | slice | list[int]) -> Self:
        """Return the rows chosen by a mask, an index array or a slice."""
        return type(self)(**{name: getattr(self, name)[rows] for name in self.columns()})

    @classmethod
    def stack(cls, tables: list[Self]) -> Self:
        """Put the rows of several tables below one another."""
        whole = [cls.empty(), *tables]
        return cls(**{name: np.concatenate([getattr(t, name) for t in whole]) for name in cls.columns()})

    @classmethod
    @abstractmethod
    def empty(cls) -> Self:
        """Return a table without rows."""


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceEstimate(_Rows):
    """Reflecting surfaces, in scene coordinates.

    Attributes
    ----------
    identity : (S,) int64
        Number that a surface keeps from its birth on.
    sfv_m : (S, 2) float64, m
        Surface feature vector: the mirror image of the scene's origin.
    sfv_cov_m2 : (S, 2, 2) float64, m^2
        Its covariance.
    line : (S, 2) float64, [rad, m]
        Normal angle ``a`` and offset ``o`` of the line ``q . (cos a, sin a) = o``.
    line_cov : (S, 2, 2) float64
        Their covariance.
    reflection : (S,) float64
        Amplitude reflection coefficient.
    reflection_var : (S,) float64
        Its variance.
    existence : (S,) float64
        Probability that the surface exists.
    extent_m : (S, 2) float64, m
        Stretch that was hit: least and greatest coordinate along the tangent ``(-sin a, cos a)``, counted
        from the foot point ``o (cos a, sin a)``; NaN where nothing was hit.
    owner : (S,) int64
        The one anchor that the surface serves (virtual anchors); -1 for all.
    """

    identity: np.ndarray
    sfv_m: np.ndarray
    sfv_cov_m2: np.ndarray
    line: np.ndarray
    line_cov: np.ndarray
    reflection: np.ndarray
    reflection_var: np.ndarray
    existence: np.ndarray
    extent_m: np.ndarray
    owner: np.ndarray

    @classmethod
    def empty(cls) -> Self:
        """Return a table without surfaces."""
        none, pair, square = np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, 2))
        whole = np.zeros(0, np.int64)
        return cls(whole, pair, square, pair, square, none, none, none, pair, whole)

    @classmethod
    def from_lines(
        cls,
        line: np.ndarray,
        line_cov: np.ndarray,
        reflection: np.ndarray,
        reflection_var: np.ndarray,
        existence: np.ndarray,
        extent_m: np.ndarray | None = None,
        identity: np.ndarray | None = None,
        owner: np.ndarray | None = None,
    ) -> Self:
        """Build the table from lines; surface feature vectors and their covariances follow from them.

        Parameters
        ----------
        line, line_cov, reflection, reflection_var, existence, extent_m, identity, owner : np.ndarray
            As the attributes; without `extent_m` NaN, without `identity` 0 to S-1, without `owner` -1.
        """
        line = np.asarray(line, float).reshape(-1, 2)
        return cls(
            np.arange(len(line), dtype=np.int64) if identity is None else np.asarray(identity, np.int64),
            sfv(line),
            sfv_covariance(line, line_cov),
            line,
            np.asarray(line_cov, float),
            np.asarray(reflection, float),
            np.asarray(reflection_var, float),
            np.asarray(existence, float),
            np.full((len(line), 2), np.nan) if extent_m is None else np.asarray(extent_m, float),
            np.full(len(line), -1, np.int64) if owner is None else np.asarray(owner, np.int64),
        )

    @property
    def ends_m(self) -> np.ndarray:
        """Ends of the stretch that was hit: (S, 2, 2) float64, m, indexed [surface, end, xy]; NaN if none."""
        angle = self.line[:, 0]
        along = self.extent_m[:, :, None] * unit(angle + 0.5 * np.pi)[:, None, :]
        return self.line[:, 1, None, None] * unit(angle)[:, None, :] + along

    @property
    def reflection_learned(self) -> np.ndarray:
        """Whether anything was learned of a surface's coefficient, (S,) bool.

        Where no amplitudes are measured, or a method learns none, it stays what it was at birth: anything
        from 0 to 1.
        """
        same = np.isclose(self.reflection, REFLECTION_BINS.mean(), rtol=0, atol=ALIKE)
        return ~(same & np.isclose(self.reflection_var, REFLECTION_BINS.var(), rtol=0, atol=ALIKE))


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceStretches(_Rows):
    """Stretches of surfaces that paths were reflected by, of methods that map no cells.

    Attributes
    ----------
    surface : (W,) int64
        Row of the surface in its table; one may have several stretches or none. Ascending.
    extent_m : (W, 2) float64, m
        From where to where along the surface, as `SurfaceEstimate.extent_m` counts; ascending.
    """

    surface: np.ndarray
    extent_m: np.ndarray

    @classmethod
    def empty(cls) -> Self:
        """Return a table without stretches."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 2)))


FREE, MIRROR, SCATTERER = 0, 1, 2
"""Kinds of learned features."""


@dataclass(frozen=True, eq=False, repr=False)
class FeatureEstimate(_Rows):
    """Learned features (hybrid SLAM): points that stand for paths, each of one anchor.

    Attributes
    ----------
    identity : (F,) int64
        Number that a feature keeps.
    anchor : (F,) int64
        Index of the anchor in the scene where it was learned.
    anchor_m : (F, 2) float64, m
        Where that anchor stands, by which it is known elsewhere.
    position_m : (F, 2) float64, m
    bias_m : (F,) float64, m
        Length of the path beyond the distance to the point.
    variance : (F,) float64
        Mean power at 1 m, in units of the samples squared.
    noise : (F,) float64
        Noise power of the anchor's samples where it was learned, which tells another recording's scale.
    covariance : (F, 4, 4) float64
        Of x, y, bias (m) and variance.
    kind : (F,) int64
        0 free, 1 mirror (an image of the anchor), 2 scatterer.
    steps_seen, last_step : (F,) int64
        At how many steps it was heard, and the latest of them.
    """

    identity: np.ndarray
    anchor: np.ndarray
    anchor_m: np.ndarray
    position_m: np.ndarray
    bias_m: np.ndarray
    variance: np.ndarray
    noise: np.ndarray
    covariance: np.ndarray
    kind: np.ndarray
    steps_seen: np.ndarray
    last_step: np.ndarray

    @classmethod
    def empty(cls) -> Self:
        """Return a table without features."""
        none, whole, pair = np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 2))
        square = np.zeros((0, 4, 4))
        return cls(whole, whole, pair, pair, none, none, none, square, whole, whole, whole)


@dataclass(frozen=True, eq=False, repr=False)
class PathEstimate(_Rows):
    """Propagation paths that the filter believes in at one step.

    Attributes
    ----------
    anchor : (L,) int64
        Index of the anchor.
    surfaces : (L, 2) int64
        Identities of the surfaces hit, last one first: (-1, -1) line of sight, (s, s) single bounce.
    distance_m, aod_rad, aoa_rad, amplitude : (L,) float64; m, rad, rad, 1
        Predicted length, angles (relative, as measured) and normalised amplitude.
    existence : (L,) float64
        Probability that the path exists.
    points : (L, 4, 2) float64, m
        Anchor, first and last interaction point, agent; NaN for a bounce that isn't there.
    """

    anchor: np.ndarray
    surfaces: np.ndarray
    distance_m: np.ndarray
    aod_rad: np.ndarray
    aoa_rad: np.ndarray
    amplitude: np.ndarray
    existence: np.ndarray
    points: np.ndarray

    @classmethod
    def empty(cls) -> Self:
        """Return a table without paths."""
        none, pair = np.zeros(0), np.zeros((0, 2), np.int64)
        return cls(np.zeros(0, np.int64), pair, none, none, none, none, none, np.zeros((0, 4, 2)))


@dataclass(frozen=True, eq=False, repr=False)
class HypothesisEstimate(_Rows):
    """Where the agent may be, the likeliest first. Mostly there is one row.

    Attributes
    ----------
    weight : (K,) float64
        Probability of every hypothesis.
    position_m : (K, 2) float64, m
    heading_rad : (K,) float64, rad
    position_cov_m2 : (K, 2, 2) float64, m^2
    surface_count : (K,) int64
        How many surfaces each has.
    """

    weight: np.ndarray
    position_m: np.ndarray
    heading_rad: np.ndarray
    position_cov_m2: np.ndarray
    surface_count: np.ndarray

    @classmethod
    def empty(cls) -> Self:
        """Return a table without hypotheses."""
        none = np.zeros(0)
        return cls(none, np.zeros((0, 2)), none, np.zeros((0, 2, 2)), np.zeros(0, np.int64))


@dataclass(frozen=True, eq=False, repr=False)
class RingEstimate(_Rows):
    """Places where images of anchors may be that aren't known yet (direct SLAM): a row per hypothesis.

    Attributes
    ----------
    ring : (H,) int64
        Which ring of this step a row is of.
    anchor : (H,) int64
        Index of the anchor.
    existence : (H,) float64
        Probability that there is such an image, the same in all rows of a ring.
    weight : (H,) float64
        Probability of the place, if there is one; those below 0.001 are left out.
    position_m : (H, 2) float64, m
    """

    ring: np.ndarray
    anchor: np.ndarray
    existence: np.ndarray
    weight: np.ndarray
    position_m: np.ndarray

    @classmethod
    def empty(cls) -> Self:
        """Return a table without rings."""
        none, whole = np.zeros(0), np.zeros(0, np.int64)
        return cls(whole, whole, none, none, np.zeros((0, 2)))
