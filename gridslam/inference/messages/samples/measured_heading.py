"""The message of a heading that was measured beside the samples, as by an IMU; docs/model.md, (M519)."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.state.state import State
from gridslam.world.geometry import wrap
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

LEAST_RAD = 1e-3
"""Deviation that a heading is taken to have at least: of an exact one, too, so that the belief has a root."""
WORST = 30.0
"""Normalised innovation squared at which it is cut off for health."""


def measure_heading(
    state: State, scan: SignalScan, model: SignalModel, least_rad: float = LEAST_RAD
) -> State:
    """The state with the heading of a scan in its joint belief, and in its health; the same if it holds none.

    Parameters
    ----------
    least_rad : float
        Deviation that the heading is taken to have at least, rad.
    """
    if scan.heading_rad is None:
        return state
    belief = state.belief
    beside = belief.covariance[HEADING]  # of the heading with all else
    variance = float(beside[HEADING]) + max(model.waveform.heading_std_rad, least_rad) ** 2
    news = float(wrap(scan.heading_rad - belief.mean[HEADING]))
    mean = belief.mean + beside * (news / variance)
    mean[HEADING] = wrap(mean[HEADING])
    covariance = belief.covariance - np.outer(beside, beside) / variance
    monitor = state.monitor
    # one more number whose innovation is judged: a heading that the arrays contradict isn't believed unsaid.
    # So it comes after them: before, lines of sight that contradict it would be denied, and nobody the wiser
    monitor = replace(
        monitor, misfit=monitor.misfit + min(news**2 / variance, WORST), freedom=monitor.freedom + 1
    )
    return replace(state.believing(replace(belief, mean=mean, covariance=covariance)), monitor=monitor)
