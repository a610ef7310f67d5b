"""One page about a study: what its runs amount to, and its figures."""

from __future__ import annotations

import csv
from collections.abc import Callable
from html import escape
from itertools import product
from pathlib import Path

import numpy as np

from gridslam.errors import InputError
from gridslam.io.files import refuse_leaving
from gridslam.studies.columns import SUMMARY as COLUMNS
from gridslam.viewers.page import MIME, picture, refuse_other, table, write_page

SUMMARY = "summary.csv"
SCORES: dict[str, tuple[str, Callable[[float], str]]] = {
    "runs": ("runs", "{:.0f}".format),
    "diverged": ("diverged", "{:.0f}".format),
    "position_settled_rmse_m": ("position, RMSE", lambda v: f"{100 * v:.2f} cm"),
    "position_settled_standard_error_m": ("its standard error over seeds", lambda v: f"{100 * v:.2f} cm"),
    "position_less_first_m": ("RMSE minus the first method's, same seeds", lambda v: f"{100 * v:+.2f} cm"),
    "position_less_first_standard_error_m": ("standard error of that", lambda v: f"{100 * v:.2f} cm"),
    "position_to_unknown_map_bound": ("over the bound of an unknown map", "{:.2f}".format),
    "position_to_known_map_bound": ("of a known map", "{:.2f}".format),
    "position_settled_nees": ("squared error over own variance (2 is right)", "{:.2f}".format),
    "position_settled_median_nees": ("the same, median (1.39 is right)", "{:.2f}".format),
    "silent_steps": ("steps off by over 4 claimed deviations while health is well", "{:.0f}".format),
    "heading_settled_rmse_deg": ("heading, RMSE", "{:.2f} deg".format),
    "heading_to_unknown_map_bound": ("over its bound", "{:.2f}".format),
    "surface_ospa_m": ("surfaces at the end, OSPA", lambda v: f"{100 * v:.1f} cm"),
    "surface_gospa_m": ("surfaces at the end, GOSPA", "{:.2f} m".format),
    "image_ospa_m": ("virtual anchors, OSPA", lambda v: f"{100 * v:.1f} cm"),
    "seconds_per_step": ("time per step", lambda v: f"{1000 * v:.1f} ms"),
}
CAPTIONS = {
    "errors": "Errors over the steps, with bounds.",
    "cdf": "How errors are distributed.",
    "map": "Errors of the surfaces (MOSPA) and how many there are.",
    "surfaces": "Errors of single surfaces.",
    "rays": "Paths believed in.",
    "consistency": "Squared errors over claimed variances.",
    "hidden": "Errors while all lines of sight are hidden.",
}
"""What is drawn, by how the names of figures end; in the order of the page."""


def is_study(folder: Path) -> bool:
    """Whether a folder is one that a study wrote its tables into."""
    return (folder / SUMMARY).is_file() and (folder / "study.jsonl").is_file()


def write_study_report(folder: Path, overwrite: bool = False) -> Path:
    """Write ``report.html`` into a study's folder and return its path.

    Parameters
    ----------
    folder : Path
    overwrite : bool
        Whether a page of this name that isn't such a report may be replaced, too.

    Raises
    ------
    InputError
        The table can't be read or the folder not written to, something else has the report's name, or
        figures are links to elsewhere.
    """
    refuse_other(folder, overwrite)
    refuse_leaving(folder, [folder / SUMMARY, folder / "figures", *(folder / "figures").glob("*")])
    rows = _summary(folder / SUMMARY)
    scenes = ", ".join(dict.fromkeys(row["scene"] for row in rows))
    parts = [
        f"<h1>Study: {escape(scenes)}</h1>",
        "<p>Errors are of the steps from step 50 on.</p>",
        _scores(rows),
    ]
    figures = [path for path in sorted((folder / "figures").glob("*")) if path.suffix in MIME]
    for scene in dict.fromkeys(_parts(path)[0] for path in figures):
        parts.append(f"<h2>{escape(scene)}</h2>")
        own = {_parts(path)[1]: path for path in figures if _parts(path)[0] == scene}
        parts += [picture(own[kind], told) for kind, told in CAPTIONS.items() if kind in own]
    return write_page(folder, f"study of {scenes}", parts)


def _parts(figure: Path) -> tuple[str, str]:
    """Of which scene and agent a figure is, and of what."""
    scene, _, kind = figure.stem.rpartition("-")
    return scene, kind


def _summary(path: Path) -> list[dict[str, str]]:
    """Rows of a study's table."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file, strict=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(str(path), "none that can be read", "the table of a study") from error
    if not rows or not {"scene", "method", "runs"} <= set(rows[0]):
        raise InputError(str(path), "another table", "that of a study")
    for row, one in product(rows, COLUMNS):
        told = row.get(one.name)
        try:
            wrong = bool(told) and one.kind != "text" and bool(one.refuses(np.array(float(told or "nan"))))
        except ValueError:
            wrong = True
        if wrong:
            raise InputError(f"{path}: {one.name}", repr(told), f"a number, {one.allowed}")
    return rows


def _scores(rows: list[dict[str, str]]) -> str:
    """A column for whatever tells one row from another, then scores; one that no row has is left out."""
    names = list(rows[0])
    who = names[: names.index("runs")]
    who = [name for name in who if len({row[name] for row in rows}) > 1] or ["method"]
    told = [key for key in SCORES if any(row.get(key) for row in rows)]
    cells = [
        [
            *(row[name] for name in who),
            *(SCORES[key][1](float(row[key])) if row[key] else "-" for key in told),
        ]
        for row in rows
    ]
    return table([*who, *(SCORES[key][0] for key in told)], cells)
