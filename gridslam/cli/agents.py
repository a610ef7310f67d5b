"""Command line: which agents a command is about, and files that say whose they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gridslam.errors import InputError
from gridslam.wording import counted

if TYPE_CHECKING:
    from gridslam.world.observation import Kind
    from gridslam.world.scene import Scene


def named_file(item: str) -> tuple[str | None, Path]:
    """Agent and file of ``NAME=FILE``, or of a file alone, which may have such a sign in its name."""
    name, sign, rest = item.partition("=")
    return (name, Path(rest)) if sign and not Path(item).exists() else (None, Path(item))


def files_by_agent(option: str, items: Sequence[str], agents: Sequence[str]) -> dict[str | None, Path]:
    """Files of what agents heard: NAME=FILE of each, or one for each agent in their order; None: of the one.

    Parameters
    ----------
    items : sequence of str
        Values of `option`.
    agents : sequence of str
        Those that were named by --agent.

    Raises
    ------
    InputError
        Several that don't say whose they are, and aren't as many as agents; two of one agent, or one of
        another than was named.
    """
    given = [named_file(item) for item in items]
    each = "NAME=FILE of each, or one file for each --agent, in their order"
    if len(given) > 1 and all(name is None for name, _ in given):
        if len(given) != len(agents):
            raise InputError(option, f"{len(given)} files for {counted(len(agents), '--agent')}", each)
        given = [(name, path) for name, (_, path) in zip(agents, given, strict=True)]
    found = dict[str | None, Path]()
    for name, path in given:
        if name is None and len(given) > 1:
            raise InputError(option, f"{path} beside files of named agents", each)
        if name in found:
            raise InputError(option, f"{name}={path}", f"one file of agent {name}")
        found[name] = path
    named = [name for name in found if name is not None]
    if named and agents and set(named) != set(agents):
        raise InputError(option, f"of {', '.join(named)}", f"of {', '.join(agents)}, as --agent says")
    return found


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
    names = chosen or named or [agent.name for agent in world.agents[: 1 if measurements else None]]
    if not names:
        raise InputError(f"{world.name}: agents", "none", "at least one")
    if measurements and not named and len(names) > 1:
        file = files[None]
        found = f"{', '.join(names)}, with one file whose rows don't say whose they are ({file})"
        allowed = "one agent, a table with a column agent, or a file for each (NAME=FILE, or in order)"
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
