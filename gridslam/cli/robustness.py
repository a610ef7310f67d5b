"""The command ``gridslam robustness``. Nothing heavy is imported before it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from gridslam.cli.options import flag
from gridslam.cli.output import print_whole
from gridslam.errors import InputError
from gridslam.systems.registry import DEFAULT, method_class, method_help

if TYPE_CHECKING:
    from gridslam.studies.robustness import Result

out, err = Console(), Console(stderr=True)
FILE = "robustness.csv"


def robustness(
    output: Annotated[Path | None, typer.Option("-o", "--output", help="folder for the table")] = None,
    runs: Annotated[int, typer.Option(min=1, help="seeds per case")] = 3,
    seed: Annotated[int, typer.Option(min=0, help="the first seed")] = 1,
    scene: Annotated[list[str] | None, typer.Option(help="room, alcove or canyon")] = None,
    case: Annotated[list[str] | None, typer.Option(help="kinds of disturbance; default: all")] = None,
    method: Annotated[str, typer.Option(help=method_help())] = DEFAULT,
    threads: Annotated[int | None, typer.Option(min=1)] = None,
    overwrite: Annotated[bool, flag("--overwrite", "replace an earlier table")] = False,
) -> None:
    """Disturb what a filter hears and is told: errors in bounds before, during and after, and its health."""
    from gridslam import runtime
    from gridslam.io.files import write_bytes
    from gridslam.studies.robustness import plan, study, table

    pairs = plan(scene or ["room", "alcove", "canyon"], case or [])
    method_class(method, "--method")
    if output is not None:
        if (output / FILE).exists() and not overwrite:
            raise InputError(str(output / FILE), "something of this name", "a new folder (or --overwrite)")
        if output.exists() and not output.is_dir():
            raise InputError(str(output), "a file", "a folder")
        output.mkdir(parents=True, exist_ok=True)
    runtime.start(threads=threads)
    seeds = range(seed, seed + runs)
    results = []
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task("runs", total=len(pairs) * runs)
        for result in study(pairs, seeds, method):
            results.append(result)
            bar.advance(task)
            if output is not None:
                write_bytes(output / FILE, table(results))
    _show(results)
    if output is not None:
        out.print(f"wrote {output / FILE}", highlight=False, markup=False, soft_wrap=True)


def _show(results: list[Result]) -> None:
    """One line per scene and case, over the seeds."""
    import numpy as np

    from gridslam.studies.robustness import KINDS

    printed = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    titles = "scene", "disturbance", "before", "during", "after", "worst", "steps to\nrecover"
    for title in (*titles, "unwell before\nduring, after", "surfaces", "s/step", "good"):
        right = title not in ("scene", "disturbance")
        printed.add_column(title, justify="right" if right else "left", no_wrap=True)

    def number(values: list[float], form: str) -> str:
        known = [v for v in values if np.isfinite(v)]
        return format(float(np.sqrt(np.mean(np.square(known)))), form) if known else "-"

    for scene, case in dict.fromkeys((r.scene, r.case) for r in results):
        own = [r for r in results if (r.scene, r.case) == (scene, case)]
        took = [r.recovered_after for r in own]
        unwell = (
            [r.unwell_before for r in own], [r.unwell_during for r in own], [r.unwell_after for r in own],
        )  # fmt: skip
        printed.add_row(
            scene,
            KINDS[case].description,
            number([r.before for r in own], ".2f"),
            number([r.during for r in own], ".2f"),
            number([r.after for r in own], ".2f"),
            f"{max(r.after for r in own):.2f}",
            "never" if min(took) < 0 else str(max(took)),
            " ".join(f"{np.mean(u):.0%}" if np.isfinite(u).all() else "-" for u in unwell),
            f"{np.mean([r.surfaces for r in own]):.1f}",
            f"{np.mean([r.seconds_per_step for r in own]):.3f}",
            f"{sum(r.good for r in own)}/{len(own)}",
        )
    print_whole(printed)
    note = (
        "position error over known-map bound; after: from 50 steps after the disturbance (or the start) on; "
        "unwell: share of steps at which health isn't ok; good: within 2 bounds after, or said not to be"
    )
    out.print(note, highlight=False, soft_wrap=True)
