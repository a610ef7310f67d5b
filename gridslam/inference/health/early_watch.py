"""Paths that arrive before the line of sight to where the agent is believed to be, as none can.

Then it is elsewhere. That needs no map, and tells a filter that is lost and sure of itself, as `va` by
distances alone may be in a flat: metres off, about every other anchor is nearer in truth. docs/model.md,
(M525).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_of
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import slant

CLUTTER_NAT = 21.0
"""How unlikely clutter is as loud as a path that counts: its amplitudes are Rayleigh's with a squared scale
of a half above the threshold, so that e^-21 of them are beyond the root of 21 and the threshold's square."""
DEVIATIONS, LEAST_M = 4.0, 0.2
"""By how many deviations of distance and position together, and how much more, a path is too short."""
KEEP, EARLY = 0.9, 0.25
"""Share of what was so far that a step leaves, and share of the latest steps from which on health says so."""


def arrives_early(scans: Sequence[AnchorScan], deviations: Array, belief: Belief, model: FilterModel) -> bool:
    """Whether a loud path of a scan is too short for where the agent is believed to be.

    Where no amplitudes are measured clutter can't be told from paths: never.

    Parameters
    ----------
    deviations : (M, 3)
        Of all measurements, one anchor's after the other's; as of `own_deviations`.
    belief : Belief
        Of the one hypothesis, the scan taken in, as wide as its turn is open.
    """
    whole = whole_of(scans)
    loud = whole.amplitude > np.sqrt(CLUTTER_NAT + model.radio.threshold**2)
    if not loud.any():
        return False
    place, spread = model.places[whole.label], belief.covariance[0, 0] + belief.covariance[1, 1]
    sight = slant(np.hypot(*(place[:, :2] - belief.mean[:2]).T), place[:, 3])
    least = sight - LEAST_M - DEVIATIONS * np.sqrt(deviations[:, 0] ** 2 + spread)
    return bool((loud & (whole.value[:, 0] < least)).any())
