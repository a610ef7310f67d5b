"""Command line: which agents a command is about, and files that say whose they are."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gridslam.errors import InputError

if TYPE_CHECKING:
    from gridslam.world.scene import Scene


def named_file(item: str) -> tuple[str | None, Path]:
    """Agent and file of ``NAME=FILE``, or of a file alone, which may have such a sign in its name."""
    name, sign, rest = item.partition("=")
    return (name, Path(rest)) if sign and not Path(item).exists() else (None, Path(item))


def agents_of(world: Scene, chosen: list[str] | None, measurements: Path | None) -> list[str]:
    """Names of the agents to run, all of which can be."""
    names = chosen or [agent.name for agent in world.agents[: 1 if measurements else None]]
    if not names:
        raise InputError(f"{world.name}: agents", "none", "at least one")
    if measurements and len(names) > 1:
        raise InputError("--agent", ", ".join(names), "one agent with --measurements")
    if len(set(names)) < len(names):
        raise InputError("--agent", ", ".join(names), "each agent once")
    for name in names:
        world.agent(name)
        if measurements is None and not world.walls:
            raise InputError(
                f"{world.name}: walls",
                "none",
                "walls to simulate from, or --measurements FILE (--signal FILE)",
            )
        if measurements is None:
            world.track(name)
    return names
