"""Figures of a finished run, drawn from its folder."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from gridslam.bounds import known_map_bound
from gridslam.geometry import wrap
from gridslam.runfiles import AgentFiles, RunFiles, read_run
from gridslam.scene import Scene
from gridslam.simulate import true_paths

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#7f7f7f"


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained", dpi=200)
    FigureCanvasAgg(figure)
    return figure


def _frame(axes: Axes, scene: Scene) -> None:
    axes.set(xlim=scene.grid.x_m, ylim=scene.grid.y_m, aspect="equal", xlabel="x (m)", ylabel="y (m)")


def _walls(axes: Axes, scene: Scene, color: str = GREEN, width: float = 0.8) -> None:
    walls = scene.segments()
    if len(walls):
        pieces = LineCollection(list(np.stack([walls.start, walls.end], 1)), colors=color, linewidths=width)
        pieces.set_label("true walls")
        axes.add_collection(pieces)


def _anchors(axes: Axes, scene: Scene) -> None:
    place = scene.anchor_positions
    axes.plot(*place.T, "^", color="k", ms=6, label="anchors", zorder=5)
    for name, (x, y) in zip(scene.anchor_names, place, strict=True):
        axes.annotate(name, (x, y), (4, 4), textcoords="offset points", fontsize=8)


def _extent(found: AgentFiles) -> tuple[float, float, float, float]:
    low, high = found.map.origin_m, found.map.corner_m
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def draw_map(scene: Scene, found: AgentFiles) -> Figure:
    """Occupancy, true and estimated track, true walls and detected surfaces."""
    figure = _figure(8, 6)
    axes = figure.add_subplot()
    classes = np.where(~found.map.observed, 1, np.where(found.map.occupied, 2, 0))
    colors = ListedColormap(["#ffffff", "#dcdcdc", "#303030"])
    axes.imshow(
        classes, origin="lower", extent=_extent(found), cmap=colors, vmin=0, vmax=2, interpolation="nearest"
    )
    _walls(axes, scene)
    last = found.estimates[-1]
    detected = last.surfaces.take(last.detected)
    ends = detected.ends_m
    ends = ends[np.isfinite(ends).all((1, 2))]
    axes.add_collection(
        LineCollection(list(ends), colors=ORANGE, linewidths=2.5, alpha=0.6, label="surfaces found")
    )
    if found.truth is not None:
        axes.plot(*found.truth.position_m.T, color="k", lw=2.2, alpha=0.35, label="true track")
    axes.plot(*found.trajectory.position_m.T, color=BLUE, lw=1.0, label="estimated track")
    _anchors(axes, scene)
    _frame(axes, scene)
    figure.legend(loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    axes.set_title("white: free, light grey: unexplored, dark: occupied", fontsize=9)
    return figure


def draw_reflection(scene: Scene, found: AgentFiles) -> Figure:
    """Reflection coefficient of the occupied cells."""
    figure = _figure(8, 5.6)
    axes = figure.add_subplot()
    axes.set_facecolor("#f2f2f2")
    shown = np.where(found.map.occupied, found.map.reflection, np.nan)
    image = axes.imshow(
        shown, origin="lower", extent=_extent(found), cmap="viridis", vmin=0, vmax=1, interpolation="nearest"
    )
    figure.colorbar(image, ax=axes, label="reflection coefficient", shrink=0.8)
    _walls(axes, scene, GREY, 0.4)
    _frame(axes, scene)
    return figure


def draw_rays(scene: Scene, name: str, found: AgentFiles, step: int | None = None) -> Figure:
    """Rays of one step coloured by SNR: estimated, and true where the walls are known."""
    step = len(found.estimates) // 2 if step is None else step
    panels = [("estimated", found.estimates[step].paths.points, found.estimates[step].paths.amplitude)]
    if found.truth is not None and scene.walls:
        true = true_paths(scene, name).at(step)
        panels.append(("true", true.points, true.amplitude))
    figure = _figure(6 * len(panels), 4.6)
    scale = Normalize(6, 40)
    for number, (title, points, amplitude) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), number + 1)
        _walls(axes, scene, "k", 0.8)
        lines = [row[~np.isnan(row[:, 0])] for row in points]
        bundle = LineCollection(
            lines, array=20 * np.log10(np.maximum(amplitude, 1e-3)), cmap="plasma", norm=scale, lw=1.2
        )
        axes.add_collection(bundle)
        _anchors(axes, scene)
        _frame(axes, scene)
        axes.set_title(f"{title}, step {step}: {len(lines)} paths", fontsize=9)
        if number == len(panels) - 1:
            figure.colorbar(bundle, ax=axes, label="SNR (dB)", shrink=0.8)
    return figure


def draw_errors(scene: Scene, name: str, found: AgentFiles) -> Figure:
    """Position and heading error over time against the known-map bound, and the number of surfaces."""
    figure = _figure(8, 7)
    position, heading, count = figure.subplots(3, 1, sharex=True)
    number = np.array([int(e.detected.sum()) for e in found.estimates])
    steps = np.arange(len(number))
    if found.truth is not None:
        size = min(len(number), len(found.truth))
        gap = found.trajectory.position_m[:size] - found.truth.position_m[:size]
        turn = wrap(found.trajectory.heading_rad[:size] - found.truth.heading_rad[:size])
        position.semilogy(steps[:size], np.linalg.norm(gap, axis=1), color=BLUE, lw=0.9, label="error")
        heading.semilogy(steps[:size], np.degrees(np.abs(turn)), color=BLUE, lw=0.9)
        if scene.walls:
            bound = known_map_bound(scene, name)
            position.semilogy(bound.position_m[:size], color=ORANGE, label="known-map bound")
            heading.semilogy(np.degrees(bound.heading_rad[:size]), color=ORANGE)
        position.legend(fontsize=8, frameon=False)
    position.set_ylabel("position error (m)")
    heading.set_ylabel("heading error (deg)")
    count.step(steps, number, where="mid", color=BLUE)
    count.set(xlabel="step", ylabel="surfaces found")
    for axes in (position, heading, count):
        axes.grid(alpha=0.3)
    return figure


def draw_all(directory: str | os.PathLike[str], run: RunFiles | None = None) -> list[Path]:
    """Draw all figures of a run's folder into ``figures/`` and return their paths."""
    folder = Path(directory) / "figures"
    run = read_run(directory) if run is None else run
    folder.mkdir(exist_ok=True)
    written = []
    for name, found in run.agents.items():
        for title, figure in (
            ("map", draw_map(run.scene, found)),
            ("reflection", draw_reflection(run.scene, found)),
            ("rays", draw_rays(run.scene, name, found)),
            ("errors", draw_errors(run.scene, name, found)),
        ):
            written.append(folder / f"{name}-{title}.png")
            figure.savefig(written[-1])
    return written
