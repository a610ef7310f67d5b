"""The array that most functions take and return, and copies of the values that hold arrays."""

import dataclasses
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Value = TypeVar("Value")


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
    """An array of float64; numpy would drop imaginary parts with a warning.

    Raises
    ------
    TypeError, ValueError
        Complex numbers, or none.
    """
    array = np.asarray(values)
    if array.dtype.kind == "c":
        raise TypeError("complex numbers")
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
