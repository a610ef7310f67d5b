"""Calibration of the radio: clutter and orientation of every anchor, and the gain of amplitudes.

Sums with forgetting over some ten steps stand for a window. Nothing here needs the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.kernels import GAIN, GAIN_PRECISION, TURNED, TURNED_PRECISION
from gridslam.world.filter_model import fixed
from gridslam.world.radio import RadioModel

KEEP, KEEP_GAIN = 0.9, 0.99
"""Factors by which sums are multiplied per step: forgetting."""
TRUST = 1.0
"""Steps of listening that the scene's own clutter level is worth."""
LEAST_CLUTTER, MOST_CLUTTER = 0.2, 20.0
"""Bounds of the clutter level, as shares of the scene's."""
ANY_CLUTTER = 5.0
"""Measurements a step that may be clutter whatever the scene says: of tables that seem to have none."""
SURPRISE, DOUBTED = 4.0, 3.0
"""Standard deviations by which clutter breaks with its past, and with the scene's level."""
BROKEN = 0.3
"""Share of `KEEP` that a past is worth with which clutter breaks."""
GAIN_STD, LEAST_GAIN, MOST_GAIN = 0.3, 0.2, 5.0
"""Prior of the ratio of true to stated amplitude, and its bounds."""
TURN_STD, KEEP_TURN, BEYOND_DOUBT = 0.02, 0.995, 4.5
"""Prior of an anchor's orientation (rad), forgetting per step, deviations from which on it is believed."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is believed of the radio beside what the scene states.

    Attributes
    ----------
    clutter, listened : (J,)
        Sums of clutter and of steps, with forgetting.
    turn, turn_weight : (J,)
        Sums from which the anchors' true orientations follow, relative to the stated ones.
    pull, weight : float
        Sums from which the ratio of true to stated amplitude follows.
    """

    clutter: Array
    listened: Array
    turn: Array
    turn_weight: Array
    pull: float
    weight: float

    @classmethod
    def start(cls, anchors: int) -> Self:
        """Before the first scan."""
        none, known = np.zeros(anchors), GAIN_STD**-2
        return cls(none, none, none, np.full(anchors, TURN_STD**-2), known, known)

    def faded(self) -> Self:
        """The calibration a step later, by forgetting."""
        gain, turn = GAIN_STD**-2, TURN_STD**-2
        return replace(
            self,
            turn=KEEP_TURN * self.turn,
            turn_weight=turn + KEEP_TURN * (self.turn_weight - turn),
            pull=gain + KEEP_GAIN * (self.pull - gain),
            weight=gain + KEEP_GAIN * (self.weight - gain),
        )

    def unturned(self, anchors: NDArray[np.bool_]) -> Self:
        """With what departures have said of the orientations of some anchors (J,) forgotten."""
        if not anchors.any():
            return self
        turn, weight = np.where(anchors, 0.0, self.turn), np.where(anchors, TURN_STD**-2, self.turn_weight)
        return replace(self, turn=turn, turn_weight=weight)

    @property
    def gain(self) -> float:
        """Ratio of true to stated amplitude; 1 unless it differs beyond doubt."""
        ratio, doubt = self.loudness
        return ratio if abs(self.pull / self.weight - 1) > BEYOND_DOUBT * doubt else 1.0

    @property
    def loudness(self) -> tuple[float, float]:
        """Ratio of true to stated amplitude, beyond doubt or not, and its deviation."""
        ratio = self.pull / self.weight
        return min(max(ratio, LEAST_GAIN), MOST_GAIN), 1 / math.sqrt(self.weight)

    @cached_property
    def turned(self) -> Array:
        """How far each anchor is turned from its stated orientation, (J,) rad; 0 unless beyond doubt."""
        sums = zip(self.turn.tolist(), self.turn_weight.tolist(), strict=True)
        angles = [t / w if abs(t) > BEYOND_DOUBT * math.sqrt(w) else 0.0 for t, w in sums]
        return np.array(angles) if any(angles) else _unturned(len(angles))

    @property
    def turns_told(self) -> bool:
        """Whether departures of lines of sight have told how anchors are turned, however little."""
        return bool(self.turn_weight.max() > TURN_STD**-2)

    def estimate(self, anchor: int, stated: float) -> float:
        """Mean clutter per step of an anchor: a Gamma-Poisson estimate about the scene's level."""
        mean = (TRUST * stated + float(self.clutter[anchor])) / (TRUST + float(self.listened[anchor]))
        return min(max(mean, LEAST_CLUTTER * stated), max(MOST_CLUTTER * stated, ANY_CLUTTER))

    def clutter_level(self, anchor: int, stated: float) -> float:
        """The estimate if it differs from the scene's level beyond doubt, else that level."""
        mean = self.estimate(anchor, stated)
        doubt = math.sqrt(stated / (TRUST + float(self.listened[anchor])))
        return mean if abs(mean - stated) > DOUBTED * doubt else stated

    def tuned(self, stated: RadioModel, anchor: int) -> RadioModel:
        """The radio with the calibration applied."""
        gain, level = self.gain, self.clutter_level(anchor, stated.false_alarms)
        if gain == 1 and level == stated.false_alarms:
            return stated
        return replace(stated, amplitude_at_1m=stated.amplitude_at_1m * gain, false_alarms=level)

    def with_clutter(self, anchor: int, count: float, stated: RadioModel, weight: float = 1.0) -> Self:
        """Take in how much clutter an anchor's scan held, before its association.

        Parameters
        ----------
        weight : float
            Steps of listening that the scan is worth.
        """
        usual = self.estimate(anchor, stated.false_alarms)
        # a level that jumps is learned afresh, or a burst would be over before it is believed
        keep = KEEP if abs(count - usual) < SURPRISE * math.sqrt(usual + 1) else BROKEN * KEEP
        clutter, listened = self.clutter.copy(), self.listened.copy()
        clutter[anchor] = keep * clutter[anchor] + weight * count
        listened[anchor] = keep * listened[anchor] + weight
        return replace(self, clutter=clutter, listened=listened)

    def amplified(self, gain: float, std: float) -> Self:
        """With a ratio of true to stated amplitude and its deviation, whatever was believed of it: (M564)."""
        return replace(self, pull=gain / std**2, weight=1 / std**2)

    def with_turn(self, anchor: int, turned: float, weight: float) -> Self:
        """An anchor is turned by so much (rad, with 1 / rad^2), whatever was believed of it: (M511)."""
        turn, turn_weight = self.turn.copy(), self.turn_weight.copy()
        turn_weight[anchor] = TURN_STD**-2 + weight
        turn[anchor] = turned * turn_weight[anchor]
        return replace(self, turn=turn, turn_weight=turn_weight)

    def fitted(self, fits: Array) -> Self:
        """Take in how the measurements of all anchors fitted, (J, 9); see `gridslam.kernels.SUMS`."""
        pull, weight = fits[:, GAIN : GAIN_PRECISION + 1].sum(0).tolist()
        return replace(
            self,
            turn=self.turn + fits[:, TURNED],
            turn_weight=self.turn_weight + fits[:, TURNED_PRECISION],
            pull=self.pull + pull,
            weight=self.weight + weight,
        )


@lru_cache(16)
def _unturned(anchors: int) -> Array:
    """No turns of so many anchors, (J,): one array, which kernels needn't be handed anew at every step."""
    return fixed(np.zeros(anchors))
