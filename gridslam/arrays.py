"""The array that most functions take and return, and copies of the values that hold arrays."""

import dataclasses
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Value = TypeVar("Value")
LATER = {"later": True}
"""Metadata of a field that files of earlier versions lack: it is its default then."""
NO_NUMBERS = {"c": "complex numbers", "b": "true or false", "SU": "text", "M": "dates (datetime64)",
              "m": "spans of time (timedelta64)"}  # fmt: skip
"""What arrays of some NumPy kinds hold, which could be taken for real numbers."""


def replace(value: Value, /, **changes: Any) -> Value:
    """As `dataclasses.replace`, of frozen dataclasses of plain fields: a step makes some forty such copies.

    The standard one calls ``__init__``, which sets field by field past the class's own guard: it takes five
    times as long. What was cached of the value isn't copied.

    Raises
    ------
    TypeError
        No such field.
    """
    kind: Any = type(value)
    names = _fields(kind)
    own = value.__dict__ | changes
    if len(own) != len(names):  # something is cached, or no field
        for name in [name for name in own if name not in names]:
            del own[name]
        if not changes.keys() <= own.keys():
            raise TypeError(f"{kind.__name__} has no field {', '.join(changes.keys() - own.keys())}")
    fresh: Value = object.__new__(kind)
    object.__setattr__(fresh, "__dict__", own)
    return fresh


def real(values: object) -> Array:
    """An array of float64; what is masked is NaN.

    NumPy would drop masks and imaginary parts, and count dates in whatever unit they have.

    Raises
    ------
    TypeError, ValueError
        Complex numbers, dates, text, truth values, or nothing of the kind.
    """
    if isinstance(values, list | tuple) and any(isinstance(row, np.ma.MaskedArray) for row in values):
        values = np.ma.stack(values)
    if isinstance(values, np.ma.MaskedArray):
        return (
            real(values.data)
            if values.mask is np.ma.nomask
            else np.where(values.mask, np.nan, real(values.data))
        )
    array = np.asarray(values)
    found = (
        {np.asarray(one).dtype.kind for one in array.flat} if array.dtype.kind == "O" else {array.dtype.kind}
    )
    for kinds, called in NO_NUMBERS.items():
        if array.size and not found.isdisjoint(kinds):
            raise TypeError(called)
    return array.astype(np.float64, copy=False)


def put(array: NDArray[Any], rows: int | NDArray[np.intp], value: NDArray[Any] | float) -> NDArray[Any]:
    """A copy with other values in some rows."""
    fresh = array.copy()
    fresh[rows] = value
    return fresh


def squared(numbers: NDArray[np.complex128]) -> Array:
    """Squares of the magnitudes of complex numbers."""
    return np.asarray(numbers.real**2 + numbers.imag**2)


@cache
def _fields(kind: type) -> tuple[str, ...]:
    """Names of a dataclass's fields, if nothing else has to be done to make one."""
    if hasattr(kind, "__post_init__") or not all(field.init for field in dataclasses.fields(kind)):
        raise TypeError(f"{kind.__name__} is more than its fields: use dataclasses.replace")
    return tuple(field.name for field in dataclasses.fields(kind))
