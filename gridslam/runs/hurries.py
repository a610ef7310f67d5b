"""Whether an agent's velocity changes faster, by a run itself, than the motion allows that the run assumed.

Single steps tell it where each is long (`gridslam.inference.management.jolts`). Of a device that is heard ten
times a second none does: it turns over many steps, each a little, and the filter, too sure, loses it there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.estimates import Estimate

OVER, RATIO, OFTEN, LIKELY = 10, 3.0, 0.1, 0.9
"""Steps over which a change of the velocity is looked at; deviations, of those that the motion model expects
there, from which on it is too large, and the share of steps from which on the motion is called too smooth (of
right settings hardly any step's is); the share of changes that the acceleration that is told allows."""


def hurry(estimates: Sequence[Estimate], acceleration_mps2: float) -> tuple[float, float] | None:
    """The share of steps at which the velocity changed too fast, and the acceleration that allows for it.

    Parameters
    ----------
    acceleration_mps2 : float
        Standard deviation of the white acceleration over a step, as the filter assumed it.

    Returns
    -------
    (float, float), optional
        The second in m/s^2; None if it's few steps.
    """
    if len(estimates) < 2 * OVER:
        return None
    velocity = np.stack([one.velocity_mps for one in estimates])
    time_s = np.array([one.time_s for one in estimates])
    walked = np.concatenate([[0.0], np.cumsum(np.diff(time_s) ** 2)])
    expected = acceleration_mps2 * np.sqrt(walked[OVER:] - walked[:-OVER])
    change = np.linalg.norm(velocity[OVER:] - velocity[:-OVER], axis=1)
    good = np.isfinite(change) & (expected > 0)
    if good.sum() < OVER:
        return None
    ratio = change[good] / expected[good]
    share = float((ratio > RATIO).mean())
    return (share, acceleration_mps2 * float(np.quantile(ratio, LIKELY))) if share > OFTEN else None
