"""Figures: of a finished run, drawn from its folder, and of a map alone."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from gridslam.estimates import Estimate, HypothesisEstimate
from gridslam.evaluation.ground_truth import inherited_truth, known_bound, truth_of
from gridslam.evaluation.metrics import track_errors
from gridslam.io.files import cannot_write, write_bytes
from gridslam.maps.map import Map
from gridslam.runs.run_files import AgentFiles, RunFiles, read_run
from gridslam.simulation.image_source import Truth
from gridslam.world.scene import Scene

BLUE, ORANGE, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
"""Told apart by every kind of colour vision (Okabe and Ito)."""
CELLS = ("free", "#ffffff"), ("unexplored", "#d9d9d9"), ("occupied", "#4d4d4d")
MARGIN = 0.03
"""Of the larger side of what is shown, around it."""
COLUMN_IN = 7.2
"""Width of two columns of a journal, inches."""
STRENGTH = ListedColormap(colormaps["plasma_r"](np.linspace(0.1, 1, 256)), "strength")
"""Weak paths light, so that the strong ones stand out, but none too light for paper."""


def draw_map(scene: Scene, found: AgentFiles) -> Figure:
    """Occupancy, true and estimated track, rival hypotheses, true walls and detected surfaces."""
    figure, axes = _region(found.map, scene)
    _occupancy(axes, found.map)
    _walls(axes, scene, GREEN, 1.6)
    _surfaces(axes, found.map)
    axes.plot(*found.trajectory.position_m.T, color=BLUE, lw=1.8, label="estimated track")
    if found.truth is not None:
        axes.plot(*found.truth.position_m.T, color="k", lw=0.7, ls=(0, (4, 2)), label="true track")
    axes.plot(*found.trajectory.position_m[0], "o", color=BLUE, mec="w", ms=5, label="start")
    _rivals(axes, found.estimates)
    _anchors(axes, scene)
    _legend(figure, axes)
    return figure


def draw_reflection(scene: Scene, found: AgentFiles) -> Figure:
    """Reflection coefficient of the occupied cells, beside the true walls."""
    figure, axes = _region(found.map, scene)
    _coefficients(figure, axes, found.map)
    _walls(axes, scene, "k", 0.5)
    _anchors(axes, scene)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def draw_rays(
    scene: Scene, name: str, found: AgentFiles, step: int | None = None, truth: Truth | None = None
) -> Figure:
    """Rays of one step (default: the middle one) coloured by SNR: estimated and, where known, true."""
    step = len(found.estimates) // 2 if step is None else step
    truth = _truth(scene, name, found) if truth is None else truth
    own = found.estimates[step]
    panels = [("estimated", own.paths.points, own.paths.amplitude, own.position_m)]
    if truth is not None:
        here = truth.paths.at(step)
        panels.append(("true", here.points, here.amplitude, truth.trajectory.position_m[step]))
    window = _window(found.map, scene)
    figure = _sized(window, len(panels))
    low = scene.radio.detection_threshold_db
    levels = [20 * np.log10(np.maximum(amplitude, 1e-6)) for _, _, amplitude, _ in panels]
    high = max([low + 10, *(level.max() for level in levels if len(level))])
    scale = Normalize(low, 5 * np.ceil(high / 5))
    for number, ((title, points, _, place), level) in enumerate(zip(panels, levels, strict=True)):
        axes = figure.add_subplot(1, len(panels), number + 1)
        _walls(axes, scene, "k", 1.0)
        order = np.argsort(level)  # the strongest on top
        lines = [row[~np.isnan(row[:, 0])] for row in points[order]]
        width = 0.6 + 1.4 * np.clip(scale(level[order]), 0, 1)
        axes.add_collection(LineCollection(lines, array=level[order], cmap=STRENGTH, norm=scale, lw=width))
        axes.plot(*place, "o", color="k", mfc="w", ms=6, label="agent", zorder=5)
        _anchors(axes, scene)
        _frame(axes, window)
        axes.set_title(f"{title}: {len(lines)} paths at step {own.step}", fontsize=9)
        if number:
            axes.set_ylabel("")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    weak = any((level < low).any() for level in levels)
    _colorbar(figure, figure.axes[-1], ScalarMappable(scale, STRENGTH), "SNR (dB)", weak)
    return figure


def draw_errors(
    scene: Scene,
    name: str,
    found: AgentFiles,
    truth: Truth | None = None,
    earlier: Sequence[Truth] = (),
) -> Figure:
    """Position and heading error over time against the known-map bound, and the number of surfaces.

    The true number is of the walls that could be heard of so far, by this agent and those before it.
    """
    truth = _truth(scene, name, found) if truth is None else truth
    figure = _figure(COLUMN_IN, 5.6)
    position, heading, count = figure.subplots(3, 1, sharex=True)
    steps = np.array([e.step for e in found.estimates])
    if found.truth is not None:
        gap, turn = track_errors(found.trajectory, found.truth)
        position.semilogy(steps, 100 * np.linalg.norm(gap, axis=1), color=BLUE, lw=0.9, label="error")
        heading.semilogy(steps, np.degrees(np.abs(turn)), color=BLUE, lw=0.9)
        bound = known_bound(scene, name, truth)
        if bound is not None:
            size = len(steps)
            style = {"color": ORANGE, "lw": 1.6, "ls": "--"}
            position.semilogy(steps, 100 * bound.position_m[:size], label="known-map bound (RMS)", **style)
            heading.semilogy(steps, np.degrees(bound.heading_rad[:size]), **style)
        position.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, fontsize=8, frameon=False)
    else:
        deviation = np.sqrt([np.diag(e.covariance)[[0, 1, 4]] for e in found.estimates])
        position.semilogy(steps, 100 * np.hypot(*deviation[:, :2].T), color=BLUE, lw=0.9)
        heading.semilogy(steps, np.degrees(deviation[:, 2]), color=BLUE, lw=0.9)
    kind = "error" if found.truth is not None else "standard deviation"
    position.set_ylabel(f"position\n{kind} (cm)")
    heading.set_ylabel(f"heading\n{kind} (deg)")
    number = [int(e.detected.sum()) for e in found.estimates]
    count.step(steps, number, where="mid", color=BLUE, lw=2.0, label="detected")
    true: list[int] = []
    if truth is not None:
        true = _seen_so_far(truth, earlier, len(steps))
        count.step(steps, true, where="mid", color="k", lw=0.9, ls="--", label="true, heard of so far")
        count.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, fontsize=8, frameon=False)
    top = 1.15 * max([1, *number, *true])
    count.set(xlabel="step", ylabel="surfaces", ylim=(0, top), xlim=(steps[0], max(steps[-1], steps[0] + 1)))
    count.yaxis.set_major_locator(MaxNLocator(integer=True))
    for axes in (position, heading, count):
        axes.grid(alpha=0.3)
    for axes in (position, heading):  # where an error crosses zero is of no interest
        axes.set_ylim(bottom=max(axes.get_ylim()[0], 0.03 * np.median(axes.lines[0].get_ydata())))
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 3)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    figure.align_ylabels()
    return figure


def draw_all(directory: str | os.PathLike[str], run: RunFiles | None = None) -> list[Path]:
    """Draw all figures of a run's folder into ``figures/`` and return their paths.

    Raises
    ------
    InputError
        Not a run's folder, or it can't be written to.
    """
    folder = Path(directory) / "figures"
    run = read_run(directory) if run is None else run
    written: list[Path] = []
    first = next(iter(run.agents.values()))
    earlier = inherited_truth(run.scene, first.map, latest=False)
    for name, found in run.agents.items():
        truth = _truth(run.scene, name, found)
        drawn = {
            "map": draw_map(run.scene, found),
            "reflection": draw_reflection(run.scene, found),
            "rays": draw_rays(run.scene, name, found, truth=truth),
            "errors": draw_errors(run.scene, name, found, truth, earlier),
        }
        written += _save(folder, {f"{name}-{title}": figure for title, figure in drawn.items()})
        earlier += [truth] if truth is not None else []
    return written


def draw_export(grid: Map, directory: str | os.PathLike[str]) -> list[Path]:
    """Draw ``occupancy.png`` and ``reflection.png`` of a map alone and return their paths.

    Raises
    ------
    InputError
        The folder can't be written to.
    """
    first, axes = _region(grid)
    _occupancy(axes, grid)
    _surfaces(axes, grid)
    _legend(first, axes)
    second, axes = _region(grid)
    _coefficients(second, axes, grid)
    return _save(Path(directory), {"occupancy": first, "reflection": second})


def _truth(scene: Scene, name: str, found: AgentFiles) -> Truth | None:
    truth = truth_of(scene, name, found.truth)
    return truth if isinstance(truth, Truth) else None


def _seen_so_far(truth: Truth, earlier: Sequence[Truth], steps: int) -> list[int]:
    """How many true surfaces some path had hit by each step."""
    surface = truth.segments.surface
    seen = {int(s) for other in earlier for s in surface[other.paths.segment[other.paths.segment >= 0]]}
    counts = []
    for step in range(steps):
        hit = truth.paths.segment[truth.paths.step == step]
        seen |= set(surface[hit[hit >= 0]].tolist())
        counts.append(len(seen))
    return counts


def _save(folder: Path, figures: dict[str, Figure]) -> list[Path]:
    """Write figures as PNG, each whole or not at all."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
    for title, figure in figures.items():
        picture = io.BytesIO()
        figure.savefig(picture, format="png", bbox_inches="tight", pad_inches=0.05)
        write_bytes(folder / f"{title}.png", picture.getvalue())
    return [folder / f"{title}.png" for title in figures]


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained", dpi=200)
    FigureCanvasAgg(figure)
    return figure


def _window(grid: Map, scene: Scene | None = None) -> np.ndarray:
    """Corners (2, 2), m, lower left first, of what is worth seeing: observed cells, walls, anchors."""
    region = np.stack([grid.origin_m, grid.corner_m])
    cells = np.argwhere(grid.observed)[:, ::-1]
    seen = [grid.origin_m + grid.cell_m * cells, grid.origin_m + grid.cell_m * (cells + 1)]
    if scene is not None:
        walls = scene.segments()
        seen += [walls.start.reshape(-1, 2), walls.end.reshape(-1, 2), scene.anchor_positions]
    points = np.concatenate(seen)
    if not len(points):
        return region
    margin = MARGIN * float(np.ptp(points, axis=0).max())
    return np.clip(np.stack([points.min(0) - margin, points.max(0) + margin]), *region)


def _sized(window: np.ndarray, panels: int = 1) -> Figure:
    """Figure whose height follows the shape of the window, within reason."""
    width, height = window[1] - window[0]
    share = float(np.clip(height / width, 0.3, 1.3)) / panels
    return _figure(COLUMN_IN, share * (COLUMN_IN - 1.4) + 1.2)


def _region(grid: Map, scene: Scene | None = None) -> tuple[Figure, Axes]:
    window = _window(grid, scene)
    figure = _sized(window)
    axes = figure.add_subplot()
    _frame(axes, window)
    return figure, axes


def _frame(axes: Axes, window: np.ndarray) -> None:
    (left, bottom), (right, top) = window
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="x (m)", ylabel="y (m)")


def _cells(axes: Axes, grid: Map, shown: np.ndarray, **style: Any) -> AxesImage:
    """A picture of cells that leaves the limits of the axes as they are."""
    limits = axes.axis()
    image = axes.imshow(shown, origin="lower", extent=_extent(grid), interpolation="nearest", **style)
    axes.axis(limits)
    return image


def _extent(grid: Map) -> tuple[float, float, float, float]:
    (left, bottom), (right, top) = grid.origin_m.tolist(), grid.corner_m.tolist()
    return left, right, bottom, top


def _occupancy(axes: Axes, grid: Map) -> None:
    classes = np.where(~grid.observed, 1, np.where(grid.occupied, 2, 0))
    colors = ListedColormap([color for _, color in CELLS])
    _cells(axes, grid, classes, cmap=colors, vmin=0, vmax=2)


def _coefficients(figure: Figure, axes: Axes, grid: Map) -> None:
    axes.set_facecolor("#f2f2f2")
    shown = np.where(grid.occupied, grid.reflection, np.nan)
    image = _cells(axes, grid, shown, cmap="viridis", vmin=0, vmax=1)
    _colorbar(figure, axes, image, "reflection coefficient (amplitude)")


def _colorbar(figure: Figure, axes: Axes, scale: ScalarMappable, label: str, weak: bool = False) -> None:
    """Colour bar as high as the axes, whatever their shape."""
    side, ticks = axes.inset_axes((1.03, 0, 0.035, 1)), MaxNLocator(6, steps=[1, 2, 5])
    figure.colorbar(scale, cax=side, label=label, extend="min" if weak else "neither", ticks=ticks)


def _walls(axes: Axes, scene: Scene, color: str, width: float) -> None:
    walls = scene.segments()
    if len(walls):
        pieces = LineCollection(list(np.stack([walls.start, walls.end], 1)), colors=color, linewidths=width)
        pieces.set_label("true walls")
        axes.add_collection(pieces)


def _surfaces(axes: Axes, grid: Map) -> None:
    ends = grid.wall_segments().ends_m
    pieces = LineCollection(list(ends), colors=ORANGE, linewidths=1.0, label="surfaces found", zorder=3)
    pieces.set_linestyle((0, (4, 2)))
    axes.add_collection(pieces)


def _rivals(axes: Axes, estimates: Sequence[Estimate]) -> None:
    """Where else the agent could have been: all hypotheses but the likeliest, the larger the likelier."""
    rivals = HypothesisEstimate.stack([e.hypotheses.take(slice(1, None)) for e in estimates])
    if len(rivals):
        size = 2 + 16 * rivals.weight
        x, y = rivals.position_m.T
        axes.scatter(x, y, size, color=PURPLE, lw=0, alpha=0.6, label="other hypotheses", zorder=4)


def _anchors(axes: Axes, scene: Scene) -> None:
    place = scene.anchor_positions
    axes.plot(*place.T, "^", color="k", mec="w", ms=8, ls="", label="anchors", zorder=6)
    for name, (x, y) in zip(scene.anchor_names, place, strict=True):
        halo = [withStroke(linewidth=2, foreground="w")]
        style: dict[str, Any] = {"fontsize": 8, "path_effects": halo, "zorder": 6}
        axes.annotate(name, (x, y), (6, 5), textcoords="offset points", annotation_clip=True, **style)


def _legend(figure: Figure, axes: Axes) -> None:
    """Legend below the axes, the meaning of the cells included."""
    handles, _ = axes.get_legend_handles_labels()
    cells = [Patch(fc=color, ec="#808080", lw=0.5, label=title) for title, color in CELLS]
    whole = [*handles, *cells]
    figure.legend(
        handles=whole, loc="outside lower center", ncols=min(5, len(whole)), fontsize=8, frameon=False
    )
