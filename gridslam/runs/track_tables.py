"""A run's track as a table for spreadsheets, MATLAB's ``readtable`` and the like."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence

import numpy as np

from gridslam.arrays import Array
from gridslam.estimates import Estimate
from gridslam.io.files import write_bytes
from gridslam.world.trajectory import Trajectory

COLUMNS = ("step", "time_s", "x_m", "y_m", "heading_rad", "x_std_m", "y_std_m", "heading_std_rad")
HEIGHT, TRUE = ("height_m", "height_std_m"), ("true_x_m", "true_y_m", "true_heading_rad", "true_height_m")


def track_columns(
    estimates: Sequence[Estimate], track: Trajectory, truth: Trajectory | None = None
) -> dict[str, Array]:
    """Columns of a track, (N,) each: what is believed and, where it is known, what is true.

    Heights are there where the track has them; their deviation is 0 where the height was told.

    Parameters
    ----------
    estimates : sequence of Estimate
        One per step.
    track, truth : Trajectory
        As estimated, and as it was; the truth at any times that cover it.
    """
    step, time = np.array([e.step for e in estimates]), track.time_s
    variances = np.reshape([np.diag(e.covariance)[[0, 1, 4]] for e in estimates], (-1, 3))
    spread = np.sqrt(np.maximum(variances, 0.0))
    own = (step, time, *track.position_m.T, track.heading_rad, *spread.T)
    columns = dict(zip(COLUMNS, own, strict=True))
    if track.height_m is not None:
        unsure = np.array([e.heights.get("agent", (0.0, 0.0))[1] for e in estimates])
        columns |= dict(zip(HEIGHT, (track.height_m, unsure), strict=True))
    if truth is not None:
        heading = np.interp(time, truth.time_s, np.unwrap(truth.heading_rad))
        there = [np.interp(time, truth.time_s, axis) for axis in truth.position_m.T]
        there.append(np.angle(np.exp(1j * heading)))
        if truth.height_m is not None:
            there.append(np.interp(time, truth.time_s, truth.height_m))
        columns |= dict(zip(TRUE, there, strict=False))
    return columns


def write_track(path: str | os.PathLike[str], columns: dict[str, Array]) -> None:
    """Write columns as CSV, numbers at full precision.

    Raises
    ------
    InputError
        The file can't be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*([repr(v) for v in values.tolist()] for values in columns.values()), strict=True))
    write_bytes(path, text.getvalue().encode("utf-8"))
