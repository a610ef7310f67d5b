"""Figures of a study, after [Li2025adaptive], Figs. 4 to 6: all methods and settings side by side."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from gridslam.drawing.map_figure import FORMATS, encoded
from gridslam.drawing.widths import fonts
from gridslam.evaluation.consistency import nees_band
from gridslam.io.files import refuse_leaving, write_files
from gridslam.studies.batches import Batch
from gridslam.studies.looks import (
    BOUND,
    KNOWN,
    PALE,
    band,
    blank,
    draw_bound,
    fit_axis,
    legend,
    log_axis,
    look,
    pale,
    tell_cut,
    title_of,
)
from gridslam.systems.registry import kind_of
from gridslam.world.scene import Scene
from gridslam.world.scene_derived import surface_names

MOST_SURFACES = 12
"""Panels in the figure of single surfaces; those that are there longest come first."""
TITLE = 24
"""Letters of a surface's name in a line."""
LEAST_M, LEAST_CM, LEAST_DEG = 1e-4, 1e-2, 1e-3
"""Errors below these are drawn as these."""
ERRORS = ("position_error_m", 100.0, LEAST_CM), ("heading_error_rad", np.degrees(1.0), LEAST_DEG)
"""Errors that are drawn, with the factor to cm and degrees; the heading only where something tells of it."""
WHOLE_IN = 8.0
"""Width for which figures are laid out."""
GREY = 0.1
"""How dark shaded areas are that are of all methods."""
HIDDEN = "position_error_m", "position_claimed_m"
SETTLED = 30
"""Steps after which errors count for where axes end; a third of a shorter run."""
SHARE = "80 % of the runs"


def draw_study(
    directory: Path, found: Sequence[Batch], form: str = "png", width: float = WHOLE_IN
) -> list[Path]:
    """Draw the figures of every scene and agent into ``figures/`` and return their paths.

    None is written before all are drawn.

    Parameters
    ----------
    directory : Path
    found : sequence of Batch
    form : str
        ``png``, ``pdf`` or ``svg``.
    width : float, inches

    Raises
    ------
    InputError
        The folder can't be written to, or its figures lie elsewhere by a link.
    """
    refuse_leaving(directory, [directory / "figures"])
    groups: dict[tuple[str, str], list[Batch]] = {}
    for batch in found:
        groups.setdefault((batch.variant.name, batch.agent), []).append(batch)
    files = {}
    for (scene, agent), own in groups.items():
        for title, draw in DRAWN.items():
            with fonts(width):
                figure = draw(own)
                if figure is not None:
                    _resize(figure, width)
                    files[f"{_name(scene, agent, title)}.{form}"] = encoded(figure, form)
    return write_files(directory / "figures", files)


def drawn_before(directory: Path, found: Sequence[Batch]) -> list[Path]:
    """Figures of these scenes and agents that lie in ``figures/``, whatever their form and whenever drawn."""
    who = dict.fromkeys((batch.variant.name, batch.agent) for batch in found)
    names = [_name(*of, title) for of in who for title in DRAWN]
    every = (directory / "figures" / f"{name}.{form}" for name in names for form in FORMATS)
    return [path for path in every if path.is_file()]


def _name(scene: str, agent: str, title: str) -> str:
    """A figure's file, but for its form."""
    return re.sub(r"[^\w.-]+", "_", f"{scene}-{agent}-{title}")


def _resize(figure: Figure, width: float) -> None:
    """Give a figure another width; narrow ones keep more of their height, for what stands beside the axes."""
    figure.set_size_inches(width, (width / WHOLE_IN) ** 0.6 * figure.get_figheight())


def draw_errors(own: Sequence[Batch]) -> Figure:
    """Position and heading RMSE over time, 80 % of runs, bounds ([Li2025adaptive], Figs. 6b, 6c).

    Axes end where errors do after the first steps; errors beyond are told in words.
    """
    headed = _heading_measured(own)
    figure = blank(8, 6.5 if headed else 3.8)
    panels = figure.subplots(2 if headed else 1, 1, sharex=True, squeeze=False)[:, 0]
    for number, batch in enumerate(own):
        color, style = look(number)
        for axes, (name, scale, least) in zip(panels, ERRORS, strict=False):
            low, high = np.maximum(scale * batch.quantiles(name), least)
            axes.fill_between(np.arange(len(low)), low, high, color=color, alpha=0.18, lw=0)
            axes.plot(scale * batch.rmse(name), color=color, ls=style, lw=1.3, label=title_of(batch))
    for axes, name, (_, scale, _) in zip(panels, ("position_m", "heading_rad"), ERRORS, strict=False):
        known = [scale * getattr(batch.benchmark.known, name) for batch in own]
        unknown = [scale * getattr(batch.benchmark.unknown, name) for batch in own]
        draw_bound(axes, known, "known-map bound", KNOWN)
        draw_bound(axes, unknown, "unknown-map bound")
        axes.grid(alpha=0.3)
    for axes, what, (name, scale, _) in zip(
        panels, ("position RMSE (cm)", "heading RMSE (deg)"), ERRORS, strict=False
    ):
        axes.set_ylabel(what)
        settled = min(SETTLED, own[0].rmse(name).shape[-1] // 3)
        fit_axis(axes, "y", scale * np.concatenate([batch.quantiles(name)[1][settled:] for batch in own]))
        tell_cut(axes, [scale * batch.rmse(name) for batch in own])
    panels[-1].set_xlabel("step")
    legend(figure, panels, [band(SHARE)])
    return figure


def draw_cdf(own: Sequence[Batch]) -> Figure:
    """Share of all steps of all runs with an error below a value."""
    figure = blank(8, 3.8)
    axes = figure.subplots(1, 2 if _heading_measured(own) else 1, sharey=True, squeeze=False)[0]
    for number, batch in enumerate(own):
        color, style = look(number)
        for panel, (name, scale, least) in zip(axes, ERRORS, strict=False):
            error = np.sort(np.maximum(scale * np.abs(batch.steps[name]).ravel(), least))
            share = np.arange(1, len(error) + 1) / len(error)
            panel.step(error, share, where="post", color=color, ls=style, lw=1.3, label=title_of(batch))
    for panel, what, (name, scale, _) in zip(
        axes, ("position error (cm)", "heading error (deg)"), ERRORS, strict=False
    ):
        panel.set(xlabel=what, ylim=(0, 1.01))
        panel.grid(alpha=0.3)
        errors = scale * np.abs(np.concatenate([batch.steps[name].ravel() for batch in own]))
        fit_axis(panel, "x", errors[errors <= np.nanquantile(errors, 0.995)])
    axes[0].set_ylabel("share of steps, from the first")
    legend(figure, axes)
    return figure


def draw_mospa(own: Sequence[Batch]) -> Figure | None:
    """MOSPA of surfaces and virtual anchors, and their number, if told ([Li2025adaptive], Figs. 6a, 4b)."""
    if all(np.isnan(batch.mapped(batch.mean("surfaces"))).all() for batch in own):
        return None
    figure = blank(8, 8.5)
    distance, image, count = figure.subplots(3, 1, sharex=True)
    for number, batch in enumerate(own):
        color, style = look(number)
        for axes, name in ((distance, "surface_ospa_m"), (image, "image_ospa_m")):
            if np.isnan(batch.mapped(batch.mean(name))).all():  # it maps no surfaces
                continue
            low, high = np.maximum(batch.quantiles(name), LEAST_M)
            axes.fill_between(np.arange(len(low)), low, high, color=color, alpha=0.18, lw=0)
            axes.plot(batch.mean(name), color=color, ls=style, lw=1.3, label=title_of(batch))
        number_of = batch.mapped(batch.mean("surfaces"))
        if not np.isnan(number_of).all():
            count.plot(number_of, color=color, ls=style, lw=1.3)
    draw_bound(distance, [batch.benchmark.mospa_at_bounds_m for batch in own], "mean of the walls' bounds")
    draw_bound(count, [batch.benchmark.surfaces for batch in own], "surfaces that are there", KNOWN)
    for axes, label in (
        (distance, "MOSPA of\nthe surfaces (m)"),
        (image, "MOSPA of the\nvirtual anchors (m)"),
    ):
        axes.set_ylabel(label)
        if any((np.asarray(line.get_ydata()) > 0).any() for line in axes.lines):  # else no logarithm
            axes.set_yscale("log")
    count.set(xlabel="step", ylabel="surfaces found")
    count.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    for axes in (distance, image, count):
        axes.grid(alpha=0.3)
    legend(figure, (distance, image, count), [band(SHARE)])
    return figure


def draw_surfaces(own: Sequence[Batch]) -> Figure | None:
    """RMSE of each surface with its bound, and the share of runs that have it ([Li2025adaptive], Fig. 5).

    Surfaces are called as the scene calls their walls.
    """
    mark, scene = own[0].benchmark, Scene.from_toml(own[0].variant.scene, own[0].variant.name)
    names = surface_names(scene.walls, scene.segments())
    chosen = np.sort(np.argsort(mark.surface_since, kind="stable")[:MOST_SURFACES])
    told = [not np.isnan(batch.mapped(batch.mean("surfaces"))).all() for batch in own]
    if not len(chosen) or not any(told):  # bounds alone tell nothing of a method
        return None
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = blank(WHOLE_IN, 2.0 * rows + 0.8)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel in panels.flat[len(chosen) :]:
        panel.set_visible(False)
    for panel in panels[-2, len(chosen) % columns or columns :] if rows > 1 else ():
        panel.tick_params(labelbottom=True)
    for panel, column in zip(panels.flat, chosen, strict=False):
        share = panel.twinx()
        share.set(ylim=(0, 1.02))
        share.tick_params(labelsize="x-small", labelright=panel.get_subplotspec().is_last_col())
        for number, batch in enumerate(own):
            if not told[number]:
                continue
            color, style = look(number)
            error = batch.steps["surface_error_m"][:, column]
            panel.plot(
                batch.rmse("surface_error_m")[column],
                color=color,
                ls=style,
                lw=1.2,
                label=title_of(batch),
            )
            share.plot(np.isfinite(error).mean(0), color=color, ls=style, **PALE)
        draw_bound(
            panel,
            [batch.benchmark.unknown.surface_m[:, column] for batch in own],
            "mapping error bound",
        )
        title = fill(names[mark.unknown.surface[column]], TITLE)
        panel.set_title(title, fontsize="small")
        panel.set(yscale="log")
        panel.set_ylim(1e-3, 10)
        panel.grid(alpha=0.3)
    figure.supxlabel("step", fontsize="medium")
    figure.supylabel("RMSE (m)", fontsize="medium")
    legend(figure, list(panels.flat), [pale("share of runs that have it (right axes)")])
    return figure


def draw_rays(own: Sequence[Batch]) -> Figure | None:
    """Paths of each anchor: detected, sum of their beliefs, and true ones ([Li2025adaptive], Fig. 4a).

    None of a method that tells no paths.
    """
    anchors, told = own[0].benchmark.anchors, [batch.tells_paths for batch in own]
    if not any(told):
        return None
    figure = blank(8, 2.4 * len(anchors) + 0.8)
    panels = figure.subplots(len(anchors), 1, sharex=True, squeeze=False)[:, 0]
    for anchor, (panel, name) in enumerate(zip(panels, anchors, strict=True)):
        for number, batch in enumerate(own):
            if not told[number]:
                continue
            color, style = look(number)
            panel.plot(batch.mean("rays")[anchor], color=color, ls=style, lw=1.3, label=title_of(batch))
            panel.plot(batch.mean("ray_belief")[anchor], color=color, ls=style, **PALE)
        likely = [batch.benchmark.likely_rays[anchor] for batch in own]
        draw_bound(panel, likely, "true, likelier heard than missed", KNOWN)
        draw_bound(panel, [batch.benchmark.rays[anchor] for batch in own], "true paths")
        panel.set_ylabel(f"paths of {name}")
        panel.grid(alpha=0.3)
    panels[-1].set_xlabel("step")
    legend(figure, panels, [pale("sum of the paths' beliefs")])
    return figure


def draw_consistency(own: Sequence[Batch]) -> Figure:
    """Mean NEES of position and heading over time in the 95 % band of consistent filters."""
    headed = _heading_measured(own)
    figure = blank(8, 6 if headed else 3.5)
    panels = figure.subplots(2 if headed else 1, 1, sharex=True, squeeze=False)[:, 0]
    for panel, name, degrees in zip(panels, ("position", "heading"), (2, 1), strict=False):
        for number, batch in enumerate(own):
            color, style = look(number)
            panel.plot(batch.mean(f"{name}_nees"), color=color, ls=style, lw=1.1, label=title_of(batch))
        for runs in sorted({batch.runs for batch in own}):
            panel.axhspan(*nees_band(runs, degrees), color="k", alpha=GREY, lw=0)
        panel.axhline(degrees, color=BOUND[0], ls=BOUND[1], lw=1.4, label="mean of a consistent filter")
        panel.set_ylabel(f"mean NEES of {name}")
        log_axis(panel)
        panel.grid(alpha=0.3)
    panels[-1].set_xlabel("step")
    legend(figure, panels, [band("95 % band of a consistent filter", GREY)])
    return figure


def draw_hidden(own: Sequence[Batch]) -> Figure | None:
    """Error and claimed deviation where all lines of sight are hidden; of methods on samples alone.

    As [HybridSlam] compares its map with the line of sight alone, and with a map that is known.
    """
    hidden = own[0].benchmark.hidden
    if not hidden.any() or all(kind_of(batch.method) == "paths" for batch in own):
        return None
    figure = blank(8, 4.4)
    axes = figure.subplots()
    for number, batch in enumerate(own):
        color, _ = look(number)
        error, claimed = (np.maximum(100 * batch.rmse(name), LEAST_CM) for name in HIDDEN)
        then = [float(np.sqrt(np.mean(values[hidden] ** 2))) for values in (error, claimed)]
        label = f"{title_of(batch)}: hidden {then[0]:.3g} cm, claimed {then[1]:.3g}"
        axes.plot(error, color=color, lw=1.4, label=label)
        axes.plot(claimed, color=color, lw=1.0, ls=BOUND[1])
    axes.fill_between(
        np.arange(len(hidden)),
        0,
        1,
        where=hidden,
        color="k",
        alpha=GREY,
        lw=0,
        transform=axes.get_xaxis_transform(),
        zorder=0,
    )
    axes.set(ylabel="position RMSE (cm)", xlabel="step")
    log_axis(axes)
    axes.grid(alpha=0.3)
    claims = Line2D([], [], color="k", ls=BOUND[1], lw=1.0, label="claimed")
    legend(figure, [axes], [claims, band("no line of sight", GREY)], 1)
    return figure


def _heading_measured(own: Sequence[Batch]) -> bool:
    """Whether a heading is drawn: whether anything tells of it in any batch."""
    return any(batch.benchmark.heading_told for batch in own)


DRAWN = {
    "errors": draw_errors,
    "cdf": draw_cdf,
    "map": draw_mospa,
    "surfaces": draw_surfaces,
    "rays": draw_rays,
    "consistency": draw_consistency,
    "hidden": draw_hidden,
}
"""What is drawn of a scene and agent, by how its file is called; some of it only where there is anything."""
