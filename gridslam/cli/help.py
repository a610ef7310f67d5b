"""Command line: what all commands share: groups, names to complete, the version."""

from __future__ import annotations

from typing import Annotated

import typer

from gridslam.cli.options import flag

MAP, LOOK, SCENES, COMPARE = "Map", "Look at and hand over", "Scenes", "Compare and measure"
"""Groups of commands."""
SCENE_HELP = "bundled name or path"


def scene_names() -> list[str]:
    """Names to complete a scene by."""
    from gridslam.world.scene_files import bundled_scenes

    return list(bundled_scenes())


def method_names() -> list[str]:
    """Names to complete a method by."""
    from gridslam.systems.registry import METHODS

    return sorted(METHODS)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"gridslam {version('gridslam')}")
        raise typer.Exit


def about(
    version: Annotated[
        bool, flag("--version", "Show the version and exit.", is_eager=True, callback=_version)
    ] = False,
) -> None:
    """Radio multipath in, a map out. Begin with: gridslam run; gridslam check FILE looks at your own data."""
