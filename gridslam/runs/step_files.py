"""All estimates of a run over time, in one HDF5 file."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import h5py
import numpy as np

from gridslam.errors import InputError
from gridslam.estimate_tables import HypothesisEstimate, PathEstimate, RingEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.io.datasets import Group
from gridslam.io.files import reading_h5, writing_h5
from gridslam.maps.map_files import surfaces_of
from gridslam.runs.step_datasets import ALL_STEPS, HYPOTHESES, PAIRS, PATHS, RINGS, STEPS, SURFACES

Pair = tuple[float, float]
Rows = TypeVar("Rows", PathEstimate, HypothesisEstimate, RingEstimate)


def write_steps(path: str | os.PathLike[str], estimates: Sequence[Estimate]) -> None:
    """Write all estimates over time as HDF5: the datasets of `gridslam.runs.step_datasets`.

    How long a step took is left out, so that a run repeated gives the same file.

    Raises
    ------
    InputError
        The file can't be written.
    """
    with writing_h5(path, ALL_STEPS.kind) as file:
        columns = {one.name: [getattr(e, one.name) for e in estimates] for one in STEPS.datasets}
        STEPS.put(file, {one.name: one.rows(columns[one.name]) for one in STEPS.datasets})
        found = [np.zeros(0, bool), *(np.asarray(e.detected, bool) for e in estimates)]
        surfaces = [e.surfaces for e in estimates]
        whole = vars(SurfaceEstimate.stack(surfaces)) | {"detected": np.concatenate(found)}
        SURFACES.put(file, _offset(surfaces) | whole)
        _put_rows(file, PATHS, PathEstimate, [e.paths for e in estimates])
        _put_rows(file, HYPOTHESES, HypothesisEstimate, [e.hypotheses for e in estimates])
        if any(len(e.rings) for e in estimates):
            _put_rows(file, RINGS, RingEstimate, [e.rings for e in estimates])
        for group in PAIRS:
            _put_pairs(file, group, [getattr(e, group.name) for e in estimates])


def read_steps(path: str | os.PathLike[str]) -> list[Estimate]:
    """Read estimates written by `write_steps`.

    Raises
    ------
    InputError
        No such file, another format or version, contradicting datasets, or damaged.
    """
    with reading_h5(path, ALL_STEPS.kind, ALL_STEPS.versions) as file:
        sizes: dict[str, int] = {}
        rows = STEPS.get(file, sizes)
        count = sizes["N"]
        walls = SURFACES.get(file, sizes)
        at = _checked_offset(file, SURFACES, walls, sizes["S"])
        routes = _get_rows(file, PATHS, PathEstimate, sizes)
        rivals = _get_rows(file, HYPOTHESES, HypothesisEstimate, sizes)
        unknown = _get_rows(file, RINGS, RingEstimate, sizes)
        tall, reflected = (_get_pairs(file, group, sizes) for group in PAIRS)
    surfaces, detected = surfaces_of(walls), walls["detected"]
    return [
        Estimate(
            int(rows["step"][n]),
            float(rows["time_s"][n]),
            rows["position_m"][n],
            rows["velocity_mps"][n],
            float(rows["heading_rad"][n]),
            rows["covariance"][n],
            surfaces.take(slice(at[n], at[n + 1])),
            routes[n],
            detected[at[n] : at[n + 1]],
            float(rows["effective_sample_size"][n]),
            math.nan,
            hypotheses=rivals[n],
            heights=tall[n],
            coefficients=reflected[n],
            rings=unknown[n],
        )
        for n in range(count)
    ]


def storable(estimate: Estimate, where: str) -> Estimate:
    """An estimate that can be written and read again; a method of one's own may hold what can't be.

    Raises
    ------
    InputError
        Numbers out of their range, as probabilities above 1, or NaN where it says nothing; `where` is what it
        calls the estimate.
    """
    tables = ((SURFACES, "surfaces"), (PATHS, "paths"), (HYPOTHESES, "hypotheses"), (RINGS, "rings"))
    for one in STEPS.datasets:
        one.hold(np.asarray(getattr(estimate, one.name)), f"{where}: {one.name}")
    for group, name in tables:
        table = getattr(estimate, name)
        for one in group.datasets:
            if one.name in table.columns():
                one.hold(np.asarray(getattr(table, one.name)), f"{where}: {name}.{one.name}")
    return estimate


def _offset(tables: Sequence[Any]) -> dict[str, Any]:
    """Where the rows of each step begin."""
    return {"offset": np.cumsum([0, *map(len, tables)])}


def _put_rows(file: h5py.File, group: Group, kind: type[Rows], tables: list[Rows]) -> None:
    """Tables of all steps below one another, and where each begins."""
    group.put(file, _offset(tables) | vars(kind.stack(tables)))


def _get_rows(file: h5py.File, group: Group, kind: type[Rows], sizes: dict[str, int]) -> list[Rows]:
    """The tables of every step; empty ones where a file holds none."""
    found = group.get(file, sizes)
    if found["offset"] is None:
        return [kind.empty()] * sizes["N"]
    whole = kind(**{name: found[name] for name in kind.columns()})
    offset = _checked_offset(file, group, found, len(whole))
    return [whole.take(slice(offset[n], offset[n + 1])) for n in range(sizes["N"])]


def _checked_offset(file: h5py.File, group: Group, found: dict[str, Any], rows: int) -> np.ndarray:
    """Where rows of steps begin: from 0 on, never falling, up to their number."""
    offset = np.asarray(found["offset"])
    if offset[0] != 0 or (np.diff(offset) < 0).any() or offset[-1] != rows:
        allowed = f"offsets from 0 that never fall, up to the {rows} rows"
        raise InputError(f"{file.filename}: /{group.name}/offset", "other offsets", allowed)
    return offset


def _put_pairs(file: h5py.File, group: Group, steps: Sequence[Mapping[str, Pair]]) -> None:
    """Heights or coefficients and their deviations, of those that are known of at every step."""
    names = [one.name for one in group.datasets if all(one.name in step for step in steps)]
    if any(steps):
        group.put(file, {name: np.array([step[name] for step in steps]) for name in names})


def _get_pairs(file: h5py.File, group: Group, sizes: dict[str, int]) -> list[dict[str, Pair]]:
    """Heights or coefficients of every step and their deviations; none where a file holds none."""
    rows = {name: pairs.tolist() for name, pairs in group.get(file, sizes).items() if pairs is not None}
    return [{name: (row[n][0], row[n][1]) for name, row in rows.items()} for n in range(sizes["N"])]
