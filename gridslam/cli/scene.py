"""Command line: floor plans as scenes, reports of runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from gridslam.cli.help import LOOK, SCENE_HELP, SCENES, scene_names
from gridslam.cli.options import Commands, flag
from gridslam.errors import InputError
from gridslam.wording import counted

if TYPE_CHECKING:
    from gridslam.importers.floorplans import Line, Plan

out = Console()
scene_app = Commands(no_args_is_help=True, help="Make, show, draw and import scene files.")
POSES = "x,y or x,y,deg, or with heights x,y,z,deg"
UNTURNED = "no angle told, so 0 degrees: it faces along x"
PICTURES = (".yaml", ".yml", ".pgm", ".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
KINDS = "FILE.geojson, FILE.json or FILE.dxf (Inkscape saves an SVG drawing as DXF)"


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(scene_app, name="scene", rich_help_panel=SCENES)
    app.command(rich_help_panel=SCENES)(scenes)
    app.command(rich_help_panel=LOOK)(report)


def scenes() -> None:
    """List the bundled scenes."""
    from gridslam.world.scene import Scene
    from gridslam.world.scene_files import bundled_scenes

    for name in bundled_scenes():
        _say(f"{name}: {Scene.load(name).description}")


@scene_app.callback()
def _scene() -> None:
    """Make, show, draw and import scene files."""


@scene_app.command("new")
def new_scene(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="SCENE.toml")],
    overwrite: Annotated[bool, flag("--overwrite")] = False,
) -> None:
    """Write a scene file to begin with: a room with two anchors, and what each key means."""
    from gridslam.io.files import refuse_taken, write_bytes
    from gridslam.world.names import label_fault
    from gridslam.world.scene import Scene
    from gridslam.world.scene_reference import commented

    if output.suffix != ".toml":
        raise InputError("-o", repr(output.name), "a name that ends in .toml")
    refuse_taken([output], overwrite)
    name = output.stem if label_fault(output.stem) is None else "scene"
    world = Scene.load("room").model_copy(update={"name": name, "description": ""})
    write_bytes(output, commented(world, all_keys=True).encode("utf-8"))
    _say(f"wrote {output}; to see that it is right: gridslam check {output}, gridslam scene draw {output}")


@scene_app.command("show")
def show_scene(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, autocompletion=scene_names)],
    whole: Annotated[bool, flag("--whole", "all keys with defaults and what they mean")] = False,
) -> None:
    """Print a scene file."""
    from gridslam.world.scene import Scene
    from gridslam.world.scene_files import BUNDLED, bundled_scenes
    from gridslam.world.scene_reference import commented

    world = Scene.load(scene)
    path = BUNDLED / f"{scene}.toml" if scene in bundled_scenes() else Path(scene)
    _say((commented(world) if whole else path.read_text(encoding="utf-8")).rstrip())


@scene_app.command("draw")
def draw(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, autocompletion=scene_names)],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="FILE.png, .pdf or .svg; default: SCENE.png", show_default=False),
    ] = None,
    width: Annotated[
        float, typer.Option(metavar="CM", min=5, max=50, help="8.8 suits a column of a paper")
    ] = 18.3,
    overwrite: Annotated[bool, flag("--overwrite")] = False,
) -> None:
    """Draw a scene: walls, anchors and where they face, agents' starts and ways, with their names."""
    from gridslam.drawing.map_figure import FORMATS, encoded
    from gridslam.drawing.scene_figure import draw_scene
    from gridslam.drawing.widths import fonts, inches
    from gridslam.io.files import refuse_taken, write_bytes
    from gridslam.world.scene import Scene

    path = Path(f"{Path(scene).stem}.png") if output is None else output
    if path.suffix.lower()[1:] not in FORMATS:
        raise InputError("-o", repr(path.name), "a name that ends in .png, .pdf or .svg")
    refuse_taken([path], overwrite)
    wide = inches(width)
    with fonts(wide):
        image = encoded(draw_scene(Scene.load(scene), wide), path.suffix.lower()[1:])
    write_bytes(path, image)
    _say(f"wrote {path}")


@scene_app.command("import")
def import_plan(
    file: Annotated[Path, typer.Argument(metavar="PLAN", help=KINDS)],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="SCENE.toml")],
    anchor: Annotated[list[str] | None, typer.Option(help=f"{POSES}, in m; repeat for each")] = None,
    start: Annotated[str | None, typer.Option(help=f"{POSES} of the agent")] = None,
    material: Annotated[list[str] | None, typer.Option(help="LAYER=MATERIAL")] = None,
    reflection: Annotated[list[str] | None, typer.Option(help="MATERIAL=COEFFICIENT")] = None,
    layer: Annotated[list[str] | None, typer.Option(help="only this layer of a DXF drawing")] = None,
    unit: Annotated[str | None, typer.Option(help="of the plan: m, dm, cm, mm, in or ft")] = None,
    origin: Annotated[str, typer.Option(help="x,y of the plan that becomes the scene's 0,0, m")] = "0,0",
    cell: Annotated[float, typer.Option(min=0.001, help="side of a cell, m")] = 0.1,
    geographic: Annotated[bool, flag("--geographic", "GeoJSON in degrees")] = False,
    overwrite: Annotated[bool, flag("--overwrite")] = False,
) -> None:
    """Make a scene file of a floor plan, and a picture of it beside it."""
    from gridslam.importers.floorplans import plan_of
    from gridslam.importers.plan_files import write_plan
    from gridslam.world.names import label_fault

    if output.suffix != ".toml":
        raise InputError("-o", repr(output.name), "a name that ends in .toml")
    for taken in (output, output.with_suffix(".png")):
        if taken.exists() and not overwrite:
            raise InputError(str(taken), "something of this name", "a new name (or --overwrite)")
    anchors, agent = _poses(anchor or [], start)
    place = _numbers(origin, "--origin", 2)
    names, values = _table(material, "--material"), _table(reflection, "--reflection")
    coefficients = {name: _share(name, text) for name, text in values.items()}
    lines, note = _walls(file, geographic, unit, layer or [])
    plan = plan_of(
        lines,
        file.name,
        names,
        coefficients,
        (place[0], place[1]),
        name=output.stem if label_fault(output.stem) is None else "plan",
        anchors=tuple(pose for pose, _ in anchors),
        start=agent[0] if agent is not None else None,
        cell_m=cell,
        heights_m=tuple(height for _, height in anchors if height is not None),
        start_height_m=agent[1] if agent is not None else None,
    )
    picture = write_plan(plan, output)
    for line in ([note] if note else []) + _remarks(plan, anchor or [], start):
        _say(line)
    _say(f"wrote {output} and {picture}" + ("" if anchors else "; it has no anchor yet: place one in it"))


def _poses(anchor: list[str], start: str | None) -> tuple[list[Posed], Posed | None]:
    """Where anchors and the agent are told to be, all with heights or none."""
    anchors = [_pose(text, "--anchor") for text in anchor]
    agent = _pose(start, "--start") if start is not None else None
    told = [*zip(anchor, anchors, strict=True)]
    _require_alike(told, "--anchor")
    if start is not None and agent is not None:
        _require_alike([*told, (start, agent)], "--start")
    return anchors, agent


def _walls(file: Path, geographic: bool, unit: str | None, layer: list[str]) -> tuple[list[Line], str]:
    """Walls of a plan, by what kind of file it is, and what is said of its units."""
    from gridslam.importers import dxf, geojson

    kind = file.suffix.lower()
    if kind == ".dxf":
        if geographic:
            raise InputError("--geographic", f"with {file.name}", "GeoJSON, for which it is")
        return dxf.read_walls(file, unit, layer)
    if kind in (".geojson", ".json"):
        if layer:
            raise InputError("--layer", f"{layer[0]!r} with {file.name}", "a DXF drawing, which has layers")
        return geojson.read_walls(file, geographic, unit), f"units: {unit}, as asked for" if unit else ""
    if kind in PICTURES:
        traced = "its walls, traced over it in Inkscape (to DXF) or QGIS (to GeoJSON)"
        raise InputError(str(file), "a map or picture of cells, which are no walls", f"{traced}: {KINDS}")
    raise InputError(str(file), f"a name that ends in {kind!r}", KINDS)


def _remarks(plan: Plan, anchor: list[str], start: str | None) -> list[str]:
    """What was taken for granted where nothing was told, walls drawn twice, and the walls by material."""
    from gridslam.world.scene_derived import repeats_note
    from gridslam.world.scene_parts import Wall

    notes = [f"--anchor {text}: {UNTURNED}" for text in anchor if text.count(",") == 1]
    notes += [f"--start {start}: {UNTURNED}"] if start is not None and start.count(",") == 1 else []
    notes += [f"{far}; the region to map reaches there" for far in plan.outside]
    twice = repeats_note([Wall.checked(line.wall, plan.source) for line in plan.lines])
    notes += [twice] if twice else []
    lines = [f"note: {told}" for told in notes]
    for name, (value, why) in plan.materials.items():
        count = sum(item.material == name for item in plan.lines)
        lines.append(f"{name}: {counted(count, 'wall')}, {value:g} ({why})")
    return lines


def report(
    directory: Annotated[Path, typer.Argument(metavar="FOLDER", help="of a run, or of a study")],
    still: Annotated[bool, flag("--still", "without the moving picture of each agent")] = False,
    overwrite: Annotated[bool, flag("--overwrite", "replace a report.html that isn't one of these")] = False,
) -> None:
    """Write report.html into a run's or a study's folder: one page with all its figures, which opens offline.

    It is made of that folder alone: an earlier report is replaced, as figures are by plot.
    """
    from rich.progress import Progress

    from gridslam.viewers.report import write_report
    from gridslam.viewers.study_report import is_study, write_study_report

    if is_study(directory):
        _say(f"wrote {write_study_report(directory, overwrite)}")
        return
    err = Console(stderr=True)
    with Progress(console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task("drawing", total=None)
        page = write_report(
            directory, not still, lambda done, total: bar.update(task, completed=done, total=total), overwrite
        )
    _say(f"wrote {page}")


def _numbers(text: str, option: str, count: int, allowed: str = "x,y in numbers") -> list[float]:
    from math import isfinite

    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(isfinite(value) and abs(value) < 1e9 for value in values):
        raise InputError(option, repr(text), allowed)
    return values


Posed = tuple[tuple[float, float, float], float | None]
"""x, y (m) and degrees, and the height, if one is told."""


def _pose(text: str, option: str) -> Posed:
    count = max(text.count(",") + 1, 2)
    x, y, *more = _numbers(text, option, min(count, 4), f"{POSES}, in numbers")
    return (x, y, more[-1] if more else 0.0), more[0] if count == 4 else None


def _require_alike(told: Sequence[tuple[str, Posed]], option: str) -> None:
    """Refuse heights of some, and not of others."""
    for text, (_, height) in told[1:]:
        if (height is None) != (told[0][1][1] is None):
            missing = "without a height" if height is None else "with a height"
            raise InputError(
                option, f"{text!r}, {missing}", "x,y,z,deg for all anchors and the start, or for none"
            )


def _table(pairs: list[str] | None, option: str) -> dict[str, str]:
    table = {}
    for pair in pairs or ():
        name, equals, value = pair.rpartition("=")
        if not (equals and name and value):
            raise InputError(option, repr(pair), "NAME=VALUE")
        table[name] = value
    return table


def _share(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value <= 1:
        raise InputError("--reflection", f"{name}={text}", "a coefficient above 0, up to 1")
    return value


def _say(text: str) -> None:
    out.print(text, highlight=False, markup=False, soft_wrap=True)
