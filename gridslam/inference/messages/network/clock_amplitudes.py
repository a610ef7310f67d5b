"""What amplitudes say of which path a measurement is, while its anchor's clock is searched for; (M103)."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.ray_amplitudes import LEVEL_SHARE, WEAKENED
from gridslam.world.radio import RadioModel

NOTHING = 1e-9
"""Share of a path's being missed below which a measurement says nothing of it, at an offset or at all."""


def amplitude_ratio(measured: Array, expected: Array, radio: RadioModel) -> Array:
    """What amplitudes say for paths of known strength, against any amplitude up to twice theirs.

    A reflection may well have a line of sight's angles, but hardly its strength. One path in fifty counts as
    weakened by something unknown, so that no amplitude rules a path out.

    Parameters
    ----------
    measured : (M,)
        NaN where not measured.
    expected : (L,)

    Returns
    -------
    (L, M)
    """
    level = np.asarray(expected)[:, None]
    deviation = np.hypot(radio.amplitude_std(level), LEVEL_SHARE * level)
    density = np.exp(-0.5 * ((measured - level) / deviation) ** 2) / (np.sqrt(2 * np.pi) * deviation)
    return np.where(np.isnan(measured), 1.0, WEAKENED + (1 - WEAKENED) * 2 * level * density)
