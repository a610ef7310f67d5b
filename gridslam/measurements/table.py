"""What an agent heard: one table of detected paths, handed out step by step."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError, located
from gridslam.measurements import csv_table, hdf5_table, matlab, per_step_arrays
from gridslam.measurements.simulated import Simulated
from gridslam.wording import counted
from gridslam.world.columns import KEYS, MOST_STEPS, OPTIONAL, VALUES, Columns, check_columns, fill_missing
from gridslam.world.geometry import wrap
from gridslam.world.given import SECONDS, numbers, whole_numbers
from gridslam.world.names import label_fault
from gridslam.world.scan import Scan
from gridslam.world.trajectory import Trajectory

__all__ = ["Measurements", "Scan"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Measurements:
    """All that an agent heard, read-only; iterating yields one `Scan` per step.

    Attributes
    ----------
    anchors : tuple of str, J names
    step : (K,) int
        Rising; a missing step is one at which nothing was heard.
    time_s : (K,) float64
        Rises strictly from step to step.
    anchor : (K,) int
        Index into `anchors`.
    distance_m, aod_rad, aoa_rad, amplitude : (K,) float64
        As in `Scan`; NaN where not measured.
    distance_std_m, aod_std_rad, aoa_std_rad : (K,) float64 or None
    aod_elevation_rad, aoa_elevation_rad, aod_elevation_std_rad, aoa_elevation_std_rad : (K,) float64 or None
    anchor_position_m : (J, 2) or, with heights, (J, 3) float64, m, or None
    anchor_orientation_rad : (J,) float64, rad, or None
    interval_s : float
        Time between steps, for those before the first and after the last row; 0 stands for the median.
    steps : int
        Number of steps; 0 stands for all up to the last one heard.
    truth : Trajectory or None
        For scoring alone: no filter reads it.
    unlabelled : bool
        Whether rows may leave open whose they are (anchor -1).
    pseudo : bool
        Whether distances hold offsets of clocks, and may be negative.
    simulated : Simulated or None
        The simulation that it is of; None of what was recorded, and of CSV files, which don't tell.

    Raises
    ------
    InputError
        Columns of different lengths, unordered steps or times, infinities, impossible values.
    """

    anchors: tuple[str, ...]
    step: NDArray[np.intp]
    time_s: Array
    anchor: NDArray[np.intp]
    distance_m: Array
    aod_rad: Array
    aoa_rad: Array
    amplitude: Array
    distance_std_m: Array | None = None
    aod_std_rad: Array | None = None
    aoa_std_rad: Array | None = None
    aod_elevation_rad: Array | None = None
    aoa_elevation_rad: Array | None = None
    aod_elevation_std_rad: Array | None = None
    aoa_elevation_std_rad: Array | None = None
    anchor_position_m: Array | None = None
    anchor_orientation_rad: Array | None = None
    interval_s: float = 0.0
    steps: int = 0
    truth: Trajectory | None = None
    unlabelled: bool = False
    pseudo: bool = False
    simulated: Simulated | None = None

    def __post_init__(self) -> None:
        names = tuple(self.anchors)
        if not names or len(set(names)) < len(names):
            raise InputError("measurements: anchors", ", ".join(names) or "none", "names, each once")
        for name in names:
            allowed = label_fault(name) if isinstance(name, str) else "text"
            if allowed is not None:
                raise InputError("measurements: anchors", repr(name), allowed)
        count = np.size(self.step)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys((*KEYS, *VALUES, *OPTIONAL), (count,))
        placed = self.anchor_position_m
        width = 3 if placed is not None and np.shape(placed)[1:] == (3,) else 2  # with heights
        shapes |= {"anchor_position_m": (len(names), width), "anchor_orientation_rad": (len(names),)}
        arrays: Columns = {}
        for name, shape in shapes.items():
            if name in (*KEYS, *VALUES) or getattr(self, name) is not None:
                arrays[name] = _column(name, getattr(self, name))
                if arrays[name].shape != shape:
                    raise InputError(f"measurements: {name}", f"shape {arrays[name].shape}", f"shape {shape}")
        for name in ("anchor_position_m", "anchor_orientation_rad"):
            if name in arrays and not np.isfinite(arrays[name]).all():
                raise InputError(f"measurements: {name}", "NaN or infinity", "finite numbers")
        place = "measurements: {}[{}]".format
        check_columns(arrays, len(names), lambda row, name: place(name, row), self.unlabelled, self.pseudo)
        for name in ("aod_rad", "aoa_rad"):
            arrays[name] = wrap(arrays[name])
        for name, values in arrays.items():
            values.setflags(write=False)
            object.__setattr__(self, name, values)

        spanned = int(self.step[-1]) + 1 if count else 0
        steps, interval = self.steps or spanned, self.interval_s or self._median_interval()
        if not spanned <= steps <= MOST_STEPS:
            raise InputError("measurements: steps", str(steps), f"{spanned} to {MOST_STEPS}")
        if not (np.isfinite(interval) and interval > 0):
            raise InputError("measurements: interval_s", str(interval), "a number above 0")
        for name, value in (("anchors", names), ("steps", int(steps)), ("interval_s", float(interval))):
            object.__setattr__(self, name, value)

    def _median_interval(self) -> float:
        steps, first = np.unique(self.step, return_index=True)
        gaps = np.diff(self.time_s[first]) / np.diff(steps)
        return float(np.median(gaps)) if len(gaps) else 1.0

    def __repr__(self) -> str:
        """One line."""
        known = "" if self.truth is None else ", true track known"
        size = f"{counted(len(self.step), 'path')} in {counted(len(self), 'step')}"
        return f"<Measurements of {size}, anchors {', '.join(self.anchors)}{known}>"

    def __len__(self) -> int:
        return self.steps

    def __iter__(self) -> Iterator[Scan]:
        return map(self.scan, range(self.steps))

    def scan(self, step: int) -> Scan:
        """What was heard at one step, possibly nothing.

        Raises
        ------
        IndexError
            There is no such step.
        """
        if not 0 <= step < self.steps:
            raise IndexError(f"step {step} of {self.steps}")
        rows = slice(*np.searchsorted(self.step, [step, step + 1]))
        cut = {name: values[rows] for name, values in self.columns.items() if name not in ("step", "time_s")}
        return Scan(step=step, time_s=self._time(step, rows), **cut)

    @property
    def times_s(self) -> Array:
        """Times of all steps, (steps,) s."""
        return np.array([scan.time_s for scan in self])

    def _time(self, step: int, rows: slice) -> float:
        """Time of a step: its own, between its neighbours, or at `interval_s` beyond the ends."""
        if rows.start < rows.stop:
            return float(self.time_s[rows.start])
        if not len(self.step):
            return step * self.interval_s
        before, after = max(rows.start - 1, 0), min(rows.start, len(self.step) - 1)
        if self.step[before] < step < self.step[after]:
            return float(np.interp(step, self.step[[before, after]], self.time_s[[before, after]]))
        nearest = before if step > self.step[before] else after
        return float(self.time_s[nearest] + (step - self.step[nearest]) * self.interval_s)

    @property
    def columns(self) -> Columns:
        """Columns of the table that are there, in the order of the files."""
        names = (*KEYS, *VALUES, *(name for name in OPTIONAL if getattr(self, name) is not None))
        return {name: getattr(self, name) for name in names}

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write one row per detected path (no anchors' places, no truth).

        Raises
        ------
        InputError
            The file can't be written.
        """
        csv_table.write_csv(path, self.columns, self.anchors)

    @classmethod
    def from_csv(
        cls, path: str | os.PathLike[str], anchors: Sequence[str] | None = None, pseudo: bool = False
    ) -> Measurements:
        """Read a CSV file of one agent; a quantity whose column it lacks was not measured.

        Parameters
        ----------
        path : path
        anchors : sequence of str, optional
            Names of the anchors, in the scene's order (``scene.anchor_names``); without it, those of the
            file in the order in which they first appear.
        pseudo : bool
            Whether distances hold offsets of clocks, and may be negative.

        Raises
        ------
        InputError
            The first fault, with its line.
        """
        with located(path):
            columns, names, _ = csv_table.read_csv(path, anchors, pseudo=pseudo)
            table: dict[str, Any] = fill_missing(columns)
            return cls(anchors=names, **table, pseudo=pseudo)

    def to_h5(self, path: str | os.PathLike[str]) -> None:
        """Write everything, the truth included, as HDF5 (``h5read`` of MATLAB reads it).

        Raises
        ------
        InputError
            The file can't be written.
        """
        hdf5_table.write_h5(path, self.columns, {f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def from_h5(cls, path: str | os.PathLike[str]) -> Measurements:
        """Read an HDF5 file.

        Raises
        ------
        InputError
            Not such a file, cut short, or any fault in its content.
        """
        with located(path):
            table: dict[str, Any] = fill_missing(hdf5_table.read_h5(path))
            return cls(**table)

    @classmethod
    def from_mat(cls, path: str | os.PathLike[str], anchors: Sequence[str] | None = None) -> Measurements:
        """Read a MATLAB file, version 5 to 7.3; see `gridslam.measurements.matlab` for what it holds.

        Parameters
        ----------
        path : path
        anchors : sequence of str, optional
            Names of the anchors, in the scene's order (``scene.anchor_names``), of which the file's number 1
            is the first; without it, those that the file says.

        Raises
        ------
        InputError
            Not such a file, cut short, or any fault in its content.
        """
        with located(path):
            columns, names = matlab.read_mat(path, anchors)
            table: dict[str, Any] = fill_missing(columns)
            return cls(anchors=names, **table)

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], anchors: Sequence[str] | None = None, pseudo: bool = False
    ) -> Measurements:
        """Read a file of any known kind: ``.csv``, ``.mat``, and HDF5 under any other name.

        Parameters
        ----------
        path : path
        anchors : sequence of str, optional
            As of `from_csv` and `from_mat`; an HDF5 file holds them.
        pseudo : bool
            Of CSV files, which don't say it: distances hold offsets of clocks, and may be negative.

        Raises
        ------
        InputError
            As the reader of its kind.
        """
        kind = os.path.splitext(os.fspath(path))[1].lower()
        if kind == ".csv":
            return cls.from_csv(path, anchors, pseudo)
        return cls.from_mat(path, anchors) if kind == ".mat" else cls.from_h5(path)

    @classmethod
    def from_arrays(
        cls,
        distance_m: Mapping[str, Sequence[ArrayLike]],
        aod_rad: Mapping[str, Sequence[ArrayLike]] | None = None,
        aoa_rad: Mapping[str, Sequence[ArrayLike]] | None = None,
        amplitude: Mapping[str, Sequence[ArrayLike]] | None = None,
        *,
        time_s: ArrayLike | None = None,
        interval_s: float = 1.0,
        **more: Any,
    ) -> Measurements:
        """Collect arrays that hold one row of paths per step, for each anchor.

        Parameters
        ----------
        distance_m, aod_rad, aoa_rad, amplitude : dict of anchor name to N sequences
            Ragged lists, or (N, M) arrays padded with NaN; a quantity left out was not measured. All of an
            anchor's quantities have the same number of paths in a step.
        time_s : (N,) s, optional
            Times of the steps; otherwise every `interval_s` from 0.
        **more
            Standard deviations and elevations in the same form, and any other argument of `Measurements`.

        Raises
        ------
        InputError
            Quantities whose shapes differ, or any fault of their content.

        Examples
        --------
        >>> from gridslam.measurements.table import Measurements
        >>> heard = Measurements.from_arrays({"A": [[2.0, 5.5], [], [2.1]], "B": [[4.0], [4.1], []]})
        >>> len(heard), heard.scan(0).distance_m.tolist()
        (3, [2.0, 5.5, 4.0])
        """
        given = {"distance_m": distance_m, "aod_rad": aod_rad, "aoa_rad": aoa_rad, "amplitude": amplitude}
        given |= {name: more.pop(name, None) for name in OPTIONAL}
        tables = {name: quantity for name, quantity in given.items() if quantity is not None}
        columns = per_step_arrays.table(tables, time_s, interval_s)
        known = [field.name for field in fields(cls) if field.name not in columns]
        for name in more:
            if name not in known:
                raise InputError("measurements: from_arrays", repr(name), ", ".join([*given, *known]))
        return cls(interval_s=interval_s, **{**columns, **more})


def _column(name: str, given: object) -> NDArray[Any]:
    """An array of its own, of whole numbers or of any."""
    where = f"measurements: {name}"
    if name == "step":
        return whole_numbers(given, where, f"whole numbers, 0 to {MOST_STEPS - 1}")
    if name == "anchor":
        return whole_numbers(given, where, "whole numbers from 0: which of the anchors")
    return numbers(given, where, SECONDS if name == "time_s" else "real numbers")
