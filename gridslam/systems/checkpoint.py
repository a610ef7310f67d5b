"""Checkpoint of a running filter, from which it goes on bit for bit: one format for every system.

What is believed is a value (a state, or several hypotheses, each a state), so a checkpoint is that value, the
scene, and who is running. Random numbers are a function of seed and step, so the step's number is all that
must be kept of them.
"""

from __future__ import annotations

import json
import os
import re
from typing import Any

import h5py

from gridslam.errors import InputError
from gridslam.inference.state.population import Population
from gridslam.io.covariances import require_covariance
from gridslam.io.files import get_attributes, put_attributes, reading_h5, subgroup, writing_h5
from gridslam.maps.map import Map
from gridslam.maps.map_files import get_map, put_map
from gridslam.maps.run_identity import Identity, parallel
from gridslam.systems.values import arrays_of, get_value, put_value
from gridslam.world.scene import Scene
from gridslam.world.waveform import Waveform

FORMAT, VERSION = "gridslam-checkpoint", 3


def write_checkpoint(slam: Any, path: str | os.PathLike[str]) -> None:
    """Write who is running, a `FilterFront`, and how far it has got, as HDF5.

    Raises
    ------
    InputError
        The file can't be written.
    """
    with writing_h5(path, FORMAT, VERSION) as file:
        attributes = {
            "method": slam.method,
            "scene": slam.scene.to_toml(),
            "agent": slam.agent,
            "seed": slam.seed,
            "provenance": json.dumps(slam.provenance),
            "identity": str(slam.now.identity),
            "origin_m": _origin_of(slam),
        }
        if slam.now.number is not None:
            attributes["number"] = int(slam.now.number)
        put_attributes(file.create_group("run"), attributes)
        put_value(file, "believed", slam.now.believed)
        put_value(file, "waveform", getattr(slam, "waveform", None))
        if getattr(slam, "inherited", None) is not None:
            put_map(slam.inherited, file.create_group("inherited"))


def read_checkpoint(path: str | os.PathLike[str], system: Any) -> Any:
    """A filter of class `system`, a `FilterFront`, as it was when a checkpoint was written.

    Parameters
    ----------
    system : type
        The class that is to go on from it. Types of the state are those of its state before the first step.

    Raises
    ------
    InputError
        No such file, or not a checkpoint of this version and system, or one whose numbers can't be.
    """
    with reading_h5(path, FORMAT, VERSION) as file:
        known = get_attributes(subgroup(file, "run"))
        if known.get("method") != system.method:
            raise InputError(f"{path}: method", repr(known.get("method")), repr(system.method))
        scene, agent = Scene.from_toml(str(known["scene"]), f"{path}: scene"), str(known["agent"])
        waveform = get_value(file, "waveform", Waveform | None)
        more = {} if waveform is None else {"waveform": waveform}
        slam = system(scene, agent=agent, seed=int(str(known["seed"])), **more)
        began = str(known.get("origin_m", "0 0"))  # earlier versions didn't say
        if began != _origin_of(slam):
            allowed = f"({_origin_of(slam)}) m: one that was made by this version"
            raise InputError(f"{path}: /run/origin_m", f"({began}) m", allowed)
        fresh = slam.now.believed
        kind = fresh.kind if isinstance(fresh, Population) else type(fresh)
        believed = get_value(file, "believed", kind)
        _require_alike(believed, fresh, str(path))
        slam.require_sound(believed, slam.model, f"{path}: /believed")
        slam.inherited = _read_inherited(file, slam.scene) if "inherited" in file else None
        slam.provenance, identity = _read_origin(known, str(path))
        number = _read_number(known, str(path))
        slam.now = slam.now._replace(believed=believed, identity=identity, number=number)
        return slam


def _origin_of(slam: Any) -> str:
    """About where a filter reckons, x and y in m; see `gridslam.systems.far_regions`."""
    return " ".join(f"{value:g}" for value in slam.model.origin_m.tolist())


def _read_inherited(file: h5py.File, scene: Scene) -> Map:
    """What of an earlier agent's map goes into the one that is made."""
    where = f"{file.filename}: /inherited"
    try:
        inherited = Map(**get_map(subgroup(file, "inherited")))
    except InputError as error:
        named = error.where if error.where.startswith(where) else where
        raise InputError(named, error.found, error.allowed) from error
    if inherited.shape != scene.grid.shape:
        raise InputError(where, f"{inherited.shape} cells", f"{scene.grid.shape}, those of the scene")
    return inherited


def _read_origin(known: dict[str, Any], path: str) -> tuple[dict[str, list[Any]], Identity]:
    """Who made the map that a filter started from, and which measurements it has taken in."""
    provenance = json.loads(str(known.get("provenance")))
    if not isinstance(provenance, dict) or not all(isinstance(v, list) for v in provenance.values()):
        raise InputError(f"{path}: /run/provenance", str(provenance)[:60], "lists by name")
    text = str(known.get("identity"))
    if not re.fullmatch(r"[0-9a-f]{64} \d+ [0-9a-f]*", text):
        raise InputError(f"{path}: /run/identity", repr(text[:60]), "a checksum and a count")
    return provenance | parallel(provenance), Identity.parse(text)


def _read_number(known: dict[str, Any], path: str) -> int | None:
    """The number of the latest step; None before the first, and of files of earlier versions."""
    if "number" not in known:
        return None
    try:
        return int(str(known["number"]))
    except ValueError:
        found = repr(known["number"])[:60]
        raise InputError(f"{path}: /run/number", found, "a whole number") from None


def _require_alike(believed: Any, fresh: Any, path: str) -> None:
    """Refuse arrays with other numbers of axes than those of a fresh state, and covariances that are none."""
    before = arrays_of(fresh)
    for name, array in arrays_of(believed).items():
        like = before.get(re.sub(r"/\d+(?=/)", "/0", name).replace("/search/before/", "/"))
        if like is not None and like.ndim != array.ndim:
            raise InputError(f"{path}: /believed/{name}", f"shape {array.shape}", f"{like.ndim} axes")
        if name.rpartition("/")[2] == "covariance" and array.ndim == 2:
            require_covariance(array, f"{path}: /believed/{name}")
