"""Arrays with one row of paths per step, ragged or padded with NaN, as one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import real
from gridslam.errors import InputError
from gridslam.world.columns import VALUES
from gridslam.world.given import SECONDS, numbers

Quantity = Mapping[str, Sequence[ArrayLike]]
"""Name of an anchor to N sequences, or an (N, M) array."""


def table(quantities: Mapping[str, Quantity], time_s: ArrayLike | None, interval_s: float) -> dict[str, Any]:
    """Collect the columns of a measurement table; a path all of whose values are NaN is padding.

    Parameters
    ----------
    quantities : dict of column name to `Quantity`
        With ``distance_m``, whose anchors and numbers of paths all others share.
    time_s : (N,) s or None
        Times of the steps; otherwise every `interval_s` from 0.
    interval_s : float

    Returns
    -------
    dict
        ``anchors``, ``steps`` and the columns: arguments of `gridslam.measurements.table.Measurements`.

    Raises
    ------
    InputError
        Quantities whose shapes differ, or values that are no numbers.
    """
    for name, quantity in quantities.items():
        if not isinstance(quantity, Mapping):
            found = type(quantity).__name__
            raise InputError(
                f"measurements: {name}", found, 'rows of paths by anchor: {"A": [[2.0, 5.5], []]}'
            )
    first = quantities["distance_m"]
    anchors, steps = tuple(first), max((len(rows) for rows in first.values()), default=0)
    times = (
        np.arange(steps) * interval_s if time_s is None else numbers(time_s, "measurements: time_s", SECONDS)
    )
    if times.shape != (steps,):
        raise InputError("measurements: time_s", f"shape {times.shape}", f"shape ({steps},)")
    counts = _counts(quantities, anchors, steps)
    flat = {name: _flat(name, quantity, anchors) for name, quantity in quantities.items()}
    flat |= {name: np.full(counts.sum(), np.nan) for name in VALUES if name not in flat}
    step = np.concatenate([np.repeat(np.arange(steps), row) for row in counts])
    anchor = np.repeat(np.arange(len(anchors)), counts.sum(axis=1))
    filled = ~np.all([np.isnan(flat[name]) for name in VALUES], axis=0)
    order = np.flatnonzero(filled)[np.argsort(step[filled], kind="stable")]
    columns = {"step": step, "time_s": times[step], "anchor": anchor, **flat}
    taken = {name: values[order] for name, values in columns.items()}
    return {"anchors": anchors, "steps": steps, **taken}


def _counts(tables: Mapping[str, Quantity], anchors: tuple[str, ...], steps: int) -> NDArray[np.intp]:
    """Paths per anchor and step, (J, N), the same in every quantity."""
    found = None
    for name, quantity in tables.items():
        if set(quantity) != set(anchors):
            raise InputError(
                f"measurements: {name}", f"anchors {sorted(quantity)}", f"anchors {sorted(anchors)}"
            )
        counts = np.zeros((len(anchors), steps), dtype=np.intp)
        for index, anchor in enumerate(anchors):
            if len(quantity[anchor]) != steps:
                found_steps = f"{len(quantity[anchor])} steps"
                raise InputError(f"measurements: {name}[{anchor!r}]", found_steps, f"{steps} steps")
            counts[index] = [np.size(row) for row in quantity[anchor]]
        found = counts if found is None else found
        if (counts != found).any():
            index, step = np.argwhere(counts != found)[0]
            where = f"measurements: {name}[{anchors[index]!r}][{step}]"
            raise InputError(where, f"{counts[index, step]} paths", f"{found[index, step]}, as in distance_m")
    return np.zeros((len(anchors), steps), dtype=np.intp) if found is None else found


def _flat(name: str, quantity: Quantity, anchors: tuple[str, ...]) -> NDArray[np.float64]:
    try:
        rows = [np.ravel(real(row)) for anchor in anchors for row in quantity[anchor]]
    except (TypeError, ValueError) as error:
        raise InputError(f"measurements: {name}", str(error), "numbers, one per path") from error
    return np.concatenate([np.zeros(0), *rows])
