"""Strict data models whose faults read as one line: file, field, found, allowed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher
from typing import Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from gridslam.errors import Faults, InputError

MOST_FAULTS = 10
"""Lines about one scene at most."""
ALIKE, LEAST_BEGINNING = 0.6, 3
"""Likeness from which on a name may be meant; letters of one from which on a name that begins so is."""


def fault(field: str, found: str, allowed: str) -> PydanticCustomError:
    """Exception for a validator to raise: a field below the model, what stands there, what could."""
    # braces in the text would be read as a template, so everything travels in the context
    return PydanticCustomError("fault", "fault", {"field": field, "found": found, "allowed": allowed})


def nearest(word: str, known: Iterable[str]) -> str:
    """Say which known word was probably meant, or list them all."""
    known, plain = tuple(known), plain_name(word)
    begun = [name for name in known if len(plain) >= LEAST_BEGINNING and plain_name(name).startswith(plain)]
    alike = [(SequenceMatcher(None, plain_name(name), plain).ratio(), name) for name in begun or known]
    likeness, name = max(alike, key=lambda one: one[0], default=(0.0, ""))
    close = likeness >= ALIKE or begun
    return f"{name} (nearest known)" if close else ", ".join(known) or "none here"


def plain_name(name: str) -> str:
    """A name in small letters, whatever sets its parts apart an underscore: ``aoa_rad`` of ``AoA [rad]``."""
    return re.sub(r"[\W_]+", "_", name.casefold()).strip("_")


class Strict(BaseModel):
    """Frozen model: no unknown keys, no silent conversions, no NaN or infinity.

    What checks a model is built when one is first checked: parts of a scene are checked by the scene's.
    """

    model_config = ConfigDict(
        strict=True, extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True, defer_build=True
    )

    table: ClassVar[str] = ""
    """Under which heading a scene file has such a model, where a key may be looked for."""

    def __init_subclass__(cls, table: str = "", **settings: Any) -> None:
        super().__init_subclass__(**settings)
        cls.table = table

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse to change a value."""
        if name.startswith("_"):
            super().__setattr__(name, value)
            return
        allowed = "a new one: scene.with_filter(...), or gs.Scene.checked of changed scene.model_dump()"
        raise InputError(f"{type(self).__name__}.{name}", "a change of what is given", allowed)

    @model_validator(mode="before")
    @classmethod
    def _know_every_key(cls, data: Any) -> Any:
        for key in data if isinstance(data, Mapping) else ():
            if key not in cls.model_fields:
                raise fault(
                    str(key), "an unknown key", _elsewhere(key) or nearest(str(key), cls.model_fields)
                )
        return data

    @classmethod
    def checked(cls, data: Mapping[str, Any], where: str) -> Self:
        """Build the model from plain data; lists stand for tuples.

        Raises
        ------
        InputError
            The fault, with `where` and the path to the field; of several, `Faults`.
        """
        try:
            return cls.model_validate({key: _tuples(value) for key, value in data.items()})
        except ValidationError as error:
            faults = [_input_error(one, where, data) for one in _apart(error.errors())]
            if len(faults) == 1:
                raise faults[0] from None
            if len(faults) > MOST_FAULTS:
                rest = f"{len(faults) - MOST_FAULTS + 1} more faults"
                faults = [*faults[: MOST_FAULTS - 1], InputError(where, rest, "none")]
            raise Faults(faults) from None


def _elsewhere(key: object) -> str:
    """Under which headings of a scene file a key is known; what is appended to a file is of its last one."""
    found = [one.table for one in Strict.__subclasses__() if one.table and key in one.model_fields]
    return f"it under {' or '.join(found)}, which has this key" if found else ""


def _apart(errors: list[ErrorDetails]) -> list[ErrorDetails]:
    """Faults without those that say again what is wrong: of another type, or of the list that holds it."""
    kept: list[ErrorDetails] = []
    for error in errors:
        depth = len(error["loc"])
        if any(len(one["loc"]) > depth and one["loc"][:depth] == error["loc"] for one in errors):
            continue
        same = (one for one in kept if one["loc"][:-1] == error["loc"][:-1])
        if not any(one["input"] is error["input"] and one["type"] != "missing" for one in same):
            kept.append(error)
    return kept


def _tuples(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return tuple(_tuples(item) for item in value)
    if isinstance(value, Mapping):
        return {key: _tuples(item) for key, item in value.items()}
    return value


def _input_error(error: ErrorDetails, where: str, data: Mapping[str, Any]) -> InputError:
    field, context = _field(error["loc"]), error.get("ctx", {})
    if error["type"] == "fault":
        field = f"{field}.{context['field']}" if field and context["field"] else field or context["field"]
        found, allowed = context["found"], context["allowed"]
    elif error["type"] == "missing":
        found, allowed = "nothing", "a value, this key has no default"
    else:
        plain = {"model_type": "a table", "dict_type": "a table", "tuple_type": "a list"}
        plain["too_long"] = f"at most {context.get('max_length')} items"
        plain["too_short"] = f"at least {context.get('min_length')} items"
        message = error["msg"].removeprefix("Input should be ")
        found, allowed = _short(error["input"]), plain.get(error["type"], message)
    field += _whose(field, data)
    return InputError(f"{where}: {field}" if field else where, found, allowed)


def _whose(field: str, data: Mapping[str, Any]) -> str:
    """The name of the wall that a field belongs to, where it has one: nobody counts walls."""
    item = re.match(r"walls\[(\d+)\]", field)
    if item is None:
        return ""
    rows, number = data.get("walls"), int(item[1])
    row = rows[number] if isinstance(rows, list | tuple) and number < len(rows) else None
    name = row.get("name") if isinstance(row, Mapping) else None
    return f" (of {_short(name)})" if isinstance(name, str) and name else ""


def _field(location: tuple[int | str, ...]) -> str:
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).removeprefix(".")


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
