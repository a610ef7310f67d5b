"""The folder of a finished run: written whole or not at all, and read back for figures."""

from __future__ import annotations

import json
import math
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.files import beside, cannot_write, write_bytes
from gridslam.map import Map
from gridslam.measurements import Measurements
from gridslam.scene import Scene
from gridslam.stepfiles import read_steps, write_steps
from gridslam.trajectory import Trajectory

if TYPE_CHECKING:
    from gridslam.result import Run

RESERVED = frozenset(
    (
        "figures",
        "run.json",
        "scene.toml",
        "map.h5",
        "map.yaml",
        "map.pgm",
        "reflection.yaml",
        "reflection.pgm",
    )
)
PACKAGES = ("gridslam", "numpy", "scipy", "taichi", "h5py")


@dataclass(frozen=True, eq=False)
class AgentFiles:
    """What a run's folder holds about one agent.

    Attributes
    ----------
    measurements : Measurements
    trajectory : Trajectory
        Estimated track.
    truth : Trajectory or None
        True track, where known.
    estimates : list of Estimate
        All steps; their `seconds` are NaN.
    map : Map
        Map at the end.
    """

    measurements: Measurements
    trajectory: Trajectory
    truth: Trajectory | None
    estimates: list[Estimate]
    map: Map


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


def check_output(directory: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Refuse an output folder before a long run rather than after it.

    Raises
    ------
    InputError
        It exists and `overwrite` is off, it exists and isn't a run's folder, or it can't be made.
    """
    target = Path(directory)
    if target.exists() or target.is_symlink():
        if not overwrite:
            raise InputError(str(target), "something of this name", "a new folder (or --overwrite)")
        if not target.is_dir() or (any(target.iterdir()) and not (target / "run.json").is_file()):
            raise InputError(
                str(target), "something that no run wrote", "a new folder, or a run's to overwrite"
            )
    above = next(parent for parent in target.absolute().parents if parent.exists())
    try:  # to ask for rights isn't enough: the superuser has them all, read-only disks or not
        os.rmdir(tempfile.mkdtemp(prefix=".gridslam-", dir=above))
    except OSError as error:
        raise InputError(
            str(target), f"{error.strerror or error} in {above}", "a folder that can be written to"
        ) from error


def write_run(
    directory: str | os.PathLike[str],
    scene: Scene,
    runs: Sequence[Run],
    measurements: Sequence[Measurements],
    scores: Sequence[Mapping[str, Any] | None],
    settings: Mapping[str, Any],
    overwrite: bool = False,
    draw: Callable[[Path], None] | None = None,
) -> None:
    """Write a run's folder under a temporary name and rename it when it is complete.

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
        Draws ``figures/`` in the folder it is given. If it fails (or Ctrl-C ends it), the folder is kept
        without them and the error passed on.

    Raises
    ------
    InputError
        The folder exists, can't be written to, or the disk is full: nothing half-written is left behind.
    """
    names = [run.agent for run in runs]
    for name in names:
        if not re.fullmatch(r"\w[\w .+-]*", name) or name in RESERVED:
            raise InputError(
                "agent name", repr(name), "letters, digits, space, _ . + -, and no file of the run's"
            )
    if not names or len(set(names)) < len(names):
        raise InputError("agents", f"{names}", "one or more, each once")
    check_output(directory, overwrite)
    target = Path(directory).resolve()
    part = beside(target)
    trouble: BaseException | None = None
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        _fill(part, scene, runs, measurements, scores, settings)
        if draw is not None:
            try:
                draw(part)
            except (Exception, KeyboardInterrupt) as error:  # hours of filtering outweigh a figure
                trouble = error
                shutil.rmtree(part / "figures", ignore_errors=True)
        _swap(part, target)
    except OSError as error:
        raise cannot_write(target, error) from error
    except InputError as error:
        raise InputError(str(target), error.found, error.allowed) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    if isinstance(trouble, InputError | OSError):
        reason = trouble.found if isinstance(trouble, InputError) else trouble.strerror or str(trouble)
        raise InputError(f"{target / 'figures'}", reason, "room for figures (the rest is written)")
    if trouble is not None:
        raise trouble


def read_run(directory: str | os.PathLike[str]) -> RunFiles:
    """Read a run's folder back.

    Raises
    ------
    InputError
        Not a run's folder, or one of its files is missing or damaged.
    """
    folder = Path(directory)
    try:
        summary = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        names = list(summary["agents"])
        if not names:
            raise ValueError("no agent")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder / 'run.json'}", "none that can be read", "a folder that a run wrote"
        ) from error
    agents = {}
    for name in names:
        own = folder / name
        truth = own / "truth.tum"
        agents[name] = AgentFiles(
            Measurements.from_h5(own / "measurements.h5"),
            Trajectory.from_tum(own / "trajectory.tum"),
            Trajectory.from_tum(truth) if truth.exists() else None,
            read_steps(own / "steps.h5"),
            Map.load(own / "map.h5"),
        )
    return RunFiles(Scene.load(folder / "scene.toml"), summary, agents)


def _fill(
    folder: Path,
    scene: Scene,
    runs: Sequence[Run],
    measurements: Sequence[Measurements],
    scores: Sequence[Mapping[str, Any] | None],
    settings: Mapping[str, Any],
) -> None:
    agents = {}
    for run, heard, score in zip(runs, measurements, scores, strict=True):
        own = folder / run.agent
        own.mkdir()
        heard.to_h5(own / "measurements.h5")
        run.trajectory.to_tum(own / "trajectory.tum")
        if heard.truth is not None:
            heard.truth.to_tum(own / "truth.tum")
        write_steps(own / "steps.h5", run.estimates)
        run.map.save(own / "map.h5")
        agents[run.agent] = dict(score if score is not None else run.score(None))
    last = runs[-1]
    shutil.copyfile(folder / last.agent / "map.h5", folder / "map.h5")
    last.map.to_nav2(folder)
    write_bytes(folder / "scene.toml", scene.to_toml().encode("utf-8"))
    summary = {
        "scene": scene.name,
        "method": last.method,
        "seed": last.seed,
        "start": last.start,
        "particles": last.scene.filter.particles,
        "device": last.device,
        "versions": {"python": platform.python_version()} | {name: version(name) for name in PACKAGES},
        **settings,
        "agents": agents,
    }
    text = json.dumps(_strict(summary), indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    write_bytes(folder / "run.json", text.encode("utf-8"))


def _swap(part: Path, target: Path) -> None:
    """Put the finished folder in its place; the one that stood there goes last."""
    if not target.exists():
        part.rename(target)
        return
    old = part.with_name(f"{part.stem}.old.part")
    shutil.rmtree(old, ignore_errors=True)
    target.rename(old)
    try:
        part.rename(target)
    except OSError:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _strict(value: Any) -> Any:
    """The same in plain JSON: NumPy values made Python's, numbers that aren't finite made null."""
    if isinstance(value, Mapping):
        return {str(key): _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return _strict(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
