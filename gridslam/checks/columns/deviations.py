"""Deviations of a table that can't be its own: variances, degrees; and distances finer than the radio's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.tables.unit_hypotheses import ADVICE, ANGLES, Suspicion, finite
from gridslam.world.columns import Columns
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene

ALIKE, OTHER = np.log(3.0), np.log(3.0)
"""Median factor within which values are squares, and beyond which they aren't deviations; logarithms."""
LEAST = 20
"""Rows with a deviation of their own and an amplitude, to tell by."""

WIDE_RAD, NARROWER = 0.3, 10.0
"""Median deviation of angles from which on degrees are asked for; times by which angles must scatter less."""
MAD, FINER = 1.48, 5.0
"""Deviation over median absolute one; times as exact as the bandwidth allows that distances must be."""


def variances(table: Columns, scene: Scene) -> list[Suspicion]:
    """Columns of deviations that are rather variances, by what the radio measures at these amplitudes.

    Parameters
    ----------
    table : dict of (K,) arrays
    """
    if not {"distance_std_m", "amplitude"} <= table.keys():
        return []
    own, amplitude = table["distance_std_m"], table["amplitude"]
    rows = (own > 0) & (amplitude > 0)
    if np.count_nonzero(rows) < LEAST:
        return []
    expected = np.log(scene.signal_model().distance_scale / amplitude[rows])
    given = np.log(own[rows])
    squares, deviations = (float(np.median(np.abs(given - power * expected))) for power in (2, 1))
    if squares > ALIKE or deviations < OTHER or squares > 0.5 * deviations:
        return []
    text = (
        "variances, where standard deviations belong: take roots (of deviations of angles, too, if squared)"
    )
    usual = float(np.exp(np.median(expected)))
    reason = (
        f"median {np.median(own[rows]):.2g}, where this radio's deviation is about {usual:.2g} at these "
        f"amplitudes, and its square {usual**2:.2g}"
    )
    return [Suspicion("distance_std_m", "variances", text, False, reason)]


def degrees(table: Columns, scene: Scene, agent: str | None) -> tuple[list[Suspicion], Columns]:
    """Deviations of angles that are far wider than lines of sight scatter, and the table with radians.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    """
    names = {name: name.replace("rad", "std_rad") for name in ANGLES}
    wide = [name for name, own in names.items() if np.median([*finite(table, own), 0.0]) > WIDE_RAD]
    if not wide or not len(table["step"]):
        return [], table
    order = np.argsort(table["step"], kind="stable")
    plain = {name: values[order] for name, values in table.items() if name not in names.values()}
    sight = explain(plain, scene, agent)
    rows = sight.row[sight.sure]
    number = np.searchsorted(np.unique(plain["step"][sight.row]), plain["step"][rows])
    away = sight.position_m[number] - scene.anchor_positions[plain["anchor"][rows]]
    found, cured = list[Suspicion](), dict(table)
    for name in wide:
        gap = plain[name][rows]
        if name == "aod_rad":
            facing = scene.anchor_orientations[plain["anchor"][rows]]
            gap = gap + facing - np.arctan2(away[:, 1], away[:, 0])
        scatter = _scatter(plain["step"][rows], plain["anchor"][rows], gap)
        own = float(np.median(finite(table, names[name])))
        if scatter is None or NARROWER * scatter > own:
            continue
        reason = f"median {own:.2g} rad, where lines of sight scatter by {scatter:.2g} rad at most"
        found.append(Suspicion(names[name], "degrees", ADVICE["degrees"], False, reason))
        cured[names[name]] = np.radians(table[names[name]])
    return found, cured


def _scatter(step: NDArray[np.intp], anchor: NDArray[np.intp], angle: Array) -> float | None:
    """Deviation of angles (N,) of lines of sight by what they change from step to step; None of too few."""
    order = np.lexsort((step, anchor))
    near = (np.diff(step[order]) == 1) & (np.diff(anchor[order]) == 0)
    change = np.asarray(wrap(np.diff(angle[order])))[near]
    change = change[np.isfinite(change)]
    return MAD * float(np.median(np.abs(change))) / np.sqrt(2) if len(change) >= LEAST else None


def too_exact(table: Columns, scene: Scene) -> list[Suspicion]:
    """A bandwidth too small for the distances: they change far more evenly than such a radio measures them.

    Of each anchor the shortest distance of each step is looked at, line of sight or not; second differences
    leave little of the agent's motion. A table with deviations of its own doesn't ask the bandwidth.

    Parameters
    ----------
    table : dict of (K,) arrays
    """
    own, radio = finite(table, "distance_std_m"), scene.signal_model()
    if len(own) or radio.given_distance_std is not None or not {"distance_m", "amplitude"} <= table.keys():
        return []
    rows = np.flatnonzero((table["amplitude"] > 0) & np.isfinite(table["distance_m"]))
    rows = rows[np.lexsort((table["distance_m"][rows], table["step"][rows], table["anchor"][rows]))]
    step, anchor = table["step"][rows], table["anchor"][rows]
    first = (np.diff(step, prepend=-1) != 0) | (np.diff(anchor, prepend=-1) != 0)
    rows, step, anchor = rows[first], step[first], anchor[first]
    near = (step[2:] - step[:-2] == 2) & (anchor[2:] == anchor[:-2]) & (step[1:-1] - step[:-2] == 1)
    if near.sum() < LEAST:
        return []
    bend = np.diff(table["distance_m"][rows], 2)[near]
    scatter = MAD * float(np.median(np.abs(bend))) / np.sqrt(6)
    expected = float(np.median(radio.distance_std(table["amplitude"][rows[1:-1][near]])))
    if expected < FINER * scatter:
        return []
    text = (
        f"far more exact than radio.bandwidth_hz of {scene.radio.bandwidth_hz:g} allows, by a factor of "
        f"{expected / max(scatter, 1e-9):.0f}: is the bandwidth larger? Or they are smoothed: then give "
        "deviations of their own in distance_std_m"
    )
    reason = f"they scatter by {scatter:.2g} m from step to step, where {expected:.2g} m are expected"
    return [Suspicion("distance_m", "exact", text, False, reason)]
