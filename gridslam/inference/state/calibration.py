"""What a filter learns of its radio and of itself: clutter level, SNR, and whether what is heard fits.

Sums with forgetting over some ten steps stand for a window. Nothing here needs the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.estimates import Health
from gridslam.kernels import SUMS
from gridslam.world.radio import SignalModel

Array = NDArray[np.float64]
KEEP, KEEP_GAIN, SLOW = 0.9, 0.99, 0.03
"""Shares of what was learned that are kept per step; share of news that enters what is usual."""
TRUST = 1.0
"""Steps of listening that the scene's own clutter level is worth."""
LEAST_CLUTTER, MOST_CLUTTER = 0.2, 20.0
"""Bounds of the clutter level, as shares of the scene's."""
SURPRISE, DOUBTED = 4.0, 3.0
"""Standard deviations by which clutter breaks with its past, and with what was told."""
GAIN_STD, LEAST_GAIN, MOST_GAIN = 0.3, 0.5, 2.0
"""Prior of the ratio of true to told amplitude, and its bounds."""
TURN_STD, KEEP_TURN, BEYOND_DOUBT = 0.02, 0.995, 3.5
"""Prior of an anchor's orientation (rad), share kept per step, deviations from which on it is believed."""
SILENT, LOST, MISFIT, LOUD_CLUTTER, FEW, VAGUE_M = 5, 0.5, 1.7, 3.0, 3.0, 1.0
"""When something is amiss: steps of silence; share of the usual explained; ratio of innovations to what is
expected; of clutter; effective particles; position's standard deviation."""
AFRESH, ENOUGH = 5, 4
"""Steps for which a new start is told of; loud measurements that are needed to call it for."""


FADING = ("misfit", "freedom", "pull", "weight", "explained", "loud")
FADE = np.array([KEEP, KEEP, KEEP_GAIN, KEEP_GAIN, KEEP, KEEP])
PRIOR = np.array([0.0, 0.0, GAIN_STD**-2, GAIN_STD**-2, 0.0, 0.0])
"""What is summed up with forgetting, the share that is kept per step, and where each sum returns to."""
NOTHING = np.append(np.zeros(SUMS - 1), np.inf)
"""Sums of an anchor before its measurements were taken in."""


@dataclass
class Watch:
    """State of what is watched, as arrays, so that it can be kept in a checkpoint.

    Attributes
    ----------
    clutter, listened : (J,)
        Clutter heard, and steps listened to, with forgetting.
    misfit, freedom : (1,)
        Normalised innovations squared of sure associations, and their degrees of freedom: numbers measured
        with finite deviations.
    explained, loud : (1,)
        Measurements too loud for clutter that known paths explain, and all such.
    usual, near : (1,)
        Share of them that is explained, and that lies where a line of sight or a single bounce is predicted,
        in the long run.
    pull, weight : (1,)
        Sums from which the ratio of true to told amplitude follows.
    turn, turn_weight : (J,)
        Sums from which the anchors' true orientations follow, relative to the told ones.
    silent, since : (1,)
        Steps of silence so far; steps since the agent was found again.

    Within a step `taken` (J,) is by how much the anchors are taken to be turned, and `fits` (J, 9) how the
    measurements of each fitted, which its updates add to; see `gridslam.kernels.SUMS`.
    """

    clutter: Array
    listened: Array
    misfit: Array
    freedom: Array
    explained: Array
    loud: Array
    usual: Array
    near: Array
    pull: Array
    weight: Array
    turn: Array
    turn_weight: Array
    silent: Array
    since: Array

    def __post_init__(self) -> None:
        """Keep in one array what is summed up in the order of `fits`."""
        self._sums = np.concatenate([getattr(self, name) for name in FADING])
        self._tie()
        self.taken, self._effective = self.turned, np.inf
        self.fits = np.tile(NOTHING, (len(self.clutter), 1))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on as a copy, whose arrays were copied one by one."""
        self.__dict__.update(state)
        self._tie()

    def _tie(self) -> None:
        for number, name in enumerate(FADING):
            setattr(self, name, self._sums[number : number + 1])

    @classmethod
    def start(cls, anchors: int) -> Watch:
        """Nothing heard yet."""
        own = ("clutter", "listened", "turn", "turn_weight")
        state = {f.name: np.zeros(anchors if f.name in own else 1) for f in fields(cls)}
        state["turn_weight"] += TURN_STD**-2
        state["pull"] += GAIN_STD**-2
        state["weight"] += GAIN_STD**-2
        state["since"] += 1e6
        return cls(**state)

    def begin(self, scan_size: int) -> None:
        """A new step, at which `scan_size` measurements were heard."""
        self._sums[:] = PRIOR + FADE * (self._sums - PRIOR)
        prior = TURN_STD**-2
        self.turn *= KEEP_TURN
        self.turn_weight[:] = prior + KEEP_TURN * (self.turn_weight - prior)
        self.silent[:] = 0 if scan_size else self.silent + 1
        self.since += 1
        self._effective = np.inf
        self.taken[:] = self.turned
        self.fits[:] = NOTHING

    @property
    def gain(self) -> float:
        """Ratio of true to told amplitude; 1 unless it differs beyond doubt."""
        pull, weight = float(self.pull[0]), float(self.weight[0])
        ratio, doubt = pull / weight, 1 / math.sqrt(weight)
        sure = abs(ratio - 1) > BEYOND_DOUBT * doubt
        return min(max(ratio, LEAST_GAIN), MOST_GAIN) if sure else 1.0

    @property
    def turned(self) -> Array:
        """How far each anchor is turned from what was told, (J,) rad; 0 unless that is beyond doubt."""
        told = zip(self.turn.tolist(), self.turn_weight.tolist(), strict=True)
        return np.array([t / w if abs(t) > BEYOND_DOUBT * math.sqrt(w) else 0.0 for t, w in told])

    def estimate(self, anchor: int, told: float) -> float:
        """Mean clutter per step of an anchor: a Gamma-Poisson estimate about the level that was told."""
        mean = (TRUST * told + float(self.clutter[anchor])) / (TRUST + float(self.listened[anchor]))
        return min(max(mean, LEAST_CLUTTER * told), MOST_CLUTTER * told)

    def level(self, anchor: int, told: float) -> float:
        """The estimate if it differs from what was told beyond doubt, else what was told."""
        mean = self.estimate(anchor, told)
        doubt = math.sqrt(told / (TRUST + float(self.listened[anchor])))
        return mean if abs(mean - told) > DOUBTED * doubt else told

    def tuned(self, told: SignalModel, anchor: int) -> SignalModel:
        """The radio's numbers as they seem to be."""
        gain, level = self.gain, self.level(anchor, told.false_alarms)
        if gain == 1 and level == told.false_alarms:
            return told
        return replace(told, amplitude_at_1m=told.amplitude_at_1m * gain, false_alarms=level)

    def listen(self, anchor: int, count: float, told: SignalModel) -> float:
        """Take in how much clutter an anchor's scan held, before its association; return the level."""
        usual = self.estimate(anchor, told.false_alarms)
        # a level that jumps is learned afresh, or a burst would be over before it is believed
        keep = KEEP if abs(count - usual) < SURPRISE * math.sqrt(usual + 1) else 0.3 * KEEP
        self.clutter[anchor] = keep * self.clutter[anchor] + count
        self.listened[anchor] = keep * self.listened[anchor] + 1
        return self.level(anchor, told.false_alarms)

    def judge(self) -> None:
        """Take in how the measurements of all anchors fitted."""
        self._sums += self.fits[:, :6].sum(0)
        self.turn += self.fits[:, 6]
        self.turn_weight += self.fits[:, 7]
        self._effective = float(self.fits[:, 8].min())

    def lost(self, count: int, near: int) -> bool:
        """Whether, of `count` loud measurements, far fewer than usual lie where a path is predicted."""
        if count < ENOUGH:
            return False
        lost = bool(near < LOST * self.near[0] * count)
        if not lost:
            self.near += SLOW * (near / count - self.near)
        return lost

    def found(self, was_lost: bool) -> None:
        """The agent was found by other means than following it."""
        if was_lost:
            self.since[:] = 0

    def health(self, told: SignalModel, spread_m: float, particles: int, names: Sequence[str] = ()) -> Health:
        """Say how things are.

        Parameters
        ----------
        spread_m : float
            Standard deviation of the position.
        particles : int
            How many there are.
        names : sequence of str
            Of the anchors; numbers from 1 on where they are missing.
        """
        misfit, freedom, _, _, explained, loud = self._sums.tolist()
        silent, since, usual = int(self.silent[0]), int(self.since[0]), float(self.usual[0])
        share = (explained + 1) / (loud + 1)
        ratio = misfit / freedom if freedom > 0 else 1.0
        low, high = innovation_band(freedom)
        effective = float(min(self._effective, particles))
        heard = [self.estimate(j, told.false_alarms) for j in range(len(self.clutter))]
        reasons = []
        if silent >= SILENT:
            reasons.append(f"nothing heard for {silent} steps")
        if spread_m > VAGUE_M:
            reasons.append(f"position known to {spread_m:.1f} m alone")
        if since < AFRESH:
            reasons.append(f"agent found again {since} steps ago")
        if usual > 0 and share < LOST * usual:
            reasons.append(f"{share:.0%} of the loud measurements explained, usually {usual:.0%}")
        if ratio > max(high, MISFIT):
            reasons.append(f"innovations {ratio:.1f} times as large as they should be")
        clutter = max(heard) / told.false_alarms
        if clutter > LOUD_CLUTTER:
            reasons.append(f"clutter {clutter:.1f} times what the scene says")
        if self.taken.any():
            worst = int(np.abs(self.taken).argmax())
            turn = np.degrees(self.taken[worst])
            name = names[worst] if names else f"number {worst + 1}"
            reasons.append(f"anchor {name} seems turned by {turn:.1f} degrees")
        if effective < FEW:
            reasons.append(f"{effective:.0f} particles carry the weight")
        if not silent:
            self.usual[0] = usual + (SLOW if usual > 0 else 1.0) * (share - usual)
        return Health(
            not reasons, "; ".join(reasons), effective, ratio, (low, high), share, np.array(heard),
            self.gain, self.turned, silent,
        )  # fmt: skip


def innovation_band(freedom: float) -> tuple[float, float]:
    """Band of the mean normalised innovation squared with 0.998 probability (Wilson and Hilferty)."""
    part = 2 / (9 * max(freedom, 1.0))
    reach = 3.09 * math.sqrt(part)
    return max(1 - part - reach, 0.0) ** 3, (1 - part + reach) ** 3
