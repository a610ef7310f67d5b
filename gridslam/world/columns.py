"""The columns of what is heard, and what their rows must satisfy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.quantity import Quantity

MOST_STEPS = 10_000_000
NOT_MEASURED = "not measured"


Column = Quantity
"""A column of a table of measurements; NaN stands for not measured."""


def _angle(name: str, most: float, meaning: str) -> Column:
    return Column(name, "rad", meaning, NOT_MEASURED, -most, most)


def _deviation(name: str, unit: str, of: str) -> Column:
    meaning = f"its own standard deviation of `{of}`, in place of the one that follows from the amplitude"
    return Column(name, unit, meaning, "by the amplitude", 0.0, open=True)


TABLE = (
    Column("step", "1", "number of the step, rising; a number that is missing is a silent step",
           least=0, most=MOST_STEPS - 1),
    Column("time_s", "s", "its time, strictly rising with the steps"),
    Column("anchor", "index",
           "which anchor: a row of `/anchors`, a name in CSV files; -1, or nothing, where that isn't known",
           least=0),
    Column("distance_m", "m", "length of the path; where offsets of clocks are in it any number",
           NOT_MEASURED, 0.0, open=True),
    _angle("aod_rad", 2 * np.pi, "direction in which it leaves the anchor, minus the anchor's orientation"),
    _angle("aoa_rad", 2 * np.pi,
           "direction from the agent to where it comes from, minus the agent's heading"),
    Column("amplitude", "1", "square root of its SNR", NOT_MEASURED, 0.0, open=True),
    _deviation("distance_std_m", "m", "distance_m"),
    _deviation("aod_std_rad", "rad", "aod_rad"),
    _deviation("aoa_std_rad", "rad", "aoa_rad"),
    _angle("aod_elevation_rad", 0.5 * np.pi, "elevation at which it leaves the anchor"),
    _angle("aoa_elevation_rad", 0.5 * np.pi, "elevation of where it comes from"),
    _deviation("aod_elevation_std_rad", "rad", "aod_elevation_rad"),
    _deviation("aoa_elevation_std_rad", "rad", "aoa_elevation_rad"),
)  # fmt: skip
"""All columns but `agent`, an index beside them in tables of several."""
BY_NAME = {column.name: column for column in TABLE}
KEYS = ("step", "time_s", "anchor")
VALUES = ("distance_m", "aod_rad", "aoa_rad", "amplitude")
DEVIATIONS = ("distance_std_m", "aod_std_rad", "aoa_std_rad")
ELEVATIONS = ("aod_elevation_rad", "aoa_elevation_rad")
OPTIONAL = tuple(name for name in BY_NAME if name not in (*KEYS, *VALUES))
"""Columns that a table may lack altogether."""
ONE_AGENT = "one (run --agent NAME takes one's rows), or a method for several (network)"
"""What is allowed where a table holds several agents, and one is asked for."""
UNITS = {"agent": "index"} | {name: column.unit for name, column in BY_NAME.items()}

LEAST_M = 1e-3
"""What half of all distances are above at least: no device stands nearer to its anchors."""

Columns = dict[str, NDArray[Any]]


def fill_missing(columns: Columns) -> Columns:
    """Return the table with the columns of `VALUES` that it lacks, all NaN: not measured."""
    count = len(columns["step"])
    return columns | {name: np.full(count, np.nan) for name in VALUES if name not in columns}


def require_distances(columns: Mapping[str, NDArray[Any]]) -> None:
    """Refuse a table in which no row has a distance: what our methods make of angles alone is no map.

    Raises
    ------
    InputError
        There are rows, and none has one.
    """
    if len(columns["step"]) and not np.isfinite(columns.get("distance_m", np.nan)).any():
        raise InputError("distance_m", "a distance in no row", "distances: nothing can be mapped without")


def require_within(columns: Mapping[str, NDArray[Any]], most_m: float) -> None:
    """Refuse a table of which no distance is one that the radio measures: they are in another unit.

    Parameters
    ----------
    most_m : float
        The longest, `network_scene.longest_m`.

    Raises
    ------
    InputError
        There are distances, and each is longer, or half of them are shorter than `LEAST_M`.
    """
    distance = columns.get("distance_m", np.zeros(0))
    distance = distance[np.isfinite(distance)]
    if not len(distance):
        return
    found = f"{distance.min():.4g} to {distance.max():.4g} m"
    if distance.min() > most_m:
        raise InputError("distance_m", found, f"up to radio.max_distance_m, {most_m:g} m (metres?)")
    if np.median(np.abs(distance)) < LEAST_M:
        allowed = f"metres, half of them above {LEAST_M:g} m (of delays in seconds: times 299792458)"
        raise InputError("distance_m", found, allowed)


def check_columns(
    columns: Columns,
    anchors: int,
    place: Callable[[int, str], str],
    unlabelled: bool = False,
    pseudo: bool = False,
    in_degrees: Mapping[str, str] | None = None,
    timed: bool = False,
) -> None:
    """Check what the rows of a measurement table must satisfy.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Every key of `KEYS`, and any of `VALUES` and `OPTIONAL`; NaN stands for not measured.
    anchors : int
        Number of anchors.
    place : callable
        Says where a row and column stand, for the error.
    unlabelled : bool
        Whether a row may leave open whose it is (anchor -1).
    pseudo : bool
        Whether offsets of clocks are in the distances, which may then be negative.
    in_degrees : dict of str, optional
        What columns of angles are called that are degrees where they come from.
    timed : bool
        Whether the steps were counted by the times, so that what is out of order are times.

    Raises
    ------
    InputError
        Steps or times out of order, an anchor out of range, a value that can't be, or a row without any.
    """

    def refuse(bad: NDArray[np.bool_], name: str, allowed: str) -> None:
        for row in np.flatnonzero(bad)[:1]:
            value, called = columns[name][row], name
            if in_degrees and name in in_degrees:  # said as it is written
                value, called = np.round(np.degrees(value), 9), in_degrees[name]
            raise InputError(place(int(row), called), str(value), allowed)

    step, time = columns["step"], columns["time_s"]
    refuse(BY_NAME["step"].refuses(step), "step", f"0 to {MOST_STEPS - 1}")
    refuse(~np.isfinite(time), "time_s", "a finite number")
    later = np.concatenate([[False], np.diff(step) > 0])
    same = np.concatenate([[False], np.diff(step) == 0])
    rise = np.concatenate([[0.0], np.diff(time)])
    back = ~(later | same) & (np.arange(len(step)) > 0)
    if timed:
        refuse(back, "time_s", "times in rising order (sort the rows by time_s)")
    again = " (a second recording? count its steps on, or give it a file of its own)"
    refuse(back, "step", "steps in rising order" + again * bool((step[back][:1] == step[:1]).any()))
    refuse(later & (rise <= 0), "time_s", "times that rise strictly from step to step")
    refuse(same & (rise != 0), "time_s", "one time for all rows of a step")
    lowest = -1 if unlabelled else 0
    outside = (columns["anchor"] < lowest) | (columns["anchor"] >= anchors)
    refuse(outside, "anchor", f"{'-1 (not known), ' if unlabelled else ''}0 to {anchors - 1}")
    for name in (name for name in (*VALUES, *OPTIONAL) if name in columns):
        refuse(np.isinf(columns[name]), name, "a finite number")
        bad = BY_NAME[name].refuses(columns[name])
        if name in ("aod_rad", "aoa_rad"):
            allowed = f"radians, 2 pi at most (degrees of a CSV file: {name[:3]}_deg)"
            if in_degrees and name in in_degrees:
                allowed = "degrees, 360 at most, or an empty cell if not measured"
            refuse(bad, name, allowed)
        elif name in ELEVATIONS:
            refuse(bad, name, "radians above the horizontal, pi/2 at most")
        elif not (pseudo and name == "distance_m"):
            clocks = " (any, in a scene with [clocks])" if unlabelled and name == "distance_m" else ""
            refuse(bad, name, f"a number {BY_NAME[name].allowed}{clocks}")
    there = [name for name in VALUES if name in columns]
    empty = np.all([np.isnan(columns[name]) for name in there], axis=0)
    refuse(empty, there[0], f"at least one of {', '.join(VALUES)} in each row")
