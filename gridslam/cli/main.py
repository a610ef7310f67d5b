"""Command line: mapping and simulating. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import sys
import warnings
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from gridslam.cli import bench, files, network, scene, signals
from gridslam.cli.help import COMPARE, MAP, SCENE_HELP, about, method_names, scene_names
from gridslam.cli.observed import angles_hint, given_file, recorded, require_map_used, source, suited_method
from gridslam.cli.output import ended, interruptible, reserved
from gridslam.cli.resume import as_saved, refuse_contradictions, unfinished
from gridslam.cli.robustness import robustness
from gridslam.cli.study import study
from gridslam.errors import InputError, Note, Unwritten
from gridslam.systems.registry import DEFAULT, METHODS, method_class, method_help, taken_by

if TYPE_CHECKING:
    from gridslam.maps.map import Map
    from gridslam.measurements.heard import Heard
    from gridslam.runs.reservation import Place
    from gridslam.runs.run import Run
    from gridslam.runs.unfinished import Unfinished
    from gridslam.viewers.rerun_view import RunView
    from gridslam.world.scene import Scene

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
out, err = Console(), Console(stderr=True)
MAIN_SCENE = "hall"
WIDEST_TABLE = 160
"""Columns up to which the table is printed whole, whatever the terminal."""
app.callback()(about)


@app.command(rich_help_panel=MAP)
def run(
    context: typer.Context,
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, autocompletion=scene_names)] = MAIN_SCENE,
    agent: Annotated[list[str] | None, typer.Option(help="agents, in order")] = None,
    method: Annotated[str, typer.Option(help=method_help(), autocompletion=method_names)] = DEFAULT,
    particles: Annotated[int | None, typer.Option(help="instead of the scene's filter.particles")] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    measurements: Annotated[
        Path | None, typer.Option(help="CSV, MATLAB or HDF5 file of the one agent")
    ] = None,
    signal: Annotated[
        Path | None, typer.Option(help="sampled signals of the one agent, for methods that take them")
    ] = None,
    truth: Annotated[Path | None, typer.Option(help="TUM track to score what was recorded by")] = None,
    map_file: Annotated[Path | None, typer.Option("--map", help="map to start from")] = None,
    same_frame: Annotated[
        bool, typer.Option("--same-frame", help="the map is in the scene's frame, though it shares no anchor")
    ] = False,
    start: Annotated[
        str | None, typer.Option(help="told start: drawn from the prior by seed (default), or exact")
    ] = None,
    device: Annotated[str, typer.Option(help="auto, cpu or gpu")] = "auto",
    threads: Annotated[int | None, typer.Option(min=1)] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="new folder")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace an earlier run's folder")] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="show it in the Rerun viewer meanwhile")] = False,
    rerun_to: Annotated[
        str | None, typer.Option(help="FILE.rrd to record to instead, or HOST:PORT of a viewer")
    ] = None,
    checkpoint: Annotated[
        int | None, typer.Option(min=1, help="steps between checkpoints, from which --resume goes on")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            help="folder of an interrupted run with --checkpoint: go on with it, as it was asked for",
            is_eager=True,
            callback=as_saved,
        ),
    ] = None,
) -> None:
    """Map a scene with its agents, each starting from the map that the one before it left."""
    from gridslam import runtime
    from gridslam.maps.frames import fitted
    from gridslam.maps.map import Map
    from gridslam.world.scene import Scene

    if resume is not None:
        refuse_contradictions(context, resume)
        output = resume
    world = Scene.load(scene)
    world = world if particles is None else world.with_filter(particles=particles)
    if method in METHODS and METHODS[method].several:
        for option, asked in (
            ("--truth", truth),
            ("--signal", signal),
            ("--checkpoint", checkpoint),
            ("--rerun", rerun or rerun_to),
        ):
            if asked:
                raise InputError(option, f"with --method {method}", "none: all agents run at once")
        whole, tables, more = network.run_network(
            world, method, agent, seed, measurements, map_file, same_frame, start, device, threads, output,
            overwrite,
        )  # fmt: skip
        out.print(_table(list(whole.runs.values()), tables), width=max(out.width, WIDEST_TABLE), crop=False)
        network.say(more, out)
        return
    takes = taken_by(method_class(method, "--method"))
    file = given_file(measurements, signal, takes, method)
    names = _agents(world, agent, file)
    method = suited_method(method, world, names, file)
    system = method_class(method, "--method")
    require_map_used(map_file, system, method)
    if file is None and takes == "signal":
        world.waveform(names[0])
    how = _start(start, file)
    going_on = resume is not None
    with interruptible() as termination, reserved(output, world.name, overwrite, going_on) as (folder, place):
        heard = recorded(world, file, truth, takes)
        prior = Map.load(map_file) if map_file else None
        given, note = fitted(prior, world, str(map_file), same_frame) if prior is not None else (None, None)
        with _view(world, names, rerun_to, overwrite) if rerun or rerun_to else nullcontext() as view:
            runtime.start(device, threads)
            for line in (*place.notes, note, angles_hint(world, method, heard)):
                if line:
                    err.print(f"note: {line}", highlight=False, markup=False, soft_wrap=True)
            resolved = {"agent": names, "particles": world.filter.particles, "start": how}
            kept = unfinished(context, place, world, system, resolved)
            runs, heards = _explore(world, names, method, seed, how, heard, given, view, kept)
            stopped = len(runs) < len(names) or runs[-1].interrupted
            scores = []
            try:
                if not (stopped and kept):
                    with _busy("scoring"):
                        scores = _scores(world, runs, heards, given)
            except KeyboardInterrupt:
                scores, stopped = [done.score() for done in runs], True
            if stopped and kept:
                line = f"{ended(termination)} after {kept.where()}; to go on: gridslam run --resume {folder}"
                err.print(line, highlight=False, markup=False, soft_wrap=True)
                sys.exit(143 if termination.asked else 130)
            stopped = not _finish(folder, place, world, runs, heards, scores, source(file)) or stopped
        if stopped:
            done = f"{len(runs[-1].estimates)} of {len(heards[-1])} steps of {runs[-1].agent}"
            line = f"{ended(termination)} after {done}: {folder} holds what was done"
            err.print(line, highlight=False, markup=False, soft_wrap=True)
            sys.exit(143 if termination.asked else 130)


@app.command(rich_help_panel=MAP)
def simulate(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, autocompletion=scene_names)],
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.csv or FILE.h5")],
    agent: Annotated[
        list[str] | None, typer.Option(help="default: the first; several go into one file")
    ] = None,
    unlabelled: Annotated[
        bool, typer.Option("--unlabelled", help="nothing says which anchor a measurement is of")
    ] = False,
    signal: Annotated[
        bool, typer.Option("--signal", help="sampled signals instead of paths, into FILE.h5")
    ] = False,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace files of these names")] = False,
) -> None:
    """Write what an agent would hear, or several agents at once."""
    from gridslam.io.files import refuse_taken
    from gridslam.simulation.simulate import simulate as hear
    from gridslam.world.scene import Scene

    if output.suffix not in (".csv", ".h5"):
        raise InputError("-o", repr(output.name), "a name that ends in .csv or .h5")
    world = Scene.load(scene)
    names = _agents(world, agent or [a.name for a in world.agents[:1]], None)
    refuse_taken([output], overwrite)
    if signal:
        if len(names) > 1 or unlabelled:
            raise InputError("--signal", "several agents" if len(names) > 1 else "--unlabelled", "one agent")
        if output.suffix != ".h5":
            raise InputError("-o", repr(output.name), "a name that ends in .h5, with --signal")
        samples = hear(world, names[0], seed, what="signal")
        samples.to_h5(output)
        counts = f"{len(samples)} steps, samples {' x '.join(map(str, samples.waveform.shape))}"
    elif len(names) == 1 and not unlabelled:
        heard = hear(world, names[0], seed)
        (heard.to_csv if output.suffix == ".csv" else heard.to_h5)(output)
        counts = f"{len(heard)} steps, {len(heard.step)} measurements"
    else:
        several = hear(world, names, seed, unlabelled)
        (several.to_csv if output.suffix == ".csv" else several.to_h5)(output)
        counts = f"{len(names)} agents, {len(several)} steps, {len(several.agent)} measurements"
    out.print(f"wrote {output}: {counts}", highlight=False, soft_wrap=True)


signals.register(app)
files.register(app)
scene.register(app)
app.command(rich_help_panel=COMPARE)(study)
app.command(rich_help_panel=COMPARE)(robustness)
bench.register(app)


def main() -> None:
    """Entry point: bad input is one line and exit code 2, Ctrl-C is 130, never a traceback for either."""
    said: set[str] = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in said:  # a file may be read twice
            said.add(str(message))
            err.print(f"note: {message}", highlight=False, markup=False, soft_wrap=True)

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", Note)
            shown = warnings.showwarning
            warnings.showwarning = lambda message, kind, *rest: (
                show(message) if issubclass(kind, Note) else shown(message, kind, *rest)
            )
            code = app(standalone_mode=False)
    except Unwritten as error:
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


def _refuse(reason: str) -> None:
    """Say in one line what is wrong, whatever line breaks it quotes."""
    line = " ".join(reason.split())
    if line:  # no arguments at all: the help was shown
        err.print(f"error: {line}", highlight=False, markup=False, soft_wrap=True)
    sys.exit(2)


def _busy(what: str) -> AbstractContextManager[object]:
    """A sign of life on a terminal."""
    return err.status(what) if err.is_terminal else nullcontext()


def _agents(world: Scene, chosen: list[str] | None, measurements: Path | None) -> list[str]:
    """Names of the agents to run, all of which can be."""
    names = chosen or [agent.name for agent in world.agents[: 1 if measurements else None]]
    if not names:
        raise InputError(f"{world.name}: agents", "none", "at least one")
    if measurements and len(names) > 1:
        raise InputError("--agent", ", ".join(names), "one agent with --measurements")
    if len(set(names)) < len(names):
        raise InputError("--agent", ", ".join(names), "each agent once")
    for name in names:
        world.agent(name)
        if measurements is None and not world.walls:
            raise InputError(
                f"{world.name}: walls",
                "none",
                "walls to simulate from, or --measurements FILE (--signal FILE)",
            )
        if measurements is None:
            world.track(name)
    return names


def _start(asked: str | None, measurements: Path | None) -> str:
    """What agents are told of their start: of recorded measurements, the scene's own is all that is known."""
    from gridslam.world.start import HOWS

    if asked is not None and asked not in HOWS:
        raise InputError("--start", repr(asked), " or ".join(HOWS))
    if measurements is not None and asked == "drawn":
        raise InputError("--start", "drawn with --measurements", "exact: the scene's own start")
    return asked or ("drawn" if measurements is None else "exact")


def _view(
    world: Scene, names: list[str], where: str | None, overwrite: bool
) -> AbstractContextManager[RunView]:
    from gridslam.viewers.rerun_view import open_view

    return open_view(world, names, where, overwrite)


def _explore(
    world: Scene,
    names: list[str],
    method: str,
    seed: int,
    how: str,
    recorded: Heard | None,
    given: Map | None,
    view: RunView | None = None,
    kept: Unfinished | None = None,
) -> tuple[list[Run], list[Heard]]:
    """Run the agents one after the other; Ctrl-C ends the list early.

    It raises only if that is empty and nothing is kept to go on from.
    """
    from gridslam.runs.map_scene import map_scene
    from gridslam.runs.progress import progress_bar
    from gridslam.simulation.simulate import heard_by
    from gridslam.world.start import told_start

    takes = taken_by(method_class(method))

    runs: list[Run] = []
    heards: list[Heard] = []
    try:
        for number, name in enumerate(names):
            with _busy(f"simulating {name}"):
                heard = kept.measurements(number) if kept else recorded
                heard = recorded if heard is None else heard
                heard = heard_by(world, name, seed, takes) if heard is None else heard
            own = kept.agent(number, name, heard) if kept else None
            watch = view.follow(name, heard.truth) if view else None
            with progress_bar(name, heard.truth, err) as tell:
                prior = runs[-1].map if runs else given
                start = told_start(world, name, seed, how)
                done = map_scene(
                    world, heard, method, name, seed, prior, tell, watch=watch, start=start, checkpoint=own
                )
            heards.append(heard)
            runs.append(done)
            if view:
                view.show_map(done.map)
            if done.interrupted:
                break
    except KeyboardInterrupt:
        if not (runs or kept):
            raise
    return runs, heards[: len(runs)]


def _scores(world: Scene, runs: list[Run], heards: list[Heard], given: Map | None) -> list[dict[str, Any]]:
    """Score each run against its own track and the walls that any agent so far could hear of."""
    from gridslam.evaluation.ground_truth import inherited_truth, truth_of
    from gridslam.simulation.image_source import Truth

    earlier = inherited_truth(world, given) if given is not None else []
    scores = []
    for done, heard in zip(runs, heards, strict=True):
        truth = truth_of(world, done.agent, heard.truth)
        scores.append(done.score(truth, earlier))
        if isinstance(truth, Truth):
            earlier = [*earlier, truth.first(len(done.estimates))]
    return scores


def _finish(
    folder: Path,
    place: Place,
    world: Scene,
    runs: list[Run],
    heards: list[Heard],
    scores: list[dict[str, Any]],
    settings: dict[str, Any],
) -> bool:
    """Write the folder and say what is in it; False if Ctrl-C ended the writing or drawing."""
    from gridslam.runs.run_files import write_run
    from gridslam.viewers.plots import draw_all

    whole = True

    def draw(part: Path) -> None:
        nonlocal whole
        try:
            with _busy("drawing figures"):
                draw_all(part)
        except KeyboardInterrupt:
            whole = False

    fault: InputError | None = None
    try:
        write_run(folder, world, runs, heards, scores, settings, place.overwrite, draw, place)
    except KeyboardInterrupt:
        whole = False
    except InputError as error:  # the table is worth seeing all the same
        fault = error
    out.print(_table(runs, scores), width=max(out.width, WIDEST_TABLE), crop=False)
    for done, score in zip(runs, scores, strict=True):
        for why, steps in score["health"]["why"].items():
            line = f"note: {done.agent}: {why} ({steps} of {len(done.estimates)} steps)"
            out.print(line, highlight=False, markup=False, soft_wrap=True)
    if fault is not None:
        raise fault
    out.print(
        f"wrote {folder}, computed on the {runs[-1].device}", highlight=False, markup=False, soft_wrap=True
    )
    return whole


def _table(runs: list[Run], scores: list[dict[str, Any]]) -> Table:
    """One line per agent; units in the titles."""
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    titles = "agent", "steps", "position\nRMSE cm", "bound\ncm", "heading\nRMSE deg", "bound\ndeg"
    for title in (*titles, "surfaces\nfound true", "map\nprecision", "map\nrecall", "s/step"):
        table.add_column(title, justify="left" if title == "agent" else "right", no_wrap=True)

    def number(value: float | None, form: str, scale: float = 1, own: float | None = None) -> str:
        if value is None and own is not None:  # without a truth, what the filter says itself
            return f"+-{format(scale * own, form)}"
        return "-" if value is None else format(scale * value, form)

    for done, score in zip(runs, scores, strict=True):
        found, matched, true = (score[f"surfaces_{key}"] for key in ("detected", "matched", "true"))
        of = "" if true is None else f" {matched}/{true}"
        if found is None:
            found = f"{score['features']} features" if score["features"] else "-"
        table.add_row(
            done.agent,
            str(score["steps"]),
            number(score["position_rmse_m"], ".2f", 100, score["position_std_m"]),
            number(score["position_bound_m"], ".2f", 100),
            number(score["heading_rmse_deg"], ".2f", 1, score["heading_std_deg"]),
            number(score["heading_bound_deg"], ".2f"),
            f"{found}{of}",
            number(score["map"]["occupied_precision"], ".1%"),
            number(score["map"]["occupied_recall"], ".1%"),
            number(score["seconds_per_step"], ".3f"),
        )
    return table
