"""What one scan says of poses: lines of sight, new bounces, clutter; and known surfaces, if there is a map;
owner of the kernel that scores poses by it.

A single bounce with distance and both angles has three numbers for the two unknowns of its line: the third
tells of the pose. Three such paths fix a pose, four tell it from chance; a line of sight fixes it alone.
Without arrivals a line of sight tells the place, and nothing the heading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.management.poses.pose_fix import Sources
from gridslam.inference.management.poses.scan_terms import MAP_VARIANCE
from gridslam.inference.messages.amplitudes import DetectionTable, detection_table
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.kernels.primitives import clues as column
from gridslam.kernels.primitives.blocks import Clues
from gridslam.kernels.primitives.tables import AOA
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import level_of, unit
from gridslam.world.radio import REFLECTION_BINS, RadioModel

IN_SIGHT = 0.9
"""Chance that an anchor is in sight."""
TWICE = 0.1
"""Chance that a new path has bounced more than once: its AoD says nothing of the pose then."""
NEAREST_M = 0.1
"""From an anchor to its image, at least: nearer, a line would stand in the anchor."""
MISFIT = 7.5
"""Deviations from which on an AoD fits no new bounce."""


@dataclass(frozen=True, eq=False)
class AnchorTerms:
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
    def of(
        cls, scan: AnchorScan, radio: RadioModel, birth_rate: float, over: Sources | None = None,
        deaf: bool = False,
    ) -> Self:  # fmt: skip
        """The terms of one anchor's scan.

        Parameters
        ----------
        birth_rate : float
            Births per anchor, step and unit of lines (rad m).
        over : Sources, optional
            Single bounces over known surfaces.
        deaf : bool
            Whether no anchor's measurements have an arrival: then a departure tells of a line, too.
        """
        rows = np.arange(len(scan))
        known = np.isfinite(scan.amplitude)
        strength = np.where(known, scan.amplitude, radio.threshold)
        value = scan.table[:, :3].copy()
        std = deviations(scan, rows, strength, value[:, 1:], radio)
        value[:, 1] += scan.orientation
        flat = np.log([radio.span_m, 2 * np.pi, 2 * np.pi])
        clutter = radio.log_clutter(scan.amplitude) + (flat * ~np.isfinite(std)).sum(1)
        level = radio.amplitude(value[:, :1], REFLECTION_BINS)
        born = np.exp(radio.log_rician(strength[:, None], level))
        if not known.all():
            detected = radio.detection_probability(np.maximum(level, 1e-6))
            born = np.where(known[:, None], born, detected)
        angle = np.isfinite(std[:, 1:] if deaf else std[:, 2:]).any(1)
        whole = np.isfinite(std[:, 0]) & angle  # or it tells of no line
        with np.errstate(divide="ignore"):
            log_born = np.log(whole * birth_rate * value[:, 0] * born.mean(1))
        return cls(
            scan.position, scan.height, value, std**2, scan.amplitude,
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
        return PoseLikelihood((self,)).score(poses, widen)

    def over(self) -> Array:
        """What the kernel takes of single bounces over known surfaces, (S, KNOWN)."""
        if self.known is None:
            return np.zeros((0, column.KNOWN))
        rows = np.flatnonzero((self.known.image != self.position).any(1))
        line, table = self.known.line[rows], np.zeros((len(rows), column.KNOWN))
        normal = unit(line[:, 0])
        table[:, column.IMAGE : column.NORMAL] = self.known.image[rows]
        table[:, column.NORMAL : column.OFFSET], table[:, column.OFFSET] = normal, line[:, 1]
        table[:, column.SIDE], table[:, column.TURN] = normal @ self.position - line[:, 1], 2 * line[:, 0]
        table[:, column.CHANCE], table[:, column.COEFFICIENT] = (
            self.known.chance[rows],
            self.known.level[rows],
        )
        return table


@dataclass(frozen=True, eq=False)
class PoseLikelihood:
    """One scan, of all anchors, to score poses by.

    Attributes
    ----------
    terms : tuple of AnchorTerms
        Of every anchor that listened.
    """

    terms: tuple[AnchorTerms, ...]

    @classmethod
    def of(
        cls, scans: Sequence[AnchorScan], radios: Sequence[RadioModel], model: FilterModel,
        known: Sequence[Sources] | None = None,
    ) -> Self:  # fmt: skip
        """The anchors' scans, with each one's calibrated radio, and the paths over a map's surfaces."""
        maps: Sequence[Sources | None] = known or [None] * len(scans)
        rows, rate = zip(scans, radios, maps, strict=True), model.birth_rate
        deaf = not any(bool(scan.measured[:, AOA].any()) for scan in scans)
        return cls(tuple(AnchorTerms.of(scan, radio, rate, own, deaf) for scan, radio, own in rows))

    @property
    def tells_heading(self) -> bool:
        """Whether any arrival was measured."""
        return any(bool(np.isfinite(own.variance[:, 2]).any()) for own in self.terms)

    def score(self, poses: Array, widen: float = 1.0) -> Array:
        """Log-likelihood of the scan at poses (N, 3) in m, m, rad; in ratio to clutter alone, (N,)."""
        score = np.zeros(len(poses))
        if not self.terms or not len(poses):
            return score
        runtime.start()
        from gridslam.kernels.management.pose_score import score_poses

        step, whole = self.terms[0].table.step, np.ascontiguousarray(poses, np.float64)
        score_poses(IN_SIGHT, NEAREST_M, step, whole, clues_of(self, widen), score)
        return score


def measurement_rows(terms: Sequence[AnchorTerms], widen: float) -> Array:
    """What the kernel takes of all measurements, (M, HEARD): columns as in `kernels.primitives.clues`."""
    value, variance, amplitude, log_clutter, log_born = (
        np.concatenate([getattr(own, name) for own in terms])
        for name in ("value", "variance", "amplitude", "log_clutter", "log_born")
    )
    height = np.repeat([own.height for own in terms], [len(own) for own in terms])
    rows, measured, loud = (
        np.zeros((len(value), column.MEASURED)),
        np.isfinite(variance),
        np.isfinite(amplitude),
    )
    variance = np.where(measured, widen**2 * variance, 1.0)
    rows[:, :3], rows[:, column.AMPLITUDE] = value, np.where(loud, amplitude, -1.0)
    for first, noise, share in (
        (column.STRAIGHT, variance, IN_SIGHT),
        (column.OVER, variance + MAP_VARIANCE, 1.0),
    ):
        norm = np.where(measured, -0.5 * np.log(2 * np.pi * noise), 0.0).sum(1)
        rows[:, first : first + 3] = measured / noise
        rows[:, first + 3] = norm + np.log(share) - log_clutter
    most = np.log(np.maximum(2 * rows[:, column.AMPLITUDE], 1.0))  # a density of so much at most
    rows[:, column.PEAK] = np.where(loud, most, 0.0)
    rows[:, column.BORN] = np.exp(log_born - log_clutter)
    level, arrives = level_of(value[:, 0], height)[:, None], measured[:, [2]]
    # the anchor's image, from the agent as it faces; or, without an arrival, the agent's image, reversed
    rows[:, column.TOWARD : column.TURNED] = level * np.where(arrives, unit(value[:, 2]), -unit(value[:, 1]))
    rows[:, column.TURNED : column.FIT] = unit(value[:, 1] + value[:, 2])
    both, spread = measured[:, 1:].all(1), variance[:, 1] + variance[:, 2]
    rows[:, column.FIT] = both * (1 - TWICE) / np.sqrt(2 * np.pi * spread)
    rows[:, column.SURE] = both / spread
    rows[:, column.ANY] = np.where(both, TWICE / (2 * np.pi), 1.0)  # a double bounce leaves anywhere
    widest = np.minimum(np.where(both, MISFIT * np.sqrt(spread), 0.0), np.pi)
    rows[:, column.NEAR] = np.where(widest < np.pi, np.cos(widest), -2.0)
    return rows


@lru_cache(4)
def clues_of(likelihood: PoseLikelihood, widen: float) -> Clues:
    """A scan as the kernel takes it, with deviations multiplied."""
    terms = likelihood.terms
    over = [own.over() for own in terms]
    ends = [np.cumsum([0, *map(len, parts)]) for parts in (terms, over)]
    whose = np.stack([end for last in ends for end in (last[:-1], last[1:])], 1).astype(np.int32)
    listeners = [(*own.position, own.height, own.radio.amplitude_at_1m, own.radio.samples) for own in terms]
    whole, known = measurement_rows(terms, widen), np.concatenate(over)
    return Clues(np.array(listeners), np.ascontiguousarray(whose), whole, known, terms[0].table.chance)
