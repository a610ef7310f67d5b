"""Checkpoint of a running filter, from which it goes on bit for bit: one format for every system.

A population of states is a value, so a checkpoint is that value, the scene, and who is running. Random
numbers are a function of seed and step, so the step's number is all that must be kept of them.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.inference.state.belief import AGENT, Belief
from gridslam.inference.state.grid import BINS, Grid
from gridslam.inference.state.population import Population, numbers
from gridslam.inference.state.ray_amplitudes import RayAmplitudes
from gridslam.inference.state.rings import BEARINGS, MOVING, Rings
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.io.files import get, get_attributes, put, put_attributes, reading_h5, subgroup, writing_h5
from gridslam.maps.run_identity import Identity
from gridslam.systems.soundness import SLACK, require_sound
from gridslam.world.filter_model import FilterModel
from gridslam.world.scene import Scene

FORMAT, VERSION = "gridslam-checkpoint", 3
MOST_HYPOTHESES = 1000
Part = TypeVar("Part")
Shape = tuple[int | None, ...]


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Who is running, and how far it has got.

    Attributes
    ----------
    method, agent : str
    scene : Scene
    seed : int
    provenance : dict of str to list
        Who made the map that the filter started from, as parallel lists.
    identity : Identity
        Of the measurements that were taken in.
    population : Population
    """

    method: str
    scene: Scene
    agent: str
    seed: int
    provenance: dict[str, list[Any]]
    identity: Identity
    population: Population


def write_checkpoint(kept: Checkpoint, path: str | os.PathLike[str]) -> None:
    """Write a checkpoint as HDF5.

    Raises
    ------
    InputError
        The file can't be written.
    """
    population = kept.population
    with writing_h5(path, FORMAT, VERSION) as file:
        attributes = {
            "method": kept.method,
            "scene": kept.scene.to_toml(),
            "agent": kept.agent,
            "seed": kept.seed,
            "provenance": json.dumps(kept.provenance),
            "identity": str(kept.identity),
        }
        put_attributes(file.create_group("run"), attributes)
        group = file.create_group("hypotheses")
        put_attributes(group, {name: getattr(population, name) for name in numbers()})
        put(group, "log_weight", np.array(population.log_weight), "1")
        _put_part(group.create_group("watch"), population.watch)
        for number, state in enumerate(population.states):
            _put_state(group.create_group(str(number)), state)


def _put_state(group: h5py.Group, state: State) -> None:
    """Write a state."""
    attributes = {
        "step": state.step,
        "next_identity": state.next_identity,
        "time_s": math.nan if state.time_s is None else state.time_s,
    }
    put_attributes(group.create_group("state"), attributes)
    put(group["state"], "los", state.los, "1")
    for name in ("belief", "surfaces", "calibration", "monitor", "grid", "rings"):
        part = getattr(state, name)
        if part is not None:
            _put_part(group.create_group(name), part)
    if state.amplitudes is not None:
        rays = group.create_group("amplitudes")
        for name, array in zip(("key", "probability", "length"), _table(state.amplitudes), strict=True):
            put(rays, name, array, "m" if name == "length" else "1")


def read_checkpoint(
    path: str | os.PathLike[str], method: str, start: Callable[[FilterModel], State]
) -> Checkpoint:
    """Read a checkpoint.

    Parameters
    ----------
    method : str
        The system that is to go on from it.
    start : callable
        The system's state before the first step, from which types and shapes are taken.

    Raises
    ------
    InputError
        No such file, or not a checkpoint of this version and system, or one whose numbers can't be.
    """
    with reading_h5(path, FORMAT, VERSION) as file:
        known = get_attributes(subgroup(file, "run"))
        if known.get("method") != method:
            raise InputError(f"{path}: method", repr(known.get("method")), repr(method))
        scene, agent = Scene.from_toml(str(known["scene"]), f"{path}: scene"), str(known["agent"])
        model = scene.filter_model(agent)
        population = _read_population(subgroup(file, "hypotheses"), start(model), model, str(path))
        provenance, identity = _read_origin(known, str(path))
        return Checkpoint(method, scene, agent, int(str(known["seed"])), provenance, identity, population)


def _read_origin(known: dict[str, Any], path: str) -> tuple[dict[str, list[Any]], Identity]:
    """Who made the map that a filter started from, and which measurements it has taken in."""
    provenance = json.loads(str(known.get("provenance")))
    if not isinstance(provenance, dict) or not all(isinstance(v, list) for v in provenance.values()):
        raise InputError(f"{path}: /run/provenance", str(provenance)[:60], "lists by name")
    text = str(known.get("identity"))
    if not re.fullmatch(r"[0-9a-f]{64} \d+ [0-9a-f]*", text):
        raise InputError(f"{path}: /run/identity", repr(text[:60]), "a checksum and a count")
    return provenance, Identity.parse(text)


def _read_population(group: h5py.Group, fresh: State, model: FilterModel, path: str) -> Population:
    """The hypotheses that a file holds."""
    log_weight = _finite(group, "log_weight", (None,), np.dtype(float)).tolist()
    if not 0 < len(log_weight) <= MOST_HYPOTHESES or abs(np.exp(log_weight).sum() - 1) > SLACK:
        raise InputError(f"{path}: /hypotheses/log_weight", "numbers that can't be", "logs of probabilities")
    known, own = get_attributes(group), {}
    like = Population.of(fresh)
    for name in numbers():
        if name not in known:
            raise InputError(f"{path}: /hypotheses/{name}", "none", "a number")
        own[name] = type(getattr(like, name))(known[name])
    if not -1 <= own["guard"] < len(log_weight) or (own["searching"] and len(log_weight) > 1):
        raise InputError(f"{path}: /hypotheses", "numbers that can't be", "one of the hypotheses")
    watch = _get_part(group, "watch", like.watch, {})
    states = []
    for number in range(len(log_weight)):
        state = _read_state(subgroup(group, str(number)), fresh, len(model.anchors), path)
        require_sound(state, model, path)
        states.append(state)
    return Population(tuple(states), tuple(log_weight), **own, watch=watch)


def _read_state(file: h5py.Group, fresh: State, anchors: int, path: str) -> State:
    """A state that a group holds, in the types and shapes of one that is fresh."""
    group = subgroup(file, "state")
    known: dict[str, Any] = get_attributes(group)
    size = len(get(subgroup(file, "belief"), "mean", (None,)))
    if size < AGENT or (size - AGENT) % 2:
        raise InputError(f"{path}: mean", f"{size} entries", f"{AGENT}, and 2 for each surface")
    count, time_s = (size - AGENT) // 2, float(known["time_s"])
    if math.isinf(time_s):
        raise InputError(f"{path}: /state/time_s", str(time_s), "a time, or NaN before the first step")
    belief = _get_part(file, "belief", fresh.belief, {"mean": (size,), "covariance": (size, size)})
    _require_proper(belief, path)
    per_surface: dict[str, Shape] = {f.name: (count,) for f in fields(SurfaceBank)}
    whole = {"reflection": (count, BINS), "extent": (count, 2), "single": (anchors, count)}
    surfaces = _get_part(
        file, "surfaces", fresh.surfaces, {**per_surface, **whole, "double": (anchors, count, count)},
        blank=("extent",),
    )  # fmt: skip
    calibration: dict[str, Shape] = {
        name: (anchors,) for name in ("clutter", "listened", "turn", "turn_weight")
    }
    return State(
        belief, surfaces, _finite(group, "los", (anchors,), fresh.los.dtype),
        _get_part(file, "calibration", fresh.calibration, calibration),
        _get_part(file, "monitor", fresh.monitor, {}),
        int(known["step"]), int(known["next_identity"]), None if math.isnan(time_s) else time_s,
        None if fresh.grid is None else _read_grid(file, fresh.grid),
        None if fresh.amplitudes is None else _read_amplitudes(file),
        None if fresh.rings is None else _read_rings(file, fresh.rings),
    )  # fmt: skip


def _read_grid(file: h5py.Group, fresh: Grid) -> Grid:
    shapes: dict[str, Shape] = {
        "evidence": fresh.shape, "observed": fresh.shape, "row": fresh.shape, "hit": (None, BINS)
    }  # fmt: skip
    return _get_part(file, "grid", fresh, shapes)


def _read_rings(file: h5py.Group, fresh: Rings) -> Rings:
    rings, size = len(get(subgroup(file, "rings"), "anchor", (None,))), MOVING + 2
    several: dict[str, Shape] = {name: (rings,) for name in ("anchor", "existence", "age", "seen")}
    mixture: dict[str, Shape] = {"weight": (rings, BEARINGS), "mean": (rings, BEARINGS, size)}
    return _get_part(
        file, "rings", fresh, {**several, **mixture, "covariance": (rings, BEARINGS, size, size)}
    )


def _read_amplitudes(file: h5py.Group) -> RayAmplitudes:
    group = subgroup(file, "amplitudes")
    count = len(get(group, "length", (None,)))
    key = get(group, "key", (count, 3)).tolist()
    probability = _finite(group, "probability", (count, None), np.dtype(float))
    length = _finite(group, "length", (count,), np.dtype(float)).tolist()
    return RayAmplitudes(
        {(a, b, c): (row, far) for (a, b, c), row, far in zip(key, probability, length, strict=True)}
    )


def _put_part(group: h5py.Group, part: Any) -> None:
    """Write a part of a state: arrays as datasets, numbers as attributes."""
    values = {f.name: getattr(part, f.name) for f in fields(part)}
    put_attributes(group, {n: v for n, v in values.items() if not isinstance(v, np.ndarray)})
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            put(group, name, value, "1")


def _get_part(
    file: h5py.Group, name: str, like: Part, shapes: dict[str, Shape], blank: tuple[str, ...] = ()
) -> Part:
    """Read a part of a state in the types of another; fields named `blank` may hold NaN."""
    group = subgroup(file, name)
    known, values, where = get_attributes(group), {}, f"{file.file.filename}: {group.name}"
    for field in fields(like):  # type: ignore[arg-type]
        kind = getattr(like, field.name)
        if isinstance(kind, np.ndarray):
            values[field.name] = _finite(
                group, field.name, shapes[field.name], kind.dtype, field.name in blank
            )
            continue
        if field.name not in known:
            raise InputError(f"{where}/{field.name}", "none", "a number")
        values[field.name] = type(kind)(known[field.name])
        if not math.isfinite(values[field.name]):
            raise InputError(f"{where}/{field.name}", str(known[field.name]), "a number")
    return type(like)(**values)


def _finite(
    group: h5py.Group, name: str, shape: Shape, dtype: np.dtype[Any], blank: bool = False
) -> NDArray[Any]:
    """A dataset in the type that kernels take."""
    whole = dtype.kind in "iub"
    value = np.ascontiguousarray(get(group, name, shape, "iub" if whole else "fiub"), dtype=dtype)
    if not blank and not np.isfinite(value).all():
        raise InputError(f"{group.file.filename}: {group.name}/{name}", "NaN or infinity", "finite numbers")
    return value


def _require_proper(belief: Belief, path: str) -> None:
    """Refuse a covariance that is none."""
    covariance = belief.covariance
    if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-12):
        raise InputError(f"{path}: /belief/covariance", "not symmetric", "a covariance")
    scale = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    if (scale == 0).any() or np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() < -1e-6:
        raise InputError(f"{path}: /belief/covariance", "not positive definite", "a covariance")


def _table(amplitudes: RayAmplitudes) -> tuple[NDArray[np.int64], NDArray[Any], NDArray[Any]]:
    """Keys (n, 3), probabilities (n, K) and lengths (n,) of all rays."""
    rows = list(amplitudes.known.values())
    key = np.array(list(amplitudes.known), np.int64).reshape(-1, 3)
    return key, np.array([row for row, _ in rows]).reshape(len(rows), -1), np.array([m for _, m in rows])
