"""Numbers that stand for nothing in a table: -999, 9999, 0, in a column or over whole rows.

What is measured hardly ever repeats to the last digit. A filler does, far more often than any other number of
its column; and it is one of the usual ones, or lies far from all others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.world.columns import VALUES, Columns

USUAL = (-1.0, 0.0, -99.0, -999.0, -9999.0, 99.0, 999.0, 9999.0, 99999.0, -99999.0, 65535.0, -32768.0)
"""Fillers that are known as such."""
LEAST_ROWS, LEAST_SHARE = 3, 0.002
"""Rows, and share of a table's, that hold a filler at least."""
LARGEST = 1e12
"""Numbers beyond aren't looked at: `check` says anyway that nothing is measured so."""
OFTENER = 5.0
"""Times as often as the commonest other number of the column that a filler is there: numbers that are rounded
repeat, too, but all of them do."""
FAR = 20.0
"""Spreads of a column (its middle half) beyond which a number that repeats is none of it."""


def padding(columns: Columns, written: dict[str, str] | None = None) -> tuple[list[Suspicion], Columns]:
    """Fillers, each with the columns that hold it, and the table without them.

    Parameters
    ----------
    columns : dict of (K,) arrays
    written : dict of str, optional
        What columns are called in the file, where angles are degrees there.

    Returns
    -------
    found : list of Suspicion
    columns : dict of (K,) arrays
        Rows without a distance or any number are left out; of the others only the fillers are, as NaN.
    """
    written, table = written or {}, dict(columns)
    count, held = len(columns["step"]), dict[float, dict[str, NDArray[np.bool_]]]()
    for name in (name for name in VALUES if name in columns):
        values = np.degrees(columns[name]) if name in written else columns[name]
        for value in fillers(values, positive=name in ("distance_m", "amplitude")):
            held.setdefault(value, {})[name] = np.isclose(values, value, rtol=1e-9, atol=1e-12)
    found = []
    for value, rows in held.items():
        for name, own in rows.items():
            table[name] = np.where(own, np.nan, table[name])
        each = {int(own.sum()) for own in rows.values()}
        much = " and ".join(str(rows) for rows in sorted(each)) if len(each) < 3 else f"up to {max(each)}"
        names = ", ".join(written.get(name, name) for name in rows)
        text = f"padding: {value:g} stands for nothing there; leave such cells empty or such rows out"
        found.append(Suspicion(names, "padding", text, True, f"{much} of {count} rows"))
    if not found:
        return [], columns
    present = [name for name in VALUES if name in table]
    empty = np.all([np.isnan(table[name]) for name in present], axis=0)
    if "distance_m" in held_columns(held):
        empty |= np.isnan(table["distance_m"]) & ~np.isnan(columns["distance_m"])
    return found, {name: values[~empty] for name, values in table.items()}


def held_columns(held: dict[float, dict[str, NDArray[np.bool_]]]) -> set[str]:
    """Columns that hold any filler.

    Parameters
    ----------
    held : dict of dict of (K,) bool
        By filler and column, the rows that hold it.
    """
    return {name for rows in held.values() for name in rows}


def fillers(values: Array, positive: bool = False) -> list[float]:
    """Numbers of a column that stand for nothing, the commonest first.

    Parameters
    ----------
    values : (K,) array
    positive : bool
        Whether what is measured is above 0: then a usual filler below needn't be common.
    """
    known = values[np.abs(values) < LARGEST]
    if not len(known):
        return []
    number, often = np.unique(np.round(known, 9), return_counts=True)
    usual = np.isin(number, USUAL)
    low, middle, high = np.quantile(known, [0.25, 0.5, 0.75])
    strange = np.abs(number - middle) > FAR * max(high - low, 1e-9)
    common = often >= max(LEAST_ROWS, LEAST_SHARE * len(known))
    sure = common & positive & usual & (number <= 0)
    candidates = common & (usual | strange)
    others = often[~candidates].max(initial=1)
    # where nothing but a constant is left, the column is no measurement, but not padded either
    named = (sure | (candidates & (often >= OFTENER * others))) & (often < len(known))
    return [float(number[i]) for i in np.flatnonzero(named)[np.argsort(-often[named])]]
