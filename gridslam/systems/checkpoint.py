"""Checkpoint of a running filter, from which it goes on bit for bit."""

from __future__ import annotations

import json
import math
import os
from dataclasses import fields

import numpy as np

from gridslam.errors import InputError
from gridslam.inference.state.belief import AGENT, Belief
from gridslam.inference.state.calibration import Watch
from gridslam.inference.state.surface_bank import BINS, Bank
from gridslam.io.files import get, get_attributes, put, put_attributes, reading_h5, subgroup, writing_h5
from gridslam.systems.grid import GridSlam
from gridslam.world.scene import Scene

FORMAT = "gridslam-checkpoint"


def save(slam: GridSlam, path: str | os.PathLike[str]) -> None:
    """Write the whole state of a filter as HDF5.

    Random numbers are a function of seed and step, so the step's number is all that must be kept of them.

    Raises
    ------
    InputError
        The file can't be written.
    """
    with writing_h5(path, FORMAT) as file:
        last = math.nan if slam.last_time is None else slam.last_time
        state = {
            "scene": slam.scene.to_toml(),
            "agent": slam.agent,
            "seed": slam.seed,
            "steps": slam.steps,
            "next_identity": slam.next_identity,
            "last_time_s": last,
            "provenance": json.dumps(slam.provenance),
            "identity": slam.identity.state,
        }
        put_attributes(file.create_group("state"), state)
        for name, value in (("mean", slam.belief.mean), ("covariance", slam.belief.covariance)):
            put(file["state"], name, value, "m, m/s, rad")
        put(file["state"], "sight", slam.sight, "1")
        for name in ("evidence", "observed", "coefficient"):
            put(file["state"], name, getattr(slam.cells, name), "1")
        watch = file.create_group("watch")
        for field in fields(Watch):
            put(watch, field.name, getattr(slam.watch, field.name), "1")
        bank = file.create_group("bank")
        for field in fields(Bank):
            put(bank, field.name, getattr(slam.bank, field.name), "1")


def resume(path: str | os.PathLike[str]) -> GridSlam:
    """Read a checkpoint and return the filter, ready for its next step.

    Raises
    ------
    InputError
        No such file, or not a checkpoint of this version.
    """
    with reading_h5(path, FORMAT) as file:
        state, bank = subgroup(file, "state"), subgroup(file, "bank")
        kept = get_attributes(state)
        scene = Scene.from_toml(str(kept["scene"]), f"{path}: scene")
        slam = GridSlam(scene, agent=str(kept["agent"]), seed=int(str(kept["seed"])))
        size = len(get(state, "mean", (None,)))
        if size < AGENT or (size - AGENT) % 2:
            raise InputError(f"{path}: mean", f"{size} entries", f"{AGENT}, and 2 for each surface")
        mean, covariance = get(state, "mean", (size,)), get(state, "covariance", (size, size))
        slam.belief = Belief(_like(slam.belief.mean, mean), _like(slam.belief.mean, covariance))
        slam.sight = _like(slam.sight, get(state, "sight", (len(scene.anchors),)))
        shape = slam.cells.shape
        slam.cells.evidence = _like(slam.cells.evidence, get(state, "evidence", shape))
        slam.cells.observed = _like(slam.cells.observed, get(state, "observed", shape))
        slam.cells.coefficient = get(state, "coefficient", (*shape, BINS))
        count, anchors = max(size - AGENT, 0) // 2, len(scene.anchors)
        several = {"reflection": (count, BINS), "extent": (count, 2), "single": (anchors, count)}
        shapes = {"double": (anchors, count, count), **several}
        rows = {f.name: get(bank, f.name, shapes.get(f.name, (count,))) for f in fields(Bank)}
        slam.bank = Bank(**{name: _like(getattr(slam.bank, name), row) for name, row in rows.items()})
        slam.steps, slam.next_identity = int(str(kept["steps"])), int(str(kept["next_identity"]))
        watch = subgroup(file, "watch")
        kept_by = {f.name: len(getattr(slam.watch, f.name)) for f in fields(Watch)}
        slam.watch = Watch(**{name: get(watch, name, (n,)).astype(float) for name, n in kept_by.items()})
        last = float(str(kept["last_time_s"]))
        slam.last_time = None if math.isnan(last) else last
        slam.provenance = {"runs": []} | json.loads(str(kept["provenance"]))
        if "identity" in kept:  # checkpoints of earlier versions have none: "" stands for unknown
            slam.identity.state = str(kept["identity"])
    return slam


def _like(array: np.ndarray, value: np.ndarray) -> np.ndarray:
    """The value in the type of an array, as kernels take it."""
    return np.ascontiguousarray(value, dtype=array.dtype)
