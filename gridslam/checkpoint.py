"""Checkpoint of a running filter, from which it goes on bit for bit."""

from __future__ import annotations

import json
import math
import os
from dataclasses import fields

from gridslam.files import get, get_attributes, put, put_attributes, reading_h5, subgroup, writing_h5
from gridslam.inference.belief import Belief
from gridslam.inference.surfaces import Bank
from gridslam.inference.watch import Watch
from gridslam.scene import Scene
from gridslam.systems.grid import GridSlam

FORMAT = "gridslam-checkpoint"
BANK_DIMENSIONS = {"reflection": 2, "single": 2, "extent": 2, "double": 3}


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
        slam.belief = Belief(get(state, "mean", (size,)), get(state, "covariance", (size, size)))
        slam.sight = get(state, "sight", (len(scene.anchors),))
        shape = slam.cells.shape
        slam.cells.evidence = get(state, "evidence", shape)
        slam.cells.observed = get(state, "observed", shape)
        slam.cells.coefficient = get(state, "coefficient", (*shape, None))
        rows = {f.name: get(bank, f.name, (None,) * BANK_DIMENSIONS.get(f.name, 1)) for f in fields(Bank)}
        slam.bank = Bank(**rows)
        slam.steps, slam.next_identity = int(str(kept["steps"])), int(str(kept["next_identity"]))
        watch = subgroup(file, "watch")
        slam.watch = Watch(**{f.name: get(watch, f.name, (None,)) for f in fields(Watch)})
        last = float(str(kept["last_time_s"]))
        slam.last_time = None if math.isnan(last) else last
        slam.provenance = json.loads(str(kept["provenance"]))
    return slam
