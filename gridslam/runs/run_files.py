"""The folder of a finished run: written whole or not at all, and read back for figures."""

from __future__ import annotations

import json
import math
import os
import platform
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.errors import InputError, Unwritten
from gridslam.estimates import Estimate
from gridslam.evaluation.ground_truth import untold_heading
from gridslam.io.files import cannot_write, write_bytes
from gridslam.maps.map import Map
from gridslam.measurements.observations import NAMES, Observations, kind_of, read_observations
from gridslam.runs.parts import holds_checkpoint, refuse_unfinished
from gridslam.runs.reservation import Place, reserve
from gridslam.runs.run import Run
from gridslam.runs.step_files import read_steps, write_steps
from gridslam.runs.stopping import held_back
from gridslam.runs.summary import hold
from gridslam.runs.unheard import unheard_steps
from gridslam.systems.registry import METHODS, particles_of
from gridslam.world.names import folder_fault
from gridslam.world.scene import Scene
from gridslam.world.start import Start
from gridslam.world.trajectory import Trajectory

PACKAGES = ("gridslam", "numpy", "scipy", "taichi", "h5py")


@dataclass(frozen=True, eq=False)
class AgentFiles:
    """What a run's folder holds about one agent.

    Attributes
    ----------
    measurements : Measurements or Recording
    trajectory : Trajectory
        Estimated track.
    truth : Trajectory or None
        True track, where known.
    estimates : list of Estimate
        All steps; their `seconds` are NaN.
    map : Map
        Map at the end.
    """

    measurements: Observations
    trajectory: Trajectory
    truth: Trajectory | None
    estimates: list[Estimate]
    map: Map

    @property
    def unheard(self) -> tuple[int, ...]:
        """Steps at which nothing was heard."""
        return unheard_steps(self.measurements, len(self.estimates))


@dataclass(frozen=True, eq=False)
class RunFiles:
    """A run's folder.

    Attributes
    ----------
    scene : Scene
        Resolved scene.
    summary : dict
        Content of ``run.json``.
    agents : dict of AgentFiles
        By name, in the order in which they explored.
    """

    scene: Scene
    summary: dict[str, Any]
    agents: dict[str, AgentFiles]


def write_run(
    directory: str | os.PathLike[str],
    scene: Scene,
    runs: Sequence[Run],
    measurements: Sequence[Observations],
    scores: Sequence[Mapping[str, Any] | None],
    settings: Mapping[str, Any],
    overwrite: bool = False,
    draw: Callable[[Path], None] | None = None,
    place: Place | None = None,
    more: Mapping[str, Callable[[Path], None]] | None = None,
) -> None:
    """Write a run's folder under a temporary name and rename it when it is complete.

    A file that can't be written doesn't cost the others. Ctrl-C ends the drawing, and else waits
    until the files are written and the folder has its name.

    Parameters
    ----------
    directory : path
        The folder; it mustn't exist unless `overwrite` is on, and is then replaced at the very end.
    scene : Scene
        Resolved scene.
    runs, measurements, scores : sequences, one item per agent
        In the order of exploration; a score of None stands for no truth.
    settings : mapping
        More entries of ``run.json``'s top level, such as the number of threads.
    overwrite : bool
        Whether an earlier run's folder may be replaced.
    draw : callable, optional
        Draws ``figures/`` in the folder it is given. If it fails, the folder is kept with those that it
        left (if Ctrl-C ends it, without them), and the error passed on.
    place : Place, optional
        The folder, if `reserve` has it already.
    more : dict of str to callable, optional
        Writers of more files, by name.

    Raises
    ------
    Unwritten
        Some files couldn't be written. The rest is in the folder or, if a run stands there, beside it; of a
        run that has a checkpoint, that is kept instead, from which all can be written later.
    InputError
        The folder exists or another run is at work on it, or nothing at all can be written: nothing
        half-written is left behind. Or something stands there by the end: the run is kept beside it.
    """
    names = [run.agent for run in runs]
    for name in names:
        allowed = folder_fault(name)
        if allowed is not None:
            raise InputError("agent name", repr(name), allowed)
    if not names or len(set(names)) < len(names):
        raise InputError("agents", f"{names}", "one or more, each once")
    with reserve(directory, overwrite) if place is None else nullcontext(place) as here:
        with held_back() as asked:
            faults = _fill(here, scene, runs, measurements, scores, settings, more or {})
            if faults and holds_checkpoint(here.part):  # whole later is better than in parts now
                found = "the run's checkpoint, and not all of its files"
                go_on = f"to write them again: gridslam run --resume {directory}"
                raise Unwritten([*faults, InputError(str(directory), found, go_on)])
            if here.empty:
                raise InputError(str(directory), faults[0].found, faults[0].allowed)
            here.precious = True
        trouble: BaseException | None = None
        if draw is not None and not asked.is_set():
            try:
                draw(here.part)
            except (Exception, KeyboardInterrupt) as error:  # hours of filtering outweigh a figure
                trouble = error
        with held_back() as asked_late:
            if isinstance(trouble, KeyboardInterrupt):
                shutil.rmtree(here.part / "figures", ignore_errors=True)
            if faults and here.target.exists():  # a whole run isn't replaced by parts of one
                found = f"an earlier, whole run; what could be written is kept in {here.keep()}"
                beside = InputError(str(directory), found, "a run without faults instead")
                raise Unwritten([*faults, *_undrawn(trouble, here), beside])
            here.finish()
        if trouble is None and (asked.is_set() or asked_late.is_set()):
            trouble = KeyboardInterrupt()
    undrawn = _undrawn(trouble, here)
    if faults or undrawn:
        raise Unwritten([*faults, *undrawn]) from trouble
    if trouble is not None:
        raise trouble


def read_summary(folder: Path) -> dict[str, Any]:
    """Content of the ``run.json`` of a run's folder.

    Raises
    ------
    InputError
        There is none, it is damaged, or holds what can't be (`gridslam.runs.summary`).
    """
    try:
        summary: dict[str, Any] = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        scores = summary["agents"]
        if not scores or not all(isinstance(table, dict) for table in (summary, scores, *scores.values())):
            raise ValueError("no agent")
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{folder / 'run.json'}", "none that can be read", "a folder that a run wrote"
        ) from error
    hold(summary, str(folder / "run.json"))
    return summary


def read_run(directory: str | os.PathLike[str], maps: Mapping[str, Map] | None = None) -> RunFiles:
    """Read a run's folder back.

    Parameters
    ----------
    directory : path
    maps : dict of str to Map, optional
        Maps of agents that are at hand: they aren't read a second time, as large as they are.

    Raises
    ------
    InputError
        Not a run's folder, or one of its files is missing or damaged.
    """
    folder = Path(directory)
    refuse_unfinished(folder)
    summary = read_summary(folder)
    scores, agents = summary["agents"], {}
    for name in scores:
        allowed = folder_fault(name)
        if allowed is not None:  # a path out of the folder, above all
            raise InputError(f"{folder / 'run.json'}: agents", repr(name), allowed)
        own = folder / name
        track, truth = Trajectory.from_tum(own / "trajectory.tum"), None
        if (own / "truth.tum").exists():
            truth = Trajectory.from_tum(own / "truth.tum")
        agents[name] = AgentFiles(
            read_observations(own),
            track,
            truth,
            read_steps(own / "steps.h5"),
            maps[name] if maps and name in maps else Map.load(own / "map.h5"),
        )
    return RunFiles(Scene.load(folder / "scene.toml"), summary, agents)


def _fill(
    place: Place,
    scene: Scene,
    runs: Sequence[Run],
    measurements: Sequence[Observations],
    scores: Sequence[Mapping[str, Any] | None],
    settings: Mapping[str, Any],
    more: Mapping[str, Callable[[Path], None]],
) -> list[InputError]:
    """Write all files, each by itself; returns a fault for each that couldn't be."""
    faults: list[InputError] = []

    def attempt(name: str, write: Callable[[Path], None]) -> bool:
        try:
            write(place.part / name)
        except Exception as error:  # whatever it is: the other files are worth having
            faults.append(fault_of(place.target / name, error))
            return False
        return True

    agents: dict[str, dict[str, Any]] = {}
    for run, observed, score in zip(runs, measurements, scores, strict=True):
        own = run.agent
        agents[own] = dict(score or {})
        if score is None:
            attempt("run.json", lambda _, run=run: agents[run.agent].update(run.score(None)))  # type: ignore[misc]
        if not attempt(own, Path.mkdir):
            continue
        attempt(f"{own}/{NAMES[kind_of(observed)]}", observed.to_h5)
        told = untold_heading(scene, own, observed) if run.method in METHODS else None
        to_tum = run.trajectory.to_tum
        attempt(f"{own}/trajectory.tum", to_tum if told is None else partial(to_tum, remark=told))
        if observed.truth is not None:
            attempt(f"{own}/truth.tum", observed.truth.to_tum)
        attempt(f"{own}/steps.h5", lambda path, run=run: write_steps(path, run.estimates))  # type: ignore[misc]
        attempt(f"{own}/map.h5", run.map.save)
    for name, write in more.items():
        attempt(name, write)
    last = runs[-1]
    twin = place.part / last.agent / "map.h5"
    attempt("map.h5", lambda p: write_bytes(p, twin.read_bytes()) if twin.exists() else last.map.save(p))
    if last.map.observed.any():
        for name, content in last.map.nav2_files().items():
            attempt(name, lambda path, content=content: write_bytes(path, content()))  # type: ignore[misc]
    attempt("scene.toml", lambda path: write_bytes(path, scene.to_toml().encode("utf-8")))
    summary = {
        "scene": scene.name,
        "method": last.method,
        "seed": last.seed,
        "start": last.start,
        "starts": {run.agent: _pose(run.began) for run in runs},
        "particles": particles_of(last.method, last.scene.filter.particles),
        "device": last.device,
        "versions": {"python": platform.python_version()} | {name: version(name) for name in PACKAGES},
        "notes": [],
        **settings,
        "agents": agents,
    }
    attempt(
        "run.json", lambda path: write_bytes(path, _json(summary))
    )  # last: it says that the rest is there
    return faults


def _undrawn(trouble: BaseException | None, place: Place) -> list[InputError]:
    """A fault for each figure that is missing, or one for all of them."""
    if isinstance(trouble, Unwritten):
        figures = place.target / "figures"
        return [
            InputError(str(figures / Path(fault.where).name), fault.found, fault.allowed)
            for fault in trouble.faults
        ]
    if isinstance(trouble, InputError | OSError):
        reason = trouble.found if isinstance(trouble, InputError) else trouble.strerror or str(trouble)
        return [InputError(f"{place.target / 'figures'}", reason, "room for figures (the rest is written)")]
    return []


def _pose(start: Start) -> dict[str, Any]:
    return {"position_m": start.position_m.tolist(), "heading_deg": float(np.degrees(start.heading_rad))}


def fault_of(path: Path, error: Exception) -> InputError:
    """Say in one line why a file of a run is missing, whatever went wrong."""
    if isinstance(error, InputError):
        return InputError(str(path), error.found, error.allowed)
    if isinstance(error, OSError):
        return cannot_write(path, error)
    return InputError(str(path), f"{type(error).__name__}: {error}", "what the file's format can hold")


def _json(summary: Mapping[str, Any]) -> bytes:
    text = json.dumps(_strict(summary), indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    return text.encode("utf-8")


def _strict(value: Any) -> Any:
    """A value in plain JSON: NumPy values made Python's, numbers that aren't finite made null."""
    if isinstance(value, Mapping):
        return {str(key): _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return _strict(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
