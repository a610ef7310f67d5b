"""What one scan says of poses: lines of sight, new bounces, clutter; and known surfaces, if there is a map.

A single bounce with distance and both angles has three numbers for the two unknowns of its line: the third
tells of the pose. Three such paths fix a pose, four tell it from chance; a line of sight fixes it alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.management.pose_recovery import Sources
from gridslam.inference.messages.likelihood import DetectionTable, detection_table, deviations
from gridslam.inference.state.anchor_measurements import AnchorScan
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import level_of, slant, unit
from gridslam.world.radio import REFLECTION_BINS, RadioModel

IN_SIGHT = 0.9
"""Chance that an anchor is in sight."""
TWICE = 0.1
"""Chance that a new path has bounced more than once: its AoD says nothing of the pose then."""
NEAREST_M = 0.1
"""From an anchor to its image, at least: nearer, a line would stand in the anchor."""
PAIRS = 200_000
"""Poses x measurements that are scored at a time."""
MAP_VARIANCE = np.array([0.03, 0.02, 0.02]) ** 2
"""What a map's own errors add to a measurement's, m^2 and rad^2."""
MOST = 60.0
"""Log-likelihood ratio of one measurement, at most."""


@dataclass(frozen=True, eq=False)
class SnapshotTerms:
    """What of an anchor's measurements doesn't depend on the pose.

    Attributes
    ----------
    position : (2,) m
    height : float, m
        Of the anchor above the agent.
    value : (M, 3)
        Distance (m), AoD in the world and AoA (rad); 0 where not measured.
    variance : (M, 3)
        Infinite where not measured.
    amplitude : (M,)
        NaN: not measured.
    log_clutter : (M,)
        Log intensity of clutter, over what was measured.
    log_born : (M,)
        Log intensity of new single bounces, but for what AoD and geometry say.
    radio : RadioModel
    table : DetectionTable
    known : Sources
        Lines of sight and single bounces over surfaces that are known, if a map is to be reckoned with.
    """

    position: Array
    height: float
    value: Array
    variance: Array
    amplitude: Array
    log_clutter: Array
    log_born: Array
    radio: RadioModel
    table: DetectionTable
    known: Sources | None = None

    @classmethod
    def of(cls, heard: AnchorScan, radio: RadioModel, birth_rate: float, over: Sources | None = None) -> Self:
        """The terms of one anchor's scan.

        Parameters
        ----------
        birth_rate : float
            Births per anchor, step and unit of lines (rad m).
        over : Sources, optional
            Single bounces over known surfaces.
        """
        rows = np.arange(len(heard))
        known = np.isfinite(heard.amplitude)
        strength = np.where(known, heard.amplitude, radio.threshold)
        std = deviations(heard, rows, strength, np.nan_to_num(heard.value[:, 1:]), radio)
        value = np.nan_to_num(heard.value)
        value[:, 1] += heard.orientation
        flat = np.log([radio.max_distance_m, 2 * np.pi, 2 * np.pi])
        clutter = radio.log_clutter(heard.amplitude) + (flat * ~np.isfinite(std)).sum(1)
        level = radio.amplitude(value[:, :1], REFLECTION_BINS)
        born = np.exp(radio.log_rician(strength[:, None], level))
        if not known.all():
            detected = radio.detection_probability(np.maximum(level, 1e-6))
            born = np.where(known[:, None], born, detected)
        whole = np.isfinite(std[:, 0]) & np.isfinite(std[:, 2])  # or it tells of no line
        with np.errstate(divide="ignore"):
            log_born = np.log(whole * birth_rate * value[:, 0] * born.mean(1))
        return cls(
            heard.position, heard.height, value, std**2, heard.amplitude,
            clutter + np.log(radio.false_alarms), log_born, radio, detection_table(radio), over,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.value)

    def score(self, poses: Array, widen: float) -> Array:
        """Log-likelihood of the anchor's scan at poses (N, 3), in ratio to clutter, (N,).

        Parameters
        ----------
        widen : float
            By which deviations are multiplied.
        """
        away = poses[:, :2] - self.position
        distance = slant(np.hypot(away[:, 0], away[:, 1]), self.height)
        strength = self.radio.amplitude(distance)
        log = -IN_SIGHT * self.table(strength)
        if not len(self):
            return np.asarray(log)
        variance, heading = widen**2 * self.variance, poses[:, 2, None]
        measured = np.isfinite(variance)
        weight = np.where(measured, 1 / variance, 0.0)
        norm = np.where(measured, -0.5 * np.log(2 * np.pi * np.where(measured, variance, 1.0)), 0.0)
        leaving = np.arctan2(away[:, 1], away[:, 0])[:, None]
        world = heading + self.value[:, 2]
        straight = weight[:, 0] * (self.value[:, 0] - distance[:, None]) ** 2
        straight += weight[:, 1] * _wrapped(self.value[:, 1] - leaving) ** 2
        straight += weight[:, 2] * _wrapped(world - leaving - np.pi) ** 2
        straight = norm.sum(1) - 0.5 * straight + np.log(IN_SIGHT) + self._heard_at(strength)
        level = level_of(self.value[:, :1], self.height)
        image = away[:, None] + level * np.stack([np.cos(world), np.sin(world)], -1)
        gap = np.hypot(image[..., 0], image[..., 1])
        spread = widen**2 * (self.variance[:, 1] + self.variance[:, 2])
        known = np.isfinite(spread)
        bounced = 2 * np.arctan2(image[..., 1], image[..., 0]) - world
        spread = np.where(known, spread, 1.0)
        fits = np.exp(-0.5 * _wrapped(self.value[:, 1] - bounced) ** 2 / spread) / np.sqrt(2 * np.pi * spread)
        other = TWICE / (2 * np.pi)  # a double bounce leaves in any direction
        fits = np.where(known, (1 - TWICE) * fits + other, 1.0)
        born = self.log_born + np.log(fits / np.maximum(gap, NEAREST_M))
        shorter = distance[:, None] < self.value[:, 0]  # or the point of reflection isn't between
        ratio = np.exp(np.minimum(straight - self.log_clutter, MOST))
        ratio += shorter * np.exp(np.minimum(born - self.log_clutter, MOST))
        if self.known is not None:
            for source in np.flatnonzero((self.known.image != self.position).any(1)).tolist():
                missed, more = self._over(source, poses, variance)
                log -= missed
                ratio += more
        return np.asarray(log + np.log1p(ratio).sum(1))

    def _over(self, source: int, poses: Array, variance: Array) -> tuple[Array, Array]:
        """Chance of being detected (N,) over a known surface, and ratios to clutter (N, M)."""
        assert self.known is not None
        image, (angle, offset) = self.known.image[source], self.known.line[source]
        normal = unit(angle)
        toward = image - poses[:, :2]
        distance = slant(np.hypot(toward[:, 0], toward[:, 1]), self.height)
        side = (poses[:, :2] @ normal - offset) * float(normal @ self.position - offset)
        there = self.known.chance[source] * (side > 0)
        strength = self.radio.amplitude(distance, self.known.level[source])
        back = np.arctan2(toward[:, 1], toward[:, 0])
        predicted = distance, 2 * angle - back, back - poses[:, 2]
        measured = np.isfinite(variance)
        noise = np.where(measured, variance, 1.0) + MAP_VARIANCE
        log = self._heard_at(strength) - self.log_clutter
        log = log - 0.5 * np.where(measured, np.log(2 * np.pi * noise), 0.0).sum(1)
        for axis, value in enumerate(predicted):
            gap = self.value[:, axis] - value[:, None]
            gap = gap if axis == 0 else _wrapped(gap)
            log -= 0.5 * np.where(measured[:, axis], gap**2 / noise[:, axis], 0.0)
        return there * self.table(strength), there[:, None] * np.exp(np.minimum(log, MOST))

    def _heard_at(self, strength: Array) -> Array:
        """Log of p_d times the density of every measured amplitude, at expected ones (N,): (N, M)."""
        known = np.isfinite(self.amplitude)
        measured = np.where(known, self.amplitude, self.radio.threshold)
        rice = self.radio.log_rician(measured, np.maximum(strength[:, None], 1e-6))
        if known.all():
            return np.asarray(rice)
        missed = np.log(np.maximum(self.table(strength), 1e-12))[:, None]
        return np.where(known, rice, missed)


def _wrapped(angle: Array) -> Array:
    """The angle in (-pi, pi], quickly."""
    return np.asarray(angle - 2 * np.pi * np.rint(angle / (2 * np.pi)))


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One scan, of all anchors, to score poses by.

    Attributes
    ----------
    terms : tuple of SnapshotTerms
        Of every anchor that listened.
    """

    terms: tuple[SnapshotTerms, ...]

    @classmethod
    def of(
        cls, scans: Sequence[AnchorScan], radios: Sequence[RadioModel], model: FilterModel,
        known: Sequence[Sources] | None = None,
    ) -> Self:  # fmt: skip
        """The anchors' scans, with each one's calibrated radio, and the paths over a map's surfaces."""
        maps: Sequence[Sources | None] = known or [None] * len(scans)
        rows = zip(scans, radios, maps, strict=True)
        return cls(tuple(SnapshotTerms.of(heard, radio, model.birth_rate, own) for heard, radio, own in rows))

    def score(self, poses: Array, widen: float = 1.0) -> Array:
        """Log-likelihood of the scan at poses (N, 3) in m, m, rad; in ratio to clutter alone, (N,)."""
        block = max(PAIRS // max(1, *(len(own) for own in self.terms)), 1)
        return np.concatenate(
            [
                sum((own.score(poses[at : at + block], widen) for own in self.terms), np.zeros(1))
                for at in range(0, len(poses), block)
            ]
        )
