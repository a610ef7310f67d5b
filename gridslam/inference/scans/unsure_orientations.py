"""What departures tell where nobody knows exactly how anchors are turned; docs/model.md, (M568)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.inference.scans.anchor_measurements import UNKNOWN, of_all_anchors
from gridslam.inference.scans.deviations import deviations
from gridslam.world.filter_model import FilterModel
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan
from gridslam.world.scan import Scan


def as_sure_as_anchors(scan: Scan, model: FilterModel) -> Scan:
    """The scan with departures whose deviations allow for how the anchors may be turned.

    Not about an only anchor: all turns with it. Of a row that doesn't say its anchor, as for the least sure.
    """
    unsure = model.orientation_std
    if model.senders == 1 or not unsure.any() or not len(scan):
        return scan
    whose = np.asarray(scan.anchor, np.intp)
    whole, std = of_all_anchors(scan), np.full(len(scan), np.nan)
    for anchor in np.unique(whose).tolist():
        rows = np.flatnonzero(whose == anchor)
        height = float(model.places[anchor, 3]) if anchor != UNKNOWN else 0.0
        own = replace(whole, anchor=anchor, height=height)
        amplitude, angles = whole.amplitude[rows], whole.value[rows, 1:]
        std[rows] = deviations(own, rows, amplitude, angles, model.radio)[:, 1]
    turned = np.where(whose == UNKNOWN, unsure.max(), unsure[whose])
    told = np.isfinite(std) & (turned > 0)
    before = np.full(len(scan), np.nan) if scan.aod_std_rad is None else scan.aod_std_rad
    return replace(scan, aod_std_rad=np.where(told, np.hypot(std, turned), before))


def all_as_sure_as_anchors(scan: NetworkScan, model: NetworkModel) -> NetworkScan:
    """All agents' scans with departures whose deviations allow for how the anchors may be turned."""
    each = zip(scan.scans, model.agents, strict=True)
    return replace(
        scan, scans=tuple(None if own is None else as_sure_as_anchors(own, of) for own, of in each)
    )
