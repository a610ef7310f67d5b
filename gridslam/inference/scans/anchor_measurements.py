"""Measurements of one anchor in a scan, or of all of them, as arrays."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import overload

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels.primitives import tables
from gridslam.kernels.primitives.tables import (
    AMPLITUDE,
    AOA,
    AOD,
    AS_CLUTTER,
    DISTANCE,
    LABEL,
    OWN_STD,
    SCAN_COLUMNS,
)
from gridslam.world.columns import ELEVATIONS
from gridslam.world.filter_model import FilterModel, fixed
from gridslam.world.radio import RadioModel
from gridslam.world.scan import Scan

LOUD = np.log(1000.0)
"""Squared amplitude above the squared threshold that one in a thousand clutter measurements exceeds."""
QUIET = np.log(20.0)
"""The same that one in twenty exceeds."""
CLUTTER_PER_QUIET = 1 / (1 - np.exp(-QUIET))
"""How much clutter one stands for that is quieter than that."""
LEAST_STD = 1e-6
UNKNOWN = -1
"""Stands for an anchor that nobody has told."""
NOWHERE = fixed(np.full(2, np.nan))
"""Where it is."""


@dataclass(frozen=True)
class AnchorScan:
    """Measurements of one anchor at one step, or of all anchors; NaN stands for not measured.

    Attributes
    ----------
    anchor : int
        `UNKNOWN` for measurements of any anchors.
    position : (2,) m
    orientation : float, rad
        Of the anchor; NaN where it is unknown.
    height : float, m
        Of the anchor above the agent.
    value : (M, 3)
        Distance (m), AoD and AoA (rad).
    own_std : (M, 3)
        Deviations that came with the table.
    amplitude : (M,)
    label : (M,) int
        The anchor that sent each, `UNKNOWN` if that isn't known.
    table : (M, SCAN_COLUMNS)
        The same as kernels take it: columns of `scan` in `kernels.primitives.tables`.
    elevation : (M, 4) or None
        Elevations of departure and arrival and their own deviations (rad), NaN for none.
    """

    anchor: int
    position: Array
    orientation: float
    height: float
    value: Array
    own_std: Array
    amplitude: Array
    label: NDArray[np.intp]
    table: Array
    elevation: Array | None = None

    def __len__(self) -> int:
        return len(self.amplitude)

    @cached_property
    def loud(self) -> NDArray[np.bool_]:
        """Measurements (M,) that clutter is unlikely to be the cause of: one in a thousand is as loud."""
        return np.asarray(self.table[:, tables.LOUD] > 0.5)

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Whether distance, AoD and AoA were measured, (M, 3)."""
        return np.asarray(self.table[:, OWN_STD : OWN_STD + 3] >= 0)

    @cached_property
    def whole(self) -> NDArray[np.bool_]:
        """Measurements (M,) that lack nothing."""
        return np.asarray(self.measured.all(1) & (self.table[:, AMPLITUDE] > 0))

    @cached_property
    def arriving(self) -> NDArray[np.bool_]:
        """Measurements (M,) of distance, AoA and amplitude, at least."""
        return np.asarray(self.measured[:, [DISTANCE, AOA]].all(1) & (self.table[:, AMPLITUDE] > 0))

    @classmethod
    def of(
        cls, anchor: int, position: Array, orientation: float, value: Array, own_std: Array, amplitude: Array,
        threshold: float = 0.0, height: float = 0.0,
    ) -> AnchorScan:  # fmt: skip
        """Measurements given one by one: values and their deviations (M, 3), amplitudes (M,).

        `threshold` is the amplitude from which on the radio detects; all are labelled with their anchor.
        """
        label = np.full(len(amplitude), anchor)
        table = _table(value, own_std, amplitude, label, threshold)
        return cls(anchor, position, orientation, height, value, own_std, amplitude, label, table)

    def take(self, rows: NDArray[np.intp]) -> AnchorScan:
        """Some of them."""
        return replace(
            self, value=self.value[rows], own_std=self.own_std[rows], amplitude=self.amplitude[rows],
            label=self.label[rows], table=self.table[rows],
            elevation=None if self.elevation is None else self.elevation[rows],
        )  # fmt: skip

    def without_departures(self, rows: NDArray[np.bool_] | slice = slice(None)) -> AnchorScan:
        """The same to kernels as if no departure had been measured, of some or all."""
        table = self.table.copy()
        table[rows, OWN_STD + AOD] = -1.0
        return replace(self, table=table)


@dataclass(frozen=True, eq=False)
class SplitScan(Sequence[AnchorScan]):
    """A scan, anchor by anchor, the silent ones too.

    Attributes
    ----------
    each : tuple of AnchorScan
    whole : AnchorScan
        All of it in that order, of which those are parts.
    """

    each: tuple[AnchorScan, ...]
    whole: AnchorScan

    def __len__(self) -> int:
        return len(self.each)

    @cached_property
    def departs(self) -> bool:
        """Whether a direction of departure was measured."""
        return bool(self.whole.measured[:, AOD].any())

    @cached_property
    def arrives(self) -> bool:
        """Whether a direction of arrival was measured."""
        return bool(self.whole.measured[:, AOA].any())

    @cached_property
    def surest_first(self) -> list[AnchorScan]:
        """The loudest anchor first, or the nearest where amplitudes aren't measured; (M550)."""
        return sorted(self.each, key=_unsureness)

    def __iter__(self) -> Iterator[AnchorScan]:
        return iter(self.each)

    @overload
    def __getitem__(self, anchor: int) -> AnchorScan: ...
    @overload
    def __getitem__(self, anchor: slice) -> Sequence[AnchorScan]: ...
    def __getitem__(self, anchor: int | slice) -> AnchorScan | Sequence[AnchorScan]:
        return self.each[anchor]


def _unsureness(scan: AnchorScan) -> tuple[float, float]:
    """By what anchors are put in order: a line of sight is loudest, and first. NaN counts for nothing."""
    loudest, nearest = (
        np.fmax.reduce(scan.amplitude, initial=0.0),
        np.fmin.reduce(scan.value[:, 0], initial=np.inf),
    )
    return -float(loudest), float(nearest)


def whole_of(scans: Sequence[AnchorScan]) -> AnchorScan:
    """All measurements of several anchors, one anchor's after the other's."""
    if isinstance(scans, SplitScan):
        return scans.whole
    names = "value", "own_std", "amplitude", "label", "table"
    parts = {name: np.concatenate([getattr(scan, name) for scan in scans]) for name in names}
    return AnchorScan(UNKNOWN, NOWHERE, np.nan, np.nan, **parts)


def split_by_anchor(scan: Scan, model: FilterModel) -> SplitScan:
    """A scan, anchor by anchor, the silent ones too."""
    return anchor_scans(told_alone(scan, model.radio), model.places[: model.senders], model.radio.threshold)


def told_alone(scan: Scan, radio: RadioModel) -> Scan:
    """The scan without angles that an array without extent can't tell, unless they come with deviations."""
    blind_agent, blind = not radio.agent_aperture.any(), np.logical_not(radio.anchor_aperture.any(1))
    if not (blind_agent or blind.any()):
        return scan
    own = scan.aod_std_rad, scan.aoa_std_rad
    aod, aoa = (np.full(len(scan), True) if std is None else np.isnan(std) for std in own)
    whose = np.asarray(scan.anchor, np.intp)
    aod &= np.where(whose < 0, blind.all(), blind[np.minimum(whose, len(blind) - 1)])
    return replace(
        scan,
        aod_rad=np.where(aod, np.nan, scan.aod_rad),
        aoa_rad=np.where(aoa & blind_agent, np.nan, scan.aoa_rad),
    )


def anchor_scans(scan: Scan, anchors: Array, threshold: float = 0.0) -> SplitScan:
    """A scan, anchor by anchor.

    Parameters
    ----------
    anchors : (J, 6)
        As `FilterModel.places`.
    threshold : float
        Amplitude from which on the radio detects.
    """
    whose = np.asarray(scan.anchor, np.intp)
    order = whose.argsort(kind="stable")
    ends = whose[order].searchsorted(np.arange(len(anchors) + 1)).tolist()
    rows = slice(ends[0], ends[-1])  # others belong to no anchor of the scene
    value, own, amplitude, label = _columns(scan, order[rows])
    table = _table(value, own, amplitude, label, threshold)
    steep = _elevation(scan, order[rows])
    parts = (slice(begin - rows.start, end - rows.start) for begin, end in itertools.pairwise(ends))
    each = (
        AnchorScan(
            anchor,
            anchors[anchor, :2],
            facing,
            height,
            value[part],
            own[part],
            amplitude[part],
            label[part],
            table[part],
            None if steep is None else steep[part],
        )
        for anchor, (facing, height, part) in enumerate(zip(*anchors[:, 2:4].T.tolist(), parts, strict=True))
    )
    return SplitScan(
        tuple(each), AnchorScan(UNKNOWN, NOWHERE, np.nan, np.nan, value, own, amplitude, label, table, steep)
    )


def of_all_anchors(scan: Scan, threshold: float = 0.0) -> AnchorScan:
    """A whole scan, of which some rows or all don't say which anchor sent them: its `anchor` is -1 there."""
    value, own, amplitude, label = _columns(scan, np.arange(len(scan)))
    table = _table(value, own, amplitude, label, threshold)
    return AnchorScan(UNKNOWN, NOWHERE, np.nan, np.nan, value, own, amplitude, label, table)


def whole_scan(scan: Scan, model: FilterModel) -> AnchorScan:
    """A whole scan by `of_all_anchors` and the model's threshold, as a step's messages share it in `work`."""
    return of_all_anchors(told_alone(scan, model.radio), model.radio.threshold)


def _elevation(scan: Scan, rows: NDArray[np.intp]) -> Array | None:
    """Elevations and their deviations of some rows, (M, 4); None where none was measured."""
    if all(getattr(scan, name) is None for name in ELEVATIONS):
        return None
    columns = [getattr(scan, name) for name in (*ELEVATIONS, *(_std_of(name) for name in ELEVATIONS))]
    none = np.full(len(scan), np.nan)
    return np.array([none if column is None else column for column in columns]).T[rows]


def _std_of(name: str) -> str:
    """The column of an angle's deviations."""
    return name.replace("_rad", "_std_rad")


def _columns(scan: Scan, rows: NDArray[np.intp]) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    """Values (M, 3), deviations (M, 3), amplitudes (M,) and labels (M,) of some rows."""
    value = np.array([scan.distance_m, scan.aod_rad, scan.aoa_rad]).T[rows]
    own = np.full((len(rows), 3), np.nan)
    for column, std in enumerate((scan.distance_std_m, scan.aod_std_rad, scan.aoa_std_rad)):
        if std is not None:
            own[:, column] = std[rows]
    return value, own, scan.amplitude[rows], np.asarray(scan.anchor, np.intp)[rows]


def _table(
    value: Array, own_std: Array, amplitude: Array, label: NDArray[np.intp], threshold: float
) -> Array:
    table = np.empty((len(amplitude), SCAN_COLUMNS))
    missing, silent = np.isnan(value), np.isnan(amplitude)
    excess = amplitude * amplitude - threshold * threshold
    values, stds = table[:, :OWN_STD], table[:, OWN_STD:AMPLITUDE]
    values[:], table[:, AMPLITUDE], table[:, tables.LOUD] = value, amplitude, excess > LOUD
    stds[:] = np.where(np.isnan(own_std), 0.0, np.maximum(own_std, LEAST_STD))
    table[:, AS_CLUTTER], table[:, LABEL] = CLUTTER_PER_QUIET * (excess < QUIET), label
    if missing.any():
        values[missing], stds[missing] = 0.0, -1.0
    if silent.any():
        table[silent, AMPLITUDE:LABEL] = -1.0, 1.0, 1.0
    return table
