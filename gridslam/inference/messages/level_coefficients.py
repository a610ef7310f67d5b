"""Coefficients of floor and ceiling, where they aren't known: what amplitudes say of them. (M305). Ours.

They are learned by the likelihood of what was heard and missed, by association, of paths over levels alone:
of those over walls, too, errors of the walls' coefficients would count as the level's.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.state import State
from gridslam.kernels.primitives import tables
from gridslam.world.filter_model import FilterModel
from gridslam.world.levels import COEFFICIENTS
from gridslam.world.radio import RadioModel

LEAST_SHARE, LEAST_CHANCE = 1e-3, 0.05
"""Probability of an association, and of a path being there, below which it says nothing."""
CLIP, NEVER, ROUGH = 12.0, 1e-30, 0.01
"""Nats by which a coefficient may be behind the best; least likelihood; steps of means for kernels."""


def learn_levels(
    state: State, scan: AnchorScan, paths: PredictedPaths, exchange: Exchange, radio: RadioModel,
    model: FilterModel,
) -> State:  # fmt: skip
    """Beliefs about coefficients of floor and ceiling after an association; docs/model.md, (M305).

    Parameters
    ----------
    scan : AnchorScan
        M measurements.
    paths : PredictedPaths
        The L paths they were associated with.
    exchange : Exchange
        Of these: probability that a path caused a measurement (L, M), and is there (L,).
    radio : RadioModel
        As the anchor's radio seems to be.

    Returns
    -------
    State
        With new `levels` (W, 50); the same object where it has none.
    """
    if state.levels is None:
        return state
    levels, image = state.levels.copy(), paths.rays.anchor // model.senders
    length = np.where(np.isfinite(scan.value[:, 0]), scan.value[:, 0], np.inf)
    known = (scan.amplitude > 0) & np.isfinite(length)
    at_1m = radio.amplitude_at_1m * COEFFICIENTS
    for row in np.flatnonzero((image > 0) & (paths.rays.table[:, 0] == 0)):
        level = image[row] - 1
        share, chance = exchange.responsible[row], float(exchange.odds[tables.CHANCE, row])
        if not levels[level].any() or (chance < LEAST_CHANCE and share.max(initial=0.0) < LEAST_SHARE):
            continue
        seen = detection_table(model.radio)(at_1m / paths.prediction.length[row])
        log = max(1 - share.sum(), 0.0) * np.log(np.maximum(1 - chance * seen, NEVER))
        for m in np.flatnonzero((share > LEAST_SHARE) & known):
            log = log + share[m] * radio.log_rician(scan.amplitude[m], at_1m / length[m])
        after = np.log(np.maximum(levels[level], NEVER)) + log
        after = np.exp(np.maximum(after - after.max(), -CLIP))
        levels[level] = after / after.sum()
    return replace(state, levels=levels)


def level_means(levels: Array) -> tuple[Array, Array]:
    """Means and deviations (W,) of beliefs (W, N) about coefficients; 0 and 0 of known ones."""
    mean = levels @ COEFFICIENTS
    return mean, np.sqrt(np.maximum(levels @ COEFFICIENTS**2 - mean**2, 0.0))


def with_levels(model: FilterModel, levels: Array | None) -> FilterModel:
    """The model with the coefficients that are believed, to a hundredth; the same object while these stay."""
    if levels is None:
        return model
    mean, stated = level_means(levels)[0], np.array(model.radio.image_gains[1:])
    rough = np.maximum(np.round(mean / ROUGH) * ROUGH, ROUGH)
    return _with_gains(model, (1.0, *np.where(mean > 0, rough, stated).tolist()))


@lru_cache(64)
def _with_gains(model: FilterModel, gains: tuple[float, ...]) -> FilterModel:
    return replace(model, radio=replace(model.radio, image_gains=gains))
