"""Command line: options that belong together as the fields of a dataclass, and flags."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any, TypeGuard, get_type_hints

import typer
from typer.core import TyperCommand

from gridslam.errors import InputError


class Commands(typer.Typer):
    """Commands whose options are refused if they are given twice, unless they take several values."""

    def command(self, name: str | None = None, **more: Any) -> Callable[[Any], Any]:
        """A decorator that adds a command, as typer's does."""
        return super().command(name, cls=_OnceEach, **more)


class _OnceEach(TyperCommand):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As typer does it, which takes the last value of an option and says nothing of the others."""
        options = [option for option in self.make_parser(ctx).parse_args(list(args))[2] if _takes_one(option)]
        for option in options:
            if options.count(option) > 1 and not ctx.resilient_parsing:
                raise InputError(option.opts[-1], f"{options.count(option)} values", "one")
        return super().parse_args(ctx, args)


def _takes_one(option: Any) -> bool:
    return bool(option.param_type_name == "option" and not option.multiple and not option.is_flag)


def flag(name: str, meaning: str = "", **more: Any) -> Any:
    """An option that is given or not, shown without a value in the help."""
    return typer.Option(name, help=meaning or None, metavar="", **more)


def map_in(path: Path | None) -> Path | None:
    """A map's file, see `map_files.file_of`.

    Raises
    ------
    InputError
        Nothing stands there but the checkpoint of a run, whose map comes when it goes on to its end.
    """
    from gridslam.maps.map_files import file_of
    from gridslam.runs.parts import refuse_unfinished

    if path is not None:
        refuse_unfinished(path)
    return file_of(path) if path is not None else None


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
