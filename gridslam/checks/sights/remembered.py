"""Answers that `check` needs again: rivals are compared with the same readings of a table, over and over."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
R = TypeVar("R")
LATEST = 64
"""Answers that are kept."""


def remembered(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function work out an answer once while it is among the latest.

    What it answers depends on its arguments alone: arrays, mappings of arrays, and values that never change,
    dataclasses among them; of other classes only the same object counts as the same.
    """
    known: OrderedDict[bytes, tuple[list[object], R]] = OrderedDict()

    @wraps(function)
    def answer(*args: P.args, **kwargs: P.kwargs) -> R:
        digest, objects = hashlib.blake2b(), list[object]()
        for part in _parts([*args, *sorted(kwargs.items())], objects):
            digest.update(part)
        key = digest.digest()
        if key not in known:
            # objects stay beside it, so that no other one gets their identity
            known[key] = objects, function(*args, **kwargs)
            if len(known) > LATEST:
                known.popitem(last=False)
        known.move_to_end(key)
        return known[key][1]

    return answer


def _parts(values: list[Any], objects: list[object]) -> Iterator[bytes]:
    """What tells arguments apart, as bytes; objects that are told by their identity are listed."""
    for value in values:
        if isinstance(value, np.ndarray):
            yield f"{value.dtype}{value.shape}".encode()
            yield np.ascontiguousarray(value).tobytes()
        elif isinstance(value, Mapping):
            yield from _parts([*sorted(value.items(), key=lambda item: str(item[0]))], objects)
        elif isinstance(value, tuple | list):
            yield from _parts([*value], objects)
        elif value is None or isinstance(value, str | bool | int | float) or is_dataclass(value):
            yield repr(value).encode()
        else:
            objects.append(value)
            yield str(id(value)).encode()
