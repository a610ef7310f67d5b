"""Monte Carlo studies: many seeded runs over scenes, settings and methods, on all cores or a cluster."""

from __future__ import annotations

import hashlib
import json
import os
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import gridslam
from gridslam import runtime
from gridslam.errors import InputError
from gridslam.evaluation.consistency import follow
from gridslam.maps.map import Map
from gridslam.runs.map_scene import map_scene
from gridslam.simulation.image_source import Truth, ground_truth
from gridslam.simulation.simulate import observations_of
from gridslam.studies.files import FORMAT, VERSION, Results
from gridslam.studies.workers import LocalWorkers, Workers
from gridslam.systems.registry import DEFAULT, METHODS, method_class, portable_name, taken_by
from gridslam.world.network_scene import require_known_clocks
from gridslam.world.scene import Scene
from gridslam.world.start import HOWS, assumed_start

COST = ("seconds_per_step", "peak_memory_mb")
"""Scores that differ from one repetition of a run to the next."""
_ONE_AT_A_TIME = threading.Lock()  # Taichi serves one thread; a cluster's worker may have several


@dataclass(frozen=True)
class Variant:
    """A scene with some of its settings changed.

    Attributes
    ----------
    scene : str
        The whole scene as TOML, changes included.
    name : str
        The scene's name.
    settings : tuple of (str, value)
        What was changed, by dotted key.
    """

    scene: str
    name: str
    settings: tuple[tuple[str, Any], ...]

    @property
    def label(self) -> str:
        """Name and changes in a few words."""
        changes = (f"{key.rpartition('.')[2]}={value}" for key, value in self.settings)
        return ", ".join((self.name, *changes))


@dataclass(frozen=True)
class Job:
    """One run: its agents in turn, each from the map that the one before it left.

    Attributes
    ----------
    variant : Variant
    method : str
    seed : int
        Of the measurements and of the filter, as in ``gridslam run --seed``.
    agents : tuple of str
    start : str
        "drawn" from the prior by seed, or "exact".
    """

    variant: Variant
    method: str
    seed: int
    agents: tuple[str, ...]
    start: str = "drawn"

    @property
    def key(self) -> dict[str, Any]:
        """All that the numbers of the run depend on; two jobs are one if their keys are equal."""
        return {
            "scene": self.variant.name,
            "hash": hashlib.sha256(self.variant.scene.encode()).hexdigest()[:16],
            "settings": dict(self.variant.settings),
            "method": self.method,
            "seed": self.seed,
            "agents": list(self.agents),
            "start": self.start,
            "gridslam": gridslam.__version__,
        }


@dataclass(frozen=True)
class Study:
    """What is to be run: every method and seed on every scene with every combination of settings.

    Attributes
    ----------
    scenes : tuple of Scene
    methods : tuple of str
        As `map_scene` takes them; a class is kept by its name, and must be one that worker processes can
        import.
    seeds : tuple of int
    settings : tuple of (str, tuple of values)
        Values to try for keys of the scene file, e.g. ``("filter.particles", (1000, 10000))``.
    agents : tuple of str
        Default: all of a scene, in order.
    start : str
        What filters are told of the agents' start: "drawn" from the prior by seed, or "exact".

    Raises
    ------
    InputError
        No scene or run, scenes of one name, an unknown method, agent or setting, or a scene that can't be
        simulated.
    """

    scenes: tuple[Scene, ...]
    methods: tuple[str, ...] = (DEFAULT,)
    seeds: tuple[int, ...] = (0,)
    settings: tuple[tuple[str, tuple[Any, ...]], ...] = ()
    agents: tuple[str, ...] = ()
    start: str = "drawn"

    def __post_init__(self) -> None:
        if self.start not in HOWS:
            raise InputError("study: start", repr(self.start), " or ".join(HOWS))
        names = [scene.name for scene in self.scenes]
        if not names or len(set(names)) < len(names):
            raise InputError("study: scenes", ", ".join(names) or "none", "scenes of different names")
        methods = tuple(portable_name(method, "study: method") for method in self.methods)
        object.__setattr__(self, "methods", methods)
        for what, values in (("methods", self.methods), ("seeds", self.seeds)):
            if not values or len(set(values)) < len(values):
                raise InputError(f"study: {what}", str(list(values)), "one or more, each once")
        for scene in self.scenes:
            if not scene.walls:
                raise InputError(f"{scene.name}: walls", "none", "walls to simulate from")
            for name in self._agents(scene):
                scene.track(name)
        for variant, method in product(self.variants(), self.methods):
            self._require_suited(Scene.from_toml(variant.scene, variant.name), method)

    def _require_suited(self, scene: Scene, method: str) -> None:
        """Refuse what would end in the first run of a pair, after all runs of others."""
        for name in self._agents(scene):
            if taken_by(method_class(method)) == "signal":
                scene.waveform(name)
            elif method in METHODS and not METHODS[method].several:
                require_known_clocks(scene, name)

    def _agents(self, scene: Scene) -> tuple[str, ...]:
        found = self.agents or tuple(agent.name for agent in scene.agents)
        if not found:
            raise InputError(f"{scene.name}: agents", "none", "an agent to simulate")
        return found

    def variants(self) -> list[Variant]:
        """Every scene with every combination of settings."""
        keys = [key for key, _ in self.settings]
        if len(set(keys)) < len(keys):
            raise InputError("study: settings", ", ".join(keys), "every key once, with all its values")
        combinations = [tuple(zip(keys, c, strict=True)) for c in product(*(v for _, v in self.settings))]
        return [
            Variant(_changed(scene, combination).to_toml(), scene.name, combination)
            for scene in self.scenes
            for combination in combinations
        ]

    def jobs(self) -> list[Job]:
        """All runs, in the order of the tables."""
        agents = {scene.name: self._agents(scene) for scene in self.scenes}
        return [
            Job(variant, method, seed, agents[variant.name], self.start)
            for variant in self.variants()
            for method in self.methods
            for seed in self.seeds
        ]

    @property
    def header(self) -> dict[str, Any]:
        """First line of the results file; seeds and methods may be added to a study, the rest may not."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "gridslam": gridslam.__version__,
            "scenes": [scene.to_toml() for scene in self.scenes],
            "settings": [[key, list(values)] for key, values in self.settings],
            "agents": list(self.agents),
            "start": self.start,
        }


@dataclass(frozen=True)
class Outcome:
    """What became of a study.

    Attributes
    ----------
    study : Study
    records : list of dict or None
        One per job, in the order of `Study.jobs`; None where the run failed.
    failures : dict of int to str
        Traceback of each run that failed.
    fresh : int
        How many runs were done now rather than found.
    """

    study: Study
    records: list[dict[str, Any] | None]
    failures: dict[int, str] = field(default_factory=dict)
    fresh: int = 0


def run_study(
    study: Study,
    directory: str | os.PathLike[str],
    workers: Workers | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Outcome:
    """Run what isn't there yet; every finished run is on disk before the next one counts.

    Parameters
    ----------
    study : Study
    directory : path
        Folder of the study; one that an interrupted study left is continued.
    workers : Workers, optional
        Where to run. Default: a process per core of this machine.
    overwrite : bool
        Begin anew.
    progress : callable, optional
        Called with (runs done, runs in all), first with those found.

    Raises
    ------
    InputError
        The folder holds something else, another study or version; the scheduler can't be reached; workers
        keep dying or have another version. What was finished stays.
    """
    workers = LocalWorkers() if workers is None else workers
    jobs = study.jobs()
    place = {identity(job.key): number for number, job in enumerate(jobs)}
    records: list[dict[str, Any] | None] = [None] * len(jobs)
    failures: dict[int, str] = {}
    with Results.open(Path(directory), study.header, overwrite) as results:
        for record in results.found:
            number = place.get(identity(record["key"]))
            if number is not None:
                records[number] = record
        left = [number for number, record in enumerate(records) if record is None]
        if progress is not None:
            progress(len(jobs) - len(left), len(jobs))
        for index, answer in workers.run(run_job, [jobs[number] for number in left]) if left else ():
            number = left[index]
            if isinstance(answer, BaseException):
                if isinstance(answer, InputError):
                    raise answer
                failures[number] = "".join(traceback.format_exception(answer))
            else:
                _same_version(answer["key"], jobs[number].key)
                results.append(answer)
                records[number] = answer
            if progress is not None:
                progress(sum(r is not None for r in records) + len(failures), len(jobs))
    return Outcome(study, records, failures, sum(records[n] is not None for n in left))


def run_job(job: Job) -> dict[str, Any]:
    """Do one run and return it as plain data; the same job gives the same numbers wherever it runs.

    Returns
    -------
    dict
        ``key``; ``agents``: for each its ``scores`` (as in run.json), ``cost`` and ``steps``, arrays as lists
        of float32, None for NaN.
    """
    with _ONE_AT_A_TIME:
        runtime.start("cpu", threads=1)
        scene = Scene.from_toml(job.variant.scene, job.variant.name)
        takes = taken_by(method_class(job.method))
        carried: Map | None = None
        earlier: list[Truth] = []
        found = {}
        for name in job.agents:
            observations = observations_of(scene, name, job.seed, takes)
            start = assumed_start(scene, name, job.seed, job.start)
            done = map_scene(scene, observations, job.method, name, job.seed, carried, start=start)
            if done.interrupted:
                raise KeyboardInterrupt
            truth = ground_truth(scene, name)
            scores = done.score(truth, earlier)
            steps = follow(done.estimates, scene, truth, earlier)
            found[name] = {
                "cost": {key: scores.pop(key) for key in COST},
                "scores": scores,
                "steps": {f.name: _short(getattr(steps, f.name)) for f in fields(steps)},
            }
            carried = done.map
            earlier.append(truth)
    return {"key": job.key, "agents": found}


def identity(key: Mapping[str, Any]) -> str:
    """A key as text that is equal for equal keys."""
    return json.dumps(key, sort_keys=True)


def _short(values: np.ndarray) -> list:
    """Lists of the shortest decimals that name each float32 (None for NaN); integers as they are."""
    if values.ndim > 1:
        return [_short(row) for row in values]
    if values.dtype.kind == "i":
        return [int(value) for value in values]
    return [None if np.isnan(value) else float(str(value)) for value in values.astype(np.float32)]


def _changed(scene: Scene, changes: Sequence[tuple[str, Any]]) -> Scene:
    """Scene with other values under dotted keys; `InputError` as from a scene file."""
    whole = scene.model_dump(exclude_none=True)
    for key, value in changes:
        table = whole
        *tables, last = key.split(".")
        for name in tables:
            table = table.get(name) if isinstance(table, dict) else None  # type: ignore[assignment]
        if not isinstance(table, dict):
            raise InputError(f"--set {key}", "no such table in a scene", "e.g. filter.births=0.1,0.2")
        table[last] = value
    return Scene.checked(whole, scene.name) if changes else scene


def _same_version(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    if found != wanted:
        have, need = found["gridslam"], wanted["gridslam"]
        raise InputError("worker: gridslam", f"version {have}", f"version {need}, as in this process")
