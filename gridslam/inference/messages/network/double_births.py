"""Births that a double bounce explains as well, put off while they would move a pose.

What is heard over a corner of two walls arrives as if from behind one wall, and departs the way it arrives.
Where poses are vague a mirror explains that, too, if they give way: one wall is born that isn't there, and
distance, departure and arrival all fit it. docs/model.md, (M491).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.beliefs.particles import Cloud
from gridslam.inference.messages.birth_proposals import propose_births
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives.tables import AOA, AOD
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap
from gridslam.world.radio import RadioModel

KNOWN_M = 0.1
"""Standard deviation of the position (both axes) up to which a birth moves the agent by little."""


def without_double_bounces(
    births: Births, state: State, scan: AnchorScan, cloud: Cloud, ratios: LikelihoodRatios,
    radio: RadioModel, model: FilterModel, senders: NDArray[np.int32] | None, *, work: Workspace,
) -> Births:  # fmt: skip
    """The births of `propose_births`, given what that was, without single bounces that may be double ones.

    Their measurements stay as new as they were: something unknown sent them. Without an arrival nothing is
    born meanwhile, (M558). Where clocks or the position are known, or no path bounces twice, the births stay
    the same object.

    Parameters
    ----------
    births : Births
        B hypotheses, of rows of `scan`.
    cloud : Cloud
        The particles that the ratios were evaluated at.
    radio : RadioModel
        As the anchor's radio seems to be.
    senders : (A,) int32 or None
        Anchors whose paths may bear surfaces; None: all.
    """
    x, y = state.belief.covariance.diagonal()[:2].tolist()
    if not (len(births) and state.belief.clocks and model.max_bounces > 1 and x + y > KNOWN_M**2):
        return births
    arrives = scan.measured[births.measurement, AOA]
    if not arrives.all():
        births = births.take(np.flatnonzero(arrives))
    alone = (births.hit < 0).all(1) & scan.measured[births.measurement, AOD]
    if not alone.any():
        return births
    open_, _ = propose_births(
        state, scan.without_departures(), cloud, ratios, radio, model, senders, work=work
    )
    anyway = {key: ratio for key, ratio in zip(_keys(open_), open_.ratio.tolist(), strict=True)}
    either = np.array([anyway.get(key, 0.0) for key in _keys(births)])
    doubly = either * departing_doubly(births, state, scan, radio, model)
    keep = np.flatnonzero(~alone | (births.ratio > doubly))
    return births if len(keep) == len(births) else births.take(keep)


def _keys(births: Births) -> list[tuple[int, ...]]:
    """What names each hypothesis: its measurement, the surfaces hit, the anchor."""
    rows = np.column_stack([births.measurement, births.hit, births.anchor])
    return [tuple(row) for row in rows.tolist()]


def departing_doubly(
    births: Births, state: State, scan: AnchorScan, radio: RadioModel, model: FilterModel
) -> Array:
    """Density (B,) of each birth's departure over double bounces, in ratio to that of any direction.

    Over a corner of a right angle a path departs the way it arrives; over others, anyhow. Either is as likely
    as a single bounce.
    """
    rows = births.measurement.astype(np.intp)
    strength = np.nan_to_num(scan.amplitude[rows], nan=radio.threshold)
    angle = scan.value[rows, 1:]
    _, departing, arriving = deviations(scan, rows, strength, np.nan_to_num(angle), radio).T
    heading = state.belief.mean[HEADING], state.belief.covariance[HEADING, HEADING]
    gap = wrap(angle[:, 0] + model.places[births.anchor, 2] - angle[:, 1] - heading[0])
    variance = departing**2 + arriving**2 + heading[1]
    return np.asarray(1.0 + np.exp(-0.5 * gap**2 / variance) * np.sqrt(2 * np.pi / variance))
