"""What is heard at one step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, real
from gridslam.errors import InputError
from gridslam.wording import counted
from gridslam.world.columns import DEVIATIONS, ELEVATIONS, OPTIONAL, VALUES, check_columns
from gridslam.world.given import time_of

BLANK = {"blank": True}
"""Of columns that may hold NaN, where a checkpoint keeps a scan."""
NOT_MEASURED: Any = None
"""Instead of a column, in scans that are made by hand; those that filters see have it."""


@dataclass(frozen=True, eq=False)
class Scan:
    """What was heard at one step; NaN stands for not measured.

    Attributes
    ----------
    step : int
        Rises from scan to scan; one that is left out is a silent one.
    time_s : float
        Rises strictly from scan to scan: all that is heard at one time is one scan.
    anchor : (M,) int
        Index of the anchor in the scene's order, ``scene.anchor_names``, from 0; -1 where it isn't known.
        Another order can't be noticed, since a scan holds no names; `Measurements` do.
    distance_m : (M,) float64
    aod_rad, aoa_rad : (M,) float64
        Departure relative to the anchor's orientation, arrival relative to the heading; NaN where not
        measured. Whoever hands a scan to a filter may leave out a column of NaN, or give None.
    amplitude : (M,) float64
        Square root of the path's SNR.
    distance_std_m, aod_std_rad, aoa_std_rad : (M,) float64 or None
        Used instead of the Fisher-information values.
    aod_elevation_rad, aoa_elevation_rad : (M,) float64 or None
        How far above the horizontal the path leaves the anchor, and the direction from the agent to where it
        comes from; with deviations, which are used in the same way.
    """

    step: int
    time_s: float
    anchor: NDArray[np.intp]
    distance_m: Array = field(default=NOT_MEASURED, metadata=BLANK)
    aod_rad: Array = field(default=NOT_MEASURED, metadata=BLANK)
    aoa_rad: Array = field(default=NOT_MEASURED, metadata=BLANK)
    amplitude: Array = field(default=NOT_MEASURED, metadata=BLANK)
    distance_std_m: Array | None = field(default=None, metadata=BLANK)
    aod_std_rad: Array | None = field(default=None, metadata=BLANK)
    aoa_std_rad: Array | None = field(default=None, metadata=BLANK)
    aod_elevation_rad: Array | None = field(default=None, metadata=BLANK)
    aoa_elevation_rad: Array | None = field(default=None, metadata=BLANK)
    aod_elevation_std_rad: Array | None = field(default=None, metadata=BLANK)
    aoa_elevation_std_rad: Array | None = field(default=None, metadata=BLANK)

    def __repr__(self) -> str:
        """One line."""
        return f"<Scan of {counted(np.size(self.anchor), 'path')}, step {self.step} at {self.time_s} s>"

    def __len__(self) -> int:
        return len(self.anchor)

    def only(self, rows: NDArray[np.bool_]) -> Scan:
        """The scan with some of its rows (M,)."""
        columns = {name: getattr(self, name) for name in ("anchor", *VALUES, *OPTIONAL)}
        kept: dict[str, Any] = {name: None if own is None else own[rows] for name, own in columns.items()}
        return replace(self, **kept)

    def content(self) -> Iterator[NDArray[Any] | None]:
        """All columns in a fixed order, None where there is none; of elevations those there are, numbered."""
        yield from (getattr(self, name) for name in ("anchor", *VALUES, *DEVIATIONS))
        # scans without any keep the identity that they had before there were elevations
        for number, name in enumerate(OPTIONAL[len(DEVIATIONS) :]):
            if (column := getattr(self, name)) is not None:
                yield np.array(number)
                yield column

    def checked(
        self, anchors: int, after: float | None = None, unlabelled: bool = False, pseudo: bool = False
    ) -> Scan:
        """The scan as arrays, if a filter can make sense of it.

        Parameters
        ----------
        anchors : int
            How many there are.
        after : float, optional
            Time of the scan before, s.
        unlabelled, pseudo : bool
            Whether anchors may be unknown (-1), and distances negative; see `check_columns`.

        Raises
        ------
        InputError
            Columns of other lengths or none of numbers, an anchor that there isn't, an infinite value, a
            length, amplitude or deviation that isn't above 0, a row without any value, or a time that is NaN
            or isn't later than that of the scan before.
        """
        given = {name: getattr(self, name) for name in (*VALUES, *OPTIONAL)}
        time = time_of(self.time_s, "scan")
        try:
            anchor = _numbers_of_anchors(self.anchor, anchors)
            given |= {n: np.full(anchor.shape, np.nan) for n in VALUES if given[n] is None}
            columns = {n: real(v) for n, v in given.items() if v is not None}
        except InputError:
            raise
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError("scan", str(error), "columns of numbers") from None
        for name, column in columns.items():
            if column.shape != anchor.shape or anchor.ndim != 1:
                raise InputError(
                    f"scan: {name}", f"shape {column.shape}", f"({anchor.size},), one per anchor's row"
                )
        require_time("scan", time, after)
        if len(anchor) and _doubtful(columns, anchor, anchors, unlabelled, pseudo):
            still = {"step": np.zeros(len(anchor), np.intp), "time_s": np.full(len(anchor), time)}
            whole = still | {"anchor": anchor} | columns
            check_columns(whole, anchors, lambda row, name: f"scan: {name}[{row}]", unlabelled, pseudo)
        return Scan(self.step, time, anchor, **columns)


def _numbers_of_anchors(given: Any, anchors: int) -> NDArray[np.intp]:
    """The column of anchors, which are counted, not named."""
    column = np.asarray(np.ma.filled(given, -1))  # masked: not known
    if column.size and column.dtype.kind not in "iu":
        many = f"whole numbers, 0 to {anchors - 1}: which of the scene's anchors"
        raise InputError("scan: anchor", repr(column.ravel()[:1].tolist()[0])[:40], many)
    return column.astype(np.intp, copy=False)


def require_time(where: str, time_s: float, after: float | None = None) -> None:
    """Refuse a time that isn't a number, or isn't later than `after`, that of the scan before.

    Times rise strictly, as in tables: a scan that is handed over twice would count twice.

    Raises
    ------
    InputError
        Either.
    """
    if not np.isfinite(time_s):
        raise InputError(f"{where}: time_s", str(time_s), "a finite number")
    if after is not None and time_s <= after:
        allowed = f"later than {after}, the scan before: all that is heard at one time is one scan"
        raise InputError(f"{where}: time_s", str(time_s), allowed)


def require_step(step: object, after: int | None = None) -> None:
    """Refuse a step that isn't a whole number, or is below `after`, that of the scan before.

    Times tell a scan that is handed over twice; who numbers none of them leaves all at 0.

    Raises
    ------
    InputError
        Either.
    """
    try:
        number = float(step)  # type: ignore[arg-type]  # whatever somebody gave
    except (TypeError, ValueError, OverflowError):
        raise InputError("scan: step", repr(step), "a whole number") from None
    if not number.is_integer():
        raise InputError("scan: step", str(step), "a whole number")
    if after is not None and number < after:
        allowed = f"{after} or above, after the scan before: steps of a later recording are counted on"
        raise InputError("scan: step", str(step), allowed)


def _doubtful(
    columns: dict[str, Array], anchor: NDArray[np.intp], anchors: int, unlabelled: bool, pseudo: bool
) -> bool:
    """Whether `check_columns` could find anything amiss: a quick look, since every step takes it."""
    angles = np.array([columns["aod_rad"], columns["aoa_rad"]])
    signed = ("aod_rad", "aoa_rad", *ELEVATIONS)
    others = np.array([column for name, column in columns.items() if name not in signed])
    steep = [columns[name] for name in ELEVATIONS if name in columns]
    return bool(
        np.minimum.reduce(anchor) < (-1 if unlabelled else 0)
        or np.maximum.reduce(anchor) >= anchors
        or np.isnan(np.minimum.reduce(others[0]))
        or np.fmin.reduce(others[1 if pseudo else 0 :], None) <= 0
        or np.fmax.reduce(np.abs(others), None) == np.inf
        or np.fmax.reduce(np.abs(angles), None) > 2 * np.pi
        or any(not (np.abs(column[~np.isnan(column)]) <= 0.5 * np.pi).all() for column in steep)
    )
