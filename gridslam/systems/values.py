"""Values in HDF5: frozen dataclasses of arrays, numbers, text, tuples and other such classes, by their types.

What a file holds never says what is made of it: the classes are those that the annotations name. A field that
may be None is absent then. Field metadata ``{"blank": True}`` lets an array hold NaN; all others are finite.
``{"later": True}`` marks a field that older files lack, which then is its default, or what a function in
place of True makes of the fields before it; ``FORMER_NAMES`` of a
class are those that it has in older files. Annotations name parts of generic classes: ``Population[State]``.
"""

from __future__ import annotations

import math
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, Union, get_args, get_origin, get_type_hints

import h5py
import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.io.files import get, put, subgroup
from gridslam.io.hdf5_limits import place_of

KIND = "class"
PLAIN = {bool: "b", int: "iu", float: "fiu", str: "USO"}
MOST_ABSENT = 1000
"""Items of a tuple of which some may be None: those aren't in a file."""


def put_value(group: h5py.Group, name: str, value: Any) -> None:
    """Write a value under a name: arrays as datasets, numbers and text as attributes, the rest as groups.

    Raises
    ------
    TypeError
        A value of another type.
    """
    if value is None:
        return
    if isinstance(value, np.ndarray):
        put(group, name, value, "1")
    elif isinstance(value, bool | int | float | str | np.generic):
        group.attrs[name] = value
    elif isinstance(value, tuple) and value and all(isinstance(item, float) for item in value):
        put(group, name, np.array(value), "1")
    elif isinstance(value, tuple):
        own = group.create_group(name)
        own.attrs["length"] = len(value)
        for number, item in enumerate(value):
            put_value(own, str(number), item)
    elif isinstance(value, Mapping):
        _put_mapping(group.create_group(name), value)
    elif is_dataclass(value):
        own = group.create_group(name)
        own.attrs[KIND] = type(value).__name__
        for field in fields(value):
            put_value(own, field.name, getattr(value, field.name))
    else:
        raise TypeError(f"{name}: a {type(value).__name__} has no form in a file")


def get_value(group: h5py.Group, name: str, hint: Any, blank: bool = False) -> Any:
    """Read a value of an annotated type.

    Parameters
    ----------
    hint : type
        As annotations have it: ``NDArray[np.float64]``, ``float | None``, ``tuple[Part, ...]``, a dataclass.
    blank : bool
        Whether arrays and numbers may be NaN.

    Raises
    ------
    InputError
        It is missing, of another type, not finite, or the class refuses it.
    """
    where = place_of(group, name)
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if types.NoneType in inner and name not in group and name not in group.attrs:
            return None
        options = [option for option in inner if option is not types.NoneType]
        return get_value(group, name, _chosen(group, name, options, where), blank)
    if origin is np.ndarray:
        return _array(group, name, _dtype(inner), blank)
    if origin is tuple:
        return _tuple(group, name, inner, blank)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _mapping(subgroup(group, name), inner, where)
    if is_dataclass(hint) and isinstance(hint, type):
        return _dataclass(subgroup(group, name), hint, where)
    if is_dataclass(origin) and isinstance(origin, type):
        own: Any = origin
        return _dataclass(
            subgroup(group, name), origin, where, dict(zip(own.__parameters__, inner, strict=True))
        )
    if hint in PLAIN:
        return _plain(group, name, hint, where, blank)
    raise TypeError(f"{where}: nothing is read as {hint}")


def arrays_of(value: Any, path: str = "") -> dict[str, NDArray[Any]]:
    """All arrays of a value, by their paths; those in mappings aside."""
    if isinstance(value, np.ndarray):
        return {path: value}
    parts: list[tuple[str, Any]] = []
    if is_dataclass(value):
        parts = [(field.name, getattr(value, field.name)) for field in fields(value)]
    elif isinstance(value, tuple):
        parts = [(str(number), item) for number, item in enumerate(value)]
    found: dict[str, NDArray[Any]] = {}
    for name, part in parts:
        found |= arrays_of(part, f"{path}/{name}" if path else name)
    return found


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _dataclass(
    group: h5py.Group, kind: type, where: str, parts: Mapping[Any, Any] = MappingProxyType({})
) -> Any:
    """A value of a class; `parts` says what its type variables stand for."""
    found = group.attrs.get(KIND)
    if found not in (kind.__name__, *getattr(kind, "FORMER_NAMES", ())):
        raise InputError(where, f"a {found}", f"a {kind.__name__}")
    hints, values = _hints(kind), dict[str, Any]()
    for field in fields(kind):
        later = field.metadata.get("later", False)
        if later and not (field.name in group.attrs or field.name in group):
            if callable(later):
                values[field.name] = later(values)
            continue
        hint = parts.get(hints[field.name], hints[field.name])
        open_ = getattr(hint, "__parameters__", ())
        hint = hint[tuple(parts[one] for one in open_)] if open_ else hint
        values[field.name] = get_value(group, field.name, hint, bool(field.metadata.get("blank", False)))
    try:
        return kind(**values)
    except InputError:
        raise
    except (ValueError, TypeError) as error:
        raise InputError(where, str(error), f"the parts of a {kind.__name__}") from None


def _chosen(group: h5py.Group, name: str, options: list[Any], where: str) -> Any:
    """Which of several types a value is of: of several classes, the one that it was written as."""
    if len(options) == 1:
        return options[0]
    item = group.get(name)
    found = item.attrs.get(KIND) if isinstance(item, h5py.Group) else None
    named = {getattr(option, "__name__", ""): option for option in options if is_dataclass(option)}
    if found not in named:
        raise InputError(where, f"a {found}", " or ".join(named) or "one type")
    return named[found]


def _dtype(inner: tuple[Any, ...]) -> np.dtype[Any] | None:
    """Type of the numbers of ``NDArray[number]``; None if any will do."""
    number = get_args(inner[1])[0] if len(inner) > 1 and get_args(inner[1]) else Any
    return np.dtype(number) if isinstance(number, type) and number is not np.generic else None


def _array(group: h5py.Group, name: str, dtype: np.dtype[Any] | None, blank: bool) -> NDArray[Any]:
    """A dataset in the type that is annotated; kinds of numbers aren't mixed."""
    item = group.get(name)
    shape = (None,) * len(item.shape or ()) if isinstance(item, h5py.Dataset) else ()
    kinds = {"i": "iu", "u": "iu", "b": "b", "c": "c"}.get(dtype.kind, "fiub") if dtype else "fiubc"
    value = np.ascontiguousarray(get(group, name, shape, kinds), dtype=dtype)
    if not shape:
        value = value.reshape(())
    if not blank and value.dtype.kind in "fc" and not np.isfinite(value).all():
        raise InputError(place_of(group, name), "NaN or infinity", "finite numbers")
    return value


def _plain(group: h5py.Group, name: str, kind: Any, where: str, blank: bool) -> Any:
    if name not in group.attrs:
        raise InputError(where, "none", f"a value of type {kind.__name__}")
    value = group.attrs[name]
    value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    if np.ndim(value) or np.asarray(value).dtype.kind not in PLAIN[kind]:
        raise InputError(where, str(value), f"a value of type {kind.__name__}")
    value = kind(value)
    if kind is float and not (math.isfinite(value) or blank):
        raise InputError(where, str(value), "a finite number")
    return value


def _tuple(group: h5py.Group, name: str, inner: tuple[Any, ...], blank: bool) -> tuple[Any, ...]:
    endless = len(inner) == 2 and inner[1] is Ellipsis
    if isinstance(group.get(name), h5py.Dataset) and set(inner) <= {float, Ellipsis}:
        values = _array(group, name, np.dtype(float), blank)
        if values.ndim != 1 or not (endless or len(values) == len(inner)):
            raise InputError(f"{group.file.filename}: {name}/length", str(values.shape), f"{len(inner)}")
        return tuple(values.tolist())
    own = subgroup(group, name)
    length = own.attrs.get("length")
    most = max(len(own) + len(own.attrs), MOST_ABSENT if types.NoneType in get_args(inner[0]) else 0)
    if not isinstance(length, np.integer) or not 0 <= length <= most or not (endless or length == len(inner)):
        allowed = f"{len(inner)}" if not endless else f"at most {most}"
        raise InputError(f"{own.file.filename}: {own.name}/length", str(length), allowed)
    hints = [inner[0]] * int(length) if endless else list(inner)
    return tuple(get_value(own, str(number), hint, blank) for number, hint in enumerate(hints))


def _put_mapping(group: h5py.Group, value: Mapping[Any, Any]) -> None:
    """Keys and values as columns; values are tuples, each part of one shape for all keys."""
    group.attrs["length"] = len(value)
    if value:
        put(group, "key", np.array(list(value)), "1")
        for number, column in enumerate(zip(*value.values(), strict=True)):
            put(group, str(number), np.array(column), "1")


def _mapping(group: h5py.Group, inner: tuple[Any, ...], where: str) -> dict[Any, Any]:
    """The other way round: keys are tuples of whole numbers, parts of values arrays or numbers."""
    length = group.attrs.get("length")
    if not isinstance(length, np.integer) or length < 0:
        raise InputError(f"{where}/length", str(length), "a number of keys")
    if length == 0:
        return {}
    keys = _array(group, "key", np.dtype(np.int64), blank=False)
    columns: list[Any] = []
    for number, hint in enumerate(get_args(inner[1])):
        dtype = _dtype(get_args(hint)) if get_origin(hint) is np.ndarray else np.dtype(hint)
        column = _array(group, str(number), dtype, blank=False)
        columns.append(column if get_origin(hint) is np.ndarray else column.tolist())
    if {len(keys), *map(len, columns)} != {int(length)}:
        found = ", ".join(str(len(column)) for column in (keys, *columns))
        raise InputError(where, f"columns of {found} rows", f"{length} rows")
    return dict(zip(map(tuple, keys.tolist()), zip(*columns, strict=True), strict=True))
