"""Numbers as users hand them over: what only looks like what was asked for is refused, in one line."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, real
from gridslam.errors import InputError

MOST_RAD = 8 * np.pi
"""Largest heading that may be one in radians, of an agent that has turned and turned."""
SECONDS = "seconds, of dates: (t - t[0]) / np.timedelta64(1, 's')"
LARGEST = 2**53
"""Beyond, floats don't tell whole numbers apart."""


def numbers(given: object, where: str, allowed: str = "numbers") -> Array:
    """An array of float64 of its own; what is masked is NaN.

    Raises
    ------
    InputError
        Complex numbers, dates, text, truth values, or nothing of the kind.
    """
    try:
        return np.array(real(given))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(where, str(error), allowed) from None


def finite(given: object, where: str) -> Array:
    """An array of float64 of its own, none of them NaN or infinite.

    Raises
    ------
    InputError
        One is, or as `numbers`.
    """
    values = numbers(given, where)
    if not np.isfinite(values).all():
        raise InputError(where, str(values.tolist()), "finite numbers")
    return values


def time_of(given: object, where: str) -> float:
    """A time in s.

    Raises
    ------
    InputError
        None, or several.
    """
    time = numbers(given, f"{where}: time_s", SECONDS)
    if time.size != 1:
        raise InputError(f"{where}: time_s", f"shape {time.shape}", "one number")
    return float(time.item())


def unmasked(samples: object) -> NDArray[Any]:
    """Samples as an array, NaN where they are masked."""
    if isinstance(samples, list | tuple) and any(isinstance(row, np.ma.MaskedArray) for row in samples):
        samples = np.ma.stack(samples)
    if isinstance(samples, np.ma.MaskedArray) and np.ma.is_masked(samples):
        return np.where(samples.mask, np.nan, np.asarray(samples.data, np.complex128))
    return np.asarray(samples)


def whole_numbers(given: object, where: str, allowed: str) -> NDArray[np.intp]:
    """An array of integers of its own.

    Raises
    ------
    InputError
        Numbers that aren't whole, or none.
    """
    values = numbers(given, where, allowed)
    wrong = values[~((np.rint(values) == values) & (np.abs(values) < LARGEST))]  # of NaN nothing is true
    if wrong.size:
        raise InputError(where, str(wrong.flat[0]), allowed)
    return values.astype(np.intp)


def require_radians(heading_rad: Array | float, where: str) -> None:
    """Refuse headings that must be degrees; some that are added up over many turns begin within four.

    Raises
    ------
    InputError
        One beyond four turns that the one before it doesn't lead to.
    """
    heading = np.atleast_1d(heading_rad)
    beyond = np.abs(heading) > MOST_RAD
    leap = np.abs(np.diff(heading, prepend=0.0)) >= np.pi
    if (beyond & leap).any():
        most = float(np.abs(heading).max())
        raise InputError(f"{where}: heading_rad", f"{most:g}", "radians, four turns at most")
