"""One page about a run that opens anywhere, offline: scores, figures, surfaces, settings."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.io.files import refuse_leaving
from gridslam.maps.map import Map
from gridslam.runs.notes import run_notes
from gridslam.runs.run_files import AgentFiles, RunFiles, read_run
from gridslam.viewers.animation import animate, film_ending
from gridslam.viewers.page import data_of, picture, refuse_other, table, write_page
from gridslam.viewers.plots import draw_all
from gridslam.wording import counted

SCORES: dict[str, tuple[str, Callable[[float], str]]] = {
    "steps": ("steps", "{:.0f}".format),
    "position_rmse_m": ("position, RMSE", lambda v: f"{100 * v:.2f} cm"),
    "position_bound_m": ("position, known-map bound", lambda v: f"{100 * v:.2f} cm"),
    "position_std_m": ("position, own standard deviation", lambda v: f"{100 * v:.2f} cm"),
    "position_nees": ("position, squared error over own variance (2 is right)", "{:.2f}".format),
    "position_median_nees": ("the same, median (1.39 is right)", "{:.2f}".format),
    "silent_steps": ("steps off by over 4 claimed deviations while health is well", "{:.0f}".format),
    "position_p95_m": ("position, 95 %", lambda v: f"{100 * v:.2f} cm"),
    "final_position_error_m": ("position, at the end", lambda v: f"{100 * v:.2f} cm"),
    "heading_rmse_deg": ("heading, RMSE", "{:.2f} deg".format),
    "heading_bound_deg": ("heading, known-map bound", "{:.2f} deg".format),
    "heading_std_deg": ("heading, own standard deviation", "{:.2f} deg".format),
    "surfaces_detected": ("surfaces found", "{:.0f}".format),
    "features": ("learned features", "{:.0f}".format),
    "surfaces_matched": ("true surfaces among them, each curved wall once", "{:.0f}".format),
    "surfaces_false": ("surfaces found where none is", "{:.0f}".format),
    "surfaces_true": ("true surfaces that paths hit", "{:.0f}".format),
    "surface_ospa_m": ("surfaces, OSPA (cut-off 5 m)", lambda v: f"{100 * v:.1f} cm"),
    "surface_gospa_m": ("surfaces, GOSPA (each missing or false one 2.5 m)", "{:.2f} m".format),
    "reflection_mae": ("reflection coefficient, mean error", "{:.3f}".format),
    "occupied_precision": ("cells called occupied that are", "{:.1%}".format),
    "occupied_recall": ("cells hit that were found", "{:.1%}".format),
    "free_precision": ("cells called free that are", "{:.1%}".format),
    "free_recall": ("cells crossed that are called free", "{:.1%}".format),
    "seconds_per_step": ("time per step", lambda v: f"{1000 * v:.0f} ms"),
    "peak_memory_mb": ("memory", "{:.0f} MB".format),
}
NOT_HIT, OPEN, ONE_PLACE = "not hit yet", "open by its cells", "one place"
UNDRAWN = {
    NOT_HIT: "believed in, but no path off it was surely heard: where on its line it stands isn't known",
    OPEN: "rays went through all cells along it, so no wall is drawn",
    ONE_PLACE: "hit at one place alone, so its length isn't known",
}
"""What stands in the table of a surface that has no wall of some length, and why."""
CAPTIONS = {
    "map": "Map: the track, and what was found.",
    "reflection": "Reflection coefficients of the occupied cells.",
    "rays": "Paths of one step.",
    "errors": "Errors over time.",
    "features": "Features learned, with three standard deviations, over the true walls.",
    "sights": "Lines of sight over time: whether they are there, and how strong.",
    "signal": "Delay profile of each anchor at one step, and the paths believed in (features are none).",
    "images": "Images of each anchor: those found, places where others may be, true virtual anchors.",
    "gospa": "Errors of the images of anchors over time (GOSPA).",
}


def write_report(
    directory: str | os.PathLike[str],
    moving: bool = True,
    progress: Callable[[int, int], None] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write ``report.html`` into a run's folder and return its path.

    A report is made of its run's folder alone: one that was made before is replaced, as figures are.

    Parameters
    ----------
    directory : path
        A run's folder; if it has no figures, they are drawn.
    moving : bool
        With a moving picture of each agent, also written as ``figures/NAME-run.mp4`` (or ``.gif``).
    progress : callable, optional
        Called after every frame of the moving pictures with (done, in all).
    overwrite : bool
        Whether a page of this name that isn't such a report may be replaced, too.

    Raises
    ------
    InputError
        Not a run's folder, one that can't be written to, something else of the report's name in it, or
        figures that are links to elsewhere.
    """
    folder = Path(directory)
    run = read_run(folder)
    refuse_other(folder, overwrite)
    refuse_leaving(folder, [folder / "figures", *(folder / "figures").glob("*")])
    figures = sorted((folder / "figures").glob("*.png")) or draw_all(folder)
    parts = [_head(run), _scores(run.summary.get("agents", {}))]
    for place, (name, found) in enumerate(run.agents.items()):
        parts.append(f"<h2>{escape(name)}</h2>")
        if moving:
            film = folder / "figures" / f"{name}-run{film_ending()}"
            parts.append(_film(run, name, found, film, _share(progress, place, len(run.agents))))
        own = {p.stem.removeprefix(f"{name}-"): p for p in figures if p.stem.startswith(f"{name}-")}
        titles = [title for title in CAPTIONS if title in own] + [t for t in own if t not in CAPTIONS]
        parts += [picture(own[title], CAPTIONS.get(title, title)) for title in titles]
        mapped = run.summary.get("agents", {}).get(name, {}).get("surfaces_detected", 0) is not None
        parts += [surface_table(found.map)] if mapped else []
    names = tuple(f"{name}-" for name in run.agents)
    parts += [picture(path, path.stem) for path in figures if not path.stem.startswith(names)]
    parts.append(_settings(run))
    return write_page(folder, run.scene.name, parts)


def _share(
    progress: Callable[[int, int], None] | None, place: int, count: int
) -> Callable[[int, int], None] | None:
    return None if progress is None else lambda done, total: progress(place * total + done, count * total)


def _head(run: RunFiles) -> str:
    scene, summary, earlier = run.scene, run.summary, run.summary.get("map")
    facts = [
        f"anchors {', '.join(scene.anchor_names)}",
        "true walls known" if scene.walls else "walls not known",
        f"method {summary.get('method', '?')}",
        f"seed {summary.get('seed', '?')}",
        f"device {summary.get('device', '?')}",
        *([f"begun with {earlier.get('file', '?')}"] if isinstance(earlier, dict) else []),
    ]
    about = f"<p>{escape(scene.description)}</p>" if scene.description else ""
    notes = "".join(f"<p><strong>Note:</strong> {escape(note)}</p>" for note in run_notes(run))
    return f"<h1>{escape(scene.name)}</h1>{about}\n<p>{escape(', '.join(facts))}</p>{notes}"


def _scores(agents: Mapping[str, Any]) -> str:
    """One column per agent; a score that nobody has is left out."""
    flat = {name: {**scores, **(scores.get("map") or {})} for name, scores in agents.items()}
    rows = []
    for key, (label, form) in SCORES.items():
        values = [scores.get(key) for scores in flat.values()]
        if any(value is not None for value in values):
            rows.append([label, *("-" if value is None else form(value) for value in values)])
    return table(["", *flat], rows)


def _film(
    run: RunFiles, name: str, found: AgentFiles, path: Path, progress: Callable[[int, int], None] | None
) -> str:
    width, height = animate(run.scene, found, path, progress=progress)
    what = f"{name}: blue the track and where the agent may be, orange surfaces found, thin lines the paths"
    if run.scene.walls:
        what += ", green true walls"
    if path.suffix == ".gif":
        return picture(path, what)
    text = escape(what, quote=True)
    size = f'width="{width}" height="{height}"'  # known before it is loaded: nothing jumps
    tag = f'<video controls loop muted autoplay playsinline {size} aria-label="{text}" src="{data_of(path)}">'
    return f"<figure>{tag}</video><figcaption>{text}</figcaption></figure>"


def surface_table(grid: Map) -> str:
    """The surfaces of a map, and where each of them is a wall, as HTML."""
    known = grid.surfaces
    if known is None or not len(known):
        return "<p>No surface was found.</p>"
    rows, walls = [], grid.wall_segments()
    for number, learned in enumerate(known.reflection_learned):
        spread = np.sqrt(max(known.reflection_var[number], 0))
        own = walls.surface == number
        stretches, length = walls.ends_m[own], walls.length_m[own].sum()
        nowhere = OPEN if np.isfinite(known.extent_m[number]).all() else NOT_HIT
        rows.append(
            [
                str(int(known.identity[number])),
                "; ".join(f"{x:.2f}, {y:.2f}" for x, y in stretches[:, 0]) or nowhere,
                "; ".join(f"{x:.2f}, {y:.2f}" for x, y in stretches[:, 1]) or "-",
                "-" if not len(stretches) else f"{length:.2f} m" if length >= 0.005 else ONE_PLACE,
                f"{known.reflection[number]:.2f} ± {spread:.2f}" if learned else "not measured",
                f"{known.existence[number]:.3f}",
            ]
        )
    titles = ["surface", "from (m)", "to (m)", "length", "reflection", "existence"]
    notes = [f"{word}: {why}" for word, why in UNDRAWN.items() if any(word in row for row in rows)]
    more = f"<p>{escape('; '.join(notes))}.</p>" if notes else ""
    summary = f"<summary>{counted(len(rows), 'surface')}</summary>"
    return f"<details open>{summary}{table(titles, rows)}{more}</details>"


def _settings(run: RunFiles) -> str:
    whole = run.scene.model_dump(exclude_none=True)
    rows = [
        [name, _plain(value)]
        for part in ("radio", "grid", "filter")
        for name, value in _flat(part, whole[part])
    ]
    rows += [[f"material {name}", f"{value:g}"] for name, value in whole["materials"].items()]
    rows += [
        [f"anchor {item.name}", f"{_plain(item.position_m)} m, {item.orientation_deg:g} deg"]
        for item in run.scene.anchors
    ]
    versions = run.summary.get("versions")
    rows += [[name, str(value)] for name, value in versions.items()] if isinstance(versions, dict) else []
    return f"<h2>Settings</h2>\n{table(['', 'value'], rows)}"


def _flat(name: str, value: Any) -> Iterable[tuple[str, Any]]:
    """Names and values of a table and of the tables in it."""
    if not isinstance(value, Mapping):
        return [(name, value)]
    return [pair for key, item in value.items() for pair in _flat(f"{name}.{key}", item)]


def _plain(value: Any) -> str:
    """A value as people write it."""
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    return f"{value:.12g}" if isinstance(value, float) else str(value)
