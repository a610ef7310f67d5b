"""Command line: what can be done with sampled signals."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from gridslam.cli.help import MAP, SCENE_HELP, scene_names
from gridslam.cli.options import flag, map_in
from gridslam.cli.output import busy
from gridslam.errors import InputError
from gridslam.wording import counted

out = Console()


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(rich_help_panel=MAP)(extract)
    app.command(rich_help_panel=MAP)(calibrate)


def extract(
    file: Annotated[Path, typer.Argument(help="sampled signals (HDF5, MATLAB)")],
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.csv or FILE.h5")],
    scene: Annotated[
        str | None,
        typer.Option(
            help=f"takes false alarms and threshold from it: {SCENE_HELP}", autocompletion=scene_names
        ),
    ] = None,
    false_alarms: Annotated[
        float | None, typer.Option(help="noise peaks per anchor and step that pass (default: 0.1)")
    ] = None,
    overwrite: Annotated[bool, flag("--overwrite", "replace a file of this name")] = False,
) -> None:
    """Find the paths in sampled signals, for methods that take path measurements."""
    from gridslam.extraction.front_end import extract as found_in
    from gridslam.io.files import new_file
    from gridslam.measurements.recording import Recording
    from gridslam.world.scene import Scene

    if output.suffix not in (".csv", ".h5"):
        raise InputError("-o", repr(output.name), "a name that ends in .csv or .h5")
    with new_file(output, overwrite) as part:
        world = Scene.load(scene) if scene is not None else None
        recording = Recording.load(file)
        with busy("looking for paths"):
            measurements = found_in(recording, world, false_alarms=false_alarms)
        (measurements.to_csv if output.suffix == ".csv" else measurements.to_h5)(part)
    snapshots = max(int(recording.heard.sum()), 1)
    size = f"{counted(len(measurements), 'step')}, {counted(len(measurements.step), 'path')}"
    line = f"wrote {output}: {size}, {len(measurements.step) / snapshots:.1f} per anchor and step"
    out.print(line, highlight=False, markup=False, soft_wrap=True)


def calibrate(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, autocompletion=scene_names)],
    file: Annotated[
        Path, typer.Argument(help="sampled signals along a known way: with the true track (HDF5, MATLAB)")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.h5: the samples with the array found")],
    prior: Annotated[
        Path | None,
        typer.Option("--map", help="map.h5 whose paths are heard beside the lines of sight", callback=map_in),
    ] = None,
    same_frame: Annotated[
        bool, flag("--same-frame", "the map is in the scene's frame, though it shares no anchor")
    ] = False,
    agent: Annotated[str | None, typer.Option(help="default: the first")] = None,
    overwrite: Annotated[bool, flag("--overwrite", "replace a file of this name")] = False,
) -> None:
    """Find where an agent's antenna elements really stand, and how its pulse is bent."""
    from dataclasses import replace

    import numpy as np

    from gridslam.io.files import new_file
    from gridslam.maps.map import Map
    from gridslam.measurements.recording import Recording
    from gridslam.runs.calibrate import calibrate as errors_of
    from gridslam.world.scene import Scene

    if output.suffix != ".h5":
        raise InputError("-o", repr(output.name), "a name that ends in .h5")
    with new_file(output, overwrite) as part:
        world, recording = Scene.load(scene), Recording.load(file)
        earlier_map = None if prior is None else Map.load(prior)
        with busy("comparing with what is known"):
            found = errors_of(world, recording, earlier_map, agent, same_frame)
        replace(recording, waveform=found.waveform).to_h5(part)
    lines = [f"wrote {output}: {counted(len(recording), 'step')}, array and pulse as found"]
    for n, (error, spread) in enumerate(zip(found.element_error_m, found.element_std_m, strict=True)):
        x, y = (f"{1e3 * e:+.2f} +- {1e3 * s:.2f}" for e, s in zip(error, spread, strict=True))
        lines.append(f"element {n}: x {x} mm, y {y} mm beside its place")
    largest = 100 * float(np.abs(found.pulse_error).max())
    lines.append(f"pulse: {largest:.1f} % at most, +- {100 * float(found.pulse_std.mean()):.1f} %")
    out.print("\n".join(lines), highlight=False, markup=False, soft_wrap=True)
