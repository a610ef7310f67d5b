"""Command line: a run of several agents at once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from gridslam.cli.doubts import heading_notes, map_notes, truth_notes, unknown_notes, whole_walls_notes
from gridslam.cli.observed import hints, noted, simulated_note, source, view_of
from gridslam.cli.output import interruptible, reserved
from gridslam.cli.resume import unfinished
from gridslam.cli.run_begin import map_before, tell
from gridslam.cli.run_end import Done, finish, go_on_later, judged
from gridslam.errors import InputError
from gridslam.systems.registry import method_class

if TYPE_CHECKING:
    from gridslam.cli.asked import Asked
    from gridslam.maps.map import Map
    from gridslam.measurements.network import NetworkMeasurements
    from gridslam.measurements.observations import Observations
    from gridslam.runs.network_run import NetworkRun
    from gridslam.runs.unfinished import Unfinished
    from gridslam.simulation.network import NetworkTruth
    from gridslam.viewers.rerun_view import RunView
    from gridslam.world.scene import Scene

err = Console(stderr=True)


def run_network(asked: Asked) -> None:
    """Locate all agents at once, and write the run's folder.

    Without measurements, what all agents hear is simulated, and nothing says whose it is, but for methods
    that stand for others, which take labels.
    """
    from gridslam import runtime

    world = asked.world
    _refuse_contradictions(asked)
    how = asked.start_how(asked.table)
    with (
        interruptible() as termination,
        reserved(asked.output, world.name, asked.overwrite, asked.resume is not None) as (folder, place),
    ):
        with noted() as read:
            heard, truth = _network_observations(asked)
        prior, of_map = map_before(asked)
        with view_of(asked, heard.agents) as view:
            runtime.start(asked.device, asked.threads)
            told = [*_stand_in(asked), *_notes_of_rows(asked, heard), *of_map, *_hints(asked, heard)]
            tell([*place.notes, *told])
            resolved = {"agent": list(heard.agents), "particles": world.filter.particles, "start": how}
            earlier = unfinished(asked.context, place, world, method_class(asked.method), resolved)
            before = earlier.network_measurements() if earlier is not None else None
            heard = heard if before is None else before
            done, stopped = _mapped(asked, heard, prior, how, earlier, view)
            if stopped and earlier is not None:
                go_on_later(folder, earlier, termination)
            end, late = _concluded(asked, done, heard, truth, prior, [*read, *told], view)
            if end.lacks and earlier is not None:
                go_on_later(folder, earlier, termination)
            finish(folder, place, world, end, stopped or late, termination)


def _refuse_contradictions(asked: Asked) -> None:
    """Refuse options that methods of several agents don't take, or not together."""
    recorded = asked.table is not None
    if asked.signal:
        found = f"{asked.signal[0]}, with method {asked.method!r}, which takes path measurements"
        raise InputError("--signal", found, "--measurements FILE")
    if recorded and asked.steps is not None:
        found = f"{asked.steps}, with a table of agents that are taken at once"
        raise InputError("--steps", found, "none: a table of fewer steps instead")
    if not recorded and asked.truth:
        raise InputError("--truth", asked.truth[0], "only together with --measurements")


def _stand_in(asked: Asked) -> list[str]:
    """Which method stands for the one that was asked for."""
    if asked.instead_of is None:
        return []
    labels = "" if asked.table else f"; labels are simulated, too (without: --method {asked.method})"
    found = f"{asked.world.name}: clocks aren't known, so {asked.instead_of} is {asked.method}"
    return [f"{found}, which finds them, those of all agents at once{labels}"]


def _notes_of_rows(asked: Asked, heard: NetworkMeasurements) -> list[str]:
    """What a file's rows look like."""
    if asked.table is None:
        return []
    note = simulated_note(asked.world, asked.table, heard.agents, heard.table)
    return [] if note is None else [note]


def _hints(asked: Asked, heard: NetworkMeasurements) -> list[str]:
    """What else may be asked for, of rows that were recorded, or none."""
    return hints(asked.world, asked.method, heard.table if asked.table is not None else None)


def _mapped(
    asked: Asked, heard: NetworkMeasurements, prior: Map | None, how: str, earlier: Unfinished | None,
    view: RunView | None,
) -> tuple[NetworkRun, bool]:  # fmt: skip
    """The run, and whether it was stopped; where its last step was done, it is whole all the same."""
    from gridslam.runs.network_run import map_network
    from gridslam.runs.progress import network_progress_bar
    from gridslam.runs.stopping import StoppedLate

    own = earlier.agent(0, ", ".join(heard.agents), heard) if earlier is not None else None
    watch = view.follow_all(heard.tracks) if view is not None else None
    try:
        with network_progress_bar(heard.tracks, err) as progress:
            done = map_network(
                asked.world, heard, asked.seed, prior, starts=how, progress=progress,
                method=asked.method, checkpoint=own, watch=watch,
            )  # fmt: skip
    except StoppedLate as late:
        return late.run, True
    return done, done.interrupted


def _concluded(
    asked: Asked, done: NetworkRun, heard: NetworkMeasurements, truth: NetworkTruth | None,
    prior: Map | None, before: list[str], view: RunView | None,
) -> tuple[Done, bool]:  # fmt: skip
    """What the run came to, with scores and notes, and whether it was asked to stop meanwhile."""
    from gridslam.runs.network_files import clock_files
    from gridslam.runs.network_run import network_scores
    from gridslam.runs.stopping import held_back

    with held_back() as shown:
        if view is not None:
            view.show_map(done.map)
        runs = list(done.runs.values())
        observed: list[Observations] = [heard[run.agent] for run in runs]
    notes = [lambda: map_notes(prior, done.map, asked.map_file) + whole_walls_notes(runs)]
    notes.append(lambda: heading_notes(asked.world, runs, observed))
    notes.append(lambda: drift_notes(asked.world, done))
    if asked.table is not None:
        notes += [
            lambda: truth_notes(asked.world, runs, observed),
            lambda: unknown_notes(asked.world, runs, observed),
        ]
    (scores, whole), said, lacks = judged(
        lambda: network_scores(done, heard, truth),
        lambda: ([run.score() for run in runs], done.score()),
        notes,
    )
    with held_back() as late:  # whatever is computed by now is written
        files = [] if asked.table is None else [asked.table]
        more: dict[str, Any] = source(files) | {"network": whole}
        if files:  # nobody knows how exact it is
            more["start"] = "scene"
        end = Done(
            runs, observed, scores, more,
            f"{len(done.clocks.step)} of {len(heard)} steps" if done.interrupted else "",
            clock_files(done.clocks, heard.clocks), _lines(whole), said, before, lacks,
        )  # fmt: skip
    return end, shown.is_set() or late.is_set()


def drift_notes(world: Scene, done: NetworkRun) -> list[str]:
    """Whose clocks drift though the scene lets them walk alone, or at which rates they are believed to go."""
    from gridslam.runs.clock_drifts import drift_note

    note = drift_note(world, done.clocks)
    return [] if note is None else [note]


def _network_observations(asked: Asked) -> tuple[NetworkMeasurements, NetworkTruth | None]:
    """What all agents heard, from a file with the tracks that are given, or simulated with the truth."""
    from gridslam.simulation.network import simulate_network

    world = asked.world
    if asked.table is None:
        names = asked.agent or [agent.name for agent in world.agents]
        return simulate_network(world, names, asked.seed, unlabelled=asked.instead_of is None)
    return with_tracks(asked, recorded_network(world, asked.table, asked.agent)), None


def with_tracks(asked: Asked, measurements: NetworkMeasurements) -> NetworkMeasurements:
    """Measurements with the true tracks that are given.

    Raises
    ------
    InputError
        One that can't be read, of no agent here, or that doesn't cover the agent's steps.
    """
    from dataclasses import replace

    from gridslam.evaluation.ground_truth import with_truth
    from gridslam.world.trajectory import Trajectory

    tracks = dict(measurements.tracks)
    for name, path in asked.tracks(measurements.agents).items():
        own = with_truth(measurements[name], Trajectory.from_tum(path), str(path))
        if own.truth is not None:
            tracks[name] = own.truth
    return replace(measurements, tracks=tracks)


def _lines(scores: dict[str, Any]) -> list[str]:
    """How good clocks and labels are."""
    lines = []
    if scores["apparent_bias_rmse_ps"] is not None:
        bound = (
            ""
            if scores["bound_ps"] is None
            else f" (bound of clocks that walk by all of walk_ns: {scores['bound_ps']:.0f})"
        )
        lines.append(f"apparent biases: {scores['apparent_bias_rmse_ps']:.0f} ps{bound}")
    if scores["steps_to_synchronise"] is not None:
        each = (f"{k} {'never' if v is None else v}" for k, v in scores["steps_to_synchronise"].items())
        lines.append(f"clocks within 3 ns from step: {', '.join(each)}")
    if scores["label_errors"] is not None:
        lines.append(f"labels: {scores['label_errors']} of {scores['labels_judged']} wrong")
    return lines


def recorded_network(world: Scene, file: Path, agents: list[str] | None) -> NetworkMeasurements:
    """Measurements of several agents from a file, present as the scene says.

    Raises
    ------
    InputError
        Any fault of the file, agents or anchors that aren't the scene's, or an agent that should be there and
        was never heard.
    """
    from dataclasses import replace

    import numpy as np

    from gridslam.errors import located
    from gridslam.measurements.network import NetworkMeasurements
    from gridslam.runs.network_run import check_network

    known = [agent.name for agent in world.agents]
    alone = agents[0] if agents and len(agents) == 1 else None
    if alone is not None:
        world.agent(alone)
    pseudo = world.clocks is not None
    measurements = NetworkMeasurements.load(file, world.anchor_names, known, pseudo, alone)
    with located(file):
        check_network(world, measurements)
    times = np.array([measurements.table.scan(step).time_s for step in range(len(measurements))])
    spans = [body.present_s[1] for body in world.agents if body.present_s]
    if spans and times[0] > max(spans):  # of another epoch: counted from where the table begins
        times = times - times[0]
    within = [body.name for body in world.agents if body.present_s and body.present_s[0] <= times[-1]]
    wanted = agents or [name for name in known if name in measurements.agents or name in within]
    for name in wanted:
        if name not in measurements.agents:
            world.agent(name)
            found = f"{name!r}, who should be there and has no row"
            raise InputError(
                f"{file}: agent", found, f"rows of it, or --agent {', '.join(measurements.agents)}"
            )
    measurements = measurements.of(wanted)
    present = np.array(measurements.present)
    for index, name in enumerate(wanted):
        span = world.agent(name).present_s
        if span is not None:
            first, last = np.searchsorted(times, [span[0] - 1e-9, span[1] + 1e-9])
            present[index] = min(first, present[index, 0]), max(last - 1, present[index, 1])
    return replace(measurements, present=present)
