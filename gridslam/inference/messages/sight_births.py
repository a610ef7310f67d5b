"""Births that would take a line of sight's measurement; docs/model.md, (M549). Ours.

What arrives loudest, from where its anchor is, at its distance, is its line of sight, and sets the pose right
where that is off by more than it claims. A new wall explains it better than that, wherever the pose is: one
that passes by the anchor, and mirrors it to about itself. Then nothing holds the agent any longer.
"""

from __future__ import annotations

import numpy as np

from gridslam.inference.messages.births import Births, with_births
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.state import State
from gridslam.world.geometry import wrap
from gridslam.world.radio import RadioModel

NEAR_M, BESIDE = 0.3, 5.0
"""How far a line of sight's length may be off, and how many deviations its angles."""
HEARD = 0.95
"""Existence of a line of sight that was heard; one that never was may be hidden behind a reflection."""
AS_LOUD = 0.8
"""How loud it is at least, of what is expected."""


def leave_sights(
    births: Births, state: State, scan: AnchorScan, paths: PredictedPaths, ratios: LikelihoodRatios,
    radio: RadioModel,
) -> tuple[Births, LikelihoodRatios]:  # fmt: skip
    """Births without those of measurements that are lines of sight, and the ratios with their sums.

    For each line of sight that is believed in that measurement alone which fits it best: a wall behind an
    anchor is heard as loud and nearly as soon.

    Parameters
    ----------
    births : Births
        B hypotheses, of rows of `scan`.
    paths : PredictedPaths
        L paths, of which the lines of sight are asked.
    ratios : LikelihoodRatios
        Of these paths and the scan's M measurements.
    radio : RadioModel
        As the anchor's radio seems to be.

    Returns
    -------
    (births, ratios)
        The same objects where no birth is left out.
    """
    if not len(births):
        return births, ratios
    rays, value, spread = paths.rays, paths.prediction.value, paths.prediction.spread
    taken, lengths, loudness = None, scan.value[:, 0].tolist(), scan.amplitude.tolist()
    bearing = set(births.measurement.tolist())
    for row in (rays.bounces == 0).nonzero()[0].tolist():
        anchor, expected = int(rays.anchor[row]), float(value[row, 0])
        if not (state.los[anchor] > HEARD and spread[row, 0, 0] < NEAR_M**2):
            continue
        least = AS_LOUD * radio.amplitude_at_1m / max(expected - float(state.belief.late(anchor)), NEAR_M)
        # without an amplitude, too; at most steps nothing is born of what lies there
        if not any(abs(lengths[m] - expected) < NEAR_M and not loudness[m] < least for m in bearing):
            continue
        length = np.abs(scan.value[:, 0] - expected)
        near = np.flatnonzero((length < NEAR_M) & ~(scan.amplitude < least))
        std = deviations(scan, near, np.fmax(scan.amplitude[near], least), scan.value[near, 1:], radio)
        angles = wrap(scan.value[near, 1:] - value[row, 1:])
        off = np.fmax(np.abs(angles) / np.sqrt(std[:, 1:] ** 2 + spread[row].diagonal()[1:]), 0.0)
        misfit = (length[near] / NEAR_M) ** 2 + ((off / BESIDE) ** 2).sum(1)
        misfit[(off >= BESIDE).any(1)] = np.inf
        if misfit.min() < np.inf:
            taken = np.zeros(len(scan), bool) if taken is None else taken
            taken[near[np.argmin(misfit)]] = True
    if taken is None:
        return births, ratios
    kept = np.flatnonzero(~taken[births.measurement])
    if len(kept) == len(births):
        return births, ratios
    births = births.take(kept)
    return births, with_births(ratios, births)
