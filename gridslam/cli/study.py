"""The command ``gridslam study``. Nothing heavy is imported before it runs."""

from __future__ import annotations

import math
import sys
import tomllib
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from gridslam.cli.options import flag
from gridslam.cli.output import print_whole
from gridslam.errors import InputError, renamed
from gridslam.systems.registry import DEFAULT, method_help
from gridslam.wording import counted

if TYPE_CHECKING:
    from gridslam.studies.study import Outcome, Study
    from gridslam.studies.workers import Workers

out, err = Console(), Console(stderr=True)


@dataclass(frozen=True)
class Place:
    """Where the runs are done."""

    scheduler: Annotated[str | None, typer.Option(help="of a Dask cluster, e.g. tcp://host:8786")] = None
    workers: Annotated[int | None, typer.Option(min=1, help="processes here; default: one per core")] = None

    def open(self) -> Workers:
        """Processes here, or those of a cluster.

        Raises
        ------
        InputError
            Both were asked for.
        """
        from gridslam.studies.workers import ClusterWorkers, LocalWorkers

        if self.scheduler is None:
            return LocalWorkers(self.workers)
        if self.workers:
            found = f"{self.workers} with --scheduler"
            raise InputError("--workers", found, "one of them; a cluster has its own")
        return ClusterWorkers(self.scheduler)


@dataclass(frozen=True)
class Figures:
    """What the figures are like."""

    form: Annotated[str, typer.Option("--format", help="of the figures: png, pdf or svg")] = "png"
    width: Annotated[
        float | None,
        typer.Option(min=5, max=50, help="of the figures, cm: 8.8 suits a column (default: 20.3)"),
    ] = None


def study(
    scene: Annotated[list[str], typer.Argument(help="bundled names or paths")],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder; an interrupted study goes on")],
    *,
    runs: Annotated[int, typer.Option(min=1, help="seeds per method, scene and setting")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="the first seed")] = 0,
    method: Annotated[list[str] | None, typer.Option(help=method_help("; may be repeated"))] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="values to try, e.g. filter.particles=1000,10000")
    ] = None,
    agent: Annotated[list[str] | None, typer.Option(help="agents, in order")] = None,
    start: Annotated[str, typer.Option(help="told start: drawn from the prior by seed, or exact")] = "drawn",
    place: Place,
    overwrite: Annotated[bool, flag("--overwrite", "begin anew")] = False,
    figures: Figures,
) -> None:
    """Run many seeds, methods and settings; write tables and figures. Started again, it goes on."""
    from gridslam.drawing.map_figure import FORMATS
    from gridslam.studies.batches import batches
    from gridslam.studies.plots import WHOLE_IN
    from gridslam.studies.results import write_results
    from gridslam.studies.study import Study
    from gridslam.studies.tables import summary_rows
    from gridslam.world.scene import Scene

    where = place.open()
    if figures.form not in FORMATS:
        raise InputError("--format", repr(figures.form), ", ".join(FORMATS))
    worlds = tuple(Scene.load(name) for name in scene)
    with ExitStack() as called:
        for world, name in zip(worlds, scene, strict=True):
            called.enter_context(renamed(world.name, name))
        plan = Study(
            worlds,
            tuple(method or [DEFAULT]),
            tuple(range(seed, seed + runs)),
            tuple(_setting(text) for text in settings or ()),
            tuple(agent or ()),
            start,
        )
    outcome = _run(plan, output, where, overwrite)
    found = batches(outcome)
    if found:
        width = WHOLE_IN if figures.width is None else figures.width / 2.54
        write_results(output, found, figures.form, width)
        _table(summary_rows(found))
    done = sum(record is not None for record in outcome.records)
    line = f"{output}: {done} of {counted(len(outcome.records), 'run')}, {outcome.fresh} of them new"
    every = len(outcome.finished)
    if every > done:  # of earlier commands, with other methods or more seeds
        line += f"; with those that were there before, tables and figures are of {every}"
    out.print(line, highlight=False, markup=False, soft_wrap=True)
    (output / "failures.log").unlink(missing_ok=True)
    if outcome.failures:
        _report(outcome, output)
        raise typer.Exit(1)


def _setting(text: str) -> tuple[str, tuple[Any, ...]]:
    """Key and values of ``--set KEY=VALUE,VALUE``, as a scene file would read them."""
    key, equals, values = text.partition("=")
    try:
        whole = tomllib.loads(f"values = [{values}]") if equals and key.strip() else {}
    except tomllib.TOMLDecodeError:
        whole = {}
    found = whole["values"] if list(whole) == ["values"] else []
    if not found:
        raise InputError("--set", repr(text), 'KEY=VALUE,VALUE as in a scene file (text in "quotes")')
    return key.strip(), tuple(found)


def _run(plan: Study, output: Path, where: Workers, overwrite: bool) -> Outcome:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from gridslam.studies.study import run_study

    reported = [0, 0]
    columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task("runs", total=None)

        def tell(done: int, total: int) -> None:
            more = done > reported[0]
            reported[:] = done, total
            if not err.is_terminal and more:  # in a log file, a line per run
                err.print(f"{done} of {counted(total, 'run')}", highlight=False)
            bar.update(task, completed=done, total=total)

        try:
            return run_study(plan, output, where, overwrite, tell)
        except KeyboardInterrupt:
            bar.stop()
            again = f"{reported[0]} of {reported[1]} runs are kept; the same command goes on from here"
            err.print(f"interrupted: {again}", highlight=False, soft_wrap=True)
            sys.exit(130)  # said already


def _beside(error: float, spread: float, ratio: float) -> str:
    """An error, with its standard error and its ratio to the bound where there are any."""
    if math.isnan(error):
        return "-"
    either = "" if math.isnan(spread) else f"+-{spread:.2f}"
    return f"{error:.2f}{either}" + ("" if math.isnan(ratio) else f", {ratio:.2f}x")


def _metres(value: float) -> str:
    """A length in m; a dash for none, as of surfaces where a method maps none."""
    return "-" if math.isnan(value) else f"{value:.3f}"


def _named(column: str, value: Any) -> str:
    """What tells a row from others; settings with the key that was varied."""
    return str(value) if "." not in column else f"{column.rpartition('.')[2]}={value}"


def _table(rows: list[dict[str, Any]]) -> None:
    table = Table(box=None)
    table.add_column("")
    lengths = ("position, cm", "heading, deg", "MOSPA, m", "VAs, m")
    for title in ("runs", "diverged", *lengths, "NEES", "silent", "paths"):
        table.add_column(title, justify="right", no_wrap=True)
    names = list(rows[0])
    for row in rows:
        table.add_row(
            ", ".join(_named(name, row[name]) for name in names[: names.index("runs")] if name in row),
            str(row["runs"]),
            str(row["diverged"]),
            _beside(
                100 * row["position_settled_rmse_m"],
                100 * row["position_settled_standard_error_m"],
                row["position_to_unknown_map_bound"],
            ),
            _beside(
                row["heading_settled_rmse_deg"],
                row["heading_settled_standard_error_deg"],
                row["heading_to_unknown_map_bound"],
            ),
            _metres(row["surface_ospa_m"]),
            _metres(row["image_ospa_m"]),
            f"{row['nees_in_band']:.0%}",
            "-" if math.isnan(row["silent_steps"]) else f"{row['silent_steps']:.0f}",
            "-" if math.isnan(row["ray_excess"]) else f"{row['ray_excess']:+.2f}",
        )
    print_whole(table)
    note = (
        "from step 50 on (of shorter runs the second half); +-: standard error over seeds (of differences "
        "on the same seeds: summary.csv); x: times the bound of an unknown map, of the mean over ways as "
        "rough as the filter assumes: on a smoother one 0.95 may be; MOSPA: of the surfaces at the end; VAs: "
        "of the paths' virtual anchors; NEES: share of all steps in its 95 % band; silent: steps, of all "
        "runs, at which the position is off by over 4 claimed deviations while health is well; paths: "
        "detected minus true"
    )
    out.print(note, highlight=False, soft_wrap=True)


def _report(outcome: Outcome, output: Path) -> None:
    from gridslam.io.files import write_bytes

    jobs, lines = outcome.study.jobs(), []
    for number, trace in sorted(outcome.failures.items()):
        job = jobs[number]
        lines.append(f"{job.variant.label}, {job.method}, seed {job.seed}\n{trace.rstrip()}\n\n")
    write_bytes(output / "failures.log", "".join(lines).encode())
    first = lines[0].strip().splitlines()
    line = f"{counted(len(lines), 'run')} failed ({first[0]}: {first[-1]}); see {output / 'failures.log'}"
    err.print(line, highlight=False, markup=False, soft_wrap=True)
