"""Blocks of arguments as Taichi takes them: packs, whose arrays it hands over behind the others."""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, get_type_hints

import taichi as ti


@cache
def pack(block: type) -> Any:
    """Annotation of a kernel's argument that is a block: a class of `kernels.primitives.blocks`."""
    hints = get_type_hints(block, include_extras=True)
    kinds = {name: hint.__metadata__ for name, hint in hints.items()}
    return ti.types.argpack(
        **{name: ti.types.ndarray(dtype=getattr(ti, kind), ndim=axes) for name, (kind, axes) in kinds.items()}
    )


def members_of(annotation: Any) -> dict[str, Any]:
    """Names and annotations of a pack's arrays; none of anything else."""
    return dict(annotation.members) if hasattr(annotation, "members") else {}


def flat_names(arguments: Iterable[Any]) -> list[str]:
    """Names of all numbers and arrays of a kernel, in the order of launches: members of packs come last.

    Raises
    ------
    TypeError
        A name occurs twice: Taichi would take one array for the other.
    """
    arguments = list(arguments)
    names = [argument.name for argument in arguments if not members_of(argument.annotation)]
    names += [name for argument in arguments for name in members_of(argument.annotation)]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise TypeError(f"blocks of one kernel share names: {', '.join(sorted(twice))}")
    return names


def grouped(arguments: Iterable[Any], flat: Mapping[str, Any]) -> list[Any]:
    """Arguments of a kernel whose packs are tuples, from numbers and arrays by name."""
    return [
        tuple(flat[name] for name in members)
        if (members := members_of(argument.annotation))
        else flat[argument.name]
        for argument in arguments
    ]


def as_packs(arguments: Sequence[Any], values: Sequence[Any]) -> list[Any]:
    """Arguments as Taichi's own launches take them: packs made of tuples. They take some 0.2 ms each."""
    return [
        argument.annotation(**dict(zip(members, value, strict=True)))
        if (members := members_of(argument.annotation))
        else value
        for argument, value in zip(arguments, values, strict=True)
    ]
