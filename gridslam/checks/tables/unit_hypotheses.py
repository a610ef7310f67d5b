"""What a column of measurements could have been meant as, and what its numbers alone give away."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.columns import Columns
from gridslam.world.geometry import wrap
from gridslam.world.network_scene import longest_m
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene

Reading = Callable[[Array, NDArray], Array]
ANGLES = ("aod_rad", "aoa_rad")
FOOT_M = 0.3048
IN_WORLD = {("aoa_rad", "world frame"), ("aoa_rad", "compass")}
"""Columns and kinds of readings by which arrivals are directions in the world, which no heading turns."""
LEAST_OFF_RAD = np.radians(10.0)
"""Off north from which on an anchor tells bearings from angles that are counted clockwise."""


@dataclass(frozen=True)
class Suspicion:
    """One thing that is probably wrong.

    Attributes
    ----------
    column : str
    kind : str
        "padding", "missing", "case", "names", "offset", "slant", "rise", "milliseconds", "microseconds",
        "fast", "leap", "degrees", "radians twice", "seconds", "nanoseconds", "millimetres", "centimetres",
        "feet", "round trip", "plan", "flipped", "mirrored", "world frame", "compass", "backwards", "swapped",
        "turned", "place", "second device", "dB", "power", "level", "variances", "exact" or "beyond".
    text : str
        What it looks like and what to do.
    certain : bool
    reason : str
        The numbers behind it.
    rivals : tuple of str
        Columns of suspicions told before that explain the same, so that one of them is meant, not all.
    """

    column: str
    kind: str
    text: str
    certain: bool
    reason: str
    rivals: tuple[str, ...] = ()

    def __str__(self) -> str:
        chance = "" if self.certain else "probably "
        if self.rivals:
            chance = f"{chance}this or what stands above of {', '.join(self.rivals)}, not both: "
        return f"{self.column}: {chance}{self.text} ({self.reason})"


def told_after(item: Suspicion, others: Iterable[Suspicion]) -> Suspicion:
    """A suspicion as it is told after others, of which it is a rival."""
    return replace(item, rivals=tuple(dict.fromkeys(other.column for other in others)))


ADVICE = {
    "degrees": "degrees, where radians belong",
    "radians twice": "turned from degrees to radians twice",
    "seconds": "delays in seconds, where metres belong (times the speed of light)",
    "nanoseconds": "delays in nanoseconds, where metres belong (times 0.299792458)",
    "millimetres": "millimetres, where metres belong",
    "centimetres": "centimetres, where metres belong",
    "feet": "feet, where metres belong (times 0.3048)",
    "round trip": "the way there and back, twice the distance",
    "flipped": "counted clockwise; angles are counter-clockwise",
    "mirrored": (
        "counted clockwise, and so is aoa_rad; or the scene is mirrored, as of a picture whose y axis points "
        "down, with anchors and start on the wrong side"
    ),
    "world frame of departure": "directions in the world; the anchor's orientation must be subtracted",
    "world frame of arrival": "directions in the world; the agent's heading must be subtracted",
    "compass of departure": (
        "directions in the world, counted clockwise from north (compass bearings), where the angle from the "
        "anchor's orientation, counter-clockwise, belongs"
    ),
    "compass of arrival": (
        "directions in the world, counted clockwise from north (compass bearings), where the angle from the "
        "agent's heading, counter-clockwise, belongs"
    ),
    "backwards": "the direction of travel, where the direction towards where the path comes from belongs",
    "swapped": "exchanged with the other angle: departure is at the anchor, arrival at the agent",
    "dB": "decibels, where the linear root of the SNR belongs",
    "power": "the SNR itself, where its root belongs",
}


ANGLE_DEVIATIONS = ("aod_std_rad", "aoa_std_rad", "aod_elevation_std_rad", "aoa_elevation_std_rad")


def absurd(columns: Columns) -> tuple[list[Suspicion], Columns]:
    """What no value of a column can be, and the table read the other way.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    """
    found, table = [], dict(columns)
    for name in ANGLES:
        values = finite(columns, name)
        wide = np.abs(values) > 2 * np.pi
        if wide.mean() > 0.01 if len(values) else False:
            reason = f"up to {np.abs(values).max():.4g}, {wide.mean():.0%} beyond 2 pi"
            found.append(Suspicion(name, "degrees", ADVICE["degrees"], True, reason))
            table[name] = np.radians(columns[name])
    for name in ANGLE_DEVIATIONS:
        values = finite(columns, name)
        if len(values) and (values > np.pi / 2).mean() > 0.01:
            reason = f"up to {values.max():.4g} rad, where a quarter of a turn is 1.57"
            found.append(Suspicion(name, "degrees", ADVICE["degrees"], True, reason))
            table[name] = np.radians(columns[name])
    values = finite(columns, "distance_m")
    if len(values) and 0 < np.median(values) < 1e-5:
        reason = f"median {np.median(values):.3g}"
        found.append(Suspicion("distance_m", "seconds", ADVICE["seconds"], True, reason))
        table["distance_m"] = columns["distance_m"] * SPEED_OF_LIGHT
    values = finite(columns, "amplitude")
    if len(values) and (values < 0).mean() > 0.002:
        reason = f"{(values < 0).mean():.0%} below 0"
        found.append(Suspicion("amplitude", "dB", ADVICE["dB"], True, reason))
        table["amplitude"] = 10 ** (columns["amplitude"] / 20)
    return found, table


def beyond_radio(columns: Columns, scene: Scene) -> list[Suspicion]:
    """Whether most distances are longer than the scene's radio measures any.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    """
    values, most = finite(columns, "distance_m"), longest_m(scene)
    if not len(values) or not np.median(values) > most:
        return []
    text = f"up to {values.max():.4g} m, where the scene's radio.max_distance_m allows {most:g} m"
    reason = f"{(values > most).mean():.0%} of them are beyond it"
    return [Suspicion("distance_m", "beyond", text, True, reason)]


def readings(name: str, scene: Scene, table: Columns) -> dict[str, Reading]:
    """Other ways in which a column could have been meant: by kind, what makes (K,) of values and anchors.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    """
    if name == "distance_m":
        factors = {"seconds": SPEED_OF_LIGHT, "nanoseconds": SPEED_OF_LIGHT * 1e-9}
        factors |= {"millimetres": 1e-3, "centimetres": 1e-2, "feet": FOOT_M, "round trip": 0.5}
        return {kind: partial(_times, factor) for kind, factor in factors.items()}
    readings: dict[str, Reading] = {
        "degrees": lambda values, _: np.radians(values),
        "radians twice": lambda values, _: np.degrees(values),
        "flipped": lambda values, _: -values,
        "backwards": lambda values, _: wrap(values + np.pi),
    }
    if name == "aod_rad":
        orientation = scene.anchor_orientations
        readings["world frame"] = lambda values, anchor: wrap(values - orientation[anchor])
        used = orientation[np.unique(table["anchor"])] if "anchor" in table else orientation
        if (np.abs(wrap(used - 0.5 * np.pi)) > LEAST_OFF_RAD).any():  # else it is the same as clockwise
            readings["compass"] = lambda values, anchor: wrap(0.5 * np.pi - values - orientation[anchor])
        if "aoa_rad" in table:
            readings["swapped"] = lambda values, _: table["aoa_rad"]
    else:
        readings["world frame"] = lambda values, _: values
        readings["compass"] = lambda values, _: wrap(0.5 * np.pi - values)
    return readings


def _times(factor: float, values: Array, _: NDArray) -> Array:
    return factor * values


def finite(columns: Columns, name: str) -> Array:
    """Values (N,) of a column that are there and finite; none if the column is missing.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    """
    values = columns.get(name, np.zeros(0))
    return values[np.isfinite(values)]
