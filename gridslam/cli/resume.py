"""Command line: `run --checkpoint` and `run --resume`, and which options they agree on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from gridslam.cli.agents import named_file
from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.runs.reservation import Place
    from gridslam.runs.unfinished import Unfinished
    from gridslam.world.scene import Scene

SETTLED = {
    "scene": "SCENE", "agent": "--agent", "method": "--method", "particles": "--particles", "seed": "--seed",
    "measurements": "--measurements", "signal": "--signal", "truth": "--truth", "map_file": "--map",
    "steps": "--steps", "same_frame": "--same-frame", "start": "--start", "device": "--device",
}  # fmt: skip
"""Options on which the result depends, by the names of their parameters: as they were, or left out."""
FREE = ("threads", "checkpoint", "overwrite")
"""Options that may be given anew."""
SOURCES = ("map_file",)

NAMED = ("measurements", "truth", "signal")
"""Those that may say whose a file is."""


def as_saved(context: typer.Context, folder: Path | None) -> Path | None:
    """Take all options that aren't given from the run that is gone on with.

    Raises
    ------
    InputError
        There is none, or it can't be read.
    """
    from gridslam.runs.unfinished import read_unfinished

    if folder is not None:
        settings = read_unfinished(folder).settings
        known = {name: settings.get(name) for name in (*SETTLED, *FREE)}
        known |= {name: [known[name]] for name in NAMED if isinstance(known[name], str)}  # saved as one
        context.default_map = {name: value for name, value in known.items() if value is not None}
    return folder


def refuse_contradictions(context: typer.Context, folder: Path) -> None:
    """Refuse options that were given together with --resume and aren't what the run was asked for.

    Raises
    ------
    InputError
        The first of them.
    """
    from gridslam.runs.unfinished import read_unfinished

    settings = read_unfinished(folder).settings
    given = {name: value for name, value in context.params.items() if _given(context, name)}
    output = given.get("output")
    if output is not None and output.resolve() != folder.resolve():
        raise InputError("-o", str(output), f"{folder}, as --resume says, or left out")
    for name, option in SETTLED.items():
        if name in given and _plain(name, given[name]) != settings.get(name):
            found, before = (_words(value) for value in (_plain(name, given[name]), settings.get(name)))
            raise InputError(option, f"{found} together with --resume", f"{before}, as before, or left out")


def unfinished(
    context: typer.Context, place: Place, scene: Scene, system: object, resolved: Mapping[str, Any]
) -> Unfinished | None:
    """The checkpoint that a run keeps, new or gone on with; None if it keeps none.

    Parameters
    ----------
    system : object
        What --method names.
    resolved : mapping
        What options came to that depend on others, in place of what was given.

    Raises
    ------
    InputError
        The method's state can't be saved, nothing can be written, or something isn't as it was.
    """
    options = context.params
    if options["resume"] is None and options["checkpoint"] is None:
        place.drop_checkpoint()
        return None
    from gridslam.runs.unfinished import Unfinished, require_savable

    require_savable(options["method"], system)
    if options["resume"] is not None:
        earlier = Unfinished.read(place.part)
        earlier.check(scene)
        earlier.settings |= {name: options[name] for name in FREE}
        return earlier
    settings = {name: _plain(name, options[name]) for name in (*SETTLED, *FREE)}
    sources = [options[name] for name in SOURCES if options[name] is not None]
    sources += [named_file(item)[1] for name in NAMED for item in options[name] or ()]
    return Unfinished.begin(place, settings | dict(resolved), scene, sources)


def _given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name not in ("DEFAULT", "DEFAULT_MAP")


def _words(value: Any) -> str:
    """An option as errors tell it."""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    if value is None or isinstance(value, bool):
        return "on" if value else "off" if value is False else "none"
    return str(value)


def _plain(name: str, value: Any) -> Any:
    """An option as it is saved: wherever a run is gone on with, paths are whole."""
    if name == "scene" and Path(value).suffix != ".toml" and Path(value).name == value:
        return value
    if name in NAMED and value is not None:
        tracks = ((agent, path.resolve()) for agent, path in map(named_file, value))
        return [str(path) if agent is None else f"{agent}={path}" for agent, path in tracks]
    return str(Path(value).resolve()) if name == "scene" or isinstance(value, Path) else value
