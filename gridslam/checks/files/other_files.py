"""What `check` says of files that runs, exports and studies leave: steps, tracks, nav2 maps, folders."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.errors import InputError
from gridslam.runs.notes import SUSPECT, run_notes
from gridslam.runs.run_files import read_run
from gridslam.runs.step_files import read_steps
from gridslam.wording import counted
from gridslam.world.trajectory import Trajectory

TRACKS, NAV2 = (".tum",), (".yaml", ".yml", ".pgm")
PICTURES: dict[str, tuple[bytes, ...]] = {
    ".png": (b"\x89png",), ".svg": (b"<svg", b"<?xml"), ".pdf": (b"%pdf",), ".gif": (b"gif8",),
    ".html": (b"<!doctype html", b"<html"), ".mp4": (b"ftyp",),
}  # fmt: skip
"""Endings of pictures and pages, and how they begin."""
LARGEST_BYTES = 2**28
"""Of a picture of cells, or a text beside it."""


def picture_line(path: Path) -> str:
    """A picture or a page, of which there is nothing to check.

    Raises
    ------
    InputError
        It is none.
    """
    try:
        with path.open("rb") as file:
            start = file.read(512).lstrip().lower()
    except OSError as error:
        raise InputError(str(path), error.strerror or "an unreadable file", "a picture or a page") from error
    if not any(start.startswith(mark) or mark in start[:300] for mark in PICTURES[path.suffix.lower()]):
        raise InputError(str(path), "another content than its name says", f"a {path.suffix[1:]} file")
    return "a page or picture, as runs and studies make them: nothing in it to check"


def steps_line(path: Path) -> str:
    """A run's ``steps.h5`` in a line.

    Raises
    ------
    InputError
        It can't be read as such.
    """
    steps = read_steps(path)
    if not steps:
        return "estimates over no steps"
    last = steps[-1]
    surfaces = counted(int(last.detected.sum()), "surface")
    span = f"steps {steps[0].step} to {last.step}, {steps[0].time_s:g} to {last.time_s:g} s"
    return f"estimates over {counted(len(steps), 'step')} ({span}): at the end {surfaces}"


def track_line(path: Path) -> str:
    """A TUM track in a line.

    Raises
    ------
    InputError
        It can't be read as such.
    """
    track = Trajectory.from_tum(path)
    long = float(np.linalg.norm(np.diff(track.position_m, axis=0), axis=1).sum())
    line = f"track: {len(track)} poses, {track.time_s[0]:g} to {track.time_s[-1]:g} s, {long:.1f} m long"
    if track.height_m is None:
        return line
    low, high = track.height_m.min(), track.height_m.max()
    return f"{line}, {f'{low:.2f} to {high:.2f}' if high - low > 0.005 else f'{low:.2f}'} m high"


def run_line(folder: Path) -> str:
    """A run's folder in a line, and one for all that was said of it.

    Raises
    ------
    InputError
        It is none, or some of it can't be read.
    """
    found = read_run(folder)
    each = []
    for name, own in found.agents.items():
        score = found.summary["agents"][name]
        steps = counted(len(own.estimates), "step")
        if score.get("interrupted"):
            steps = f"cut short, {len(own.estimates)} of {counted(len(own.measurements), 'step')}"
        each.append(f"{name} ({', '.join([steps, *_found(score)])})")
    line = f"run of {found.scene.name} by {found.summary.get('method', '?')}: {', '.join(each)}"
    return "\n".join([line, *(_as_line(note) for note in run_notes(found))])


def _as_line(note: str) -> str:
    """A note of a run, as `check` words it."""
    who, _, what = note.partition(SUSPECT)
    return f"suspect: {who}: {what}" if what else f"note: {note}"


def _found(score: Mapping[str, Any]) -> list[str]:
    """Surfaces and features, as the table of `run` counts them."""
    things = {"surface": score.get("surfaces_detected"), "feature": score.get("features")}
    return [counted(number, thing) for thing, number in things.items() if isinstance(number, int)]


EXPORTED = "map.yaml", "reflection.yaml", "cells.csv", "surfaces.csv", "occupancy.png", "reflection.png"
MAYBE_EXPORTED = ("map.png", "surfaces.geojson", "features.*", "unexplained.*", "*-track.csv")
"""What every export writes, and what some do; other files in its folder are others'."""


def is_export(folder: Path) -> bool:
    """Whether an export of a map stands in a folder, and neither a run nor a study."""
    others = ("run.json", "study.jsonl")
    return (folder / "cells.csv").is_file() and not any((folder / name).exists() for name in others)


def export_lines(folder: Path, describe: Callable[[Path], str]) -> str:
    """An export's folder: a line for each file of it.

    Raises
    ------
    InputError
        One is missing or can't be read.
    """
    more = [path for name in MAYBE_EXPORTED for path in sorted(folder.glob(name))]
    files = [*(folder / name for name in EXPORTED), *more]
    return "\n".join(["export of a map:", *(f"{path.name}: {describe(path)}" for path in files)])


def study_line(folder: Path) -> str:
    """A study's folder in a line.

    Raises
    ------
    InputError
        Its results can't be read.
    """
    path = folder / "study.jsonl"
    try:
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise InputError(str(path), "lines that can't be read", "results of a study") from error
    done = sum(isinstance(line, dict) and "key" in line for line in lines)
    return f"study: {counted(done, 'finished run')}"


MOST_PERCENT = 100
"""Largest value of a cell of a raw nav2 map; what is above is unknown."""


def nav2_line(path: Path) -> str:
    """A map of nav2 (its YAML or the picture beside it) in a line.

    Raises
    ------
    InputError
        It isn't as nav2 has it, or the picture is cut short.
    """
    text = path if path.suffix != ".pgm" else path.with_suffix(".yaml")
    known = _yaml(text)
    for key in ("image", "resolution", "origin"):
        if key not in known:
            raise InputError(str(text), f"no {key!r}", "image, resolution and origin, as nav2 has them")
    picture = text.parent / Path(known["image"]).name
    width, height, cells = _pgm(picture)
    try:
        side = float(known["resolution"])
        origin = [float(number) for number in known["origin"].strip("[] ").split(",")]
    except ValueError as error:
        raise InputError(str(text), "resolution or origin that is no number", "metres") from error
    shares = [float((cells == value).mean()) for value in (0, 254, 205)]
    line = ", ".join(
        f"{share:.0%} {kind}" for share, kind in zip(shares, ("occupied", "free", "unknown"), strict=True)
    )
    if known.get("mode") == "raw":  # as of reflection coefficients
        values = cells[cells <= MOST_PERCENT]
        line = f"percents in {values.size / cells.size:.0%} of the cells"
        line += f", {values.min()} to {values.max()}" if values.size else ""
    place = f"lower left corner at {origin[0]:g}, {origin[1]:g} m"
    return f"nav2 map: {width} x {height} cells of {side:g} m, {place}; {line}"


def _yaml(path: Path) -> dict[str, str]:
    """Keys and values of a file of plain ``key: value`` lines, all that nav2's maps need."""
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise InputError(str(path), f"{path.stat().st_size} bytes", f"at most {LARGEST_BYTES}")
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "bytes that aren't text"
        raise InputError(str(path), reason, "a YAML file of a nav2 map") from error
    pairs = (line.partition(":") for line in lines if not line.lstrip().startswith("#"))
    return {key.strip(): value.strip().strip("\"'") for key, colon, value in pairs if colon}


def _pgm(path: Path) -> tuple[int, int, np.ndarray]:
    """Width, height and values of a binary PGM."""
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise InputError(str(path), f"{path.stat().st_size} bytes", f"at most {LARGEST_BYTES}")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "the picture of a nav2 map") from error
    words: list[bytes] = []
    place = 0
    while len(words) < 4 and place < min(len(content), 4096):
        if content[place : place + 1] == b"#":
            place = content.find(b"\n", place) + 1 or len(content)
        elif content[place : place + 1].isspace():
            place += 1
        else:
            end = place
            while end < len(content) and not content[end : end + 1].isspace():
                end += 1
            words.append(content[place:end])
            place = end
    good = (
        len(words) == 4 and words[0] == b"P5" and all(word.isdigit() and len(word) < 8 for word in words[1:])
    )
    width, height = (int(words[1]), int(words[2])) if good else (0, 0)
    cells = np.frombuffer(content[place + 1 :], np.uint8)
    if not good or not len(cells) or len(cells) != width * height:
        found = f"{len(cells)} values for {width} x {height} cells" if good else "no PGM of one byte a cell"
        raise InputError(str(path), found, "a whole binary PGM")
    return width, height, cells
