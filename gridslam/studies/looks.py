"""How a study's figures look: lines of methods and bounds that differ in print, too, and what legends say."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator
from numpy.typing import NDArray

from gridslam.studies.batches import Batch
from gridslam.wording import counted

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLES = ("-", (0, (6, 1.5)), (0, (5, 1, 1, 1)), (0, (4, 1, 1, 1, 1, 1)))
"""Of methods: none is dotted, which is what bounds and truths are."""
DOTTED, SPARSE = (0, (1, 1)), (0, (1, 2.5))
BOUND, KNOWN = ("#303030", DOTTED), ("#8a8a8a", SPARSE)
"""Colour and style of a bound (or a truth), and of the lesser of two."""
PALE: dict[str, Any] = {"lw": 0.7, "alpha": 0.6}
"""Of the second line of a method, in its colour and style."""
WILD = 100.0
"""Times the median from which on errors need a logarithmic axis, as those of lost agents do."""
FEW_DECADES = 2.0
"""Decades of a logarithmic axis up to which more than powers of ten have numbers."""


def look(number: int) -> tuple[str, str | tuple]:
    """Colour and style of the line of a batch: either alone tells it from its neighbours, in print, too."""
    return COLORS[number % len(COLORS)], STYLES[number % len(STYLES)]


def title_of(batch: Batch) -> str:
    """What a batch is called in a legend."""
    settings = "".join(f", {key.rpartition('.')[2]}={value}" for key, value in batch.variant.settings)
    lost = f", {batch.diverged} diverged" if batch.diverged else ""
    return f"{batch.method}{settings} ({counted(batch.runs, 'run')}{lost})"


def draw_bound(
    axes: Axes, values: Sequence[NDArray[Any]], title: str, style: tuple[str, tuple] = BOUND
) -> None:
    """Draw a bound, if there is one, once if it is that of all batches, else each in its batch's colour."""
    if all(np.isnan(one).all() for one in values):
        return
    color, dots = style
    if all(np.array_equal(values[0], other, equal_nan=True) for other in values):
        axes.plot(values[0], color=color, ls=dots, lw=1.4, label=title)
        return
    for number, one in enumerate(values):
        own = f"{title}, in each one's colour" if number == 0 else None
        axes.plot(one, color=look(number)[0], ls=dots, lw=1.2, label=own)


def fit_axis(axes: Axes, which: str, errors: NDArray[Any]) -> None:
    """An axis from 0 to what errors come to, or a logarithmic one where some are far beyond the others."""
    errors = errors[np.isfinite(errors)]
    if not len(errors) or not errors.max() > 0:
        return
    if errors.max() > WILD * np.median(errors):
        axes.set(**{f"{which}scale": "log"})
    else:
        axes.set(**{f"{which}lim": (0, 1.15 * float(errors.max()))})


def tell_cut(axes: Axes, errors: Sequence[NDArray[Any]]) -> None:
    """Say above the axes how far errors (N,), one array a line, go beyond them, and at which step most."""
    known = [np.where(np.isfinite(values), values, 0.0) for values in errors]
    most, step = max((float(values.max()), int(values.argmax())) for values in known)
    if most > axes.get_ylim()[1]:
        where: dict[str, Any] = {"transform": axes.transAxes, "fontsize": "small"}
        axes.text(1, 1.02, f"cut off: up to {most:.3g}, at step {step}", ha="right", va="bottom", **where)


def log_axis(axes: Axes) -> None:
    """A logarithmic axis upwards, with plain numbers."""
    axes.set_yscale("log")
    low, high = np.log10(axes.get_ylim())
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high - low < FEW_DECADES else (1,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))


def blank(width: float, height: float) -> Figure:
    """An empty figure of a size in inches."""
    figure = Figure(figsize=(width, height), layout="constrained", dpi=150)
    FigureCanvasAgg(figure)
    return figure


def band(title: str, dark: float = 0.18) -> Patch:
    """What stands in a legend for shaded areas."""
    return Patch(fc="k", alpha=dark, lw=0, label=title)


def pale(title: str) -> Line2D:
    """What stands in a legend for the thin, pale lines of all methods."""
    return Line2D([], [], color="k", label=title, **PALE)


def legend(figure: Figure, panels: Iterable[Axes], more: Sequence[Artist] = (), columns: int = 3) -> None:
    """A legend above all of several panels: each title once, and more things at the end."""
    found: dict[str, Artist] = {}
    for axes in panels:
        for handle, title in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(title, handle)
    found |= {str(one.get_label()): one for one in more}
    style: dict[str, Any] = {"ncols": columns, "fontsize": "small", "frameon": False}
    figure.legend(list(found.values()), list(found), loc="outside upper center", **style)
