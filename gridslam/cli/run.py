"""Command line: `run`. Agents one after the other; those at once are in `gridslam.cli.network`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import typer
from rich.console import Console

from gridslam.cli.agents import agents_of
from gridslam.cli.asked import Asked, RunOptions
from gridslam.cli.doubts import (
    element_notes,
    fit_notes,
    found_notes,
    jolt_notes,
    map_notes,
    radio_notes,
    silence_notes,
    whole_walls_notes,
)
from gridslam.cli.network import run_network
from gridslam.cli.observed import (
    files_of,
    hints,
    noted,
    recorded,
    refuse_without_distances,
    require_map_used,
    simulated_note,
    source,
    suited_method,
    view_of,
)
from gridslam.cli.output import busy, interruptible, reserved
from gridslam.cli.resume import refuse_contradictions, unfinished
from gridslam.cli.run_begin import map_before, tell
from gridslam.cli.run_end import Done, finish, go_on_later, judged
from gridslam.errors import InputError, renamed
from gridslam.systems.registry import METHODS, method_class, taken_by

if TYPE_CHECKING:
    from gridslam.maps.map import Map
    from gridslam.measurements.observations import Observations
    from gridslam.runs.run import Run
    from gridslam.runs.unfinished import Unfinished
    from gridslam.systems.slam import Slam
    from gridslam.viewers.rerun_view import RunView
    from gridslam.world.observation import Kind
    from gridslam.world.scene import Scene

    Explored = tuple[list[Run], list[Observations], bool, Exception | None]

err = Console(stderr=True)


def run(context: typer.Context, options: RunOptions) -> None:
    """Run SLAM: map a scene with its agents, each from the map that the one before it left."""
    from gridslam.measurements.first_steps import first_of_scene
    from gridslam.world.scene import Scene

    if options.resume is not None:
        refuse_contradictions(context, options.resume)
    if Path(options.scene).suffix in (".csv", ".h5", ".mat"):
        allowed = f"a scene, and then --measurements {options.scene} (or --signal {options.scene})"
        raise InputError("SCENE", repr(options.scene), allowed)
    world = Scene.load(options.scene)
    with renamed(world.name, options.scene):
        if options.particles is not None:
            world = world.with_filter(particles=options.particles)
        if options.steps is not None:
            world = first_of_scene(world, options.steps)
        asked = Asked.of(context, options, world)
        if asked.method in METHODS and METHODS[asked.method].several:
            run_network(asked)
        else:
            _run_in_turn(asked)


@dataclass(frozen=True)
class Plan:
    """Who explores in turn, by which method, and where what they heard stands.

    Attributes
    ----------
    names : list of str
    method : str
        As it suits the scene and the files.
    system : type
    takes : str
        What the method takes: paths or samples.
    files : dict of str to Path
        Of what agents heard, by their names; what isn't there is simulated.
    unsaid : Path or None
        The file of which nobody said whose it is.
    how : str
        What agents are told of their start.
    """

    names: list[str]
    method: str
    system: type[Slam]
    takes: Kind
    files: dict[str, Path]
    unsaid: Path | None
    how: str

    @classmethod
    def of(cls, asked: Asked) -> Self:
        """As it was asked for.

        Raises
        ------
        InputError
            What was asked for contradicts itself, the scene, or the method.
        """
        world = asked.world
        takes = taken_by(method_class(asked.method, "--method"))
        files = files_of(asked, takes)
        names = agents_of(world, asked.agent, files)
        by_name = {name or names[0]: path for name, path in files.items()}
        first = by_name.get(names[0])
        method = suited_method(asked.method, world, names, list(by_name.values()))
        system = method_class(method, "--method")
        require_map_used(asked.map_file, system, method)
        if first is None and takes == "signal":
            world.waveform(names[0])
        return cls(names, method, system, takes, by_name, files.get(None), asked.start_how(first))

    @property
    def first(self) -> Path | None:
        """Where what the first agent heard stands."""
        return self.files.get(self.names[0])


def _run_in_turn(asked: Asked) -> None:
    """Run agents one after the other."""
    from gridslam import runtime

    world, plan = asked.world, Plan.of(asked)
    with (
        interruptible() as termination,
        reserved(asked.output, world.name, asked.overwrite, asked.resume is not None) as (folder, place),
    ):
        with noted() as read:
            known, whole = _recorded(asked, plan)
        refuse_without_distances(world, plan.method, [(plan.files[name], own) for name, own in known.items()])
        given, of_map = map_before(asked)
        with view_of(asked, plan.names) as view:
            runtime.start(asked.device, asked.threads)
            other = [simulated_note(world, plan.files[name], name, own) for name, own in known.items()]
            before = [*filter(None, other), *of_map, *hints(world, plan.method, whole)]
            tell([*place.notes, _taken_note(asked, plan), *before])
            resolved = {"agent": plan.names, "particles": world.filter.particles, "start": plan.how}
            earlier = unfinished(asked.context, place, world, plan.system, resolved)
            turns = Turns(world, plan.method, asked.seed, plan.how, known, given, view, earlier)
            runs, observations, stopped, fault = _explore(turns, plan.names)
            if stopped and earlier:
                go_on_later(folder, earlier, termination)
            done, late = _concluded(asked, plan, given, runs, observations, [*read, *before])
            if done.lacks and earlier:
                go_on_later(folder, earlier, termination)
            finish(folder, place, world, done, stopped or late, termination, fault)


def _recorded(asked: Asked, plan: Plan) -> tuple[dict[str, Observations], Observations | None]:
    """What agents heard where it isn't simulated: of the steps asked for, and all of the first agent's."""
    from gridslam.measurements.first_steps import first_heard

    tracks = asked.tracks(plan.names)
    shared = len(set(plan.files.values())) < len(plan.files)
    every = {
        name: recorded(
            asked.world, plan.files.get(name), tracks.get(name), plan.takes,
            name if asked.agent else None, shared,
        )
        for name in plan.names
    }  # fmt: skip
    heard = {name: own for name, own in every.items() if own is not None}
    if asked.steps is not None:
        heard = {name: first_heard(own, asked.steps) for name, own in heard.items()}
    return heard, every[plan.names[0]]


def _concluded(
    asked: Asked, plan: Plan, given: Map | None, runs: list[Run], observations: list[Observations],
    before: list[str],
) -> tuple[Done, bool]:  # fmt: skip
    """What the runs came to, with scores and notes, and whether they were asked to stop meanwhile."""
    from gridslam.runs.stopping import held_back

    world, file = asked.world, plan.first
    notes = [
        lambda: radio_notes(world) + found_notes(runs) + element_notes(runs) + jolt_notes(world, runs),
        lambda: map_notes(given, runs[-1].map, asked.map_file) + whole_walls_notes(runs),
        lambda: silence_notes(world, given, runs, observations, asked.map_file),
    ]
    if file is not None:
        notes.append(lambda: fit_notes(world, runs, observations, file, asked.scene))
    scores, said, lacks = judged(
        lambda: _scores(world, runs, observations, given, file is None),
        lambda: [one.score() for one in runs],
        notes,
    )
    with held_back() as late:  # whatever is computed by now is written
        settings = source([plan.files[one.agent] for one in runs if plan.files])
        if asked.map_file is not None:
            folder_too = "/".join(asked.map_file.resolve().parts[-2:])  # most are called map.h5
            settings["map"] = source([asked.map_file])["source"] | {"file": folder_too}
        if file is not None:  # nobody knows how exact it is
            settings["start"] = "scene"
        progress = _progress(runs, observations, plan.names)
        done = Done(runs, observations, scores, settings, progress, notes=said, before=before, lacks=lacks)
    return done, late.is_set()


def _taken_note(asked: Asked, plan: Plan) -> str | None:
    """Whose a file is taken to be, where nobody said so and the scene has several agents."""
    mine, others = plan.names[0], [one.name for one in asked.world.agents if one.name not in plan.names]
    if asked.agent or plan.unsaid is None or not others:
        return None
    return f"{plan.unsaid}: taken for {mine}'s, the scene's first agent; else: --agent {' or '.join(others)}"


@dataclass(frozen=True)
class Turns:
    """What agents that explore one after the other have in common.

    Attributes
    ----------
    world : Scene
    method : str
    seed : int
    how : str
        What they are told of their start.
    recorded : mapping of Measurements or Recording
        What agents heard, by their names, if it isn't simulated.
    given : Map or None
        What the first of them starts from.
    view : RunView or None
        Who shows it meanwhile.
    earlier : Unfinished or None
        The checkpoint.
    """

    world: Scene
    method: str
    seed: int
    how: str
    recorded: Mapping[str, Observations]
    given: Map | None
    view: RunView | None
    earlier: Unfinished | None


def _explore(turns: Turns, names: list[str]) -> Explored:
    """Run the agents in turn, and say whether they were stopped and what somebody's own step raised.

    Either ends the list early; it raises if that is empty and nothing is there to go on from.

    Raises
    ------
    InputError
        The map that they begin with was made of what one of them heard.
    """
    from gridslam.maps.run_identity import first_identity, refuse_heard
    from gridslam.runs.map_scene import map_scene
    from gridslam.runs.progress import progress_bar
    from gridslam.runs.stopping import StoppedLate, is_theirs, run_before
    from gridslam.simulation.simulate import observations_of
    from gridslam.world.start import assumed_start

    world, method, seed, earlier, view = turns.world, turns.method, turns.seed, turns.earlier, turns.view
    runs: list[Run] = []
    observations: list[Observations] = []

    def heard(number: int) -> Observations:
        observed = earlier.measurements(number) if earlier else None
        observed = turns.recorded.get(names[number]) if observed is None else observed
        if observed is None:
            with busy(f"simulating {names[number]}"):
                observed = observations_of(world, names[number], seed, taken_by(method_class(method)))
        return observed

    try:
        if turns.given is not None:  # before the first of them has taken its time
            for number in range(len(names)):
                own_run = first_identity(world.anchor_positions, heard(number))
                refuse_heard(turns.given.provenance, own_run, f"--map for {names[number]}")
        for number, name in enumerate(names):
            observed = heard(number)
            own = earlier.agent(number, name, observed) if earlier else None
            watch = view.follow(name, observed.truth) if view else None
            with progress_bar(name, observed.truth, err) as tell:
                prior = runs[-1].map if runs else turns.given
                observations.append(observed)
                try:
                    runs.append(map_scene(
                        world, observed, method, name, seed, prior, tell, watch=watch,
                        start=assumed_start(world, name, seed, turns.how), checkpoint=own,
                    ))  # fmt: skip
                except StoppedLate as late:
                    runs.append(late.run)  # it is whole all the same
                    raise
                except Exception as error:
                    runs += filter(None, [run_before(error)])
                    if earlier or not (runs and is_theirs(error)):
                        raise
                    return runs, observations[: len(runs)], False, error
            if view:
                view.show_map(runs[-1].map)
            if runs[-1].interrupted:
                break
    except KeyboardInterrupt:
        if not (runs or earlier):
            raise
        return runs, observations[: len(runs)], True, None
    return runs, observations, runs[-1].interrupted, None


def _progress(runs: list[Run], observations: list[Observations], names: list[str]) -> str:
    """How far agents in turn have got; nothing if through."""
    last, total = runs[-1], len(observations[-1])
    if last.interrupted:
        return f"{len(last.estimates)} of {total} steps of {last.agent}"
    left = names[len(runs) :]
    return f"all {total} steps of {last.agent}, before the last of {left[0]}" if left else ""


def _scores(
    world: Scene, runs: list[Run], observations: list[Observations], given: Map | None, simulated: bool
) -> list[dict[str, Any]]:
    """Score each run against its own track and the walls that any agent so far could hear of.

    What was simulated in a scene without walls knows that there are none.
    """
    from gridslam.evaluation.ground_truth import inherited_truth, truth_of
    from gridslam.simulation.image_source import Truth

    earlier = inherited_truth(world, given) if given is not None else []
    scores = []
    for done, observed in zip(runs, observations, strict=True):
        truth = truth_of(world, done.agent, observed.truth, simulated)
        scores.append(done.score(truth, earlier))
        if isinstance(truth, Truth):
            earlier = [*earlier, truth.first(len(done.estimates))]
    return scores
