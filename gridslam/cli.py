"""Command line. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from gridslam import cli_scene
from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.map import Map
    from gridslam.measurements import Measurements
    from gridslam.result import Run
    from gridslam.scene import Scene
    from gridslam.simulate import Truth

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)
out, err = Console(), Console(stderr=True)
MAIN_SCENE = "canyon"


@app.command()
def run(
    scene: Annotated[str, typer.Argument(help="bundled name or path")] = MAIN_SCENE,
    agent: Annotated[list[str] | None, typer.Option(help="agents, in order")] = None,
    method: Annotated[str, typer.Option(help="grid")] = "grid",
    seed: Annotated[int, typer.Option(min=0)] = 0,
    measurements: Annotated[Path | None, typer.Option(help="CSV or HDF5 of the one agent")] = None,
    map_file: Annotated[Path | None, typer.Option("--map", help="map to start from")] = None,
    device: Annotated[str, typer.Option(help="auto, cpu or gpu")] = "auto",
    threads: Annotated[int | None, typer.Option(min=1)] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Map a scene with its agents, each starting from the map that the one before it left."""
    from gridslam import runtime
    from gridslam.map import Map
    from gridslam.result import check_output, write_run
    from gridslam.scene import Scene

    world = Scene.load(scene)
    names = agent or ([world.agents[0].name] if measurements else [a.name for a in world.agents])
    if measurements and len(names) > 1:
        raise InputError("--agent", ", ".join(names), "one agent with --measurements")
    for name in names:
        world.agent(name)
    folder = output or _free_folder(world.name)
    check_output(folder, overwrite)
    carried = Map.load(map_file) if map_file else None
    runtime.start(device, threads)
    runs, heards, scores = [], [], []
    for name in names:
        heard = _heard(world, name, seed, measurements)
        truth = _truth(world, name, heard)
        done = _map_with_progress(world, heard, method, name, seed, carried)
        runs.append(done)
        heards.append(heard)
        scores.append(done.score(truth) if truth is not None else None)
        carried = done.map
        if done.interrupted:
            break
    write_run(folder, world, runs, heards, scores, {}, overwrite, _draw)
    _table(runs, scores)
    out.print(f"wrote {folder}", highlight=False)
    if runs[-1].interrupted:
        err.print(
            f"interrupted in {runs[-1].agent} after {len(runs[-1].estimates)} steps: kept what was done"
        )
        raise typer.Exit(130)


@app.command()
def simulate(
    scene: str,
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.csv or FILE.h5")],
    agent: Annotated[str | None, typer.Option()] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
) -> None:
    """Write what an agent would hear."""
    from gridslam.scene import Scene
    from gridslam.simulate import simulate as hear

    if output.suffix not in (".csv", ".h5"):
        raise InputError("-o", repr(output.name), "a name that ends in .csv or .h5")
    world = Scene.load(scene)
    heard = hear(world, agent or world.agents[0].name, seed)
    (heard.to_csv if output.suffix == ".csv" else heard.to_h5)(output)
    out.print(f"wrote {output}: {len(heard)} steps, {len(heard.step)} measurements", highlight=False)


@app.command()
def check(file: Path) -> None:
    """Say what a scene, measurement or map file is, or what is wrong with it."""
    out.print(_describe(file), highlight=False)


@app.command()
def export(map_file: Path, output: Annotated[Path, typer.Option("-o", "--output")]) -> None:
    """Export a map: nav2, CSV."""
    from gridslam.map import Map

    found = Map.load(map_file)
    output.mkdir(parents=True, exist_ok=True)
    found.to_nav2(output)
    found.to_csv(output)
    out.print(f"wrote {output}", highlight=False)


@app.command()
def plot(directory: Path) -> None:
    """Draw a finished run's figures again."""
    from gridslam.plots import draw_all

    for path in draw_all(directory):
        out.print(str(path), highlight=False)


@app.command()
def scenes() -> None:
    """List the bundled scenes."""
    from gridslam.scene import Scene, bundled_scenes

    for name in bundled_scenes():
        out.print(f"{name}: {Scene.load(name).description}", highlight=False, soft_wrap=True)


cli_scene.register(app)


def main() -> None:
    """Entry point: bad input is one line and exit code 2, Ctrl-C is 130, never a traceback for either."""
    try:
        code = app(standalone_mode=False)
    except InputError as error:
        err.print(f"error: {error}", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)
    except typer.Exit as stop:
        sys.exit(stop.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        err.print("interrupted")
        sys.exit(130)
    except OSError as error:
        err.print(f"error: {error.filename}: {error.strerror}", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)
    except Exception as error:
        if not hasattr(error, "format_message"):  # a usage error, whichever click typer brings along
            raise
        err.print(f"error: {error.format_message()}", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)
    sys.exit(code if isinstance(code, int) else 0)


def _draw(folder: Path) -> None:
    from gridslam.plots import draw_all

    draw_all(folder)


def _free_folder(name: str) -> Path:
    """First unused folder runs/NAME-1, runs/NAME-2, ..."""
    number = 1
    while (Path("runs") / f"{name}-{number}").exists():
        number += 1
    return Path("runs") / f"{name}-{number}"


def _heard(world: Scene, name: str, seed: int, file: Path | None) -> Measurements:
    from gridslam.measurements import Measurements
    from gridslam.simulate import simulate as hear

    if file is None:
        if not world.walls:
            raise InputError(f"{world.name}: walls", "none", "walls to simulate from, or --measurements FILE")
        return hear(world, name, seed)
    return (
        Measurements.from_csv(file, world.anchor_names)
        if file.suffix == ".csv"
        else Measurements.from_h5(file)
    )


def _truth(world: Scene, name: str, heard: Measurements) -> Truth | None:
    from gridslam.simulate import ground_truth

    return ground_truth(world, name) if heard.truth is not None and world.walls else None


def _map_with_progress(
    world: Scene, heard: Measurements, method: str, name: str, seed: int, carried: Map | None
) -> Run:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    from gridslam.estimates import Estimate
    from gridslam.mapping import map_scene

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[state]}"),
    )
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task(name, total=len(heard), state="")
        began = bar.get_time()

        def tell(estimate: Estimate, done: int, total: int) -> None:
            rate = done / max(bar.get_time() - began, 1e-9)
            state = f"{rate:.1f} steps/s, {int(estimate.detected.sum())} surfaces"
            if heard.truth is not None and estimate.step < len(heard.truth):
                gap = estimate.position_m - heard.truth.position_m[estimate.step]
                state += f", error {100 * float((gap @ gap) ** 0.5):.1f} cm"
            bar.update(task, completed=done, state=state)

        return map_scene(world, heard, method, name, seed, carried, tell)


def _table(runs: list[Run], scores: list) -> None:
    table = Table(box=None)
    for title in ("agent", "position", "heading", "surfaces", "occupied right", "walls found", "s/step"):
        table.add_column(title, justify="left" if title == "agent" else "right")
    for done, score in zip(runs, scores, strict=True):
        if score is None:
            row = ["-", "-", str(len(done.surfaces)), "-", "-"]
        else:
            cells = score["map"]
            row = [
                f"{100 * score['position_rmse_m']:.2f} cm",
                f"{score['heading_rmse_deg']:.2f} deg",
                f"{score['surfaces_detected']} of {score['surfaces_true']}",
                f"{cells['occupied_precision']:.1%}",
                f"{cells['occupied_recall']:.1%}",
            ]
        table.add_row(done.agent, *row, f"{done.seconds_per_step:.3f}")
    out.print(table)


def _describe(file: Path) -> str:
    from gridslam.map import Map
    from gridslam.measurements import Measurements
    from gridslam.scene import Scene

    if file.suffix == ".toml":
        world = Scene.load(str(file))
        size = " x ".join(str(n) for n in reversed(world.grid.shape))
        counts = f"{len(world.anchors)} anchors, {len(world.walls)} walls, {len(world.agents)} agents"
        return f"scene {world.name}: {counts}, {size} cells"
    if file.suffix == ".csv":
        import csv

        try:
            with file.open(newline="", encoding="utf-8") as rows:
                names = list(dict.fromkeys(row.get("anchor") or "" for row in csv.DictReader(rows)))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InputError(str(file), str(error), "a CSV file that can be read") from error
        heard = Measurements.from_csv(file, names)
        return (
            f"measurements: {len(heard)} steps, {len(heard.step)} paths, anchors {', '.join(heard.anchors)}"
        )
    try:
        heard = Measurements.from_h5(file)
        return (
            f"measurements: {len(heard)} steps, {len(heard.step)} paths, anchors {', '.join(heard.anchors)}"
        )
    except InputError:
        found = Map.load(file)
        height, width = found.shape
        return f"map: {width} x {height} cells of {found.cell_m} m, {found.observed.mean():.0%} observed"
