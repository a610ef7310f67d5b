"""Whether paths are there, line of sight and features, or hidden; docs/model.md, (M126), (M376).

A path that is hidden has no place in the covariance: what noise sounds like where it should be would be taken
for a faint echo, and lead the agent astray.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.features.path_products import Products, whiten
from gridslam.inference.state.features.hybrid_state import JointBelief

STAYS, APPEARS = 0.95, 0.01
"""Probability that a path is there after a step, if it was and if it wasn't."""
LEAST = 1e-300
"""Stands for a probability of 0."""


def log_likelihood(known: Products, power: Array, noise: float) -> float:
    """Log density of samples whose covariance is noise and responses of given powers (C,)."""
    return whiten(known.of(slice(0, len(power))), power, noise).log_density


def existence_of(belief: JointBelief, anchor: int, known: Products) -> float:
    """Probability of the line of sight, after the samples."""
    before = after_a_step(belief.existence[anchor])
    rows = belief.features.anchor == anchor
    power = np.where(predicted(belief) > 0.5, belief.features.power, 0.0)[rows]
    noise = belief.noise[anchor]
    there = log_likelihood(known, np.append(belief.los_power[anchor], power), noise)
    absent = log_likelihood(known.of(slice(1, 1 + len(power))), power, noise)
    return float(1 / (1 + (1 - before) / before * np.exp(np.clip(absent - there, -500, 500))))


def powers_of(belief: JointBelief, existence: Array, anchor: int, known: Products) -> Array:
    """Power of every path of an anchor; of one that isn't there, 0."""
    bank = belief.features
    rows = bank.anchor == anchor
    los = belief.los_power[anchor] if existence[anchor] > 0.5 else 0.0
    power, before = bank.power[rows], predicted(belief)[rows]
    there = np.append(los, np.where(before > 0.5, power, 0.0))
    after, _ = presence_of(before, known.of(slice(0, len(there))), there, power, belief.noise[anchor])
    return np.append(los, np.where(after > 0.5, power, 0.0))


def predicted(belief: JointBelief) -> Array:
    """Probability that features' paths are there (F,), before the samples."""
    return after_a_step(belief.features.presence)


def after_a_step(probability: Array) -> Array:
    """Probabilities that paths are there one step later."""
    return STAYS * probability + APPEARS * (1 - probability)


def presence_of(
    before: Array, known: Products, used: Array, power: Array, noise: float
) -> tuple[Array, float]:
    """Probability that each feature's path is there (C - 1,), after the samples; log of what they tell of it.

    Parameters
    ----------
    before : (C - 1,)
        Before them.
    used : (C,)
        Powers that the samples are reckoned with, of the line of sight first; 0: not there.
    power : (C - 1,)
        That the features have where they are there.
    """
    white = whiten(known, used, noise)
    share = power * white.own[1:]
    lift = power * np.abs(white.matched[1:]) ** 2
    there = used[1:] > 0
    rest = np.where(there, np.maximum(1 - share, 1e-12), 1 + share)
    gain = lift / rest - np.where(there, -1, 1) * np.log(rest)  # of there against hidden
    present, hidden = np.log(np.maximum(before, LEAST)) + gain, np.log(np.maximum(1 - before, LEAST))
    total = np.logaddexp(present, hidden)
    return np.exp(present - total), float((total - np.where(there, gain, 0.0)).sum())
