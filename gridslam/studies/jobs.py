"""The runs of a study: a scene with its settings, a method and a seed, and what comes of them."""

from __future__ import annotations

import hashlib
import inspect
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

import gridslam
from gridslam import runtime
from gridslam.evaluation.consistency import follow
from gridslam.maps.map import Map
from gridslam.runs.map_scene import map_scene
from gridslam.runs.network_run import map_network, network_scores
from gridslam.runs.run import Run
from gridslam.simulation.image_source import Truth, ground_truth
from gridslam.simulation.network import simulate_network
from gridslam.simulation.simulate import observations_of
from gridslam.systems.registry import METHODS, method_class, taken_by
from gridslam.world.scene import Scene
from gridslam.world.start import assumed_start

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
    settings: tuple[tuple[str, Any], ...] = field(hash=False)  # values may be lists; the scene has them all

    @property
    def label(self) -> str:
        """Name and changes in a few words."""
        changes = (f"{key.rpartition('.')[2]}={value}" for key, value in self.settings)
        return ", ".join((self.name, *changes))


@dataclass(frozen=True)
class Job:
    """One run: its agents in turn, each from the map that the one before it left, or all at once.

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


def source_of(method: str) -> str | None:
    """What the file that a method of one's own stands in holds, as a hash; None of those that are built in.

    Results of a file that was edited since aren't those of the method any more. What it imports isn't in it.
    """
    if method in METHODS:
        return None
    try:
        file = inspect.getsourcefile(method_class(method))
        return hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16] if file else None
    except (OSError, TypeError):
        return None


def takes_several(method: str) -> bool:
    """Whether a method takes several agents at once."""
    return method in METHODS and METHODS[method].several


def run_job(job: Job) -> dict[str, Any]:
    """Do one run and return it as plain data; the same job gives the same numbers wherever it runs.

    Methods that take several agents at once get them so, without labels, as from ``gridslam run``.

    Returns
    -------
    dict
        ``key``; ``source``, see `source_of`; ``agents``: for each its ``scores`` (as in run.json), ``cost``
        and ``steps``, arrays as lists of float32, None for NaN; ``network``: scores of clocks and labels, of
        agents at once.
    """
    with _ONE_AT_A_TIME:
        runtime.start("cpu", threads=1)
        scene = Scene.from_toml(job.variant.scene, job.variant.name)
        found = _at_once(job, scene) if takes_several(job.method) else _in_turn(job, scene)
        return {"key": job.key, "source": source_of(job.method)} | found


def _in_turn(job: Job, scene: Scene) -> dict[str, Any]:
    """Each agent from the map that the one before it left."""
    takes, found = taken_by(method_class(job.method)), {}
    carried: Map | None = None
    earlier: list[Truth] = []
    for name in job.agents:
        observations = observations_of(scene, name, job.seed, takes)
        start = assumed_start(scene, name, job.seed, job.start)
        done = map_scene(scene, observations, job.method, name, job.seed, carried, start=start)
        if done.interrupted:
            raise KeyboardInterrupt
        truth = ground_truth(scene, name)
        found[name] = _plain(done, done.score(truth, earlier), truth, earlier)
        carried = done.map
        earlier.append(truth)
    return {"agents": found}


def _at_once(job: Job, scene: Scene) -> dict[str, Any]:
    """All agents together; which anchor sent what isn't told."""
    measurements, truth = simulate_network(scene, job.agents, job.seed, unlabelled=True)
    starts = {name: assumed_start(scene, name, job.seed, job.start) for name in job.agents}
    done = map_network(scene, measurements, job.seed, starts=starts, method=job.method)
    if done.interrupted:
        raise KeyboardInterrupt
    scores, whole = network_scores(done, measurements, truth)
    found, earlier = {}, list[Truth]()
    for (name, run), own in zip(done.runs.items(), scores, strict=True):
        found[name] = _plain(run, own, truth.agents[name], earlier)  # steps as of agents in turn
        earlier.append(truth.agents[name])
    return {"agents": found, "network": whole}


def _plain(run: Run, scores: dict[str, Any], truth: Truth, earlier: Sequence[Truth]) -> dict[str, Any]:
    """An agent's run as plain data."""
    steps = follow(run.estimates, run.scene, truth, earlier)
    return {
        "cost": {key: scores.pop(key) for key in COST},
        "scores": scores,
        "steps": {f.name: _short(getattr(steps, f.name)) for f in fields(steps)},
    }


def _short(values: np.ndarray) -> list:
    """Lists of the shortest decimals that name each float32 (None for NaN); integers as they are."""
    if values.ndim > 1:
        return [_short(row) for row in values]
    if values.dtype.kind == "i":
        return [int(value) for value in values]
    return [None if np.isnan(value) else float(str(value)) for value in values.astype(np.float32)]
