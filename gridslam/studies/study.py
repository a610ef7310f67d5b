"""Monte Carlo studies: many seeded runs over scenes, settings and methods, on all cores or a cluster."""

from __future__ import annotations

import json
import os
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import gridslam
from gridslam.errors import InputError
from gridslam.studies.files import FORMAT, VERSION, Results
from gridslam.studies.jobs import Job, Variant, run_job, source_of
from gridslam.studies.workers import LocalWorkers, Workers
from gridslam.systems.registry import DEFAULT, METHODS, method_class, portable_name, taken_by
from gridslam.world.network_scene import require_known_clocks
from gridslam.world.scene import Scene
from gridslam.world.start import HOWS


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
        object.__setattr__(self, "settings", tuple((key, tuple(values)) for key, values in self.settings))
        methods = tuple(portable_name(method, "study: method") for method in self.methods)
        object.__setattr__(self, "methods", methods)
        whole = dict(methods=self.methods, seeds=self.seeds) | {f"--set {key}": v for key, v in self.settings}
        for what, values in (whole | ({"agents": self.agents} if self.agents else {})).items():
            if not values or any(value in values[:number] for number, value in enumerate(values)):
                raise InputError(f"study: {what}", str(list(values)), "one or more, each once")
        for scene in self.scenes:
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

    def jobs(self, methods: Sequence[str] | None = None, seeds: Sequence[int] | None = None) -> list[Job]:
        """All runs, in the order of the tables; of other methods and seeds, if these are given."""
        agents = {scene.name: self._agents(scene) for scene in self.scenes}
        return [
            Job(variant, method, seed, agents[variant.name], self.start)
            for variant in self.variants()
            for method in (self.methods if methods is None else methods)
            for seed in (self.seeds if seeds is None else seeds)
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
    others : list of dict
        Records of methods and seeds that the folder holds and that weren't asked for now.
    """

    study: Study
    records: list[dict[str, Any] | None]
    failures: dict[int, str] = field(default_factory=dict)
    fresh: int = 0
    others: list[dict[str, Any]] = field(default_factory=list)

    @property
    def finished(self) -> list[tuple[Job, dict[str, Any]]]:
        """Every run of the study that is there, those of earlier commands, too, in the order of the tables.

        Methods that weren't asked for now come after those that were; their classes needn't be there.
        """
        found = {identity(one["key"]): one for one in (*self.records, *self.others) if one is not None}
        keys = [one["key"] for one in self.others]
        methods = [name for key in keys if isinstance(name := key.get("method"), str)]
        seeds = {seed for key in keys if isinstance(seed := key.get("seed"), int)} | set(self.study.seeds)
        jobs = self.study.jobs(tuple(dict.fromkeys((*self.study.methods, *methods))), sorted(seeds))
        return [(job, found[key]) for job in jobs if (key := identity(job.key)) in found]


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
        The folder holds something else, another study or version, or runs of a method whose file was edited
        since; the scheduler can't be reached; workers
        keep dying or have another version; all runs are refused for the same reason. What was finished stays.
    """
    workers = LocalWorkers() if workers is None else workers
    jobs = study.jobs()
    place = {identity(job.key): number for number, job in enumerate(jobs)}
    sources = {method: source_of(method) for method in study.methods}
    records: list[dict[str, Any] | None] = [None] * len(jobs)
    failures: dict[int, str] = {}
    refused: list[InputError] = []
    others = []
    with Results.open(Path(directory), study.header, overwrite) as results:
        for record in results.found:
            number = place.get(identity(record["key"]))
            if number is None:
                others.append(record)
            else:
                _same_source(f"{results.path}", record, jobs[number].method, sources)
                records[number] = record
        left = [number for number, record in enumerate(records) if record is None]
        if progress is not None:
            progress(len(jobs) - len(left), len(jobs))
        for index, answer in workers.run(run_job, [jobs[number] for number in left]) if left else ():
            number = left[index]
            if isinstance(answer, BaseException):
                failures[number] = "".join(traceback.format_exception(answer))
                if isinstance(answer, InputError):  # a method of one's own may fail at some seeds alone
                    failures[number] = str(answer)
                    refused.append(answer)
            else:
                _same_version(answer["key"], jobs[number].key)
                _same_source("worker", answer, jobs[number].method, sources)
                results.append(answer)
                records[number] = answer
            if progress is not None:
                progress(sum(r is not None for r in records) + len(failures), len(jobs))
    if len(refused) == len(jobs) and len(set(map(str, refused))) == 1:
        raise refused[0]
    return Outcome(study, records, failures, sum(records[n] is not None for n in left), others)


def identity(key: Mapping[str, Any]) -> str:
    """A key as text that is equal for equal keys."""
    return json.dumps(key, sort_keys=True)


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


def _same_source(
    where: str, record: Mapping[str, Any], method: str, sources: Mapping[str, str | None]
) -> None:
    """Refuse to count runs of what a method of one's own was before it was edited, or is since."""
    was, now = record.get("source"), sources[method]
    if was is not None and now is not None and was != now:
        allowed = "its runs as it is now (another folder, or --overwrite)"
        raise InputError(f"{where}: {method}", "runs of another state of its file", allowed)


def _same_version(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    if found != wanted:
        have, need = found["gridslam"], wanted["gridslam"]
        raise InputError("worker: gridslam", f"version {have}", f"version {need}, as in this process")
