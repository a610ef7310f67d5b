"""What measured elevations tell: which way a path came, and heights; docs/model.md, (M301) to (M304). Ours.

Azimuths, distances and amplitudes are taken in by kernels; elevations, which few radios measure, multiply
what these leave (`weigh_elevations`, before the association), and correct the belief after it
(`correct_by_elevations`). A path has one elevation, which both of its ends see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.messages.births import Births, with_births
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import LEAST_STD, AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.kernels import GIVEN_HEIGHT, HEIGHT, RISE
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import lean, slant, trace, wrap
from gridslam.world.radio import RadioModel

LEAST_SHARE, LEAST_LEVEL_M = 1e-4, 1e-3
"""Probability below which a measurement corrects nothing; length seen from above that slopes are taken at."""
NOTHING = 1e-30
"""Precision of a measured elevation that is divided by at least."""


@dataclass(frozen=True)
class Seen:
    """Elevations of M measurements as those of arrival, both ends in one: by the way a path came, (2, M).

    Attributes
    ----------
    value : (2, M) rad
        0: of paths over walls alone, which leave as far down as they arrive from above; 1: over a level.
    variance : (2, M) rad^2
        Infinite where none was measured.
    ratio : (2, M)
        Density of the ends' difference over that of clutter, without the density of `value`.
    """

    value: Array
    variance: Array
    ratio: Array

    @classmethod
    def of(cls, scan: AnchorScan, radio: RadioModel) -> Seen:
        """What was heard, with its own deviations or those that follow from the amplitude."""
        assert scan.elevation is not None
        measured = np.isfinite(scan.elevation[:, :2])
        value = np.where(measured, scan.elevation[:, :2], 0.0)
        far = np.nan_to_num(scan.value[:, 0], nan=np.inf)
        amplitude = np.where(np.isfinite(scan.amplitude), scan.amplitude, radio.amplitude(far))
        amplitude = np.maximum(amplitude, radio.threshold)
        anchor = np.full(len(scan), scan.anchor)
        own, count = scan.elevation[:, 2:], measured.sum(1)
        rough = np.abs(value).sum(1) / np.maximum(count, 1)
        values, variances, ratios = [], [], []
        # over walls alone as steep as the anchor is high, over a level as it is heard
        for sign, steep in ((-1.0, lean(far, scan.height)), (1.0, lean(1.0, np.sin(rough)))):
            std = radio.elevation_std(amplitude, anchor, steep)
            std = np.where(np.isfinite(own), np.maximum(own, LEAST_STD), std)
            weight = np.where(measured, 1 / std**2, 0.0)
            total, both = weight.sum(1), (weight > 0).all(1)
            arrivals = value * (sign, 1.0)
            values.append((weight * arrivals).sum(1) / np.maximum(total, NOTHING))
            with np.errstate(divide="ignore"):
                variances.append(1 / total)
            spread = np.where(both, (1 / np.maximum(weight, NOTHING)).sum(1), 1.0)
            gap = arrivals[:, 0] - arrivals[:, 1]
            agree = np.exp(-0.5 * gap**2 / spread) / np.sqrt(2 * np.pi * spread)
            flat = np.pi ** (weight > 0).sum(1)  # clutter's elevations are uniform
            ratios.append(flat * np.where(both, agree, 1.0))
        return cls(np.array(values), np.array(variances), np.array(ratios))

    def ratios(self, way: NDArray[np.intp], expected: Array, variance: Array) -> Array:
        """Over clutter, of paths (L, 1) and all measurements, (L, M); 1 where there is no elevation."""
        row = np.arange(self.value.shape[1])
        return self.pairs(way, row, expected, variance)

    def pairs(self, way: NDArray[np.intp], row: NDArray[np.intp], expected: Array, variance: Array) -> Array:
        """Ratio over clutter of each path with its own measurement `row`; 1 where there is no elevation."""
        spread = self.variance[way, row] + variance
        with np.errstate(invalid="ignore"):
            gap = (self.value[way, row] - expected) ** 2 / spread
            density = np.exp(-0.5 * gap) / np.sqrt(2 * np.pi * spread)
        return np.asarray(np.where(np.isfinite(spread), self.ratio[way, row] * density, 1.0))


@dataclass(frozen=True)
class Foreseen:
    """Elevations of arrival of L paths as predicted.

    Attributes
    ----------
    way : (L,) int
        0 over walls alone, 1 over floor or ceiling.
    value : (L,) rad
    slope : (L, N)
        By the joint state.
    variance : (L,) rad^2
    """

    way: NDArray[np.intp]
    value: Array
    slope: Array
    variance: Array

    @classmethod
    def of(cls, belief: Belief, rays: Rays, model: FilterModel) -> Foreseen:
        """Predicted at the mean of the belief."""
        bounces, last, first, anchor = rays.table.T.astype(np.intp)
        place, layout, mean = model.places[anchor], belief.layout, belief.mean
        rise = place[:, RISE].astype(np.intp)
        known = rise < 0
        entry = layout.heights.start + np.maximum(rise, 0)
        height = place[:, HEIGHT].copy()
        if layout.rises:
            height = np.where(
                known, height, place[:, GIVEN_HEIGHT] + mean[np.minimum(entry, layout.head - 1)]
            )
        lines = belief.lines if len(belief.lines) else np.zeros((1, 2))
        here = np.tile(mean[:2], (len(anchor), 1))
        path = trace(
            here, place[:, :2], lines[np.maximum(last, 0)], lines[np.maximum(first, 0)], bounces, height
        )
        level = np.maximum(path.level, LEAST_LEVEL_M)
        length = slant(level, height)
        by_length = path.jacobian[:, 0] * (-height / (length * level))[:, None]
        slope, row = np.zeros((len(anchor), len(mean))), np.arange(len(anchor))
        slope[:, :2] = by_length[:, :2]
        for used, surface, columns in ((bounces > 0, last, (3, 4)), (bounces > 1, first, (5, 6))):
            rows = np.flatnonzero(used)
            for side, column in enumerate(columns):
                np.add.at(slope, (rows, layout.line(surface[rows])[:, side]), by_length[rows, column])
        if layout.rises:
            slope[row[~known], entry[~known]] = (level / length**2)[~known]
        way = (anchor >= model.senders).astype(np.intp)
        variance = (slope @ belief.covariance * slope).sum(1)
        return cls(way, np.arctan2(height, level), slope, variance)


def tells(scan: AnchorScan, radio: RadioModel) -> bool:
    """Whether elevations were measured, in a scene that has heights."""
    return scan.elevation is not None and bool(radio.upright)


def weigh_elevations(
    state: State, scan: AnchorScan, paths: PredictedPaths, ratios: LikelihoodRatios, radio: RadioModel,
    model: FilterModel,
) -> LikelihoodRatios:  # fmt: skip
    """Likelihood ratios, with the factor of the elevations; docs/model.md, (M302).

    Parameters
    ----------
    scan : AnchorScan
        M measurements; unless it `tells` of elevations, the ratios stay the same object.
    paths : PredictedPaths
        The L paths that the ratios (L, M) are of.
    radio : RadioModel
        As the anchor's radio seems to be.
    """
    if not tells(scan, radio):
        return ratios
    seen, foreseen = Seen.of(scan, radio), Foreseen.of(state.belief, paths.rays, model)
    factor = seen.ratios(foreseen.way[:, None], foreseen.value[:, None], foreseen.variance[:, None])
    return ratios.times(factor)


def weigh_by_elevations(
    births: Births, state: State, scan: AnchorScan, ratios: LikelihoodRatios, radio: RadioModel,
    model: FilterModel,
) -> tuple[Births, LikelihoodRatios]:  # fmt: skip
    """Births, of paths over walls alone, by their elevations, and the ratios with their sums; (M303).

    Parameters
    ----------
    births : Births
        B hypotheses, of rows of `scan`; unless that `tells` of elevations, both stay the same objects.
    ratios : LikelihoodRatios
        Of the scan's M measurements.
    radio : RadioModel
        As the anchor's radio seems to be.
    """
    if not tells(scan, radio) or not len(births):
        return births, ratios
    m, seen = births.measurement.astype(np.intp), Seen.of(scan, radio)
    height = model.places[births.anchor, HEIGHT]
    length = np.maximum(scan.value[m, 0], 1e-3)
    cosine = lean(length, height)
    angles = np.nan_to_num(scan.value[m, 1:])
    level = np.nan_to_num(scan.amplitude[m], nan=radio.threshold)
    std = np.minimum(deviations(scan, m, level, angles, radio, cosine)[:, 0], length)
    variance = (height / (length**2 * cosine) * std) ** 2
    rise = model.places[births.anchor, RISE].astype(np.intp)
    unsure = state.belief.covariance.diagonal()[state.belief.layout.heights]
    if len(unsure):
        variance = variance + np.where(rise < 0, 0.0, unsure[np.maximum(rise, 0)]) / (length * cosine) ** 2
    expected = np.arcsin(np.clip(height / length, -1.0, 1.0))
    ratio = births.ratio * seen.pairs(np.zeros(len(m), np.intp), m, expected, variance)
    births = replace(births, ratio=ratio)
    return births, with_births(ratios, births)


def correct_by_elevations(
    state: State, scan: AnchorScan, exchange: Exchange, radio: RadioModel, model: FilterModel
) -> State:
    """The belief corrected by elevations, by the association that there was; docs/model.md, (M304).

    Path by path, moment-matched over its measurements as other corrections are: given which path caused a
    measurement, its elevation is independent of the rest.
    """
    if not tells(scan, radio):
        return state
    seen, foreseen = Seen.of(scan, radio), Foreseen.of(state.belief, exchange.rays, model)
    begun = state.belief.mean
    mean, covariance = begun.copy(), state.belief.covariance.copy()
    share = exchange.responsible * np.isfinite(seen.variance[0])
    for row in np.argsort(-share.sum(1), kind="stable"):
        m = np.flatnonzero(share[row] > LEAST_SHARE)
        if not len(m):
            continue
        slope, way = foreseen.slope[row], foreseen.way[row]
        pushed = covariance @ slope
        spread = slope @ pushed + seen.variance[way, m]
        gap = (seen.value[way, m] - foreseen.value[row] - slope @ (mean - begun)) / spread
        part = share[row, m]
        shift = part @ gap
        mean += pushed * shift
        covariance -= np.outer(pushed, pushed) * (part @ (1 / spread - gap**2) + shift**2)
    mean[HEADING] = wrap(mean[HEADING])
    return replace(state, belief=replace(state.belief, mean=mean, covariance=covariance))
