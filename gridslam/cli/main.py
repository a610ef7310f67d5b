"""Command line: its commands. Nothing heavy is imported before one runs."""

from __future__ import annotations

import gc
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from gridslam.cli import bench, files, scene, signals
from gridslam.cli.agents import agents_of, simulation_note
from gridslam.cli.help import COMPARE, MAP, SCENE_HELP, about, scene_names
from gridslam.cli.options import Commands, flag, unpacked
from gridslam.cli.robustness import robustness
from gridslam.cli.run import run
from gridslam.cli.study import study
from gridslam.errors import Faults, InputError, Note, renamed
from gridslam.wording import counted

app = Commands(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
out, err = Console(), Console(stderr=True)
COLLECT_EVERY = 50_000
"""Objects made between two searches for garbage, not Python's 700: those of modules and kernels all stay."""
app.callback()(about)
app.command(rich_help_panel=MAP)(unpacked(run))


@app.command(rich_help_panel=MAP)
def simulate(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, autocompletion=scene_names)],
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.csv or FILE.h5")],
    agent: Annotated[
        list[str] | None, typer.Option(help="default: the first; several go into one file")
    ] = None,
    unlabelled: Annotated[
        bool,
        flag(
            "--unlabelled",
            "nothing says which anchor a measurement is of; the scene's false_alarms count for all together",
        ),
    ] = False,
    signal: Annotated[bool, flag("--signal", "sampled signals instead of paths, into FILE.h5")] = False,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    overwrite: Annotated[bool, flag("--overwrite", "replace files of these names")] = False,
) -> None:
    """Write what an agent would hear, or several agents at once."""
    from gridslam.io.files import new_file
    from gridslam.simulation.simulate import simulate as hear
    from gridslam.world.scene import Scene

    if output.suffix not in (".csv", ".h5"):
        raise InputError("-o", repr(output.name), "a name that ends in .csv or .h5")
    world = Scene.load(scene)
    with renamed(world.name, scene):
        names = agents_of(world, agent or [a.name for a in world.agents[:1]], {})
        if note := simulation_note(world):
            err.print(f"note: {note}", highlight=False, markup=False, soft_wrap=True)
        with new_file(output, overwrite) as part:
            if signal:
                if len(names) > 1 or unlabelled:
                    raise InputError(
                        "--signal", "several agents" if len(names) > 1 else "--unlabelled", "one agent"
                    )
                if output.suffix != ".h5":
                    raise InputError("-o", repr(output.name), "a name that ends in .h5, with --signal")
                samples = hear(world, names[0], seed, what="signal")
                samples.to_h5(part)
                counts = (
                    f"{counted(len(samples), 'step')}, samples {' x '.join(map(str, samples.waveform.shape))}"
                )
            elif len(names) == 1 and not unlabelled:
                measurements = hear(world, names[0], seed)
                (measurements.to_csv if output.suffix == ".csv" else measurements.to_h5)(part)
                rows = counted(len(measurements.step), "measurement")
                counts = f"{counted(len(measurements), 'step')}, {rows}"
            else:
                several = hear(world, names, seed, unlabelled)
                (several.to_csv if output.suffix == ".csv" else several.to_h5)(part)
                rows = counted(len(several.agent), "measurement")
                counts = f"{counted(len(names), 'agent')}, {counted(len(several), 'step')}, {rows}"
        what = f"{world.name}, {', '.join(names)}, seed {seed}"
        out.print(f"wrote {output}: {counts} ({what})", highlight=False, markup=False, soft_wrap=True)


signals.register(app)
files.register(app)
scene.register(app)
app.command(rich_help_panel=COMPARE)(unpacked(study))
app.command(rich_help_panel=COMPARE)(robustness)
bench.register(app)


def main() -> None:
    """Entry point: bad input is one line and exit code 2, Ctrl-C is 130, never a traceback for either."""
    printed: set[str] = set()
    gc.set_threshold(COLLECT_EVERY)

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in printed:  # a file may be read twice
            printed.add(str(message))
            err.print(f"note: {message}", highlight=False, markup=False, soft_wrap=True)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", Note)
            shown = warnings.showwarning
            warnings.showwarning = lambda message, kind, *rest: (
                show(message) if issubclass(kind, Note) else shown(message, kind, *rest)
            )
            code = _commands()(standalone_mode=False)
    except Faults as error:
        for fault in error.faults[:-1]:
            err.print(f"error: {fault}", highlight=False, markup=False, soft_wrap=True)
        _refuse(str(error.faults[-1]))
    except InputError as error:
        _refuse(str(error))
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    except OSError as error:
        _refuse(f"{error.filename or 'output'}: {error.strerror or error}")
    except Exception as error:
        if not hasattr(error, "format_message"):  # a usage error, whichever click typer brings along
            raise
        _refuse(error.format_message())
    if code == 130:  # typer makes it of a Ctrl-C that no command took care of
        err.print("interrupted")
    sys.exit(code if isinstance(code, int) else 0)


@cache
def _commands() -> Any:
    """All commands with their options: who calls `main` more than once needn't have them made anew."""
    return typer.main.get_command(app)


def _refuse(reason: str) -> None:
    """Say in one line what is wrong, whatever line breaks it quotes."""
    line = " ".join(reason.split())
    if line:  # no arguments at all: the help was shown
        err.print(f"error: {line}", highlight=False, markup=False, soft_wrap=True)
    sys.exit(2)
