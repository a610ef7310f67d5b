"""Proposals of births: how well a new surface would explain each measurement; owner of that kernel."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.belief import AGENT, Belief
from gridslam.inference.births import Births
from gridslam.inference.heard import Heard
from gridslam.inference.particles import Cloud
from gridslam.inference.surfaces import Bank

Array = NDArray[np.float64]
CONVERGED_STD_M = 0.3
SAMPLES = 256


def partners(bank: Bank, belief: Belief, most_bounces: int) -> NDArray[np.int32]:
    """Pairs (last, first) of known surfaces with which a new one may form a path, -1 for the new, (H, 2)."""
    if most_bounces < 1:
        return np.zeros((0, 2), np.int32)
    pairs = [(-1, -1)]
    if most_bounces >= 2:
        spread = belief.covariance.diagonal()[AGENT + 1 :: 2].tolist()
        for s, told in enumerate(zip(bank.existence.tolist(), bank.seen.tolist(), spread, strict=True)):
            existence, seen, variance = told
            if existence > 0.9 and seen >= 3 and variance < CONVERGED_STD_M**2:
                pairs += [(-1, s), (s, -1)]
    return np.array(pairs, np.int32)


def propose(
    heard: Heard, belief: Belief, bank: Bank, cloud: Cloud, explained: Array, radio: Array, births: float,
    radius_m: float, most_bounces: int,
) -> Births:  # fmt: skip
    """All birth hypotheses worth a look, of the measurements that carry distance and AoA.

    Surfaces are born uniformly over all lines that cross the region (angle and offset), at `births` per
    anchor and step; that measure doesn't depend on the frame.

    Parameters
    ----------
    explained : (M,)
        Ratio to clutter of the measurement's known causes.
    radio : (11,)
        `SignalModel.radio` of the anchor.
    radius_m : float
        Of the region.
    """
    runtime.start()
    from gridslam.kernels.births import propose as launch

    known = partners(bank, belief, most_bounces)
    ratio, line = np.zeros((len(heard), len(known))), np.empty((len(heard), len(known), 2))
    if ratio.size:
        launch(
            cloud.state, _noise(len(known)), belief.mean, heard.table, explained, known,
            heard.spot, radio, births / (4 * np.pi * radius_m), ratio, line,
        )  # fmt: skip
    measurement, hypothesis = ratio.nonzero()
    if not len(measurement):
        return Births.none()
    return Births(
        measurement, known[hypothesis], line[measurement, hypothesis], ratio[measurement, hypothesis]
    )


@cache
def _noise(seed: int) -> Array:
    """Standard normal noise of distance and AoA, (2, SAMPLES)."""
    return np.random.default_rng(seed).standard_normal((2, SAMPLES))
