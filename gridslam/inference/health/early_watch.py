"""Paths that arrive before the line of sight to where the agent is believed to be, as none can.

Then it is elsewhere. That needs no map, and tells a filter that is lost and sure of itself, as `va` by
distances alone may be in a flat: metres off, about every other anchor is nearer in truth. docs/model.md,
(M525); of agents of a network, where clocks are unknown and nothing says whose a path is, (M532).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_of
from gridslam.inference.scans.deviations import deviations
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import slant
from gridslam.world.radio import RadioModel

CLUTTER_NAT = 21.0
"""How unlikely clutter is as loud as a path that counts: its amplitudes are Rayleigh's with a squared scale
of a half above the threshold, so that e^-21 of them are beyond the root of 21 and the threshold's square."""
DEVIATIONS, LEAST_M = 4.0, 0.2
"""By how many deviations of distance and position together, and how much more, a path is too short."""
LOUDER, OFF_MODEL = 4.0, 0.25
"""By how many deviations, each with so much of the amplitude for what no model knows, a path is louder than a
line of sight of its length if it can't be an anchor's."""
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


def no_anchors(scan: AnchorScan, belief: Belief, model: FilterModel, radio: RadioModel) -> bool:
    """Whether a loud measurement can be of no anchor that may have sent it; docs/model.md, (M532).

    Of each it is too short for where the agent is believed to be, as clocks are believed to go, or far louder
    than a line of sight of its length. An anchor whose clock isn't known may have sent anything.

    Parameters
    ----------
    scan : AnchorScan
        Of all anchors.
    belief : Belief
        An agent's view, with clocks, the scan taken in.
    radio : RadioModel
        As the agent hears it.
    """
    rows = np.flatnonzero(np.nan_to_num(scan.amplitude) > np.sqrt(CLUTTER_NAT + radio.threshold**2))
    if not len(rows):
        return False
    loud, place = scan.amplitude[rows, None], model.places[: model.senders]
    own = deviations(scan, rows, scan.amplitude[rows], scan.value[rows, 1:], radio)[:, 0]
    way = belief.mean[:2] - place[:, :2]
    level = np.hypot(*way.T)
    joint, late = belief.covariance, np.zeros(len(place))
    variance = np.full(len(place), joint[0, 0] + joint[1, 1])
    if belief.clocks:
        clocks = slice(AGENT, AGENT + belief.clocks)
        late = belief.mean[clocks]
        shared = (way / np.maximum(level, LEAST_M)[:, None] * joint[:2, clocks].T).sum(1)
        variance = variance + np.diagonal(joint)[clocks] + 2 * shared
    spread = np.sqrt(own[:, None] ** 2 + np.maximum(variance, 0.0))
    length = scan.value[rows, None, 0] - late
    short = length < slant(level, place[:, 3]) - LEAST_M - DEVIATIONS * spread
    straight = radio.amplitude(np.maximum(length - DEVIATIONS * spread, LEAST_M))
    noise = np.sqrt(radio.amplitude_std(straight) ** 2 + (OFF_MODEL * straight) ** 2)
    others = (scan.label[rows, None] >= 0) & (scan.label[rows, None] != np.arange(len(place)))
    none = short | (loud > straight + LOUDER * noise) | others
    return bool((none.all(1) & np.isfinite(own)).any())
