"""Command line: what can be done with files that exist already."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.maps.map import Map

out = Console()
KINDS = "a scene (.toml), measurements (.csv, .mat, .h5), a map (.h5) or a run's folder"


def register(app: typer.Typer) -> None:
    """Add the commands."""
    for command in (check, export, fuse, plot, scenes):
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
    from gridslam.checks.diagnose import describe
    from gridslam.measurements.table import Measurements
    from gridslam.world.scene import Scene

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
    raw: Annotated[bool, typer.Option("--raw", help="nav2: the cells alone, no walls drawn in")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace files of these names")] = False,
) -> None:
    """Export a map for others: nav2 (yaml, pgm), pictures (png), tables (csv), surfaces (GeoJSON)."""
    from gridslam.importers.geojson import write_surfaces
    from gridslam.io.files import beside, cannot_write, put_in_place, refuse_taken
    from gridslam.maps.map import Map
    from gridslam.viewers.plots import draw_export

    found = Map.load(map_file)
    output = output.resolve()
    part = beside(output)
    try:  # all files or none: they are made aside and then moved
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        found.to_nav2(part, raw)
        found.to_csv(part)
        draw_export(found, part)
        if found.surfaces is not None:
            write_surfaces(part / "surfaces.geojson", found.surfaces, found.wall_segments())
        names = sorted(path.name for path in part.iterdir())
        refuse_taken([output / name for name in names], overwrite)
        output.mkdir(exist_ok=True)
        for name in names:
            put_in_place(part / name, output / name)
    except InputError as error:
        if part not in Path(error.where).parents:
            raise
        raise InputError(str(output), error.found, error.allowed) from error
    except OSError as error:
        raise cannot_write(output, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    _say(f"wrote {', '.join(names)} to {output}")


def fuse(
    maps: Annotated[list[Path], typer.Argument(metavar="MAP.h5...", help="two or more")],
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.h5")],
    same_frame: Annotated[
        bool, typer.Option("--same-frame", help="they are in one frame, though they share no anchor")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a file of this name")] = False,
) -> None:
    """Make one map of maps that agents made apart from each other."""
    from gridslam.maps.fusion import fuse as fused
    from gridslam.maps.map import Map

    if output.suffix != ".h5":
        raise InputError("-o", repr(output.name), "a name that ends in .h5")
    if output.is_dir() or (output.exists() and not overwrite):
        raise InputError(str(output), "something of this name", "a new file (or --overwrite)")
    if len(maps) < 2:
        raise InputError("fuse", f"{len(maps)} map", "two or more maps")
    whole = fused([Map.load(path) for path in maps], same_frame, [str(path) for path in maps])
    whole.save(output)
    _say(f"wrote {output}: {_summary(whole)}")


def plot(
    directory: Annotated[Path, typer.Argument(help="a run's folder")],
    rerun: Annotated[bool, typer.Option("--rerun", help="show it in the Rerun viewer instead")] = False,
    rerun_to: Annotated[str | None, typer.Option(help="as that of run")] = None,
) -> None:
    """Draw a finished run's figures again."""
    if rerun or rerun_to:
        from gridslam.runs.run_files import read_run
        from gridslam.viewers.rerun_view import replay

        replay(read_run(directory), rerun_to)
        return
    from gridslam.viewers.plots import draw_all

    for path in draw_all(directory):
        _say(str(path))


def scenes() -> None:
    """List the bundled scenes."""
    from gridslam.world.scene import Scene, bundled_scenes

    for name in bundled_scenes():
        _say(f"{name}: {Scene.load(name).description}")


def _say(text: str) -> None:
    out.print(text, highlight=False, markup=False, soft_wrap=True)


def _describe(file: Path) -> str:
    from gridslam.maps.map import Map
    from gridslam.runs.run_files import read_run
    from gridslam.world.scene import Scene

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
        return _summary(Map.load(file))
    raise InputError(str(file), f"an HDF5 file of format {kind!r}", KINDS)


def _summary(grid: Map) -> str:
    """A map in one line."""
    height, width = grid.shape
    surfaces = len(grid.surfaces) if grid.surfaces is not None else 0
    who = ", ".join(map(str, grid.provenance.get("agents", []))) or "unknown agents"  # type: ignore[arg-type]
    return (
        f"map by {who}: {width} x {height} cells of {grid.cell_m:g} m, {grid.observed.mean():.0%} "
        f"observed, {grid.occupied.sum()} occupied, {surfaces} surfaces"
    )


def _is_table(file: Path) -> bool:
    if file.is_dir() or file.suffix.lower() == ".toml":
        return False
    return file.suffix.lower() in (".csv", ".mat") or _kind(file) == "gridslam-measurements"


def _kind(file: Path) -> str:
    """Format that an HDF5 file says it has."""
    import h5py

    from gridslam.io.hdf5_guard import prove
    from gridslam.io.hdf5_limits import most_claimed

    if not file.is_file():
        raise InputError(str(file), "no file", KINDS)
    try:
        prove(file, most_claimed(file), ["/"])
        with h5py.File(file) as content:
            name = content.attrs.get("format", "")
    except (OSError, KeyError, RuntimeError) as error:
        raise InputError(str(file), "neither text nor whole HDF5", KINDS) from error
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
