"""A run as a moving picture: where the agent is, what it hears, which surfaces it has found so far."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from gridslam.drawing.anchor_labels import anchors
from gridslam.drawing.map_figure import BLUE, GREEN, ORANGE, PURPLE, scatterers
from gridslam.errors import InputError
from gridslam.estimate_tables import SurfaceEstimate, SurfaceStretches
from gridslam.estimates import Estimate
from gridslam.io.files import cannot_write, put_in_place
from gridslam.maps.map import Map
from gridslam.runs.run_files import AgentFiles
from gridslam.viewers.plots import STRENGTH, measures_amplitudes
from gridslam.viewers.signal_plots import BELIEVED
from gridslam.wording import counted
from gridslam.world.geometry import unit
from gridslam.world.scene import Scene

FRAMES, FRAMES_PER_SECOND, DPI = 60, 10, 80
SIGMAS = 3.0
GIF_INSTEAD = "a name that ends in .gif, or pip install 'gridslam[video]'"


def animate(
    scene: Scene,
    found: AgentFiles,
    path: str | os.PathLike[str],
    frames: int = FRAMES,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[int, int]:
    """Write the run of one agent as a GIF, or as MP4 where there is an ffmpeg.

    Parameters
    ----------
    scene : Scene
        Its walls are drawn where it has some.
    found : AgentFiles
    path : path
        Ends in ``.gif`` or ``.mp4``.
    frames : int
        At most so many of the steps, evenly spread, the last one included.
    progress : callable, optional
        Called after every frame with (frames done, frames in all).

    Returns
    -------
    (int, int)
        Width and height, pixels.

    Raises
    ------
    InputError
        Another ending, no ffmpeg for ``.mp4`` or one that fails, no steps, or the file can't be written.
    """
    path = Path(path)
    writer = _writer(path)
    steps = np.unique(np.linspace(0, len(found.estimates) - 1, max(frames, 1)).round().astype(int))
    if not found.estimates:
        raise InputError(str(path), "a run without steps", "at least one step to draw")
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    figure, axes = _figure(scene)
    try:
        with writer.saving(figure, str(part), DPI):
            for number, step in enumerate(steps, start=1):
                axes.clear()
                _draw(axes, scene, found, found.estimates[step], int(step))
                writer.grab_frame()
                figure.set_layout_engine("none")  # the frames after the first keep its layout
                if progress is not None:
                    progress(number, len(steps))
        put_in_place(part, path)
    except OSError as error:
        raise cannot_write(path, error) from error
    except subprocess.CalledProcessError as error:
        raise InputError(str(path), f"ffmpeg gave up (exit code {error.returncode})", GIF_INSTEAD) from error
    finally:
        part.unlink(missing_ok=True)
    width, height = figure.canvas.get_width_height()
    return width, height


class _Gif(PillowWriter):
    _frames: list[Any]

    def finish(self) -> None:
        if self._frames:  # else it was stopped before the first, and what stopped it is what counts
            super().finish()


def film_ending() -> str:
    """``.mp4`` where it can be written here (a quarter of the size, and can be stopped), else ``.gif``."""
    return ".mp4" if _ffmpeg() else ".gif"


def _ffmpeg() -> str | None:
    """The program: on the PATH, or brought along by imageio-ffmpeg (extra ``video``)."""
    found = shutil.which(FFMpegWriter.bin_path())
    if found is None:
        try:
            import imageio_ffmpeg

            found = imageio_ffmpeg.get_ffmpeg_exe()
        except (ImportError, RuntimeError):  # a package without a program for this machine
            return None
    return found


def _writer(path: Path) -> AbstractMovieWriter:
    kind = path.suffix.lower()
    if kind == ".gif":
        return _Gif(fps=FRAMES_PER_SECOND)
    if kind != ".mp4":
        raise InputError(str(path), f"a name that ends in {kind!r}", "a name that ends in .gif or .mp4")
    program = _ffmpeg()
    if program is None:
        raise InputError(str(path), "no ffmpeg to write it", GIF_INSTEAD)

    class Writer(FFMpegWriter):
        @classmethod
        def bin_path(cls) -> str:
            return str(program)

    everywhere = ["-pix_fmt", "yuv420p", "-movflags", "+faststart"]  # browsers play no other colours
    return Writer(fps=FRAMES_PER_SECOND, codec="h264", extra_args=everywhere)


def _figure(scene: Scene) -> tuple[Figure, Axes]:
    wide, high = (b - a for a, b in (scene.grid.x_m, scene.grid.y_m))
    width = float(np.clip(6.0 * wide / max(wide, high), 3.0, 6.0)) + 0.8
    height = float(np.clip(6.0 * high / max(wide, high), 2.5, 6.0)) + 0.8
    even = [2 * round(size * DPI / 2) / DPI for size in (width, height)]  # video codecs want even sizes
    figure = Figure(figsize=(even[0], even[1]), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def _draw(axes: Axes, scene: Scene, found: AgentFiles, now: Estimate, step: int) -> None:
    walls = scene.segments()
    axes.add_collection(
        LineCollection(list(np.stack([walls.start, walls.end], 1)), colors=GREEN, linewidths=0.8)
    )
    scatterers(axes, scene, GREEN)
    paths = now.paths.take(now.paths.existence > BELIEVED)
    rays = [row[~np.isnan(row[:, 0])] for row in paths.points]
    level = 20 * np.log10(np.maximum(paths.amplitude, 1e-3))
    by_strength: dict[str, Any] = {"array": level, "cmap": STRENGTH, "norm": Normalize(6, 40)}
    look = by_strength if measures_amplitudes(found) else {"color": PURPLE}
    axes.add_collection(LineCollection(rays, lw=0.7, alpha=0.7, **look))
    known = now.surfaces.take(now.detected)
    shown = replace(
        found.map, surfaces=known, surface_reflection=None, surface_covariance=None, anchors=None,
        stretches=_stretches(found.map, known),
    )  # fmt: skip
    ends = shown.wall_segments().ends_m
    axes.add_collection(LineCollection(list(ends), colors=ORANGE, linewidths=3, alpha=0.6))
    if found.truth is not None:
        axes.plot(*found.truth.line_m(now.time_s).T, color="k", lw=2, alpha=0.35)
    axes.plot(*found.trajectory.position_m[: step + 1].T, color=BLUE, lw=1)
    axes.set(xlim=scene.grid.x_m, ylim=scene.grid.y_m, aspect="equal", xlabel="x (m)", ylabel="y (m)")
    anchors(axes, scene, 5)
    _agent(axes, scene, now)
    axes.set_title(
        f"step {now.step}: {counted(len(rays), 'path')}, {counted(len(known), 'surface')}", fontsize=9
    )


def _stretches(final: Map, known: SurfaceEstimate) -> SurfaceStretches | None:
    """Where surfaces known by a step are walls by the map at the end; whole, if it has lost them."""
    if final.stretches is None or final.surfaces is None:
        return None
    walls, there = final.wall_segments(), np.isin(known.identity, final.surfaces.identity)
    gone = np.flatnonzero(~there & np.isfinite(known.extent_m).all(axis=1))
    pieces = [SurfaceStretches(gone, known.extent_m[gone])]
    for row in np.flatnonzero(there):
        own = walls.ends_m[walls.identity == known.identity[row]] @ unit(known.line[row, 0] + 0.5 * np.pi)
        pieces.append(SurfaceStretches(np.full(len(own), row), np.sort(own, axis=1)))
    return SurfaceStretches.stack(pieces)


def _agent(axes: Axes, scene: Scene, now: Estimate) -> None:
    """Place, heading, and where it may be."""
    length, axis = np.linalg.eigh(now.covariance[:2, :2])
    size = 2 * SIGMAS * np.sqrt(np.maximum(length, 0))
    tilt = float(np.degrees(np.arctan2(axis[1, 1], axis[0, 1])))
    x, y = map(float, now.position_m)
    axes.add_patch(Ellipse((x, y), float(size[1]), float(size[0]), angle=tilt, color=BLUE, alpha=0.25))
    axes.plot(x, y, "o", color=BLUE, ms=4)
    tip = now.position_m + 0.06 * (scene.grid.x_m[1] - scene.grid.x_m[0]) * unit(now.heading_rad)
    axes.plot([x, tip[0]], [y, tip[1]], color=BLUE, lw=1.5)
