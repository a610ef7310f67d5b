"""Command line: what `run` was asked for, in one piece."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

import typer

from gridslam.cli.agents import files_by_agent, named_file, require_kind
from gridslam.cli.help import SCENE_HELP, method_names, scene_names
from gridslam.cli.options import flag, map_in
from gridslam.cli.resume import as_saved
from gridslam.errors import InputError
from gridslam.systems.registry import DEFAULT, method_help

if TYPE_CHECKING:
    from gridslam.world.observation import Kind
    from gridslam.world.scene import Scene

MAIN_SCENE = "hall"


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of `run`, as they were given or as a run had them that is gone on with."""

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, autocompletion=scene_names)] = MAIN_SCENE
    agent: Annotated[
        list[str] | None,
        typer.Option(help="agents, in order; default: all, of measurements the scene's first"),
    ] = None
    method: Annotated[str, typer.Option(help=method_help(), autocompletion=method_names)] = DEFAULT
    particles: Annotated[int | None, typer.Option(min=1, help="instead of the scene's filter.particles")] = (
        None
    )
    steps: Annotated[int | None, typer.Option(min=1, help="the first steps of each agent alone")] = None
    seed: Annotated[int, typer.Option(min=0)] = 0
    measurements: Annotated[
        list[str] | None,
        typer.Option(
            help="CSV, MATLAB or HDF5 file of the one agent, or of all that --agent names; or one each"
        ),
    ] = None
    signal: Annotated[
        list[str] | None,
        typer.Option(
            help="FILE of samples, for methods that take them; of several agents one each, or NAME=FILE"
        ),
    ] = None
    truth: Annotated[
        list[str] | None,
        typer.Option(help="FILE.tum to score what was recorded by; of several agents at once NAME=FILE.tum"),
    ] = None
    map_file: Annotated[
        Path | None,
        typer.Option("--map", help="map to start from: map.h5, or a run's folder", callback=map_in),
    ] = None
    same_frame: Annotated[
        bool, flag("--same-frame", "the map is in the scene's frame, though it shares no anchor")
    ] = False
    start: Annotated[
        str | None, typer.Option(help="told start: drawn from the prior by seed (default), or exact")
    ] = None
    device: Annotated[str, typer.Option(help="auto, cpu or gpu")] = "auto"
    threads: Annotated[int | None, typer.Option(min=1)] = None
    output: Annotated[Path | None, typer.Option("-o", "--output", help="new folder")] = None
    overwrite: Annotated[bool, flag("--overwrite", "replace an earlier run's folder")] = False
    rerun: Annotated[bool, flag("--rerun", "show it in the Rerun viewer meanwhile")] = False
    rerun_to: Annotated[
        str | None, typer.Option(help="FILE.rrd to record to instead, or HOST:PORT of a viewer")
    ] = None
    checkpoint: Annotated[
        int | None, typer.Option(min=1, help="steps between checkpoints, from which --resume goes on")
    ] = None
    resume: Annotated[
        Path | None,
        typer.Option(
            help="folder of an interrupted run with --checkpoint: go on with it, as it was asked for",
            is_eager=True,
            callback=as_saved,
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Asked(RunOptions):
    """Options of `run`, and the scene as they leave it.

    Attributes
    ----------
    instead_of : str or None
        The method that was asked for, where `method` stands for it, since clocks aren't known.
    """

    context: typer.Context
    world: Scene
    instead_of: str | None = None

    @classmethod
    def of(cls, context: typer.Context, options: RunOptions, world: Scene) -> Self:
        """What was asked for in this context; a run that is gone on with stays in its folder."""
        if options.resume is not None:
            options = replace(options, output=options.resume)
        from gridslam.systems.suited import clocked

        given = {f.name: getattr(options, f.name) for f in fields(options)}
        asked = cls(context=context, world=world, **given)
        names = options.agent or [agent.name for agent in world.agents]
        method = str(clocked(options.method, world, names))
        return asked if method == options.method else replace(asked, method=method, instead_of=options.method)

    @property
    def shown(self) -> bool:
        """Whether the run is shown in a viewer."""
        return self.rerun or self.rerun_to is not None

    def files(self, takes: Kind) -> dict[str | None, Path]:
        """Files of what was heard, of the kind that the method takes, by agent; None: of the one agent.

        Raises
        ------
        InputError
            One of the other kind, both kinds, several that don't say whose they are, or no scene for them.
        """
        tables, signals = self.measurements or [], self.signal or []
        table, first = (named_file(items[0])[1] if items else None for items in (tables, signals))
        require_kind(table, first, takes, self.method)
        scene = self.context.get_parameter_source("scene")
        if (table or first) and scene is not None and scene.name == "DEFAULT":
            given = f"none, with {table or first}"
            raise InputError("SCENE", given, "the scene in which this was heard: a bundled name or a file")
        option, items = ("--measurements", tables) if tables else ("--signal", signals)
        return files_by_agent(option, items, self.agent or [])

    @property
    def table(self) -> Path | None:
        """The one file of all agents' path measurements, for methods that take them at once.

        Raises
        ------
        InputError
            There are several, or it is said to be one agent's.
        """
        given = [named_file(item) for item in self.measurements or ()]
        if len(given) > 1 or any(name is not None for name, _ in given):
            found = (
                f"{', '.join(self.measurements or ())}, with method {self.method!r}, which takes all at once"
            )
            raise InputError("--measurements", found, "one file, of all agents: a table with a column agent")
        return given[0][1] if given else None

    def start_how(self, file: Path | None) -> str:
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
