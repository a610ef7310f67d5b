"""What each key of a scene file means: for the reference in docs/ and for `gridslam scene new` and `show`."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, get_args

import annotated_types
import tomli_w
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from gridslam.world.scene import Scene

MEANINGS: dict[str, dict[str, str]] = tomllib.loads(
    Path(__file__).with_name("scene_keys.toml").read_text(encoding="utf-8")
)
"""By the type that has the key, and the key."""
UNITS = {
    "m": "m", "hz": "Hz", "db": "dB", "deg": "deg", "s": "s", "mps": "m/s", "mps2": "m/s^2", "ns": "ns",
    "ppb": "ppb", "wavelengths": "wavelengths",
}  # fmt: skip
"""By the last word of a key."""
TABLE, FAR = "a table", 1e6
"""What a key may hold that is a table; limits from which on are as good as none."""


@dataclass(frozen=True)
class Key:
    """A key of a scene file.

    Attributes
    ----------
    table : str
        Header of the TOML table that it stands in; empty at the top.
    name, unit, default, allowed, meaning : str
        Unit empty where there is none; default "required", "-" (none) or TOML text.
    """

    table: str
    name: str
    unit: str
    default: str
    allowed: str
    meaning: str


@cache
def keys() -> tuple[Key, ...]:
    """All keys of a scene file, table by table, in the order of the types.

    Raises
    ------
    KeyError
        A key whose meaning isn't given in `MEANINGS`.
    """
    return tuple(_keys(Scene, "", set()))


def _keys(kind: type[BaseModel], table: str, seen: set[type]) -> Iterator[Key]:
    later = []
    for name, field in kind.model_fields.items():
        inner, meaning = _models(field.annotation), MEANINGS[kind.__name__][name]
        if inner and inner[0] not in (seen | {kind}):
            seen.add(inner[0])
            several = str(field.annotation).startswith("tuple")
            header = f"{table}.{name}" if table else name
            later.append((inner[0], f"[{header}]" if several else header))
        allowed = TABLE if inner else _allowed(field)
        word = name.rpartition("_")[2]
        yield Key(table, name, UNITS.get(word, ""), _default(field, bool(inner)), allowed, meaning)
    for model, header in later:
        yield from _keys(model, header, seen)


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _default(field: FieldInfo, table: bool) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value == () or value == "":
        return "-"
    return "its own defaults" if table else _toml(value)


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return tomli_w.dumps({"x": value}).partition("=")[2].strip()


def _allowed(field: FieldInfo) -> str:
    """The kind of value and its range, in words."""
    annotation, limits = field.annotation, [*field.metadata]
    parts = [part for part in get_args(annotation) if part is not type(None)]
    if parts and type(None) in get_args(annotation):  # optional: what it may be else
        annotation = parts[0]
    text = str(annotation)
    limits += [item for part in _parts(annotation) for item in getattr(part, "metadata", ())]
    words = _words(annotation)
    if "Literal" in text:
        choices = ", ".join(f'"{word}"' for word in words)
        return f"any of {choices}" if text.startswith("tuple") else choices
    kinds = {"bool": "true, false", "int": "whole number", "str": "text"}
    kind = next((kind for name, kind in kinds.items() if re.search(rf"\b{name}\b", text)), "number")
    if text.startswith("dict"):
        kind = "a number for each name"
    elif text.startswith("tuple[tuple"):
        kind = "points [x, y]"
    elif text.startswith("tuple"):
        any_number = text.endswith("...]")
        bounded = any(isinstance(limit, annotated_types.MaxLen) for limit in limits)
        kind = (
            "two or three numbers" if any_number and bounded else "numbers" if any_number else "two numbers"
        )
    return ", ".join([kind, *_range(limits)])


def _parts(annotation: Any) -> list[Any]:
    own = [annotation] if hasattr(annotation, "metadata") or hasattr(annotation, "__metadata__") else []
    return own + [inner for part in get_args(annotation) for inner in _parts(part)]


def _words(annotation: Any) -> list[str]:
    found = []
    for part in get_args(annotation):
        found += [part] if isinstance(part, str) else _words(part)
    return found


def _range(limits: list[Any]) -> list[str]:
    marks = {annotated_types.Gt: ("gt", "above"), annotated_types.Ge: ("ge", "from"),
             annotated_types.Lt: ("lt", "below"), annotated_types.Le: ("le", "up to")}  # fmt: skip
    ranges = []
    for limit in limits:
        for kind, (name, word) in marks.items():
            if isinstance(limit, kind) and abs(getattr(limit, name)) < FAR:
                ranges.append(f"{word} {getattr(limit, name):g}")
    return list(dict.fromkeys(ranges))


def commented(scene: Scene, all_keys: bool = False) -> str:
    """A scene as TOML with what each key means, defaults included; reads back as an equal scene.

    Parameters
    ----------
    scene : Scene
    all_keys : bool
        Whether keys and tables that it hasn't are named as well, in comments.
    """
    return "\n".join(_table("", scene.model_dump(exclude_none=True), set(), all_keys)).lstrip() + "\n"


def _table(header: str, values: Mapping[str, Any], written: set[str], all_keys: bool) -> Iterator[str]:
    """Lines of a table; what a key means stands above its first appearance."""
    tables = {name: value for name, value in values.items() if _is_table(name, value)}
    own = {key.name: key for key in keys() if key.table == header}
    missing = [key for key in own.values() if key.allowed == TABLE and not values.get(key.name)]
    missing = missing if all_keys and header not in written else []
    plain = {name: value for name, value in values.items() if name not in tables}
    for name in (name for name in plain if name not in [key.name for key in missing]):
        key = own.get(name)
        if key is not None and f"{header}.{name}" not in written:
            written.add(f"{header}.{name}")
            yield f"# {key.meaning}{f' ({key.unit})' if key.unit else ''}"
        yield f"{name} = {_toml(values[name])}"
    if all_keys and header not in written:
        for key in own.values():
            if key.name not in values and key.allowed != TABLE:
                yield f"# {key.name}{f' ({key.unit})' if key.unit else ''}: {key.meaning}"
    written.add(header)
    for name, value in tables.items():
        inner = f"{header}.{name}" if header else name
        several = isinstance(value, tuple)
        for item in value if several else (value,):
            yield ""
            if name in own and f"{header}.{name}" not in written:
                written.add(f"{header}.{name}")
                yield f"# {own[name].meaning}"
            yield _headline(f"[{inner}]" if several else inner)
            yield from _table(f"[{inner}]" if several else inner, item, written, all_keys)
    for key in missing:
        yield from _named_alone(header, key)


def _headline(table: str) -> str:
    """What begins a table of this header in TOML: ``[[walls]]``, ``[walls.arc]``."""
    plain = table.replace("[", "").replace("]", "")
    return f"[[{plain}]]" if table.endswith("]") else f"[{plain}]"


def _named_alone(header: str, key: Key) -> Iterator[str]:
    """A table that a scene hasn't, and its keys, in comments."""
    inner = f"{header}.{key.name}" if header else key.name
    several = any(known.table == f"[{inner}]" for known in keys())
    yield ""
    yield f"# {_headline(f'[{inner}]' if several else inner)}: {key.meaning}"
    for own in keys():
        if own.table == (f"[{inner}]" if several else inner):
            must = ", required" if own.default == "required" else ""
            unit = f"{own.unit}{must}" if own.unit else must.removeprefix(", ")
            yield f"# {own.name}{f' ({unit})' if unit else ''}: {own.meaning}"


def _is_table(name: str, value: Any) -> bool:
    if isinstance(value, tuple):
        return bool(value) and isinstance(value[0], Mapping)
    return isinstance(value, Mapping)
