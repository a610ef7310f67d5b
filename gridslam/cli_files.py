"""Command line: what can be done with files that exist already."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from gridslam.errors import InputError

out = Console()
KINDS = "a scene (.toml), measurements (.csv, .mat, .h5), a map (.h5) or a run's folder"


def register(app: typer.Typer) -> None:
    """Add the commands."""
    for command in (check, export, plot, scenes):
        app.command()(command)


def check(
    file: Path,
    scene: Annotated[str | None, typer.Option(help="compares measurements with a scene's anchors")] = None,
    agent: Annotated[str | None, typer.Option(help="whose measurements; default: the first")] = None,
) -> None:
    """Say what a scene, measurement or map file (or a run's folder) is, or what is wrong with it.

    Exit code 0: nothing is wrong with it; 1: something looks wrong (lines that begin with "suspect:"); 2: it
    can't be read.
    """
    from gridslam.diagnose import describe
    from gridslam.measurements import Measurements
    from gridslam.scene import Scene

    world = Scene.load(scene) if scene is not None else None
    if not _is_table(file):
        _say(_describe(file))
        return
    lines = describe(file, world, agent)
    for line in lines:
        if not line.startswith("refused: "):
            _say(line)
    Measurements.load(file)  # a fault is told as that of every file
    if any(line.startswith("suspect: ") for line in lines):
        raise typer.Exit(1)


def export(
    map_file: Annotated[Path, typer.Argument(metavar="MAP.h5")],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder; other files in it stay")],
) -> None:
    """Export a map for others: nav2 (yaml, pgm), pictures (png), tables (csv), surfaces (GeoJSON)."""
    from gridslam.files import beside, cannot_write
    from gridslam.geojson import write_surfaces
    from gridslam.map import Map
    from gridslam.plots import draw_export

    found = Map.load(map_file)
    output = output.resolve()
    part = beside(output)
    try:  # all files or none: they are made aside and then moved
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        found.to_nav2(part)
        found.to_csv(part)
        draw_export(found, part)
        if found.surfaces is not None:
            write_surfaces(part / "surfaces.geojson", found.surfaces)
        names = sorted(path.name for path in part.iterdir())
        output.mkdir(exist_ok=True)
        for name in names:
            (part / name).replace(output / name)
    except InputError as error:
        raise InputError(str(output), error.found, error.allowed) from error
    except OSError as error:
        raise cannot_write(output, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    _say(f"wrote {', '.join(names)} to {output}")


def plot(
    directory: Annotated[Path, typer.Argument(help="a run's folder")],
    rerun: Annotated[bool, typer.Option("--rerun", help="show it in the Rerun viewer instead")] = False,
    rerun_to: Annotated[str | None, typer.Option(help="as that of run")] = None,
) -> None:
    """Draw a finished run's figures again."""
    if rerun or rerun_to:
        from gridslam.rerun_view import replay
        from gridslam.runfiles import read_run

        replay(read_run(directory), rerun_to)
        return
    from gridslam.plots import draw_all

    for path in draw_all(directory):
        _say(str(path))


def scenes() -> None:
    """List the bundled scenes."""
    from gridslam.scene import Scene, bundled_scenes

    for name in bundled_scenes():
        _say(f"{name}: {Scene.load(name).description}")


def _say(text: str) -> None:
    out.print(text, highlight=False, markup=False, soft_wrap=True)


def _describe(file: Path) -> str:
    from gridslam.map import Map
    from gridslam.runfiles import read_run
    from gridslam.scene import Scene

    if file.is_dir():
        found = read_run(file)
        return f"run of {found.scene.name}: {', '.join(found.agents)}"
    if file.suffix.lower() == ".toml":
        world = Scene.load(file)
        size = " x ".join(str(n) for n in reversed(world.grid.shape))
        counts = f"{len(world.anchors)} anchors, {len(world.walls)} walls, {len(world.agents)} agents"
        return f"scene {world.name}: {counts}, {size} cells of {world.grid.cell_m:g} m"
    kind = _kind(file)
    if kind == "gridslam-map":
        grid = Map.load(file)
        height, width = grid.shape
        surfaces = len(grid.surfaces) if grid.surfaces is not None else 0
        who = ", ".join(map(str, grid.provenance.get("agents", []))) or "unknown agents"  # type: ignore[arg-type]
        return (
            f"map by {who}: {width} x {height} cells of {grid.cell_m:g} m, {grid.observed.mean():.0%} "
            f"observed, {grid.occupied.sum()} occupied, {surfaces} surfaces"
        )
    raise InputError(str(file), f"an HDF5 file of format {kind!r}", KINDS)


def _is_table(file: Path) -> bool:
    if file.is_dir() or file.suffix.lower() == ".toml":
        return False
    return file.suffix.lower() in (".csv", ".mat") or _kind(file) == "gridslam-measurements"


def _kind(file: Path) -> str:
    """Format that an HDF5 file says it has."""
    import h5py

    from gridslam.files import most_claimed
    from gridslam.foreign import prove

    if not file.is_file():
        raise InputError(str(file), "no file", KINDS)
    try:
        prove(file, most_claimed(file), ["/"])
        with h5py.File(file) as content:
            name = content.attrs.get("format", "")
    except (OSError, KeyError, RuntimeError) as error:
        raise InputError(str(file), "neither text nor whole HDF5", KINDS) from error
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
