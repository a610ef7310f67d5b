"""How loud the noise of sampled signals is, by what their paths leave over; docs/model.md, (M86)."""

from __future__ import annotations

import numpy as np

GAIN, FIRST = 0.03, 2.0
"""Share of a step's noise that enters: in the long run, and at first 1 / (`FIRST` + step)."""
LEAST_RATIO, MOST_RATIO = 0.1, 10.0
"""Between which the noise of a step is, in that believed: a path that comes or goes is no noise."""


def learned_noise(noise: float, ratio: float, step: int) -> float:
    """Power of the noise after a step whose paths leave so much over, in ratio to it; (M86)."""
    share = max(GAIN, 1 / (FIRST + step))
    return noise * (1 + share * (float(np.clip(ratio, LEAST_RATIO, MOST_RATIO)) - 1))
