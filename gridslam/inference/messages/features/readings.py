"""What a step's samples may be taken for, where a line of sight comes back; docs/model.md, (M377), (M523).

A line of sight that comes, or is found elsewhere than predicted, moves the agent and all that hangs together
with it. Whether one is there is told at the predicted place, and there what is left of other paths looks like
one as well. So the step is also read as if it weren't there, or from the predicted place: evidence decides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.arrivals import COST
from gridslam.inference.messages.features.presence import after_a_step
from gridslam.inference.messages.features.regaining import regained
from gridslam.inference.messages.features.strangers import beside_strangers
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]


def update_by_readings(
    belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float, model: SignalModel,
    step: int,
) -> tuple[JointBelief, float]:  # fmt: skip
    """The belief after the samples (J, N, M) of one step by its likeliest reading, and their log evidence."""

    def read(start: Array | None = None, hidden: NDArray[np.bool_] | None = None) -> Reading:
        return Reading(*beside_strangers(belief, samples, audible, heading_rad, model, step, start, hidden))

    readings = [read()]
    place = regained(belief, samples, audible, heading_rad, model)
    if place is not belief.mean:
        readings.append(read(place[:MOVING]))
    came = audible & (after_a_step(belief.existence) < 0.5) & (readings[0].after.existence > 0.5)
    if came.any():
        readings.append(read(hidden=came))
    best = max(readings, key=lambda one: one.score(belief, audible))
    return best.after, best.evidence


class Reading(NamedTuple):
    """What comes of a step by one reading: belief, log of the evidence, paths of this step alone."""

    after: JointBelief
    evidence: float
    strangers: int

    def score(self, before: JointBelief, audible: NDArray[np.bool_]) -> float:
        """Nats that speak for it, less what it costs."""
        return self.evidence + seen_before(before, self.after, audible) - COST * self.strangers


def seen_before(before: JointBelief, after: JointBelief, audible: NDArray[np.bool_]) -> float:
    """Log of how likely it is beforehand that lines of sight are there, or hidden, as they are."""
    there = after_a_step(before.existence[audible])
    return float(np.log(np.where(after.existence[audible] > 0.5, there, 1 - there)).sum())
