"""What is in a file of measurements, and whether it is what it says: units, frames, signs, padding.

Some errors show in the numbers alone (an angle of 120, a distance of 1e-8). The others show against the
scene: of all readings of a column, the right one lets the line of sight to the anchors explain what was heard
near the agent's start and on from there (`gridslam.checks.sights.line_of_sight_filter`).
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.columns import elevations, time_units
from gridslam.checks.columns.deviations import degrees, too_exact, variances
from gridslam.checks.columns.noise import noise
from gridslam.checks.scene.lines import implausible_radio
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.starts.late_tables import begins_at_start, late_line
from gridslam.checks.tables.fillers import padding
from gridslam.checks.tables.repeats import repeats_line
from gridslam.checks.tables.unit_hypotheses import ANGLES, Suspicion, absurd, beyond_radio, finite
from gridslam.checks.verdicts.against_scene import against_scene
from gridslam.checks.verdicts.verdict import UNSURE, verdict
from gridslam.errors import InputError, located
from gridslam.measurements import csv_table, hdf5_table, matlab
from gridslam.measurements.table import Measurements
from gridslam.systems.registry import METHODS
from gridslam.wording import counted
from gridslam.world.columns import ELEVATIONS, OPTIONAL, VALUES, Columns
from gridslam.world.network_scene import clock_model
from gridslam.world.scene import Scene


def read_raw(path: str | os.PathLike[str]) -> tuple[Columns, tuple]:
    """Columns and names of the anchors of a file, the content of its rows not yet checked.

    Raises
    ------
    InputError
        Not a table of measurements.
    """
    with located(path):
        kind = Path(path).suffix.lower()
        if kind == ".csv":
            return csv_table.read_csv(path, checked=False)[:2]
        if kind == ".mat":
            return matlab.read_mat(path, None, checked=False)
        whole = hdf5_table.read_h5(path, checked=False)
        names = ("step", "time_s", "anchor", *VALUES, *OPTIONAL)
        return {name: whole[name] for name in names if name in whole}, tuple(whole["anchors"])


HELD_OFFSETS = f"{UNSURE}distances hold offsets of the scene's clocks,"
"""How a line begins about a table of which no more is told here."""
TOLD_APART_M = 3.0
"""Offset of clocks up to which lines of sight are still told by their lengths."""


def describe(path: str | os.PathLike[str], scene: Scene | None = None, agent: str | None = None) -> list[str]:
    """Say what a file of measurements holds, in units, and what looks wrong with it.

    Parameters
    ----------
    path : path
        CSV, HDF5 or MATLAB file.
    scene : Scene, optional
        Lets the angles, distances and amplitudes be compared with the anchors and the agent's start.
    agent : str, optional
        Whose table it is; otherwise the scene's first agent.

    Returns
    -------
    list of str
        Lines for a person; those of suspicions start with ``suspect:``, a fault for which the file is refused
        with ``refused:``.

    Raises
    ------
    InputError
        Not a table of measurements at all, or no such agent.
    """
    columns, names = read_raw(path)
    degrees = csv_table.columns_in_degrees(path) if Path(path).suffix.lower() == ".csv" else None
    numbers = Path(path).suffix.lower() == ".mat"
    odd = implausible_radio(scene) if scene is not None else []
    offset_m = offset_allowed_m(scene, agent) if scene is not None else 0.0
    loose = offset_m > TOLD_APART_M
    lines, fault = _loaded(path, summary(columns, names), pseudo=offset_m > 0)
    lines += _without_angles(columns) if scene is not None and len(columns["step"]) else []
    lines += elevations.remarks(columns, scene, agent)
    # of a file that is refused, by a radio that can't be meant, or clocks that may be off by so much, nothing
    # is told but what numbers alone show
    judge = None if odd or loose or fault is not None else scene
    found = suspicions(columns, names, judge, agent, degrees, numbers)
    lines += _late(columns, _anchors(names, judge, numbers) if judge is not None else None, judge, agent)
    lines += _suspected(columns, odd, found, fault)
    if loose:
        lines.append(
            f"{HELD_OFFSETS} up to {offset_m:.0f} m, so that lines of sight aren't judged by their lengths"
        )
    elif scene is not None and not (found or odd or fault is not None):
        place = _anchors(names, scene, numbers)
        lines.append(verdict(columns, place, scene, _whose(scene, agent)))
    return lines


def _loaded(
    path: str | os.PathLike[str], lines: list[str], pseudo: bool
) -> tuple[list[str], InputError | None]:
    """Lines of a summary, with what a file says of itself; and the fault for which `run` refuses it."""
    try:
        whole = Measurements.load(path, pseudo=pseudo)
    except InputError as error:
        return lines, error
    known = "" if whole.truth is None else ", true track known"
    origin = [] if whole.simulated is None else [f"  simulated: {whole.simulated}"]
    return [lines[0] + known, *origin, *lines[1:]], None


def _suspected(
    columns: Columns, odd: list[str], found: list[Suspicion], fault: InputError | None
) -> list[str]:
    """What looks wrong, in lines: with the scene's radio, with columns; and for what the file is refused."""
    missing = [item for item in found if item.kind == "missing"]  # refused by `run`, too
    suspect: list[object] = [item for item in [*odd, *found] if item not in missing]
    suspect += filter(None, (repeats_line(columns), time_units.strides_line(columns["step"])))
    refused = [*([] if fault is None else [fault]), *missing]
    return [*(f"suspect: {item}" for item in suspect), *(f"refused: {item}" for item in refused)]


def _late(
    columns: Columns, place: NDArray[np.intp] | None, scene: Scene | None, agent: str | None
) -> list[str]:
    """That a table begins late, as a line: suspect where its first rows are at the start, else a remark."""
    said = late_line(columns)
    if said is None:
        return []
    if scene is None or place is None:
        return [f"  {said}"]
    table = columns | {"anchor": place[columns["anchor"]]}
    return [f"suspect: {said}" if begins_at_start(table, scene, _whose(scene, agent)) else f"  {said}"]


def _whose(scene: Scene, agent: str | None) -> str | None:
    """The agent whose table it is: the one that is told, or the scene's first."""
    return agent if agent is not None else (scene.agents[0].name if scene.agents else None)


def _without_angles(columns: Columns) -> list[str]:
    """Which methods can use distances alone, as a line."""
    if any(len(finite(columns, name)) for name in ANGLES) or not len(finite(columns, "distance_m")):
        return []
    paths = [one for one in METHODS.values() if one.takes == "paths" and one.maps and not one.several]
    able, others = ([one.name for one in paths if one.on_angles == angles] for angles in (False, True))
    return [f"  distances alone: for --method {' or '.join(able)}; {', '.join(others)} need angles"]


def offset_allowed_m(scene: Scene, agent: str | None) -> float:
    """By how much distances may be off by the scene's clocks as little as it knows of them, m."""
    whose = [agent] if agent is not None else [body.name for body in scene.agents[:1]]
    return float(clock_model(scene, whose).half_width_m.max(initial=0.0)) if scene.clocks is not None else 0.0


def summary(columns: Columns, names: tuple[str, ...]) -> list[str]:
    """What the columns hold, in their units.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    names : tuple of str
        Of its anchors.
    """
    step, count = columns["step"], len(columns["step"])
    if not count:
        return [f"measurements: no paths, anchors {', '.join(names)}"]
    steps = int(step.max()) - int(step.min()) + 1
    pairs = np.unique(np.stack([step, columns["anchor"]]), axis=1).shape[1]
    lines = [
        f"measurements: {counted(steps, 'step')} ({step.min()} to {step.max()}, "
        f"{time_units.span(columns)}), {counted(count, 'path')}, anchors {', '.join(names)}",
        f"  {count / pairs:.1f} paths in a scan (an anchor at a step), {pairs} of {steps * len(names)} "
        "scans hold any",
    ]
    lines += time_units.intervals(columns)
    for name in (*VALUES, *(name for name in ELEVATIONS if name in columns)):
        values = columns[name][~np.isnan(columns[name])] if name in columns else np.zeros(0)
        lines.append(f"  {name}: {_range(name, values, count)}")
    own = [name for name in OPTIONAL if name in columns and "_std_" in name]
    return [*lines, f"  its own standard deviations: {', '.join(own)}"] if own else lines


def _range(name: str, values: Array, count: int) -> str:
    if not len(values):
        return "not measured"
    low, middle, high = values.min(), np.median(values), values.max()
    unit = {"amplitude": "", "distance_m": " m"}.get(name, " rad")
    text = f"{low:.4g} to {high:.4g}{unit}, median {middle:.4g}"
    if name == "amplitude" and low > 0:
        text += f" (SNR {20 * np.log10(low):.1f} to {20 * np.log10(high):.1f} dB)"
    return text if len(values) == count else f"{text}, in {len(values)} of {count} rows"


def suspicions(
    columns: Columns,
    names: tuple[str, ...],
    scene: Scene | None = None,
    agent: str | None = None,
    in_degrees: dict[str, str] | None = None,
    numbers: bool = False,
) -> list[Suspicion]:
    """Find what is probably wrong with a table; without a scene only what the numbers alone show.

    `in_degrees` holds what columns of angles are called in a file where they are degrees; `numbers` says
    whether anchors may be numbered instead of named.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    names : tuple of str
        Of its anchors, of which its column `anchor` holds the places.

    Raises
    ------
    InputError
        No such agent in the scene.
    """
    found, columns = padding(columns, in_degrees)
    plain, columns = absurd(columns)
    found += plain
    if len(columns["step"]):
        found += time_units.absurd_times(columns) or time_units.set_clocks(columns)
    if scene is None or not len(columns["step"]):
        return found
    if not len(finite(columns, "distance_m")) and "distance" in scene.radio.measures:
        text = "not measured, though the scene's radio.measures has it; nothing can be mapped without"
        found.append(Suspicion("distance_m", "missing", text, True, "no row has one"))
    place = _anchors(names, scene, numbers)
    if place is None and (place := _anchors(names, scene, folded=True)) is not None:
        allowed = ", ".join(scene.anchor_names)
        text = f"names that are the scene's ({allowed}) but for upper and lower case"
        found.append(Suspicion("anchor", "case", text, True, f"found {', '.join(names)}"))
    if place is None:
        allowed = ", ".join(scene.anchor_names)
        kind = (
            "numbers that aren't names of the scene" if _numbered(names) else "names that aren't the scene's"
        )
        text = f"{kind} ({allowed})"
        return [*found, Suspicion("anchor", "anchors", text, True, f"found {', '.join(names)}")]
    table = columns | {"anchor": place[columns["anchor"]]}
    who = _whose(scene, agent)
    wide, table = degrees(table, scene, who)
    found += [*variances(table, scene), *wide]
    found += against_scene(table, scene, who, {item.column for item in plain})
    if not found:
        order = np.argsort(table["step"], kind="stable")
        table = {name: values[order] for name, values in table.items()}
        found += noise(table, explain(table, scene, who), scene)
    named = any(item.column == "distance_m" for item in found)
    return found if named else [*found, *(beyond_radio(table, scene) or too_exact(table, scene))]


def _anchors(
    names: tuple[str, ...], scene: Scene, numbers: bool = False, folded: bool = False
) -> NDArray[np.intp] | None:
    """Which of the scene's anchors each name stands for; `folded`: upper and lower case alike.

    Of files that number anchors, as MATLAB's may, `numbers` stand for them in the scene's order.
    """
    known = scene.anchor_names
    if folded:
        names, known = tuple(name.casefold() for name in names), tuple(name.casefold() for name in known)
        if len(set(names)) < len(names) or len(set(known)) < len(known):
            return None
    if all(name in known for name in names):
        return np.array([known.index(name) for name in names], dtype=np.intp)
    return np.arange(len(names)) if numbers and _numbered(names) and len(names) <= len(known) else None


def _numbered(names: tuple[str, ...]) -> bool:
    """Whether names are numbers from 1 on."""
    return sorted(names) == sorted(str(number + 1) for number in range(len(names)))
