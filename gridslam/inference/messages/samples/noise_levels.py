"""How loud the noise of sampled signals is, by what their paths leave over; docs/model.md, (M86)."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array

GAIN, FIRST = 0.03, 2.0
"""Share of a step's noise that enters: in the long run, and at first 1 / (`FIRST` + step)."""
LEAST_RATIO, MOST_RATIO = 0.1, 10.0
"""Between which the noise of a step is, in that believed: a path that comes or goes is no noise."""
QUIET = 0.25
"""Share of the delay cells that surely hold no path at first."""


def median_noise(power: Array) -> float:
    """Power of the noise by the median of matched outputs' power, of which most hold no path.

    Of noise alone they are exponential, with the median log 2 of their mean. Of many paths it is too large,
    up to four times. That does no harm where steps to come learn the noise before a path's intensity hangs
    on it, or where it only tells peaks from noise: with `quiet_noise` instead, vague starts (`overlap`, 60
    seeds) try places as near the true one, 0.13 m in place of 0.14, and arrays (`chamber`, 12 seeds of 25
    steps) are off by the same 2.9 cm.

    Parameters
    ----------
    power : array
        Squared outputs of unit gain, one for each delay cell (and antenna).
    """
    return float(np.median(power)) / float(np.log(2))


def quiet_noise(power: Array, gain: float) -> float:
    """Power of the noise by the quieter outputs, the lower quartile of exponential ones; (M86).

    Side lobes of many paths reach most delay cells, so that their median isn't noise alone. Where what begins
    beside a line of sight hangs on the first noise, outputs are to be windowed, and the quiet ones asked.

    Parameters
    ----------
    power : array
        Squared outputs, one for each delay cell.
    gain : float
        Mean power of an output in noise of power 1.
    """
    return float(np.quantile(power, QUIET)) / (-np.log1p(-QUIET) * gain)


def learned_noise(noise: float, ratio: float, step: int) -> float:
    """Power of the noise after a step whose paths leave so much over, in ratio to it; (M86)."""
    share = max(GAIN, 1 / (FIRST + step))
    return noise * (1 + share * (float(np.clip(ratio, LEAST_RATIO, MOST_RATIO)) - 1))
