"""Command line: what can be done with files that exist already."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.measurements import Measurements

out = Console()
KINDS = "a scene (.toml), measurements (.csv, .h5), a map (.h5) or a run's folder"


def register(app: typer.Typer) -> None:
    """Add the commands."""
    for command in (check, export, plot, scenes):
        app.command()(command)


def check(file: Path) -> None:
    """Say what a scene, measurement or map file (or a run's folder) is, or what is wrong with it."""
    _say(_describe(file))


def export(
    map_file: Annotated[Path, typer.Argument(metavar="MAP.h5")],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder; other files in it stay")],
) -> None:
    """Export a map for others: nav2 (yaml, pgm), pictures (png), tables (csv)."""
    from gridslam.files import beside, cannot_write
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


def plot(directory: Annotated[Path, typer.Argument(help="a run's folder")]) -> None:
    """Draw a finished run's figures again."""
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
    from gridslam.measurements import Measurements
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
    if file.suffix.lower() == ".csv":
        return _heard(Measurements.from_csv(file, _anchors(file)))
    kind = _kind(file)
    if kind == "gridslam-measurements":
        return _heard(Measurements.from_h5(file))
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


def _heard(heard: Measurements) -> str:
    truth = ", true track known" if heard.truth is not None else ""
    counts = f"{len(heard)} steps, {len(heard.step)} paths"
    return f"measurements: {counts}, anchors {', '.join(heard.anchors)}{truth}"


def _anchors(file: Path) -> list[str]:
    """Names of the anchors in a CSV file, in order of appearance."""
    import csv

    try:
        with file.open(newline="", encoding="utf-8-sig") as rows:
            return list(dict.fromkeys((row.get("anchor") or "").strip() for row in csv.DictReader(rows)))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(str(file), reason, "a CSV file that can be read") from error


def _kind(file: Path) -> str:
    """Format that an HDF5 file says it has."""
    import h5py

    if not file.is_file():
        raise InputError(str(file), "no file", KINDS)
    try:
        with h5py.File(file) as content:
            name = content.attrs.get("format", "")
    except (OSError, KeyError, RuntimeError) as error:
        raise InputError(str(file), "neither text nor whole HDF5", KINDS) from error
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)
