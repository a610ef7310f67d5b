"""Command line: options that belong together as the fields of a dataclass, and flags."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any, TypeGuard, get_type_hints

import typer


def flag(name: str, meaning: str = "", **more: Any) -> Any:
    """An option that is given or not, shown without a value in the help."""
    return typer.Option(name, help=meaning or None, metavar="", **more)


def map_in(path: Path | None) -> Path | None:
    """A map's file; a run's folder stands for the map in it."""
    inside = path / "map.h5" if path is not None else None
    return inside if inside is not None and inside.is_file() else path


def unpacked(command: Callable[..., None]) -> Callable[..., None]:
    """The command as typer takes it: a parameter that is a dataclass becomes one for each of its fields.

    Parameters
    ----------
    command : callable
        Fields have annotations and defaults as parameters of a command would.
    """
    parameters = inspect.signature(command, eval_str=True).parameters.values()
    groups = {p.name: p.annotation for p in parameters if _is_group(p.annotation)}
    flat = list[Parameter]()
    for parameter in parameters:
        group = groups.get(parameter.name)
        flat += [parameter.replace(kind=Parameter.KEYWORD_ONLY)] if group is None else _parameters(group)

    def run(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{f.name: given.pop(f.name) for f in fields(group)})
        command(**given)

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in flat}
    vars(run)["__signature__"] = Signature(flat)
    return run


def _is_group(annotation: Any) -> TypeGuard[type[Any]]:
    return isinstance(annotation, type) and is_dataclass(annotation)


def _parameters(group: type[Any]) -> list[Parameter]:
    """Fields of a dataclass as parameters."""
    kinds = get_type_hints(group, include_extras=True)
    return [
        Parameter(
            f.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if f.default is MISSING else f.default,
            annotation=kinds[f.name],
        )
        for f in fields(group)
    ]
