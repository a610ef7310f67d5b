"""What kinds of learned features cost."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.state.features.features import places
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.signal_model import SignalModel

PRICES = np.array([[0.0, 10.0, 10.0], [10.0, 0.0, 10.0]])
"""Nats that each of these costs, where images are the rule and where scatterers are."""


def usual_prices(belief: JointBelief, model: SignalModel) -> Array:
    """What kinds of features cost, (1 or 2, 3): by the kind of most that are known, or either to be tried."""
    bank = belief.features
    if not len(bank):
        return PRICES
    place = places(belief.mean, bank.origin_m)
    far = np.hypot(*(place[:, :2] - model.anchors[bank.anchor, :2]).T)
    scattered = int((place[:, 2] > 0.5 * far).sum())
    return PRICES[[int(2 * scattered > len(bank))]]
