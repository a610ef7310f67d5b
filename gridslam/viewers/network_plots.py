"""Figures of several agents: offsets of their clocks over time, and all tracks."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from gridslam.drawing.anchor_labels import anchors
from gridslam.drawing.map_figure import blank, found_label
from gridslam.drawing.widths import PAGE_IN
from gridslam.runs.clock_track import ClockTrack
from gridslam.runs.run_files import RunFiles
from gridslam.world.clocks import ClockTruth

COLOURS = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000"
"""Told apart by every kind of colour vision (Okabe and Ito)."""
WALL = "#BBBBBB"
NS = 1e9


def draw_clocks(
    clocks: ClockTrack, truth: ClockTruth | None, width: float = PAGE_IN, reference: str | None = None
) -> Figure:
    """Offsets over time, and errors with three deviations where the truth is known.

    Without a reference clock, errors and deviations are those without what all clocks have in common, which
    nothing tells of.
    """
    figure = blank(width, (0.67 if truth is not None else 0.39) * width)
    rows = figure.subplots(2 if truth is not None else 1, 1, sharex=True, squeeze=False)[:, 0]
    devices = len(clocks.device)
    for number, name in enumerate(clocks.device):
        colour, style = COLOURS[number % len(COLOURS)], "-" if number < clocks.anchors else ":"
        rows[0].plot(clocks.time_s, NS * clocks.offset_s[:, number], style, color=colour, lw=1.2, label=name)
    rows[0].set_ylabel("offset (ns)")
    if truth is not None:
        rest = np.eye(devices)
        rest[slice(None) if reference is None else list(clocks.device).index(reference)] -= (
            1 / devices if reference is None else 1.0
        )
        error = clocks.errors(truth) @ rest
        spread = np.sqrt(np.maximum(np.einsum("ij,njk,ik->ni", rest, clocks.covariance_s2, rest), 0))
        for number in range(devices):
            colour = COLOURS[number % len(COLOURS)]
            band = 3 * NS * spread[:, number]
            rows[1].fill_between(clocks.time_s, -band, band, color=colour, alpha=0.08, lw=0)
            rows[1].plot(clocks.time_s, NS * error[:, number], color=colour, lw=0.9)
        settled = NS * np.abs(error[len(error) // 10 :]).max(initial=1e-10)
        rows[1].set_ylim(-2 * settled, 2 * settled)
        rows[1].set_ylabel("error without the\ncommon part (ns)" if reference is None else "error (ns)")
    rows[-1].set_xlabel("time (s)")
    handles: list[Artist] = list(rows[0].get_legend_handles_labels()[0])
    if truth is not None:
        handles.append(Patch(fc="k", alpha=0.3, lw=0, label="three standard deviations"))
    columns = min(devices + 1, 7 if width >= PAGE_IN else 4)
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, fontsize="small", frameon=False)
    return figure


def draw_tracks(run: RunFiles, width: float = PAGE_IN) -> Figure:
    """Tracks of all agents, with true ones where they are known, anchors, true walls and surfaces found."""
    figure = blank(width, 0.75 * width)
    axes = figure.subplots()
    for wall in run.scene.walls:
        axes.plot(*wall.corners.T, color=WALL, lw=3.0)
    last = next(iter(run.agents.values()))
    walls = last.map.wall_segments()
    for ends in walls.ends_m:
        axes.plot(*ends.T, color="k", lw=0.8)
    if run.scene.walls:
        axes.plot([], [], color=WALL, lw=3.0, label="true walls")
    axes.plot([], [], color="k", lw=0.8, label=found_label(last.map))
    for number, (name, found) in enumerate(run.agents.items()):
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(*found.trajectory.position_m.T, color=colour, lw=1.6, label=name)
        axes.plot(*found.trajectory.position_m[0], "o", color=colour, mec="w", ms=5)
        if found.truth is not None:
            axes.plot(*found.truth.line_m().T, color="k", lw=0.7, ls=(0, (4, 2)))
    if any(found.truth is not None for found in run.agents.values()):
        axes.plot([], [], color="k", lw=0.7, ls=(0, (4, 2)), label="true tracks")
    return _finished(figure, axes, run)


def draw_labels(run: RunFiles, width: float = PAGE_IN) -> Figure:
    """Paths to all agents at the middle step, coloured by the anchor that they are believed to come from."""
    figure = blank(width, 0.75 * width)
    axes = figure.subplots()
    for wall in run.scene.walls:
        axes.plot(*wall.corners.T, color="k", lw=1.0)
    for found in run.agents.values():
        own = found.estimates[len(found.estimates) // 2]
        for points, number in zip(own.paths.points, own.paths.anchor.tolist(), strict=True):
            there = points[~np.isnan(points[:, 0])]
            axes.plot(*there.T, color=COLOURS[number % len(COLOURS)], lw=0.9)
        axes.plot(*own.position_m, "o", color="k", mfc="w", ms=6, zorder=5)
    axes.plot([], [], "o", color="k", mfc="w", ms=6, label="agents")
    for number, anchor in enumerate(run.scene.anchors):
        axes.plot([], [], color=COLOURS[number % len(COLOURS)], label=f"taken for {anchor.name}'s")
    return _finished(figure, axes, run)


def _finished(figure: Figure, axes: Axes, run: RunFiles) -> Figure:
    anchors(axes, run.scene, 6.0)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    columns = 4 if figure.get_figwidth() >= PAGE_IN else 3
    figure.legend(loc="outside lower center", ncols=columns, fontsize="small", frameon=False)
    return figure
