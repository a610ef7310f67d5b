"""Files of scenes: those that come with the package, and any other by its path."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any

from gridslam.errors import InputError
from gridslam.world.names import label_fault

BUNDLED = Path(__file__).parents[1] / "scenes"


def bundled_scenes() -> list[str]:
    """Names of the scenes that come with the package."""
    return sorted(path.stem for path in BUNDLED.glob("*.toml"))


def or_scene(name: str, others: str, before: str = "") -> str:
    """What is allowed: the bundled scene that a name with a slip is nearest to, if any, and `others`.

    Parameters
    ----------
    name, others : str
    before : str
        Stands before the others, if there is such a scene.
    """
    from difflib import get_close_matches

    close = get_close_matches(name.lower(), bundled_scenes(), n=1, cutoff=0.6)
    return f"{close[0]} (nearest known scene); {before}{others}" if close else others


def scene_text(name_or_path: str | os.PathLike[str]) -> tuple[str, str]:
    """Text of a bundled scene by name or of a file by path (with a folder or ``.toml`` in it), and its path.

    Raises
    ------
    InputError
        No such scene or file, or one that isn't text.
    """
    if not isinstance(name_or_path, str | os.PathLike):
        found = type(name_or_path).__name__
        raise InputError("scene", found, f"{', '.join(bundled_scenes())}, or the path of a .toml file")
    path = Path(name_or_path)
    if path.name == str(name_or_path) and path.suffix != ".toml":
        if path.name not in bundled_scenes():
            every = f"{', '.join(bundled_scenes())}, or the path of a .toml file"
            allowed = or_scene(path.name, every, "all: ")
            if Path(f"{path.name}.toml").is_file():
                allowed = f"{path.name}.toml, which is here, or a bundled scene"
            raise InputError("scene", repr(path.name), allowed)
        path = BUNDLED / f"{path.name}.toml"
    try:
        return path.read_text(encoding="utf-8"), str(path)
    except OSError as error:
        raise InputError(
            str(path), (error.strerror or str(error)).lower(), "a scene file that can be read"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} isn't UTF-8", "TOML text in UTF-8") from error


def scene_tables(text: str, where: str) -> dict[str, Any]:
    """Tables of a scene in TOML; one without a name is called by the stem of its path, `where`.

    Raises
    ------
    InputError
        A TOML error.
    """
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # no TOML, or a number of thousands of digits
        raise InputError(where, f"broken TOML ({error})", "TOML") from error
    stem = Path(where).stem
    return {"name": stem if label_fault(stem) is None else "scene", **data}
