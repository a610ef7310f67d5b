"""A map as a figure: cells, true walls, surfaces found, track and anchors."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape
from typing import Any, Protocol

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Ellipse, Patch
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.drawing.anchor_labels import Standing, anchors
from gridslam.drawing.widths import PAGE_IN, WIDE_IN
from gridslam.estimate_tables import HypothesisEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.world.geometry import unit
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

BLUE, ORANGE, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
"""Told apart by every kind of colour vision (Okabe and Ito)."""
CELLS = ("free", "#ffffff"), ("unexplored", "#d9d9d9"), ("occupied", "#4d4d4d")
MARGIN = 0.03
"""Of the larger side of what is shown, around it."""
FORMATS = ("png", "pdf", "svg")
STILL: dict[str, dict[str, Any]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""No time of drawing in a file: the same run gives the same figures."""
UNARRANGED: Any = {"figure.autolayout": False, "figure.constrained_layout.use": False}  # whatever users set
PAD_IN = 0.05
"""Above and below what is drawn, inches."""
LAYOUTS = 2
"""Times that a figure is laid out: ticks change with the size of the axes, and the axes with the ticks."""
OUTLINE, BAND = 0.8, 1.8
"""Widths of true walls, points: as a line, and as a pale outline on which surfaces found are seen."""
DASHED, DOTTED = {"linestyle": (0, (4, 2))}, {"linestyle": (0, (1, 1.5)), "alpha": 0.4}  # not seen first
SPOT = 0.01
"""Of the larger side of what is shown: shorter stretches have a dot, or nobody would see them."""
NEAREST: dict[str, Any] = {"interpolation": "nearest", "interpolation_stage": "data"}
"""Cells as they are; the other stage makes four doubles of every cell before it picks those that are seen."""


class Walls(Protocol):
    """Stretches of surfaces: rows (W,) of their table, ends (W, 2, 2) in m, indexed [stretch, end, xy]."""

    @property
    def surface(self) -> NDArray[np.int64]: ...  # noqa: D102
    @property
    def ends_m(self) -> NDArray[np.float64]: ...  # noqa: D102


class Cells(Protocol):
    """What is drawn of a `gridslam.Map`."""

    @property
    def origin_m(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def corner_m(self) -> NDArray[np.float64]: ...  # noqa: D102
    @property
    def cell_m(self) -> float: ...  # noqa: D102
    @property
    def observed(self) -> NDArray[np.bool_]: ...  # noqa: D102
    @property
    def occupied(self) -> NDArray[np.bool_]: ...  # noqa: D102
    @property
    def reflection(self) -> NDArray[np.float64]: ...  # noqa: D102

    @property
    def surfaces(self) -> SurfaceEstimate | None: ...  # noqa: D102
    @property
    def stretches(self) -> object | None: ...  # noqa: D102
    @property
    def anchors(self) -> Standing | None: ...  # noqa: D102

    def wall_segments(self) -> Walls: ...  # noqa: D102


def draw_map(
    grid: Cells,
    scene: Scene | None = None,
    track: Trajectory | None = None,
    truth: Trajectory | None = None,
    estimates: Sequence[Estimate] = (),
    width: float = PAGE_IN,
    false: NDArray[np.bool_] | None = None,
) -> Figure:
    """Occupancy and detected surfaces and, where given, estimated and true track, true walls and anchors.

    Parameters
    ----------
    grid : Cells
    scene : Scene, optional
    track, truth : Trajectory, optional
    estimates : sequence of Estimate
        Their rival hypotheses are shown.
    width : float, inches
    false : (S,) bool, optional
        Of the map's surfaces, those that lie at no true one.
    """
    figure, axes = region(grid, scene, width)
    mapped = bool(grid.observed.any())  # some methods map no cells
    if mapped:
        occupancy(axes, grid)
    if scene is not None:
        true_walls(axes, scene, GREEN, BAND, 0.5)
    surfaces(axes, grid, false)
    if track is not None:
        axes.plot(*track.position_m.T, color=BLUE, lw=1.8, label="estimated track", zorder=4)
    if truth is not None:
        style: dict[str, Any] = {"color": "k", "lw": 0.7, "ls": (0, (4, 2)), "zorder": 4}
        axes.plot(*truth.line_m().T, label="true track", **style)
    if track is not None:
        axes.plot(*track.position_m[0], "o", color=BLUE, mec="w", ms=5, label="start", zorder=5)
    rivals(axes, estimates)
    if scene is not None:
        anchors(axes, scene, found=grid.anchors)
    legend(figure, axes, mapped)
    return figure


def draw_reflection(grid: Cells, scene: Scene | None = None, width: float = PAGE_IN) -> Figure:
    """Reflection coefficient of the occupied cells, over the true walls if there is a scene."""
    figure, axes = region(grid, scene, width)
    axes.set_facecolor("#f2f2f2")
    shown = np.where(grid.occupied, grid.reflection, np.nan)
    image = _cells(axes, grid, shown, cmap="viridis", vmin=0, vmax=1, zorder=2)
    colorbar(figure, axes, image, "reflection coefficient (amplitude)")
    if not np.isfinite(shown).any():
        axes.set_title("not measured", fontsize="small")
    if scene is not None:
        true_walls(axes, scene, "k", 0.5)
        anchors(axes, scene)
        figure.legend(loc="outside lower center", ncols=4, fontsize="small", frameon=False)
    return figure


def encoded(figure: Figure, form: str = "png") -> bytes:
    """A figure as a file's content: ``png``, ``pdf`` or ``svg``; its width, and the height in use."""
    content = io.BytesIO()
    with rc_context({"pdf.fonttype": 42, "svg.hashsalt": "gridslam"} | UNARRANGED):
        fit_legends(figure)
        drawn, engine = figure.get_tightbbox(), figure.get_layout_engine()
        out = max(-drawn.x0, drawn.x1 - figure.get_figwidth())
        if out > 0 and isinstance(engine, ConstrainedLayoutEngine):  # it was laid out for other ticks
            engine.set(w_pad=PAD_IN + out)
            lay_out(figure)
            drawn = figure.get_tightbbox()
        cut = Bbox([[0, drawn.y0 - PAD_IN], [figure.get_figwidth(), drawn.y1 + PAD_IN]])
        figure.set_layout_engine(None)  # it is laid out; any engine, "none" too, would draw it twice
        figure.savefig(content, format=form, bbox_inches=cut, metadata=STILL[form])
        figure.set_layout_engine(engine)
    return content.getvalue()


def lay_out(figure: Figure, times: int = 1) -> None:
    """Put axes and legends where there is room for them."""
    if engine := figure.get_layout_engine():
        for _ in range(times):
            engine.execute(figure)


def fit_legends(figure: Figure) -> None:
    """Legends that are wider than the figure, wherever they are, get fewer columns; lays the figure out."""
    lay_out(figure, LAYOUTS)
    before = list(figure.legends)
    for legend in before:
        low = legend.get_window_extent().y0 < 0.5 * figure.bbox.height
        place: Any = f"outside {'lower' if low else 'upper'} center"
        handles, texts = legend.legend_handles, legend.get_texts()
        columns, titles = len(texts), [text.get_text() for text in texts]
        while columns > 1 and legend.get_window_extent().width > figure.bbox.width:
            columns -= 1
            legend.remove()
            legend = figure.legend(
                [one for one in handles if one is not None], titles, loc=place, ncols=columns,
                fontsize=texts[0].get_fontsize(), frameon=False,
            )  # fmt: skip
    if figure.legends != before:
        lay_out(figure, LAYOUTS)


def inlined(figure: Figure, title: str) -> str:
    """HTML of a figure that holds the picture itself, as notebooks show it."""
    code = base64.b64encode(encoded(figure)).decode("ascii")
    image = f'<img style="max-width:44rem" alt="{escape(title)}" src="data:image/png;base64,{code}">'
    return f"<p>{escape(title)}</p>{image}"


def blank(width: float, height: float) -> Figure:
    """An empty figure of a size in inches."""
    figure = Figure(figsize=(width, height), layout="constrained", dpi=200)
    FigureCanvasAgg(figure)
    return figure


def window_of(grid: Cells, scene: Scene | None = None) -> NDArray[np.float64]:
    """Corners (2, 2), m, lower left first, of what is worth seeing: observed cells, walls, anchors."""
    whole = np.stack([grid.origin_m, grid.corner_m])
    cells = np.argwhere(grid.observed)[:, ::-1]
    seen = [grid.origin_m + grid.cell_m * cells, grid.origin_m + grid.cell_m * (cells + 1)]
    if scene is not None:
        walls = scene.segments()
        seen += [walls.start.reshape(-1, 2), walls.end.reshape(-1, 2), scene.anchor_positions]
        seen.append(scene.scatterer_positions)
    points = np.concatenate(seen)
    if not len(points):
        return whole
    margin = MARGIN * float(np.ptp(points, axis=0).max())
    return np.clip(np.stack([points.min(0) - margin, points.max(0) + margin]), *whole)


def sized(window: NDArray[np.float64], panels: int = 1, width: float = PAGE_IN) -> Figure:
    """Figure whose height follows the shape of the window, within reason."""
    across, up = window[1] - window[0]
    share = float(np.clip(up / across, 0.3, 1.3)) / panels
    return blank(width, share * (width - 1.4) + 1.2)


def region(grid: Cells, scene: Scene | None = None, width: float = PAGE_IN) -> tuple[Figure, Axes]:
    """A figure with axes over what is worth seeing of a map."""
    window = window_of(grid, scene)
    figure = sized(window, width=width)
    axes = figure.add_subplot()
    frame(axes, window)
    return figure, axes


def frame(axes: Axes, window: NDArray[np.float64]) -> None:
    """Limits and labels of axes in metres."""
    (left, bottom), (right, top) = window
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="x (m)", ylabel="y (m)")


def _cells(axes: Axes, grid: Cells, shown: NDArray, **style: Any) -> AxesImage:
    """A picture of cells that leaves the limits of the axes as they are."""
    limits = axes.axis()
    (left, bottom), (right, top) = grid.origin_m.tolist(), grid.corner_m.tolist()
    image = axes.imshow(shown, origin="lower", extent=(left, right, bottom, top), **NEAREST, **style)
    axes.axis(limits)
    return image


def occupancy(axes: Axes, grid: Cells) -> None:
    """Free and unexplored cells at the bottom, occupied ones above the true walls."""
    colors = ListedColormap([color for _, color in CELLS])
    _cells(axes, grid, (~grid.observed).astype(np.uint8), cmap=colors, vmin=0, vmax=2, zorder=0)
    occupied = np.ma.masked_array(np.full(grid.observed.shape, 2, np.uint8), ~(grid.observed & grid.occupied))
    _cells(axes, grid, occupied, cmap=colors, vmin=0, vmax=2, zorder=2)


def colorbar(figure: Figure, axes: Axes, scale: ScalarMappable, label: str, weak: bool = False) -> None:
    """Colour bar as high as the axes, whatever their shape."""
    side, ticks = axes.inset_axes((1.03, 0, 0.035, 1)), MaxNLocator(6, steps=[1, 2, 5])
    figure.colorbar(scale, cax=side, label=label, extend="min" if weak else "neither", ticks=ticks)


def true_walls(axes: Axes, scene: Scene, color: str, width: float, alpha: float = 1.0) -> None:
    """The scene's walls as outlines, below occupied cells."""
    walls = scene.segments()
    if len(walls):
        lines = list(np.stack([walls.start, walls.end], 1))
        style: dict[str, Any] = {"colors": color, "linewidths": width, "alpha": alpha, "zorder": 1}
        axes.add_collection(LineCollection(lines, label="true walls", **style))
    scatterers(axes, scene, color)


def scatterers(axes: Axes, scene: Scene, color: str) -> None:
    """The scene's scatterers as rings."""
    if len(place := scene.scatterer_positions):
        style: dict[str, Any] = {"color": color, "mfc": "none", "ms": 3, "mew": 0.6, "zorder": 1}
        axes.plot(*place.T, "o", ls="", label="true scatterers", **style)


def surfaces(axes: Axes, grid: Cells, false: NDArray[np.bool_] | None = None) -> None:
    """Surfaces found: dashed where there is a wall; dotted, whole and pale, those that nothing bears out.

    Those that are `false` (S,) have a colour of their own.
    """
    walls, table = grid.wall_segments(), grid.surfaces
    if table is None:
        return
    doubt = "not in cells" if grid.observed.any() else "hardly hit"
    wrong = np.zeros(len(table), bool) if false is None else false
    bare = np.setdiff1d(np.arange(len(table)), walls.surface)
    (left, bottom), (right, top) = zip(axes.get_xlim(), axes.get_ylim(), strict=True)
    far, wide = 2 * float(np.abs([left, right, bottom, top]).max()), max(right - left, top - bottom)
    extent = np.where(np.isfinite(table.extent_m[bare]), table.extent_m[bare], [-far, far])
    angle, offset = table.line[bare].T
    foot, along = offset[:, None] * unit(angle), unit(angle + 0.5 * np.pi)
    lines = foot[:, None] + extent[:, :, None] * along[:, None]
    for ends, rows, dotted in ((walls.ends_m, walls.surface, False), (lines, bare, True)):
        for mine, color, width, label in (
            (~wrong[rows], ORANGE, 1.0, "surfaces found" if dotted else found_label(grid)),
            (wrong[rows], PURPLE, 1.6, "found where none is"),
        ):
            if mine.any() or (color == ORANGE and not dotted):
                pieces = LineCollection(list(ends[mine]), colors=color, linewidths=width, zorder=3)
                pieces.set(**DOTTED if dotted else DASHED)
                pieces.set_label(f"{label}, {doubt}" if dotted else label)
                axes.add_collection(pieces)
                spots = mine & (np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) < SPOT * wide)
                axes.plot(*ends[spots].mean(1).T, "o", ms=2.5 * width, color=color, zorder=3)


def found_label(grid: Cells) -> str:
    """What the legend calls surfaces found."""
    where = ", from first hit to last" if grid.stretches is None else ", where they were hit"
    return "surfaces found" + where * (not grid.observed.any())


def rivals(axes: Axes, estimates: Sequence[Estimate]) -> None:
    """Where else the agent could have been: all hypotheses but the likeliest, the larger the likelier."""
    others = HypothesisEstimate.stack([e.hypotheses.take(slice(1, None)) for e in estimates])
    if len(others):
        size, (x, y) = 2 + 16 * others.weight, others.position_m.T
        axes.scatter(x, y, size, color=PURPLE, lw=0, alpha=0.6, label="other hypotheses", zorder=4)


def legend(figure: Figure, axes: Axes, mapped: bool = True) -> None:
    """Legend below the axes, with the meaning of the cells where there are any."""
    handles, _ = axes.get_legend_handles_labels()
    cells = [Patch(fc=color, ec="#808080", lw=0.5, label=title) for title, color in CELLS]
    whole = [*handles, *(cells if mapped else [])]
    if not whole:
        return
    most = 5 if figure.get_figwidth() > WIDE_IN else 3
    style: dict[str, Any] = {"ncols": min(most, len(whole)), "fontsize": "small", "frameon": False}
    figure.legend(handles=whole, loc="outside lower center", **style)


def ellipse(axes: Axes, place: Array, covariance: Array, color: str) -> None:
    """Draw three standard deviations about a place (2,), m, by its covariance (2, 2), m^2."""
    value, vector = np.linalg.eigh(covariance)
    long, short = 6 * np.sqrt(np.maximum(value[::-1], 0))
    turn = float(np.degrees(np.arctan2(vector[1, 1], vector[0, 1])))
    axes.add_patch(Ellipse((place[0], place[1]), long, short, angle=turn, fill=False, color=color))
