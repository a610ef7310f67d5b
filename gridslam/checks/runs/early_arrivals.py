"""Paths that arrive before a line of sight could, from where a run puts its agent: it was elsewhere.

The same, at each step, is what health says of itself (`gridslam.inference.health.early_watch`); here, of a
whole run, by its estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array
from gridslam.estimates import Estimate
from gridslam.inference.health.early_watch import CLUTTER_NAT, DEVIATIONS, LEAST_M
from gridslam.measurements.table import Measurements
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan

LEAST_STEPS = 3
"""Steps below which nothing is said."""


class EarlyArrivals(NamedTuple):
    """At how many of the steps that were heard a path is too short, by how much at most (m), and whose."""

    steps: int
    heard: int
    short_m: float
    anchor: str


def early_arrivals(
    estimates: Sequence[Estimate], heard: Measurements, model: FilterModel
) -> EarlyArrivals | None:
    """Loud paths shorter than the line of sight to where each step puts the agent; None if hardly any.

    Where no amplitudes are measured clutter can't be told from paths, and nothing is said.

    Parameters
    ----------
    estimates : sequence of Estimate
        Of a run on what was heard.
    heard : Measurements
        Of anchors that the model has.
    model : FilterModel
    """
    anchors = heard.anchors[: model.senders]
    places = [model.anchor_names.index(name) for name in anchors]
    loudest_clutter = np.sqrt(CLUTTER_NAT + model.radio.threshold**2)
    steps = count = 0
    worst, whose = 0.0, ""
    for one in estimates:
        scan = heard.scan(one.step)
        count += len(scan) > 0
        own = np.asarray(scan.anchor)
        loud = np.nan_to_num(np.asarray(scan.amplitude)) > loudest_clutter
        if not loud.any():
            continue
        of = np.array(places)[own]
        level = np.hypot(*(model.anchor_positions[of] - one.position_m).T)
        sight = np.hypot(level, np.asarray(model.anchor_heights)[of])
        short: Array = sight - scan.distance_m - LEAST_M
        short -= DEVIATIONS * np.hypot(_deviations(scan, model), np.sqrt(np.trace(one.covariance[:2, :2])))
        if not (loud & (short > 0)).any():
            continue
        steps += 1
        row = int(np.argmax(np.where(loud & (short > 0), sight - scan.distance_m, -np.inf)))
        if sight[row] - scan.distance_m[row] > worst:
            worst, whose = float(sight[row] - scan.distance_m[row]), anchors[own[row]]
    return EarlyArrivals(steps, count, worst, whose) if steps >= LEAST_STEPS else None


def _deviations(scan: Scan, model: FilterModel) -> Array:
    """Standard deviations of the rows' distances (M,), m: their own, else the radio's."""
    given, usual = scan.distance_std_m, model.radio.distance_std(np.asarray(scan.amplitude))
    return usual if given is None else np.where(np.isfinite(given), given, usual)
