"""At which steps of a run nothing was heard."""

import numpy as np

from gridslam.measurements.observations import Observations
from gridslam.measurements.recording import Recording


def unheard_steps(measurements: Observations, steps: int) -> tuple[int, ...]:
    """Steps, of so many, at which nothing was heard."""
    if isinstance(measurements, Recording):
        silent = ~measurements.heard[:steps].any(1)
    else:
        silent = np.bincount(measurements.step, minlength=steps)[:steps] == 0
    return tuple(np.flatnonzero(silent).tolist())
