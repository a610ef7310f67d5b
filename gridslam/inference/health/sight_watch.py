"""Whether the line of sight of an anchor is heard where it should be, at a place that is well known.

What crossing lines of sight tell (`range_watch`) is that one of two is wrong. A filter that has followed its
agent to centimetres knows which: it knows where each should be. One that arrives from its anchor and left it
towards the agent, but is longer by the same at each step, is that anchor's clock; one of the right length
from the right direction, that seems to have left it elsewhere, is its orientation. docs/model.md, (M510) and
(M511).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import LATER, Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.calibration import Calibration
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.health import reasons
from gridslam.inference.health.range_fits import (
    CERTAIN,
    CLEAR,
    FARTHEST_M,
    LEAST_OFFSET_M,
    MISFIT,
    MOST_SHIFT_M,
    Fit,
    Thing,
    shift_of,
    words,
)
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_of
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import slant, wrap

LATE, TURNED = 0, 1
"""What may be wrong with a line of sight: its length, or where it left its anchor."""
KNOWN_M, KNOWN_RAD = 0.15, 0.05
"""Deviations of position and heading beyond which nobody knows where a line of sight should be."""
NEAREST_M = 1.0
"""Level distance below which an anchor's direction tells nothing."""
FITS, SAME = 4.0, 5.0
"""Deviations within which a number is what it should be, and within which what is wrong is as before."""
DRAWN_M, DRAWN_RAD = 0.05, 0.01
"""Deviations of anchors' places and orientations as drawn."""
AS_LOUD = 0.8
"""Share of the amplitude that a path of a length has without a bounce, from which on it may have none."""
WIDEST_RAD = 0.15
"""Deviation beyond which an angle doesn't tell a line of sight from a path over a wall beside it."""
LOOKS, CHECKED, BEFORE = 6, 4, 4
"""Looks in a row at which the same is wrong; of those, looks at which another anchor's line of sight was what
it should be; and looks before at which the anchor's own was, where its clock is said to have jumped."""


@dataclass(frozen=True)
class SightWatch:
    """What lines of sight have said of their anchors so far.

    Attributes
    ----------
    right : (J,)
        Looks at which each anchor's was what it should be.
    looks, checked : (2, J)
        Looks in a row at which the same was wrong, its length or its departure, and those of them at which
        another anchor's line of sight was right.
    sums : (2, J, 4, 4)
        Over these, of the products of [what is wrong (m, rad), 1, direction from the anchor (2,)] over the
        variance of what is wrong.
    doubt : str
        Whose distances are wrong, in words; empty if none are.
    """

    right: Array
    looks: Array
    checked: Array
    sums: Array
    doubt: str = field(default="", metadata=LATER)

    @classmethod
    def start(cls, anchors: int) -> Self:
        """Before anything was heard."""
        pair = np.zeros((2, anchors))
        return cls(np.zeros(anchors), pair, pair, np.zeros((2, anchors, 4, 4)))

    def looked(
        self, scans: Sequence[AnchorScan], deviations: Array, belief: Belief, calibration: Calibration,
        model: FilterModel,
    ) -> Self:  # fmt: skip
        """Take in a scan.

        Parameters
        ----------
        deviations : (M, 3)
            Of all measurements, one anchor's after the other's; as of `own_deviations`.
        belief : Belief
            Of the likeliest hypothesis, the scan taken in.
        calibration : Calibration
            By which anchors are taken to be turned, and louder.
        """
        x, y, *_, heading = belief.covariance.diagonal()[: HEADING + 1].tolist()
        if x + y > KNOWN_M**2 or heading > KNOWN_RAD**2:
            return self
        sight, turned = Sight.of(scans, deviations, belief, calibration.turned, model), calibration.turned
        off, score = sight.off, np.abs(sight.off) / sight.std
        loudness = calibration.gain * model.radio.amplitude(sight.length + np.maximum(off[:, 0], 0.0))
        right = np.bincount(whole_of(scans).label[(score < FITS).all(1)], minlength=model.senders) > 0
        after, begin = replace(self, right=self.right + right), 0
        for scan in scans:
            rows, j = slice(begin, begin + len(scan)), scan.anchor
            begin = rows.stop
            if right[j]:
                after = after._forgetting(j)
            elif len(scan) and (found := wrong(scan, score[rows], sight.std[rows], loudness[rows])):
                what, row = found[0], rows.start + found[1]
                size = turned[j] - off[row, TURNED] if what == TURNED else off[row, LATE]
                after = after._taken_in(what, j, size, sight.std[row, what], sight.away[row], right.any())
        return replace(after, doubt=after.conclusion(model) if after.looks.any() else "")

    def _forgetting(self, anchor: int) -> Self:
        """An anchor's line of sight was what it should be."""
        if not self.looks[:, anchor].any():
            return self
        looks, checked, sums = self.looks.copy(), self.checked.copy(), self.sums.copy()
        looks[:, anchor], checked[:, anchor], sums[:, anchor] = 0, 0, 0
        return replace(self, looks=looks, checked=checked, sums=sums)

    def _taken_in(self, what: int, anchor: int, off: float, std: float, away: Array, others: object) -> Self:
        """An anchor's line of sight was off; anew where it was off by something else before."""
        looks, checked, sums = self.looks.copy(), self.checked.copy(), self.sums.copy()
        own = sums[what, anchor]
        if looks[what, anchor] and abs(off - own[0, 1] / own[1, 1]) > SAME * std:
            if looks[what, anchor] >= LOOKS:  # one path of another kind doesn't make right what was wrong
                return self
            looks[what, anchor], checked[what, anchor], own[:] = 0, 0, 0
        looks[what, anchor] += 1
        checked[what, anchor] += others
        row = np.array([off, 1.0, *away]) / std
        own += np.outer(row, row)
        return replace(self, looks=looks, checked=checked, sums=sums)

    def beyond_doubt(self, what: int) -> NDArray[np.intp]:
        """The anchors of whose lines of sight the same was wrong for long enough."""
        sums, looks = self.sums[what], self.looks[what]
        weight = np.maximum(sums[:, 1, 1], 1e-12)
        square = sums[:, 0, 1] ** 2 / weight
        sure = (looks >= LOOKS) & (self.checked[what] >= CHECKED) & (0.5 * square > CERTAIN)
        return np.flatnonzero(sure & (sums[:, 0, 0] - square < MISFIT * looks))

    def conclusion(self, model: FilterModel) -> str:
        """Whose distances have been wrong of late, in words."""
        found = [j for j in self.beyond_doubt(LATE).tolist() if self.right[j] >= BEFORE]
        said = [said for j in found if (said := words(self._readings(j, model.senders), model))]
        return reasons.of_late("; of late ".join(said)) if said else ""

    def _readings(self, anchor: int, anchors: int) -> list[Fit]:
        """An offset of an anchor's distances, and beside it a place that explains them as well."""
        sums = self.sums[LATE, anchor]
        offset, gaps = float(sums[0, 1] / sums[1, 1]), float(sums[0, 0])
        if abs(offset) < LEAST_OFFSET_M:
            return []
        found = [Fit(Thing((anchor,)), gaps - offset * float(sums[0, 1]), (offset,))]
        # away from where it is believed to stand, lines of sight are shorter
        shift = -np.linalg.solve(sums[2:, 2:] + np.eye(2) / MOST_SHIFT_M**2, sums[2:, 0])
        left = gaps + float(shift @ sums[2:, 0])
        if np.hypot(*shift) < FARTHEST_M and 0.5 * (left - found[0].misfit) < CLEAR:
            found.append(Fit(Thing(shift_of(anchor, anchors)), left, tuple(shift.tolist())))
        return found

    def turns_told(self, calibration: Calibration) -> tuple[Self, Calibration]:
        """The calibration with turns that are beyond doubt, which the watch then needn't keep."""
        watch = self
        if not self.looks[TURNED].any():
            return self, calibration
        for j in self.beyond_doubt(TURNED).tolist():
            (_, turn), (_, weight) = self.sums[TURNED, j, :2, :2].tolist()
            calibration = calibration.with_turn(j, turn / weight, weight)
            watch = watch._forgetting(j)
        return watch, calibration


def wrong(scan: AnchorScan, score: Array, std: Array, loudness: Array) -> tuple[int, int] | None:
    """What is wrong with the line of sight of an anchor that isn't where it should be, and its row.

    It is the loudest of all paths, and as loud as one without a bounce. No wall makes one that leaves its
    anchor towards the agent and arrives from there, or that is as short.

    Parameters
    ----------
    score : (M, 3)
        By how many deviations distance, AoD and AoA are off.
    std : (M, 3)
        The deviations.
    loudness : (M,)
        Amplitude of paths of such lengths without a bounce.
    """
    row = int(scan.amplitude.argmax())
    sure = scan.loud[row] and scan.whole[row] and scan.amplitude[row] > AS_LOUD * loudness[row]
    if not sure or (std[row, 1:] > WIDEST_RAD).any():
        return None
    for what in (LATE, TURNED):
        if score[row, what] > FITS and (np.delete(score[row], what) < FITS).all():
            return what, row
    return None


class Sight(NamedTuple):
    """Measurements against the lines of sight of their anchors, as they should be.

    Attributes
    ----------
    off : (M, 3)
        By how much distance (m), AoD and AoA (rad) differ from them.
    std : (M, 3)
        Deviations of that.
    away : (M, 2)
        Level directions from anchors to the agent, m per m of slant.
    length : (M,) m
        Of the lines of sight.
    """

    off: Array
    std: Array
    away: Array
    length: Array

    @classmethod
    def of(
        cls, scans: Sequence[AnchorScan], deviations: Array, belief: Belief, turned: Array,
        model: FilterModel,
    ) -> Self:  # fmt: skip
        """Those of a scan; arguments as of `SightWatch.looked`, `turned` (J,), rad, as of its calibration."""
        whole, mean = whole_of(scans), belief.mean
        place = model.places[whole.label]
        step = mean[:2] - place[:, :2]
        level = np.hypot(step[:, 0], step[:, 1])
        direction = np.arctan2(step[:, 1], step[:, 0])
        length = slant(level, place[:, 3])
        departs, arrives = direction - place[:, 2] - turned[whole.label], direction + np.pi - mean[HEADING]
        off = whole.value - np.column_stack([length, departs, arrives])
        off[:, 1:] = wrap(off[:, 1:])
        x, y, *_, heading = belief.covariance.diagonal()[: HEADING + 1].tolist()
        known = np.empty((len(off), 3))
        known[:, 0] = DRAWN_M**2 + x + y
        known[:, 1] = DRAWN_RAD**2 + known[:, 0] / np.maximum(level, 1e-3) ** 2
        known[:, 2] = known[:, 1] + heading
        std = np.sqrt(deviations**2 + known)
        told = np.isfinite(std) & (level >= NEAREST_M)[:, None]
        return cls(np.where(told, off, np.inf), np.where(told, std, 1.0), step / length[:, None], length)
