"""Command line: which agents a command is about, and files that say whose they are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.world.observation import Kind
    from gridslam.world.scene import Scene


def named_file(item: str) -> tuple[str | None, Path]:
    """Agent and file of ``NAME=FILE``, or of a file alone, which may have such a sign in its name."""
    name, sign, rest = item.partition("=")
    return (name, Path(rest)) if sign and not Path(item).exists() else (None, Path(item))


def require_kind(measurements: Path | None, signal: Path | None, takes: Kind, method: str) -> None:
    """Refuse a file of what was heard that isn't of the kind that the method takes.

    Raises
    ------
    InputError
        It is of the other kind, or there are two.
    """
    if measurements is not None and signal is not None:
        raise InputError("--signal", f"{signal} together with --measurements", "one of them")
    if signal is not None and takes == "paths":
        from gridslam.systems.registry import METHODS

        ours = [one for one in METHODS.values() if one.takes == "signal" and one.maps]
        able = ", ".join(one.name for one in ours if "-" not in one.name)
        way = f"--method {able}, or --measurements FILE: gridslam extract {signal} -o FILE.csv makes it"
        if signal.suffix.lower() == ".csv":  # no samples are kept so
            way = f"--measurements {signal}"
        raise InputError("--signal", f"{signal}, with method {method!r}, which takes path measurements", way)
    if measurements is not None and takes == "signal":
        found = f"{measurements}, with method {method!r}, which takes sampled signals"
        raise InputError("--measurements", found, "--signal FILE, or a method that takes path measurements")


def agents_of(world: Scene, chosen: list[str] | None, files: Mapping[str | None, Path]) -> list[str]:
    """Names of the agents to run, all of which can be.

    Parameters
    ----------
    files : mapping
        Of what agents heard, if it isn't simulated, by their names; None: of the one agent.
    """
    measurements, named = bool(files), [name for name in files if name is not None]
    if named and chosen and set(named) != set(chosen):
        raise InputError("--signal", f"of {', '.join(named)}", f"of {', '.join(chosen)}, as --agent says")
    names = chosen or named or [agent.name for agent in world.agents[: 1 if measurements else None]]
    if not names:
        raise InputError(f"{world.name}: agents", "none", "at least one")
    if measurements and not named and len(names) > 1:
        file = files[None]
        found = f"{', '.join(names)}, with one file whose rows don't say whose they are ({file})"
        allowed = "one agent, a table with a column agent, or --signal NAME=FILE of each"
        raise InputError("--agent", found, allowed)
    if len(set(names)) < len(names):
        raise InputError("--agent", ", ".join(names), "each agent once")
    for name in names:
        world.agent(name)
        if not measurements:
            world.track(name)
    return names


def simulation_note(world: Scene) -> str | None:
    """What to say before a simulation: in free space, as of recorded measurements, or of hidden anchors."""
    from gridslam.checks.scene.lines import hidden_note

    if world.walls:
        return hidden_note(world)
    return (
        f"{world.name} has no walls: simulated in free space (what was recorded there: --measurements FILE "
        "or --signal FILE)"
    )
