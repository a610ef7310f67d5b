"""What is in a file of measurements, and whether it is what it says: units, frames, signs, padding.

Some errors show in the numbers alone (an angle of 120, a distance of 1e-8). The others show against the
scene: of all readings of a column, the right one lets the line of sight to the anchors explain what was heard
near the agent's start and on from there (`gridslam.checks.line_of_sight_filter`).
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks import elevations, time_units
from gridslam.checks.line_of_sight_filter import Sight, explain, turning_rad
from gridslam.checks.rivals import FITTING, STRAIGHT_RAD, fitting_cure, offset_beside, upheld, whole_cure
from gridslam.checks.unit_hypotheses import ADVICE, ANGLES, Suspicion, absurd, finite, padding, readings
from gridslam.checks.verdict import verdict
from gridslam.errors import InputError, located
from gridslam.measurements import csv_table, hdf5_table, matlab
from gridslam.measurements.table import Measurements
from gridslam.wording import counted
from gridslam.world.columns import ELEVATIONS, OPTIONAL, VALUES, Columns
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene

ENOUGH, CERTAIN = 10.0, 30.0
"""Log likelihood ratios in nats above which a reading is told, and told as certain."""
LEVEL_DB = 2.5
"""Amplitudes whose level is nearer to the expected one aren't questioned."""
MOST_OFF_DB, ENOUGH_SIGHTS = 6.0, 30
"""A level so far off is told, if so many lines of sight have it."""
ENOUGH_ROWS, FAINTEST = 200, 0.02
"""Measurements, and the share of them that must be nearly as faint as can be, for a threshold to be seen."""
SHIFTS_M = (-4.0, -2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0, 4.0)
"""Errors of all distances that might be why amplitudes don't fit."""
GAINED = 0.1
"""Share of scans that another reading must explain beyond those that the column explains as it stands."""
ALIKE = 0.95
"""Share of what the best reading explains from which on another one is named beside it."""
COMMONER = {"feet": "nanoseconds"}
"""Readings so near to a commoner one (1.7 %) that this is named first where it explains as much."""
EXPLAINED = 0.85
"""Share of scans with a line of sight above which a column isn't questioned further."""


def read_raw(path: str | os.PathLike[str], anchors: tuple[str, ...] | None = None) -> tuple[Columns, tuple]:
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
    lines = summary(columns, names)
    found = suspicions(columns, names, scene, agent)
    lines += elevations.remarks(columns, scene, agent) if scene is not None else []
    lines += [f"suspect: {item}" for item in found]
    try:
        if Measurements.load(path).truth is not None:
            lines[0] += ", true track known"
    except InputError as error:
        lines.append(f"refused: {error}")
    if scene is not None and not found:
        place = _anchors(names, scene)
        who = agent if agent is not None else (scene.agents[0].name if scene.agents else None)
        lines.append(verdict(columns, place, scene, who))
    return lines


def summary(columns: Columns, names: tuple[str, ...]) -> list[str]:
    """What the columns hold, in their units."""
    step, count = columns["step"], len(columns["step"])
    if not count:
        return [f"measurements: no paths, anchors {', '.join(names)}"]
    steps, time = int(step.max()) - int(step.min()) + 1, columns["time_s"]
    pairs = np.unique(np.stack([step, columns["anchor"]]), axis=1).shape[1]
    lines = [
        f"measurements: {counted(steps, 'step')} ({step.min()} to {step.max()}, {time.min():g} to "
        f"{time.max():g} s), {counted(count, 'path')}, anchors {', '.join(names)}",
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
    columns: Columns, names: tuple[str, ...], scene: Scene | None = None, agent: str | None = None
) -> list[Suspicion]:
    """Find what is probably wrong with a table; without a scene only what the numbers alone show.

    Raises
    ------
    InputError
        No such agent in the scene.
    """
    found, columns = padding(columns)
    plain, columns = absurd(columns)
    found += plain
    if scene is None or not len(columns["step"]):
        return found
    found += time_units.absurd_times(columns)
    if not len(finite(columns, "distance_m")) and "distance" in scene.radio.measures:
        text = "not measured, though the scene's radio.measures has it; nothing can be mapped without"
        found.append(Suspicion("distance_m", "missing", text, True, "no row has one"))
    place = _anchors(names, scene)
    if place is None and (place := _anchors(names, scene, folded=True)) is not None:
        allowed = ", ".join(scene.anchor_names)
        text = f"names that are the scene's ({allowed}) but for upper and lower case"
        found.append(Suspicion("anchor", "case", text, True, f"found {', '.join(names)}"))
    if place is None:
        allowed = ", ".join(scene.anchor_names)
        text = f"names that aren't the scene's ({allowed})"
        return [*found, Suspicion("anchor", "anchors", text, True, f"found {', '.join(names)}")]
    table = columns | {"anchor": place[columns["anchor"]]}
    who = agent if agent is not None else (scene.agents[0].name if scene.agents else None)
    return found + _against_scene(table, scene, who, {item.column for item in plain})


def _anchors(names: tuple[str, ...], scene: Scene, folded: bool = False) -> NDArray[np.intp] | None:
    """Which of the scene's anchors each name stands for, upper and lower case alike if `folded`."""
    known = scene.anchor_names
    if folded:
        names, known = tuple(name.casefold() for name in names), tuple(name.casefold() for name in known)
        if len(set(names)) < len(names) or len(set(known)) < len(known):
            return None
    if all(name in known for name in names):
        return np.array([known.index(name) for name in names], dtype=np.intp)
    numbered = all(name == str(number + 1) for number, name in enumerate(names))
    return np.arange(len(names)) if numbered and len(names) <= len(known) else None


def _against_scene(table: Columns, scene: Scene, agent: str | None, known: set[str]) -> list[Suspicion]:
    """Question the columns one after the other, each with those before it read rightly."""
    found: list[Suspicion] = []
    order = np.argsort(table["step"], kind="stable")
    table = {name: values[order] for name, values in table.items()}
    keys = {name: table[name] for name in ("step", "anchor", *OPTIONAL) if name in table}
    trusted: Columns = dict(keys)
    sight: Sight | None = None
    asis = dict(table)
    for name in ("distance_m", *ANGLES):
        if not len(finite(table, name)):
            continue
        sight = explain(trusted | {name: table[name]}, scene, agent)
        best, read, plain = sight, table[name], sight
        kind, others = "", dict[str, tuple[Array, Sight]]()
        straight = name == "aoa_rad" and _faces_along_x(scene, agent)
        if sight.explained < EXPLAINED or name == "aoa_rad":
            for label, reading in readings(name, scene, table).items():
                world = name == "aoa_rad" and label == "world frame"
                if sight.explained >= EXPLAINED and not world:
                    continue  # what explains nearly all is read rightly, but for a heading that never moves
                values = reading(table[name], keys["anchor"])
                other = explain(trusted | {name: values}, scene, agent, world)
                if world and straight and turning_rad(other.position_m) < STRAIGHT_RAD:
                    continue  # relative to a heading of 0 is the same as in the world
                if not world and other.explained < plain.explained + GAINED:
                    continue
                if other.evidence > max(plain.evidence + ENOUGH, ENOUGH):
                    others[label] = values, other
        if others:
            kind, alike = _likeliest(name, others, asis, scene, agent)
            read, best = others[kind]
            gain = best.evidence - plain.evidence
            reason = (
                f"line of sight in {best.explained:.0%} of {best.scans} scans, {plain.explained:.0%} as it "
                f"stands; log likelihood ratio {gain:.0f}"
            )
            text = _advice(name, kind)
            if alike:
                advice = "; ".join(f"{_advice(name, label)} ({share:.0%})" for label, share in alike.items())
                reason += f"; nearly as much is explained by: {advice}"
            more = best.explained >= min(plain.explained + GAINED, EXPLAINED)
            found.append(Suspicion(name, kind, text, more and gain > CERTAIN and not alike, reason))
            if kind == "swapped":
                table["aoa_rad"] = table["aod_rad"]
        if kind != "world frame" or name != "aoa_rad":
            trusted[name] = read
        sight = best
    if sight is not None:
        plain = explain(asis, scene, agent)
        if plain.explained < EXPLAINED:
            cure = whole_cure(asis, scene, agent, sight, plain)
            if cure is not None:  # it explains more than all readings of single columns
                sight, trusted = cure.sight, cure.table
                found = [cure.suspicion] if cure.suspicion is not None else []
            elif sight.explained < FITTING:
                found = []  # a reading that leaves much unexplained would make things worse
        doubtful = bool(found) or plain.explained < EXPLAINED
        if doubtful and (followed := upheld(asis, trusted, found, scene, agent)) is not None:
            found, sight, trusted = [], followed, asis
        if sight.explained >= EXPLAINED and not {"distance_m", "anchor"} & {item.column for item in found}:
            cure = fitting_cure(trusted, scene, agent, sight)
            if cure is not None:
                found += [cure.suspicion] if cure.suspicion is not None else []
                sight = cure.sight
        found = offset_beside(found, asis, trusted, scene, agent, sight)
        found += time_units.slow_times(asis, sight) + time_units.fast_times(asis, sight)
    measured = len(finite(table, "distance_m")) and len(finite(table, "amplitude"))
    found += elevations.suspicions(trusted | table, sight, scene, agent) if sight is not None else []
    if sight is not None and "amplitude" not in known and measured:
        found += _loudness(table["amplitude"], sight, scene)
    return found


def _advice(name: str, kind: str) -> str:
    """What a reading of a column is called."""
    return ADVICE[kind if kind in ADVICE else f"{kind} of {'departure' if name == 'aod_rad' else 'arrival'}"]


def _likeliest(
    name: str, others: dict[str, tuple[Array, Sight]], whole: Columns, scene: Scene, agent: str | None
) -> tuple[str, dict[str, float]]:
    """The likeliest reading of a column, and what others explain that fit nearly as well.

    Distances tell little alone: they are read together with the angles as they stand, if those fit any.
    """
    sights = {kind: sight for kind, (_, sight) in others.items()}
    if name == "distance_m" and len(others) > 1 and any(len(finite(whole, angle)) for angle in ANGLES):
        joint = {kind: explain(whole | {name: values}, scene, agent) for kind, (values, _) in others.items()}
        fitting = {kind: sight for kind, sight in joint.items() if sight.explained >= FITTING}
        sights = fitting or sights
    top = max(sight.evidence for sight in sights.values())
    first = {kind: sight for kind, sight in sights.items() if sight.evidence >= top - ENOUGH}
    best = max(first, key=lambda kind: (round(first[kind].explained, 2), first[kind].evidence))
    least = max(ALIKE * sights[best].explained, FITTING)
    if best in COMMONER and COMMONER[best] in sights and sights[COMMONER[best]].explained >= least:
        best = COMMONER[best]
    return best, {k: s.explained for k, s in sights.items() if k != best and s.explained >= least}


def _faces_along_x(scene: Scene, agent: str | None) -> bool:
    if agent is None:
        return True
    body = scene.agent(agent)
    return bool(abs(wrap(np.radians(body.start_heading_deg))) < np.radians(body.prior.heading_deg + 10))


def _loudness(amplitude: Array, sight: Sight, scene: Scene) -> list[Suspicion]:
    """Amplitudes of the lines of sight against one over the distance, the level being known to some 4 dB."""
    rows = sight.row[sight.probability > 0.7]
    near = sight.distance_m[sight.probability > 0.7]
    with np.errstate(invalid="ignore"):
        good = (amplitude[rows] > 0) & (near > 0)
    loud, near = amplitude[rows][good], near[good]
    if len(loud) < 10:
        return []
    expected = np.log(scene.signal_model().amplitude(near))
    readings = {"": np.log(loud), "dB": loud * np.log(10) / 20, "power": 0.5 * np.log(loud)}
    scores = {kind: _level(values - expected) for kind, values in readings.items()}
    kind = max(scores, key=lambda name: scores[name])
    gain = scores[kind] - scores[""]
    if kind == "power":  # distances that are all off bend the same curve
        moved = (near - shift for shift in SHIFTS_M if (near > shift).all())
        bent = (_level(readings[""] - np.log(scene.signal_model().amplitude(true))) for true in moved)
        gain = scores[kind] - max([scores[""], *bent])
    off = readings[""] - expected
    level = 20 / np.log(10) * float(np.median(off))
    shown = f"{len(loud)} lines of sight are {level:+.0f} dB off as it stands"
    stated, way = scene.radio.snr_at_1m_db, "low" if level > 0 else "high"
    louder = f"the scene's radio.snr_at_1m_db of {stated:g} dB is too {way}: {stated + level:.0f} fits"
    # decibels may be as large as what they stand for; their course with the distance isn't
    misread = bool(kind) and gain >= (ENOUGH if abs(level) >= LEVEL_DB or kind != "dB" else CERTAIN)
    misread &= abs(level) >= LEVEL_DB or kind == "dB"
    begins = gain > 0 and _at_threshold(amplitude, kind, scene) and not _at_threshold(amplitude, "", scene)
    misread |= bool(kind) and begins
    # logarithms spread more or less than what they are read as does, so densities of either aren't alike
    stretch = {"": 0.0, "power": -np.log(2) * len(loud), "dB": np.log(readings["dB"]).sum()}
    if abs(level) >= MOST_OFF_DB and len(loud) >= ENOUGH_SIGHTS:
        if not misread or (not begins and _level(off - np.median(off)) > scores[kind] + stretch[kind]):
            reason = f"{shown}; or it is {ADVICE[kind]}" if kind else shown
            return [Suspicion("amplitude", "level", louder, False, reason)]
    if not misread:
        return []
    reason = f"{shown}; log likelihood ratio {gain:.0f}"
    reason += "; so read, the faintest are at the scene's radio.detection_threshold_db" if begins else ""
    return [Suspicion("amplitude", kind, ADVICE[kind], gain > CERTAIN or begins, reason)]


def _at_threshold(amplitude: Array, kind: str, scene: Scene) -> bool:
    """Whether a reading of the amplitudes begins where the scene's radio begins to detect paths."""
    decibels, measured = scene.radio.detection_threshold_db, amplitude[np.isfinite(amplitude)]
    first = {"": 10 ** (decibels / 20), "dB": decibels, "power": 10 ** (decibels / 10)}[kind]
    if len(measured) < ENOUGH_ROWS or first <= 0:
        return False
    return bool(measured.min() > 0.98 * first and np.quantile(measured, FAINTEST) < 1.1 * first)


def _level(gap: Array, spread: float = 0.2, stray: float = 0.2) -> float:
    """Log likelihood of log amplitudes off by one common level (std 0.5); a fifth may be anything."""
    levels = np.linspace(-1.5, 1.5, 61)
    near = np.exp(-0.5 * ((gap - levels[:, None]) / spread) ** 2) / (np.sqrt(2 * np.pi) * spread)
    each = np.log((1 - stray) * near + stray / 6).sum(1) - 0.5 * (levels / 0.5) ** 2
    return float(np.logaddexp.reduce(each))
