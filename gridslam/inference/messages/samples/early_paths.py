"""What arrives first; before the line of sight nothing can: the agent isn't where it is believed to be then.

A mirrored world fits itself, and its likelihood is as good as the right one's. But an anchor that comes in
sight again is heard there from too far off, or too near, which the samples tell. docs/model.md, (M451).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.messages.features.arrivals import DEVIATIONS, Arrivals
from gridslam.inference.messages.features.feature_likelihood import Front
from gridslam.inference.state.samples.images import DirectState
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan
from gridslam.world.waveform import Waveform

EVERY = 3
"""Steps from one look to the next: a world stays mirrored for long."""
LOOKS = 6
"""That are kept."""
LEAST_M = 0.1
"""Shorter lines of sight have no direction."""


def watch_arrivals(state: DirectState, scan: SignalScan, model: SignalModel) -> DirectState:
    """The state with what arrived first at this step, and whether it came before a line of sight.

    Parameters
    ----------
    state : DirectState
        After the samples.
    """
    if state.step % EVERY or not scan.heard.any():
        return state
    first = np.zeros(1 + len(model.anchors))
    first[0] = scan.time_s
    early, place, spread = False, state.belief.mean[:2], state.belief.covariance[:2, :2]
    for anchor in np.flatnonzero(scan.heard).tolist():
        way = place - model.anchors[anchor, :2]
        far = max(float(np.hypot(*way)), LEAST_M)
        nearest = far - DEVIATIONS * float(np.sqrt(way @ spread @ way)) / far
        arrivals = Arrivals.of(scan.samples[anchor, 0, 0][None], _front_of(model.waveform))
        first[1 + anchor] = arrivals.first_m()
        early |= arrivals.before(nearest)
    latest = np.vstack([*state.firsts[max(len(state.firsts) + 1 - LOOKS, 0) :], first])
    return replace(state, watch=state.watch.arrived(early), firsts=latest)


@lru_cache(8)
def _front_of(waveform: Waveform) -> Front:
    """The tables by which arrivals are found."""
    return Front(waveform)
