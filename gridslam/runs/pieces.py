"""Estimates of a run in pieces on disk, from which an interrupted one goes on: of one agent, or of several.

A piece is what happened between two checkpoints. What files of steps don't hold stands in JSON beside them,
which gives back every number as it was, NaN and infinities too.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from gridslam.errors import InputError
from gridslam.estimates import Estimate, Health
from gridslam.inference.management.network.readout import NetworkEstimate
from gridslam.io.files import write_bytes
from gridslam.runs.step_files import read_steps, write_steps

Now = TypeVar("Now")
OFFSETS = "offset_s", "offset_covariance_s2"


class Pieces(Protocol, Generic[Now]):
    """How estimates of a kind are kept."""

    def write(self, folder: Path, who: int, end: int, new: Sequence[Now]) -> list[Path]:
        """Write those up to a step (not with it), and return the files."""

    def read(self, folder: Path, who: int, end: int) -> list[Now]:
        """Read them back as they were."""


class OfOne:
    """Estimates of one agent."""

    def write(self, folder: Path, who: int, end: int, new: Sequence[Estimate]) -> list[Path]:
        """Write those up to a step (not with it), and return the files.

        Raises
        ------
        InputError
            They can't be written.
        """
        steps, health = folder / f"{who}-steps-{end}.h5", folder / f"{who}-health-{end}.json"
        write_steps(steps, new)
        write_bytes(health, exact_json([_beside(estimate) for estimate in new]))
        return [steps, health]

    def read(self, folder: Path, who: int, end: int) -> list[Estimate]:
        """Read them back as they were.

        Raises
        ------
        InputError
            They can't be read, or belong to other steps.
        """
        path = folder / f"{who}-steps-{end}.h5"
        rows = json.loads((folder / f"{who}-health-{end}.json").read_bytes())
        return _whole(path, rows)


@dataclass(frozen=True)
class OfSeveral:
    """Estimates of several agents at once: a file of steps for each, the clocks and labels beside them.

    Attributes
    ----------
    agents : tuple of str
    """

    agents: tuple[str, ...]

    def write(self, folder: Path, who: int, end: int, new: Sequence[NetworkEstimate]) -> list[Path]:
        """Write those up to a step (not with it), and return the files.

        Raises
        ------
        InputError
            They can't be written.
        """
        files = []
        for path, name in zip(self._steps(folder, who, end), self.agents, strict=True):
            write_steps(path, [own for own in (one.agents[name] for one in new) if own is not None])
            files.append(path)
        rows = [
            {
                "step": one.step,
                "time_s": one.time_s,
                "device": one.device,
                "unset": one.unset,
                "anchor": one.anchor,
                "agents": {name: own and _beside(own) for name, own in one.agents.items()},
                **{name: getattr(one, name) for name in OFFSETS},
            }
            for one in new
        ]
        files.append(folder / f"{who}-health-{end}.json")
        write_bytes(files[-1], exact_json(rows))
        return files

    def read(self, folder: Path, who: int, end: int) -> list[NetworkEstimate]:
        """Read them back as they were.

        Raises
        ------
        InputError
            They can't be read, or belong to other steps.
        """
        rows = json.loads((folder / f"{who}-health-{end}.json").read_bytes())
        own = {}
        for path, name in zip(self._steps(folder, who, end), self.agents, strict=True):
            there = [row["agents"][name] for row in rows if row["agents"][name] is not None]
            own[name] = iter(_whole(path, there))
        return [
            NetworkEstimate(
                step=row["step"],
                time_s=row["time_s"],
                agents={name: next(own[name]) if row["agents"][name] else None for name in self.agents},
                device=tuple(row["device"]),
                unset=np.array(row["unset"], bool),
                anchor={name: np.array(given, np.intp) for name, given in row["anchor"].items()},
                **{name: np.array(row[name], np.float64) for name in OFFSETS},
            )
            for row in rows
        ]

    def _steps(self, folder: Path, who: int, end: int) -> list[Path]:
        return [folder / f"{who}-steps-{end}-{number}.h5" for number in range(len(self.agents))]


def exact_json(value: Any) -> bytes:
    """JSON that gives back every number as it was, NaN and infinities too."""
    return json.dumps(value, default=lambda own: own.tolist(), ensure_ascii=False).encode("utf-8")


def _beside(estimate: Estimate) -> dict[str, Any]:
    """What a file of steps doesn't hold of one."""
    return {"seconds": estimate.seconds, "health": asdict(estimate.health)}


def _whole(path: Path, rows: Sequence[dict[str, Any]]) -> list[Estimate]:
    """Estimates as they were, with what the file of steps doesn't hold."""
    estimates = read_steps(path)
    if len(estimates) != len(rows):
        raise InputError(str(path), f"{len(estimates)} steps", f"{len(rows)}, as beside it")
    return [
        replace(estimate, seconds=row["seconds"], health=_health(row["health"]))
        for estimate, row in zip(estimates, rows, strict=True)
    ]


def _health(row: dict[str, Any]) -> Health:
    pairs: dict[str, Any] = {name: tuple(row[name]) for name in ("innovation_band", "jolt") if name in row}
    arrays = {name: np.array(row[name], dtype=np.float64) for name in ("clutter", "turned_rad")}
    return Health(**row | arrays | pairs)
