"""Floor plans as files: the scene that can be edited, and a picture of it to check it by."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gridslam.importers.floorplans import Plan, letters, printable
from gridslam.io.files import write_bytes
from gridslam.wording import counted
from gridslam.world.scene_parts import Wall

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def write_plan(plan: Plan, path: str | os.PathLike[str]) -> Path:
    """Write the scene file and a picture of it beside it.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    InputError
        The scene has a fault, or the folder can't be written to.
    """
    path = Path(path)
    text, picture = plan.toml(), path.with_suffix(".png")
    image = _picture(plan)
    write_bytes(path, text.encode("utf-8"))
    write_bytes(picture, image)
    return picture


def _picture(plan: Plan) -> bytes:
    """Walls by material, anchors and start, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    x, y = plan.region
    wide, high = x[1] - x[0], y[1] - y[0]
    scale = 7.0 / max(wide, high)
    figure = Figure(
        figsize=(max(wide * scale, 3) + 1, max(high * scale, 3) + 1), layout="constrained", dpi=120
    )
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _draw(axes, plan)
    axes.set(xlim=x, ylim=y, aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.set_title(
        f"{plan.name}: {counted(len(plan.lines), 'wall')}, {wide:g} m x {high:g} m to map".replace(
            "$", r"\$"
        ),
        fontsize=9,
    )
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _draw(axes: Axes, plan: Plan) -> None:
    """Walls in the colours of their materials, anchors and start with the ways they face."""
    from matplotlib.collections import LineCollection
    from matplotlib.patheffects import withStroke

    palette = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
    for number, (material, (value, _)) in enumerate(plan.materials.items()):
        own = [line for line in plan.lines if line.material == material]
        walls = [Wall.checked(line.wall, plan.source).corners for line in own]
        label = f"{printable(material)} ({value:g})".replace("$", r"\$") if number < 12 else None
        axes.add_collection(LineCollection(walls, colors=palette[number % len(palette)], lw=1.4, label=label))
    for number, (px, py, facing) in enumerate(plan.anchors):
        axes.plot(px, py, "k^", ms=6, label="anchors" if number == 0 else None)
        aside = -9 * np.array([np.cos(np.radians(facing)), np.sin(np.radians(facing))])  # off the arrow
        axes.annotate(
            letters(number), (px, py), tuple(aside), textcoords="offset points", fontsize=8, ha="center",
            va="center", path_effects=[withStroke(linewidth=2.0, foreground="w")],
        )  # fmt: skip
        _arrow(axes, px, py, facing)
    if plan.start:
        axes.plot(*plan.start[:2], "ko", mfc="w", ms=6, label="start")
        _arrow(axes, *plan.start)


def _arrow(axes: Axes, x: float, y: float, facing: float) -> None:
    """One metre long; `facing` in degrees."""
    tip = (x + np.cos(np.radians(facing)), y + np.sin(np.radians(facing)))
    axes.annotate("", tip, (x, y), arrowprops={"arrowstyle": "->", "lw": 0.8})
