"""Command line: speed on this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from gridslam.cli.help import COMPARE
from gridslam.cli.options import flag
from gridslam.cli.output import print_whole
from gridslam.errors import InputError
from gridslam.systems.registry import method_class, method_help

if TYPE_CHECKING:
    from gridslam.bench.bench import Speed, StepSpeed, Tell
    from gridslam.bench.growth import Growth
    from gridslam.bench.kernels import KernelSpeed

out, err = Console(), Console(stderr=True)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(rich_help_panel=COMPARE)(bench)


def bench(
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="write all numbers here too")
    ] = None,
    quick: Annotated[bool, flag("--quick", "everything, but too briefly to be exact")] = False,
    method: Annotated[
        list[str] | None,
        typer.Option(help="time steps of this one alone: " + method_help("; may be repeated")),
    ] = None,
    device: Annotated[str, typer.Option(help="auto, cpu or gpu")] = "auto",
    threads: Annotated[int | None, typer.Option(min=1, help="of the kernels")] = None,
    overwrite: Annotated[bool, flag("--overwrite", "replace that file")] = False,
) -> None:
    """Measure speed and memory on this machine: kernels against NumPy, steps, growth, start-up."""
    from gridslam.bench.bench import measure
    from gridslam.bench.plan import QUICK, Plan
    from gridslam.io.files import refuse_taken, write_bytes

    methods = list(dict.fromkeys(method or ()))
    for name in methods:
        method_class(name, "--method")
    if json_file is not None:
        _check_output(json_file)
        refuse_taken([json_file], overwrite)
    with _progress() as tell:
        speed = measure(QUICK if quick else Plan(), device, threads, tell, methods)
    if json_file is not None:
        write_bytes(json_file, speed.to_json().encode())
    for line in _machine(speed):
        out.print(line, highlight=False, markup=False, soft_wrap=True)
    tables = [_steps(speed.steps), _stages(speed.steps)]
    if not methods:
        tables = [_kernels(speed.kernels), *tables, _growth(speed.growth)]
    for table in tables:
        out.print()
        print_whole(table)
    if json_file is not None:
        out.print(f"wrote {json_file}", highlight=False, markup=False, soft_wrap=True)


def _check_output(path: Path) -> None:
    """Refuse at once what couldn't be written after minutes of work."""
    folder = path.resolve().parent
    if path.is_dir():
        raise InputError("--json", f"{str(path)!r} is a folder", "the name of a file")
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError("--json", repr(str(path)), "a file in a folder that can be written to")


@contextmanager
def _progress() -> Iterator[Tell]:
    """Say what is being measured, on a terminal alone."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task("")
        yield lambda what, done, total: bar.update(task, description=what, completed=done, total=total)


def _machine(speed: Speed) -> list[str]:
    """What was measured on, and what isn't a table."""
    here, start = speed.machine, speed.start_up
    versions = ", ".join(f"{name} {version}" for name, version in here.versions.items())
    load = "load unknown" if here.load is None else f"load {here.load:.1f} before"
    lines = [
        f"{here.cpu}, {here.cores} cores, {here.memory_gb:.0f} GiB memory, {load}",
        here.system,
        f"kernels on {here.device}, {here.threads} threads; Python {here.python}, {versions}",
    ]
    if start is not None:
        brings = "with" if start.import_starts_taichi else "without"
        lines.append(
            f"import {start.import_s:.2f} s, {brings} Taichi; first step of a run of room after "
            f"{start.cold_s:.1f} s, {start.warm_s:.1f} s once its kernels are compiled"
        )
    return [*lines, f"measured in {speed.seconds:.0f} s"]


def _table(*titles: str, left: int = 1) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for number, title in enumerate(titles):
        table.add_column(title, justify="left" if number < left else "right", no_wrap=True)
    return table


def _kernels(kernels: tuple[KernelSpeed, ...]) -> Table:
    table = _table(
        "kernel", "scene", "unit", "units", "ms\nmedian", "ms\nbest", "ns/unit\nmedian", "NumPy\nms", "ratio",
        "launch\nus", left=3,
    )  # fmt: skip
    for k in kernels:
        table.add_row(
            k.name, k.scene, k.unit, str(k.units), f"{1e3 * k.kernel_s:.2f}", f"{1e3 * k.kernel_best_s:.2f}",
            f"{k.ns_per_unit:.1f}", f"{1e3 * k.twin_s:.0f}", f"{k.ratio:.0f}", f"{k.launch_us:.0f}",
        )  # fmt: skip
    return table


def _steps(steps: tuple[StepSpeed, ...]) -> Table:
    table = _table(
        "method",
        "scene",
        "particles",
        "from\nstep",
        "ms/step\nmedian",
        "steps/s",
        "CPU\nms/step",
        "peak\nMB",
        "not in\nkernels",
        left=2,
    )
    for s in steps:
        table.add_row(
            s.method, s.scene, str(s.particles), str(s.first), f"{s.step_ms:.1f}", f"{s.steps_per_s:.1f}",
            f"{s.cpu_ms:.1f}", f"{s.peak_memory_mb:.0f}", f"{s.not_kernel_share:.0%}",
        )  # fmt: skip
    return table


def _stages(steps: tuple[StepSpeed, ...]) -> Table:
    """Milliseconds by stage; a column per kind of run, kernels first."""
    names = list(dict.fromkeys(name for s in steps for name in s.stages_ms))
    names.sort(key=lambda name: not name.startswith("kernel "))
    table = _table(
        "ms\nby\nstage\n", *(f"{s.method}\n{s.scene}\n{s.particles}\nfrom {s.first}" for s in steps)
    )
    for name in names:
        table.add_row(name, *(f"{s.stages_ms.get(name, 0.0):.1f}" for s in steps))
    return table


def _growth(growth: tuple[Growth, ...]) -> Table:
    table = _table(
        "time\nwith", "to the\npower", "CPU time\nto the", "size", "ms", "CPU\nms", "times\nthe first",
        "peak\nMB",
    )  # fmt: skip
    for g in growth:
        powers = ("-" if power is None else f"{power:.2f}" for power in (g.exponent, g.cpu_exponent))
        first = (g.of, *powers)
        for size, seconds, cpu, memory in zip(g.size, g.seconds, g.cpu_s, g.peak_memory_mb, strict=True):
            times = f"{seconds / g.seconds[0]:.1f}" if g.seconds[0] else "-"
            figures = f"{size:.0f}", f"{1e3 * seconds:.1f}", f"{1e3 * cpu:.1f}", times, f"{memory:.0f}"
            table.add_row(*first, *figures)
            first = "", "", ""
    return table
