"""Command line: what `run` was asked for, in one piece."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from gridslam.errors import InputError

if TYPE_CHECKING:
    import typer

    from gridslam.world.scene import Scene


@dataclass(frozen=True)
class Asked:
    """Options of `run`, by the names of its parameters, and the scene as they leave it."""

    context: typer.Context
    world: Scene
    method: str
    agent: list[str] | None
    seed: int
    measurements: Path | None
    signal: Path | None
    truth: list[str] | None
    map_file: Path | None
    same_frame: bool
    start: str | None
    device: str
    threads: int | None
    output: Path | None
    overwrite: bool
    rerun: bool
    rerun_to: str | None
    resume: Path | None

    @classmethod
    def of(cls, context: typer.Context, world: Scene) -> Self:
        """All options of a command as they were given, or as a run had them that is gone on with."""
        given: dict[str, Any] = {
            f.name: context.params[f.name] for f in fields(cls) if f.name in context.params
        }
        if given["resume"] is not None:
            given["output"] = given["resume"]
        return cls(context=context, world=world, **given)

    @property
    def shown(self) -> bool:
        """Whether the run is shown in a viewer."""
        return self.rerun or self.rerun_to is not None

    def told_start(self, file: Path | None) -> str:
        """What agents are told of their start: of what was recorded, the scene's own is all that is known.

        Raises
        ------
        InputError
            Another word, or one that what was recorded doesn't allow.
        """
        from gridslam.world.start import HOWS

        if self.start is not None and self.start not in HOWS:
            raise InputError("--start", repr(self.start), " or ".join(HOWS))
        if file is not None and self.start == "drawn":
            raise InputError("--start", "drawn with --measurements", "exact: the scene's own start")
        return self.start or ("drawn" if file is None else "exact")

    def tracks(self, agents: Sequence[str]) -> dict[str, Path]:
        """Files of true tracks by agent.

        Raises
        ------
        InputError
            One that says not whose it is, or of somebody else, or twice.
        """
        found = dict[str, Path]()
        for item in self.truth or ():
            name, path = named_file(item)
            whose = agents[0] if name is None and len(agents) == 1 else name
            if whose is None or whose not in agents or whose in found:
                raise InputError("--truth", item, f"NAME=FILE.tum, one for each of {', '.join(agents)}")
            found[whose] = path
        return found


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
