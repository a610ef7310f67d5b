"""What several agents heard, in one table: whose anchor it was may be unknown, and clocks may be off."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.measurements import csv_table, network_files
from gridslam.measurements.network_files import CLOCKS
from gridslam.measurements.table import Measurements
from gridslam.wording import counted
from gridslam.world.clocks import ClockTruth
from gridslam.world.columns import KEYS, OPTIONAL, VALUES, Columns
from gridslam.world.given import whole_numbers
from gridslam.world.names import folder_fault, same_folder
from gridslam.world.network_scan import NetworkScan
from gridslam.world.scan import Scan
from gridslam.world.trajectory import Trajectory

Whole = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class NetworkMeasurements:
    """Measurements of several agents over the same steps, read-only; iterating yields `NetworkScan` objects.

    Attributes
    ----------
    agents : tuple of str
        I names, in the order in which they are listened to within a step.
    table : Measurements
        Rows of all agents together.
    agent : (K,) int
        Index into `agents` of each row.
    present : (I, 2) int
        First and last step at which each agent is there; by default, of its first and last row. A step
        between them without a row is one at which it heard nothing.
    tracks : dict of str to Trajectory
        True ones, for scoring alone.
    clocks : ClockTruth or None
        True offsets, for scoring alone.

    Raises
    ------
    InputError
        Names that repeat or can't name a folder, agents without a row, or a presence that leaves rows out.
    """

    agents: tuple[str, ...]
    table: Measurements
    agent: Whole
    present: Whole | None = None
    tracks: Mapping[str, Trajectory] = field(default_factory=dict)
    clocks: ClockTruth | None = None

    def __post_init__(self) -> None:
        names = tuple(self.agents)
        agent = whole_numbers(self.agent, "measurements: agent", f"0 to {len(names) - 1}, one for each row")
        where = "measurements: agents"
        if not names:
            raise InputError(where, "none", "at least one")
        for index, name in enumerate(names):
            allowed = folder_fault(name) if name != CLOCKS else "another name"
            if allowed is not None:
                raise InputError(where, repr(name), allowed)
            if same_folder(name) in map(same_folder, names[:index]):
                raise InputError(where, f"{name!r} twice", "each name once")
        if agent.shape != self.table.step.shape or (agent < 0).any() or (agent >= len(names)).any():
            raise InputError(
                "measurements: agent", "other indices", f"0 to {len(names) - 1}, one for each row"
            )
        for name in self.tracks:
            if name not in names:
                raise InputError("measurements: truth", repr(name), ", ".join(names))
        steps_of = [self.table.step[agent == index] for index in range(len(names))]
        for name, steps in zip(names, steps_of, strict=True):
            if not len(steps):
                raise InputError(where, f"{name!r}, who heard nothing at all", "agents with measurements")
        spans = np.array([[steps[0], steps[-1]] for steps in steps_of])
        given = spans if self.present is None else np.array(self.present)
        if not np.array_equal(given, np.rint(given)):
            raise InputError("measurements: present", "numbers that aren't whole", "first and last steps")
        present = given.astype(np.intp)
        if present.shape != spans.shape:
            raise InputError("measurements: present", f"shape {present.shape}", f"shape {spans.shape}")
        for index, name in enumerate(names):
            if not 0 <= present[index, 0] <= spans[index, 0] <= spans[index, 1] <= present[index, 1]:
                found = f"{name!r} from step {present[index, 0]} to {present[index, 1]}"
                raise InputError(
                    "measurements: present", found, f"{spans[index, 0]} to {spans[index, 1]} at least"
                )
        for array in (agent, present):
            array.setflags(write=False)
        for key, value in (("agents", names), ("agent", agent), ("present", present)):
            object.__setattr__(self, key, value)

    def __repr__(self) -> str:
        """One line."""
        size = f"{counted(len(self.agent), 'path')} in {counted(len(self), 'step')}"
        return f"<NetworkMeasurements of {size}, agents {', '.join(self.agents)}>"

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[NetworkScan]:
        return map(self.scan, range(len(self)))

    def scan(self, step: int) -> NetworkScan:
        """What was heard at one step.

        Raises
        ------
        IndexError
            There is no such step.
        """
        whole = self.table.scan(step)
        rows = slice(*np.searchsorted(self.table.step, [step, step + 1]))
        whose, there = self.agent[rows], self.there(step)
        scans = (_rows_of(whole, whose == i) if there[i] else None for i in range(len(self.agents)))
        return NetworkScan(step, whole.time_s, tuple(scans))

    def there(self, step: int) -> NDArray[np.bool_]:
        """Which agents are there at a step, (I,)."""
        present = np.asarray(self.present)
        return (present[:, 0] <= step) & (step <= present[:, 1])

    def __getitem__(self, name: str) -> Measurements:
        """One agent's rows, with its true track."""
        if name not in self.agents:
            raise InputError("measurements: agent", repr(name), ", ".join(self.agents))
        mine = self.agent == self.agents.index(name)
        columns: dict[str, Any] = {key: values[mine] for key, values in self.table.columns.items()}
        last = int(np.asarray(self.present)[self.agents.index(name), 1]) + 1
        return replace(self.table, **columns, steps=last, truth=self.tracks.get(name))

    def of(self, names: Sequence[str]) -> NetworkMeasurements:
        """Measurements of some of the agents alone, in this order.

        Raises
        ------
        InputError
            One of them isn't there.
        """
        for name in names:
            if name not in self.agents:
                raise InputError("measurements: agent", repr(name), ", ".join(self.agents))
        place = np.array([names.index(name) if name in names else -1 for name in self.agents])
        mine = place[self.agent] >= 0
        columns: dict[str, Any] = {key: values[mine] for key, values in self.table.columns.items()}
        present = np.asarray(self.present)[[self.agents.index(name) for name in names]]
        tracks = {name: self.tracks[name] for name in names if name in self.tracks}
        table = replace(self.table, **columns, steps=len(self))
        return NetworkMeasurements(tuple(names), table, place[self.agent[mine]], present, tracks, self.clocks)

    @classmethod
    def of_agents(
        cls, parts: Mapping[str, Measurements], clocks: ClockTruth | None = None
    ) -> NetworkMeasurements:
        """Put the tables of several agents, of the same anchors and steps, into one.

        Parameters
        ----------
        parts : dict of agent to Measurements
            Their steps count from the same first one, and are at the same times; an agent is there from its
            first row to the last of its own steps.
        clocks : ClockTruth, optional

        Raises
        ------
        InputError
            None at all, other anchors, columns or times, or an agent who heard nothing.
        """
        if not parts:
            raise InputError("measurements: agents", "none", "at least one")
        (one, first), *others = parts.items()
        for name, part in others:
            for what, own, known in (
                ("anchors", part.anchors, first.anchors),
                ("columns", tuple(part.columns), tuple(first.columns)),
            ):
                if own != known:
                    found, allowed = ", ".join(own), f"{', '.join(known)}, as of {one!r}"
                    raise InputError(f"measurements: {what} of {name!r}", found, allowed)
        whole = {key: np.concatenate([part.columns[key] for part in parts.values()]) for key in first.columns}
        count = [len(part.step) for part in parts.values()]
        agent = np.repeat(np.arange(len(parts)), count)
        order = np.argsort(whole["step"], kind="stable")
        rows: dict[str, Any] = {key: values[order] for key, values in whole.items()}
        each = list(parts.values())
        table = replace(
            first, **rows, steps=max(part.steps for part in each), truth=None,
            unlabelled=any(part.unlabelled for part in each), pseudo=any(part.pseudo for part in each),
        )  # fmt: skip
        first_steps = [part.step[0] if len(part.step) else 0 for part in each]
        present = [[start, part.steps - 1] for start, part in zip(first_steps, each, strict=True)]
        tracks = {name: part.truth for name, part in parts.items() if part.truth is not None}
        return cls(tuple(parts), table, agent[order], np.array(present, np.intp), tracks, clocks)

    def without_labels(self) -> NetworkMeasurements:
        """Measurements of which nothing says whose a row is: all anchors -1, as where none are labelled."""
        table = replace(self.table, anchor=np.full_like(self.table.anchor, -1), unlabelled=True)
        return replace(self, table=table)

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write one row per detected path (no anchors' places, no truth).

        Raises
        ------
        InputError
            The file can't be written.
        """
        csv_table.write_csv(path, self._columns(), self.table.anchors, self.agents)

    def to_h5(self, path: str | os.PathLike[str]) -> None:
        """Write everything, the truth included, as HDF5 (version 2).

        Raises
        ------
        InputError
            The file can't be written.
        """
        network_files.write_h5(path, self._columns(), {f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], anchors: Sequence[str], agents: Sequence[str] | None = None,
        pseudo: bool = False, alone: str | None = None,
    ) -> NetworkMeasurements:  # fmt: skip
        """Read a file of any known kind: ``.csv``, ``.mat``, and HDF5 under any other name.

        Parameters
        ----------
        path : path
        anchors : sequence of str
            Names of the anchors, in the scene's order (``scene.anchor_names``); a MATLAB file names them or
            numbers them from 1.
        agents : sequence of str, optional
            Names that the file may hold (MATLAB: or number); without it, any. Those that it does hold keep
            this order.
        pseudo : bool
            Whether distances hold offsets of clocks, and may be negative.
        alone : str, optional
            The agent whose rows all are where a CSV file has no column ``agent``; needless for one agent.

        Raises
        ------
        InputError
            Not such a file, cut short, or the first fault in its content; of CSV, with its line.
        """
        kind = os.path.splitext(os.fspath(path))[1].lower()
        if kind == ".csv":
            return cls.from_csv(path, anchors, agents, pseudo, alone)
        return cls.from_mat(path, anchors, agents, pseudo) if kind == ".mat" else cls.from_h5(path)

    @classmethod
    def from_csv(
        cls, path: str | os.PathLike[str], anchors: Sequence[str], agents: Sequence[str] | None = None,
        pseudo: bool = False, alone: str | None = None,
    ) -> NetworkMeasurements:  # fmt: skip
        """Read a CSV file, whose ``anchor`` may be empty or left out.

        Parameters
        ----------
        path : path
        anchors : sequence of str
            Names of the anchors, in the scene's order (``scene.anchor_names``).
        agents : sequence of str, optional
            Names that the file may hold; without it, any.
        pseudo : bool
            Whether distances hold offsets of clocks, and may be negative.
        alone : str, optional
            The agent whose rows all are where there is no column ``agent``; needless for one agent.

        Raises
        ------
        InputError
            The first fault, with its line.
        """
        return cls(**network_files.read_csv(path, anchors, agents, pseudo, alone))

    @classmethod
    def from_mat(
        cls, path: str | os.PathLike[str], anchors: Sequence[str], agents: Sequence[str] | None = None,
        pseudo: bool = False,
    ) -> NetworkMeasurements:  # fmt: skip
        """Read a MATLAB file; ``anchor`` may be left out, 0, NaN or an empty name.

        Parameters
        ----------
        path : path
        anchors, agents : sequence of str
            Names of anchors (``scene.anchor_names``), and of agents that may be there (default: any); the
            file has the names, or numbers from 1.
        pseudo : bool
            Whether distances hold offsets of clocks, and may be negative.

        Raises
        ------
        InputError
            Not such a file, cut short, or the first fault in its content.
        """
        return cls(**network_files.read_mat(path, anchors, agents, pseudo))

    @classmethod
    def from_h5(cls, path: str | os.PathLike[str]) -> NetworkMeasurements:
        """Read an HDF5 file, version 2, or version 1 with one agent of the name "agent1".

        Raises
        ------
        InputError
            Not such a file, cut short, or any fault in its content.
        """
        return cls(**network_files.read_h5(path))

    def _columns(self) -> Columns:
        """Columns of the file, in its order."""
        rows = self.table.columns
        first = {name: rows[name] for name in KEYS[:2]}
        return first | {"agent": self.agent} | {name: rows[name] for name in rows if name not in first}


def _rows_of(scan: Scan, mine: NDArray[np.bool_]) -> Scan:
    """Some rows of a scan."""
    columns: dict[str, Any] = {name: getattr(scan, name) for name in ("anchor", *VALUES, *OPTIONAL)}
    return replace(scan, **{name: part[mine] for name, part in columns.items() if part is not None})
