"""Figures of a finished run, drawn from its folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from gridslam.drawing.anchor_labels import anchors
from gridslam.drawing.map_figure import (
    BLUE,
    GREEN,
    ORANGE,
    OUTLINE,
    blank,
    colorbar,
    draw_map,
    draw_reflection,
    encoded,
    frame,
    sized,
    true_walls,
    window_of,
)
from gridslam.drawing.widths import PAGE_IN, fonts
from gridslam.errors import InputError, Unwritten
from gridslam.evaluation.ground_truth import inherited_truth, known_bound, tells_heading, truth_of
from gridslam.evaluation.metrics import SETTLED_STEP, track_errors
from gridslam.evaluation.surface_truth import AudibleSurfaces, false_surfaces
from gridslam.io.files import refuse_leaving, write_files
from gridslam.measurements.recording import Recording
from gridslam.runs import network_files
from gridslam.runs.run_files import AgentFiles, RunFiles, fault_of, read_run
from gridslam.simulation.image_source import Truth
from gridslam.systems.registry import kind_of, maps_features
from gridslam.viewers import network_plots
from gridslam.viewers.feature_plots import draw_features, draw_sights
from gridslam.viewers.signal_plots import (
    BELIEVED,
    draw_gospa,
    draw_images,
    draw_signal,
    has_images,
    typical_step,
)
from gridslam.wording import counted
from gridslam.world.observation import Kind
from gridslam.world.scene import Scene

TITLES = (
    "map", "errors", "rays", "reflection", "signal", "gospa", "images", "sights", "features",
)  # fmt: skip
TITLES_OF_ALL = ("clocks", "tracks", "labels")
"""Figures of one agent, after its name, and of all together."""
STRENGTH = ListedColormap(colormaps["plasma_r"](np.linspace(0.1, 1, 256)), "strength")
"""Weak paths light, so that the strong ones stand out, but none too light for paper."""


def draw_rays(
    scene: Scene,
    name: str,
    found: AgentFiles,
    step: int | None = None,
    truth: Truth | None = None,
    width: float = PAGE_IN,
) -> Figure:
    """Rays of one step (default: `typical_step`) coloured by SNR: estimated and, where known, true."""
    step = typical_step(found.estimates) if step is None else step
    truth = _truth(scene, name, found) if truth is None else truth
    own = found.estimates[step]
    paths = own.paths.take(own.paths.existence > BELIEVED)
    panels = [("estimated", paths.points, paths.amplitude, own.position_m)]
    if truth is not None:
        here = truth.paths.at(step)
        panels.append(("true", here.points, here.amplitude, truth.trajectory.position_m[step]))
    window = window_of(found.map, scene)
    figure = sized(window, len(panels), width)
    low = scene.radio.detection_threshold_db
    silent = not measures_amplitudes(found)
    levels = [20 * np.log10(np.maximum(amplitude, 1e-6)) for _, _, amplitude, _ in panels]
    high = max([low + 10, *(level.max() for level in levels if len(level))])
    scale = Normalize(low, 5 * np.ceil(high / 5))
    for number, ((title, points, _, place), level) in enumerate(zip(panels, levels, strict=True)):
        axes = figure.add_subplot(1, len(panels), number + 1)
        true_walls(axes, scene, "k", OUTLINE)
        order = np.argsort(level)  # the strongest on top
        lines = [row[~np.isnan(row[:, 0])] for row in points[order]]
        thick = 0.6 + 1.4 * np.clip(scale(level[order]), 0, 1)
        look: dict[str, Any] = {"array": level[order], "cmap": STRENGTH, "norm": scale, "lw": thick}
        if not number and silent:  # what is believed of their strength, nothing has told
            look, title = {"color": BLUE, "lw": 0.8}, f"{title}, no amplitude measured"
        axes.add_collection(LineCollection(lines, **look))
        axes.plot(*place, "o", color="k", mfc="w", ms=6, label="agent", zorder=5)
        frame(axes, window)
        anchors(axes, scene)
        axes.set_title(f"{title}: {counted(len(lines), 'path')} at step {own.step}", fontsize="small")
        if number:
            axes.set_ylabel("")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize="small", frameon=False)
    weak = any((level < low).any() for level in levels)
    colorbar(figure, figure.axes[-1], ScalarMappable(scale, STRENGTH), "SNR (dB)", weak)
    return figure


def measures_amplitudes(found: AgentFiles) -> bool:
    """Whether anything told how strong paths are."""
    heard = found.measurements
    return isinstance(heard, Recording) or not len(heard.step) or bool(np.isfinite(heard.amplitude).any())


def draw_errors(
    scene: Scene,
    name: str,
    found: AgentFiles,
    truth: Truth | None = None,
    earlier: Sequence[Truth] = (),
    width: float = PAGE_IN,
    takes: Kind = "paths",
    beside: Sequence[Truth] = (),
) -> Figure:
    """Errors over time, the filter's own deviations, the known-map bound, and the number of surfaces.

    Without the heading where nothing tells of it, and the surfaces of a method that maps none. The true
    number is of the walls that paths hit so far, of this agent, those before it, and those beside it that
    share its map. Axes end where errors do after the first steps.
    """
    truth = _truth(scene, name, found) if truth is None else truth
    headed = tells_heading(scene, name, takes)
    with_surfaces = maps_surfaces(found)
    panels = 1 + headed + with_surfaces
    figure = blank(width, 0.15 * width * panels + 0.1 * width + 0.24 * panels + 0.92)
    rows = list(figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0])
    position, heading = rows[0], rows[1] if headed else None
    steps = np.array([e.step for e in found.estimates])
    own = np.sqrt([np.diag(e.covariance)[[0, 1, 4]] for e in found.estimates])
    lines = [("own standard deviation", 100 * np.hypot(*own[:, :2].T), np.degrees(own[:, 2]), GREEN, ":")]
    if found.truth is not None:
        gap, turn = track_errors(found.trajectory, found.truth)
        gap[found.truth.in_hole(found.trajectory.time_s)] = np.nan  # a line across
        error = 100 * np.linalg.norm(gap, axis=1), np.degrees(np.abs(turn))
        lines.insert(0, ("error", *error, BLUE, "-"))
        bound = known_bound(scene, name, truth, takes, found.unheard)
        if bound is not None:
            size = len(steps)
            limit = 100 * bound.position_m[:size], np.degrees(bound.heading_rad[:size])
            lines.append(("known-map bound (RMS)", *limit, ORANGE, "--"))
    for label, far, turned, color, style in lines:
        look: dict[str, Any] = {"color": color, "ls": style, "lw": 0.9 if style == "-" else 1.6}
        position.plot(steps[: len(far)], far, label=label, **look)
        if heading is not None:
            heading.plot(steps[: len(turned)], turned, **look)
    place: dict[str, Any] = {
        "loc": "lower left",
        "bbox_to_anchor": (0, 1),
        "fontsize": "small",
        "frameon": False,
    }
    position.legend(ncols=3 if width >= PAGE_IN else 1, **place)
    position.set_ylabel("position (cm)")
    if heading is not None:
        heading.set_ylabel("heading (deg)")
    if with_surfaces:
        shared = None if truth is None else _seen_so_far(truth.joined(beside), earlier, len(steps))
        _count_surfaces(rows[-1], found, shared, any(wall.arc is not None for wall in scene.walls))
        rows[-1].legend(ncols=2, **place)
    rows[-1].set(xlabel="step", xlim=(steps[0], max(steps[-1], steps[0] + 1)))
    for axes in rows:
        axes.grid(alpha=0.3)
    for axes in rows[: panels - with_surfaces]:
        _settled(axes, steps)
    figure.align_ylabels()
    return figure


def maps_surfaces(found: AgentFiles) -> bool:
    """Whether a method tells surfaces at each step, by what it left; from features they follow at the end."""
    mapped = found.map.surfaces is not None and found.map.features is None
    return mapped or any(len(e.surfaces) for e in found.estimates)


def _count_surfaces(count: Axes, found: AgentFiles, true: list[int] | None, curved: bool) -> None:
    """Surfaces found over the steps and, where they are known, the true ones, a curved wall once."""
    each, once = (" (curved walls: each piece)", " (curved walls once)") if curved else ("", "")
    steps, number = [e.step for e in found.estimates], [int(e.detected.sum()) for e in found.estimates]
    count.step(steps, number, where="mid", color=BLUE, lw=2.0, label=f"detected{each}")
    if true is not None:
        count.step(steps, true, where="mid", color="k", lw=0.9, ls="--", label=f"true, hit so far{once}")
    count.set(ylabel="surfaces", ylim=(0, 1.15 * max([1, *number, *(true or ())])))
    count.yaxis.set_major_locator(MaxNLocator(5, integer=True))


def _settled(axes: Axes, steps: NDArray[np.int64]) -> None:
    """End a linear axis where its lines do after the first steps, and say what it leaves out."""
    late = steps - steps[0] > SETTLED_STEP if steps[-1] - steps[0] > SETTLED_STEP else steps >= steps[0]
    curves = [np.asarray(line.get_ydata(), float) for line in axes.lines]
    top = 1.2 * max(float(np.nanmax(values[late[: len(values)]], initial=0)) for values in curves)
    most = max(float(np.nanmax(values, initial=0)) for values in curves)
    axes.set_ylim(0, top if top > 0 else 1)
    if most > top > 0:  # beside the axes, where no curve is
        where: dict[str, Any] = {"transform": axes.transAxes, "fontsize": "small"}
        axes.text(1, 1.02, f"first steps: up to {most:.3g}", ha="right", va="bottom", **where)


def draw_all(
    directory: str | os.PathLike[str],
    run: RunFiles | None = None,
    form: str = "png",
    width: float = PAGE_IN,
) -> list[Path]:
    """Draw all figures of a run's folder into ``figures/`` and return their paths.

    None is written before all are drawn: whatever stops the drawing leaves those of before, or none.

    Parameters
    ----------
    directory : path
    run : RunFiles, optional
        Its content, if that was read already.
    form : str
        ``png``, ``pdf`` or ``svg``.
    width : float, inches

    Raises
    ------
    Unwritten
        Some figures couldn't be drawn or written; the others were.
    InputError
        Not a run's folder, it can't be written to, or its figures lie elsewhere by a link.
    """
    folder = Path(directory) / "figures"
    refuse_leaving(Path(directory), [folder])
    run = read_run(directory) if run is None else run
    files: dict[str, bytes] = {}
    first = next(iter(run.agents.values()))
    earlier = inherited_truth(run.scene, first.map, latest=False)
    takes = kind_of(str(run.summary.get("method")))
    shared = any((Path(directory) / name).exists() for name in (network_files.H5, network_files.CSV))
    truths = {name: _truth(run.scene, name, found) for name, found in run.agents.items()}
    faults: list[InputError] = []

    def attempt(title: str, draw: Callable[[], Figure]) -> None:
        try:
            with fonts(width):
                files[f"{title}.{form}"] = encoded(draw(), form)
        except Exception as error:  # whatever it is: the other figures are worth having
            faults.append(fault_of(folder / f"{title}.{form}", error))

    for name in run.agents:
        beside = [t for other, t in truths.items() if shared and other != name and t is not None]
        for title, draw in _figures(run, name, truths[name], tuple(earlier), beside, takes, width).items():
            attempt(f"{name}-{title}", draw)
        earlier += [t for t in [truths[name]] if t is not None and not shared]
    if shared:
        clocks, known = Path(directory) / network_files.H5, run.scene.clocks
        by = known.reference if known is not None else None
        attempt("clocks", lambda: network_plots.draw_clocks(*network_files.read_clocks(clocks), width, by))
        attempt("tracks", lambda: network_plots.draw_tracks(run, width))
        attempt("labels", lambda: network_plots.draw_labels(run, width))
    written = write_files(folder, files, faults) if files else []
    failed = [Path(fault.where) for fault in faults]
    _drop_others(folder, list(run.agents), [*written, *failed], form)
    if faults:
        raise Unwritten(faults)
    return written


def _figures(
    run: RunFiles, name: str, truth: Truth | None, earlier: Sequence[Truth], beside: Sequence[Truth],
    takes: Kind, width: float,
) -> dict[str, Callable[[], Figure]]:  # fmt: skip
    """What draws the figures of an agent, by title; arguments as of `draw_errors`."""
    scene, found = run.scene, run.agents[name]
    features = found.map.features
    learned = maps_features(str(run.summary.get("method")), features) is not None
    figures: dict[str, Callable[[], Figure]] = {
        "map": lambda: draw_map(
            found.map, scene, found.trajectory, found.truth, found.estimates, width,
            None if truth is None else false_surfaces(found.map.surfaces, truth),
        ),
        "errors": lambda: draw_errors(scene, name, found, truth, earlier, width, takes, beside),
    }  # fmt: skip
    if any(np.isfinite(e.paths.points).any() for e in found.estimates):
        figures["rays"] = lambda: draw_rays(scene, name, found, truth=truth, width=width)
    if found.map.observed.any():
        figures["reflection"] = lambda: _reflection(scene, found, width)
    heard = found.measurements
    if isinstance(heard, Recording):
        figures["signal"] = lambda: draw_signal(heard, found.estimates, None, truth, width)
        if truth is not None and not learned:  # features are no images of walls
            figures["gospa"] = lambda: draw_gospa(scene, found.estimates, truth, width)
        if has_images(found.estimates):
            figures["images"] = lambda: draw_images(scene, found.estimates, width)
    if learned and features is not None:
        tracks = found.trajectory, found.truth
        figures["sights"] = lambda: draw_sights(scene, found.estimates, truth, width)
        figures["features"] = lambda: draw_features(scene, features, *tracks, width)
    return figures


def _reflection(scene: Scene, found: AgentFiles, width: float) -> Figure:
    """Reflection coefficients of cells, with what was learned of floor and ceiling above them."""
    figure = draw_reflection(found.map, scene, width)
    levels = found.estimates[-1].coefficients.items() if found.estimates else ()
    words = ", ".join(f"{name} {mean:.2f} ± {std:.2f}" for name, (mean, std) in levels)
    if words:
        figure.axes[0].set_title(words, fontsize="small")
    return figure


def _drop_others(folder: Path, agents: Sequence[str], written: Sequence[Path], form: str) -> None:
    """Delete figures of this format that an earlier drawing left; other files stay."""
    ours = {*TITLES_OF_ALL, *(f"{name}-{title}" for name in agents for title in TITLES)}
    for path in {folder / f"{name}.{form}" for name in ours} - set(written):
        path.unlink(missing_ok=True)


def _truth(scene: Scene, name: str, found: AgentFiles) -> Truth | None:
    truth = truth_of(scene, name, found.truth)
    return truth if isinstance(truth, Truth) else None


def _seen_so_far(truth: Truth, earlier: Sequence[Truth], steps: int) -> list[int]:
    """How many true surfaces some path had hit by each step, a curved wall once: as scores count them."""
    audible = AudibleSurfaces.of(truth, earlier)
    return [audible.count(step) for step in range(steps)]
