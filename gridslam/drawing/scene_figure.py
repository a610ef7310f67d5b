"""A scene as a figure, to look at it before a run: walls, anchors, scatterers, and the ways of its agents."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke

from gridslam.arrays import Array
from gridslam.drawing.anchor_labels import anchors, side_of
from gridslam.drawing.map_figure import MARGIN, frame, scatterers, sized
from gridslam.drawing.widths import PAGE_IN
from gridslam.wording import counted
from gridslam.world.geometry import unit
from gridslam.world.scene import Scene
from gridslam.world.scene_parts import Agent, Wall

WALLS = ("#404040", "#D55E00", "#56B4E9", "#E69F00", "#8C6D31", "#999999")
WAYS = ("#0072B2", "#009E73", "#CC79A7", "#A05195", "#665191")
"""Colours, in turn."""
POINTS = 72
LETTER = 0.55
"""Width of a letter, of its height."""
MOST_MATERIALS, MOST_NAMED = 8, 10
"""In the legend; and walls up to which names stand beside devices, too, where there is no other room."""
ARROWS = (0.3, 0.75)
"""Where on a way an arrow says which way it goes, of its length."""
FACING_POINTS, CLEAR_POINTS = 20, 22
"""Length of the arrows at devices; how far from them names of walls stand, if they can."""


def draw_scene(scene: Scene, width: float = PAGE_IN) -> Figure:
    """Walls by material with their names, anchors and where they face, and agents' starts and ways.

    Parameters
    ----------
    scene : Scene
    width : float, inches
    """
    tracks = {a.name: scene.track(a.name).position_m for a in scene.agents if a.waypoints_m is not None}
    window = _window(scene, list(tracks.values()))
    figure = sized(window, width=width)
    axes = figure.add_subplot()
    frame(axes, window)
    _region(axes, scene)
    _walls(axes, scene)
    scatterers(axes, scene, "#666666")
    for number, agent in enumerate(scene.agents):
        _agent(axes, scene, agent, tracks.get(agent.name), WAYS[number % len(WAYS)], number == 0)
    turned = "aod" in scene.radio.measures
    for place, angle in zip(scene.anchor_positions, scene.anchor_orientations, strict=True):
        if turned:
            _facing(axes, place, float(angle), "k")
    anchors(axes, scene, facing=turned)
    _wall_names(axes, scene, POINTS * (width - 1.0) / float(np.ptp(window[:, 0])))
    axes.set_title(plain(_title(scene)), fontsize="small")
    handles, _ = axes.get_legend_handles_labels()
    if handles:
        figure.legend(loc="outside lower center", ncols=5, fontsize="small", frameon=False)
    return figure


def plain(text: str) -> str:
    """A text of which nothing is taken for a formula."""
    return text.replace("$", r"\$")


def _window(scene: Scene, tracks: list[Array]) -> Array:
    """Corners (2, 2) m of all that there is, with a margin."""
    grid = scene.grid
    points = [np.column_stack([grid.x_m, grid.y_m]), scene.anchor_positions, scene.scatterer_positions]
    points += [wall.corners for wall in scene.walls] + tracks
    every = np.concatenate(points)
    margin = MARGIN * float(np.ptp(every, axis=0).max())
    return np.stack([every.min(0) - margin, every.max(0) + margin])


def _title(scene: Scene) -> str:
    x, y = scene.grid.x_m, scene.grid.y_m
    words = [f"{scene.name}: {x[1] - x[0]:g} m x {y[1] - y[0]:g} m to map"]
    if scene.has_heights:
        high = sorted({float(place[2]) for place in scene.anchor_places})
        words.append(f"anchors at {' to '.join(f'{z:g}' for z in dict.fromkeys((high[0], high[-1])))} m")
        words += [f"{agent.name} at {agent.height_m or 0:g} m" for agent in scene.agents[:2]]
        words += [f"{name} at {level.height_m:g} m" for name, level in scene.levels.items()]
    else:
        words += [counted(len(scene.anchors), "anchor"), counted(len(scene.walls), "wall")]
    return ", ".join(words)


def _region(axes: Axes, scene: Scene) -> None:
    """The region to map, beyond which nothing is."""
    (left, right), (low, high) = scene.grid.x_m, scene.grid.y_m
    style: dict[str, Any] = {"fill": False, "ec": "#777777", "lw": 0.8, "ls": (0, (1, 2)), "zorder": 0}
    axes.add_patch(Rectangle((left, low), right - left, high - low, label="region to map", **style))


def _kind(scene: Scene, wall: Wall) -> str:
    """What the legend calls a wall."""
    if not wall.reflects:
        return "hides lines of sight alone" if wall.blocks == "sight" else "blocks, reflects nothing"
    name = str(wall.material)
    return f"{name} ({scene.materials[name]:.3g})"


def _walls(axes: Axes, scene: Scene) -> None:
    """Walls in the colours of their materials; those that don't reflect are dashed."""
    kinds: dict[str, list[Wall]] = {}
    for wall in scene.walls:
        kinds.setdefault(_kind(scene, wall), []).append(wall)
    for number, (kind, walls) in enumerate(kinds.items()):
        style: dict[str, Any] = {"colors": WALLS[number % len(WALLS)], "linewidths": 2.0, "zorder": 2}
        style["linestyle"] = "-" if walls[0].reflects else (0, (2, 1))
        style["label"] = plain(kind) if number < MOST_MATERIALS else None
        style["capstyle"] = "projecting" if walls[0].reflects else "butt"
        axes.add_collection(LineCollection([wall.corners for wall in walls], **style))


def _wall_names(axes: Axes, scene: Scene, scale: float) -> None:
    """Names of walls along their longest pieces clear of devices, where these are as long as the names.

    Parameters
    ----------
    scale : float, points per metre
    """
    size = 6.0
    devices = np.concatenate([scene.anchor_positions, np.reshape([a.start_m for a in scene.agents], (-1, 2))])
    for wall in scene.walls:
        start, end = wall.corners[:-1], wall.corners[1:]
        length = np.linalg.norm(end - start, axis=1)
        away = np.linalg.norm(0.5 * (start + end)[:, None] - devices, axis=-1).min(1)
        longest = int(np.where(scale * away > CLEAR_POINTS, length, 0.5 * length).argmax())
        name, room = wall.name or "", scale * float(length[longest] if wall.arc is None else length.sum())
        crowded = len(scene.walls) > MOST_NAMED and scale * away[longest] < CLEAR_POINTS
        if not name or crowded or room < LETTER * size * len(name):
            continue
        if wall.arc is not None:
            longest = len(length) // 2
        (x, y), (dx, dy) = 0.5 * (start + end)[longest], (end - start)[longest]
        turn = (float(np.degrees(np.arctan2(dy, dx))) + 90) % 180 - 90
        halo = [withStroke(linewidth=1.5, foreground="w")]
        aside = 5 * unit(np.radians(turn + 90))
        axes.annotate(
            plain(name), (x, y), tuple(aside), textcoords="offset points", fontsize=size, rotation=turn,
            rotation_mode="anchor", ha="center", va="center", color="#404040", zorder=3, path_effects=halo,
        )  # fmt: skip


def _agent(axes: Axes, scene: Scene, agent: Agent, way: Array | None, color: str, first: bool) -> None:
    """Start, way and name of an agent."""
    place = np.array(agent.start_m)
    _facing(axes, place, float(np.radians(agent.start_heading_deg)), color)
    axes.plot(*place, "o", color=color, mec="w", ms=6, ls="", zorder=5, label="start" if first else None)
    if way is not None:
        axes.plot(*way.T, color=color, lw=1.2, label=plain(f"{agent.name}'s way"), zorder=4)
        along = np.append(0, np.linalg.norm(np.diff(way, axis=0), axis=1).cumsum())
        for share in ARROWS if len(way) > 1 else ():
            row = int(np.clip(np.searchsorted(along, share * along[-1]), 1, len(way) - 1))
            style = {"arrowstyle": "-|>", "color": color, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", way[row], way[row - 1], arrowprops=style, zorder=4)
        still = agent.pauses > 0
        for place, pause in zip(agent.way[still], agent.pauses[still], strict=True):
            nearest = way[np.linalg.norm(way - place, axis=1).argmin()]
            axes.plot(*nearest, "o", color=color, mfc="w", ms=4, ls="", zorder=5)
            axes.annotate(
                f"{pause:g} s", tuple(nearest), (5, -4), textcoords="offset points", fontsize=6, va="top",
                color=color, path_effects=[withStroke(linewidth=1.5, foreground="w")], zorder=6,
            )  # fmt: skip
        axes.plot(*way[-1], "s", color=color, ms=3.5, ls="", zorder=5, label="end" if first else None)
    corners = np.transpose([axes.get_xlim(), axes.get_ylim()])
    across, up = side_of(place, scene, corners, unit(np.radians(agent.start_heading_deg)))
    halo = [withStroke(linewidth=2, foreground="w")]
    axes.annotate(
        plain(agent.name), tuple(place), (4 * across, 6 * up), textcoords="offset points",
        ha="left" if across > 0 else "right", va="bottom" if up > 0 else "top", fontsize="small", color=color,
        path_effects=halo, zorder=6,
    )  # fmt: skip


def _facing(axes: Axes, place: Array, angle: float, color: str) -> None:
    """A short arrow from a device to where its array faces."""
    tip = FACING_POINTS * unit(angle)
    style = {"arrowstyle": "<-", "color": color, "lw": 0.8, "shrinkA": 0, "shrinkB": 0}  # drawn from its tip
    axes.annotate("", tuple(place), tuple(tip), textcoords="offset points", zorder=5, arrowprops=style)
