"""Command line: a run of several agents at once."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from gridslam.cli.output import ended, interruptible, reserved
from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.measurements.network import NetworkMeasurements
    from gridslam.runs.network_run import NetworkRun
    from gridslam.simulation.network import NetworkTruth
    from gridslam.world.scene import Scene

err = Console(stderr=True)


def run_network(
    world: Scene,
    method: str,
    agents: list[str] | None,
    seed: int,
    measurements: Path | None,
    map_file: Path | None,
    same_frame: bool,
    start: str | None,
    device: str,
    threads: int | None,
    output: Path | None,
    overwrite: bool,
) -> tuple[NetworkRun, list[dict[str, Any]], dict[str, Any]]:
    """Locate all agents at once, write the run's folder, and return what goes into the tables.

    Without measurements, what all agents hear is simulated, and nothing says whose it is.
    """
    from gridslam import runtime
    from gridslam.maps.frames import fitted
    from gridslam.maps.map import Map
    from gridslam.runs.network_files import clock_files
    from gridslam.runs.network_run import map_network
    from gridslam.runs.progress import network_progress_bar
    from gridslam.runs.run_files import write_run
    from gridslam.simulation.network import simulate_network
    from gridslam.viewers.plots import draw_all
    from gridslam.world.start import HOWS, told_start

    if start is not None and start not in HOWS:
        raise InputError("--start", repr(start), " or ".join(HOWS))
    if measurements is not None and start == "drawn":
        raise InputError("--start", "drawn with --measurements", "exact: the scene's own starts")
    if measurements is None and not world.walls:
        raise InputError(f"{world.name}: walls", "none", "walls to simulate from, or --measurements FILE")
    with interruptible() as termination, reserved(output, world.name, overwrite) as (folder, place):
        truth = None
        if measurements is not None:
            heard = recorded_network(world, measurements, agents)
        else:
            names = agents or [agent.name for agent in world.agents]
            heard, truth = simulate_network(world, names, seed, unlabelled=True)
        prior = Map.load(map_file) if map_file else None
        if prior is not None:
            prior, _ = fitted(prior, world, str(map_file), same_frame)
        runtime.start(device, threads)
        starts = None
        if measurements is None and start != "exact":
            starts = {name: told_start(world, name, seed) for name in heard.agents}
        with network_progress_bar(heard.tracks, err) as tell:
            done = map_network(world, heard, seed, prior, starts=starts, progress=tell, method=method)
        scores, whole = network_scores(done, heard, truth)
        runs = list(done.runs.values())
        tables = [heard[run.agent] for run in runs]
        write_run(
            folder, world, runs, tables, scores, {"network": whole}, place.overwrite,
            lambda part: _drawn(draw_all(part)), place, clock_files(done.clocks, heard.clocks),
        )  # fmt: skip
        if done.interrupted:
            steps = f"{len(done.clocks.step)} of {len(heard)} steps"
            line = f"{ended(termination)} after {steps}: {folder} holds what was done"
            err.print(line, highlight=False, markup=False, soft_wrap=True)
            sys.exit(143 if termination.asked else 130)
    return done, scores, {"folder": folder, **whole}


def say(scores: dict[str, Any], out: Console) -> None:
    """Say how good clocks and labels are, and where it all is."""
    lines = []
    if scores["apparent_bias_rmse_ps"] is not None:
        bound = "" if scores["bound_ps"] is None else f" (bound {scores['bound_ps']:.0f})"
        lines.append(f"apparent biases: {scores['apparent_bias_rmse_ps']:.0f} ps{bound}")
    if scores["steps_to_synchronise"] is not None:
        each = (f"{k} {'never' if v is None else v}" for k, v in scores["steps_to_synchronise"].items())
        lines.append(f"clocks within 3 ns from step: {', '.join(each)}")
    if scores["label_errors"] is not None:
        lines.append(f"labels: {scores['label_errors']} of {scores['labels_judged']} wrong")
    for line in (*lines, f"wrote {scores['folder']}"):
        out.print(line, highlight=False, markup=False, soft_wrap=True)


def _drawn(paths: list[Path]) -> None:
    """Figures that were drawn; nothing more is to be done with them."""


def network_scores(
    done: NetworkRun, heard: NetworkMeasurements, truth: NetworkTruth | None
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Scores of every agent, and those of clocks and labels."""
    whole = done.score(heard.clocks, truth)
    scores = []
    for name, run in done.runs.items():
        if truth is not None:
            scores.append(run.score(truth.agents[name].first(len(run.estimates))))
        else:
            scores.append(run.score(heard.tracks.get(name)))
    return scores, whole


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

    from gridslam.measurements.network import NetworkMeasurements
    from gridslam.runs.network_run import check_network

    known = [agent.name for agent in world.agents]
    heard = NetworkMeasurements.load(file, world.anchor_names, known, world.clocks is not None)
    check_network(world, heard)
    times = np.array([heard.table.scan(step).time_s for step in range(len(heard))])
    within = [body.name for body in world.agents if body.present_s and body.present_s[0] <= times[-1]]
    wanted = agents or [name for name in known if name in heard.agents or name in within]
    for name in wanted:
        if name not in heard.agents:
            world.agent(name)
            found = f"{name!r}, who should be there and has no row"
            raise InputError(f"{file}: agent", found, f"rows of it, or --agent {', '.join(heard.agents)}")
    heard = heard.of(wanted)
    present = np.array(heard.present)
    for index, name in enumerate(wanted):
        span = world.agent(name).present_s
        if span is not None:
            first, last = np.searchsorted(times, [span[0] - 1e-9, span[1] + 1e-9])
            present[index] = min(first, present[index, 0]), max(last - 1, present[index, 1])
    return replace(heard, present=present)
