"""Command line: what can be done with files that exist already."""

from __future__ import annotations

import shutil
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from gridslam.cli.help import LOOK
from gridslam.cli.options import flag, map_in
from gridslam.cli.output import busy
from gridslam.errors import InputError, Note, located

out = Console()
OTHERS = (
    ".toml", ".tum", ".yaml", ".yml", ".pgm", ".json", ".geojson", ".jsonl",
    ".png", ".svg", ".pdf", ".gif", ".html", ".mp4",
)  # fmt: skip
"""Endings of files that are neither measurements nor signals."""
EXPORTED = (
    ".yaml", ".yml", ".pgm", ".png", ".csv", ".geojson", ".json", ".h5", ".tif", ".tiff", ".pdf", ".svg",
)  # fmt: skip
"""Endings that a user gives to files."""
KINDS = (
    "a scene (.toml or a bundled name), measurements (.csv, .mat, .h5), signals (.mat, .h5), "
    "a map, steps, clocks or a checkpoint (.h5), a track (.tum), a nav2 map (.yaml), a table that gridslam "
    "wrote (.csv, .json) or a folder of a run, a study or an export"
)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    for command in (check, plot, export, fuse):
        app.command(rich_help_panel=LOOK)(command)


def check(
    file: Path,
    scene: Annotated[
        str | None, typer.Option(help="name or file of a scene, by whose anchors measurements are judged")
    ] = None,
    agent: Annotated[str | None, typer.Option(help="whose measurements; default: the first")] = None,
) -> None:
    """Say what a file or folder is (scene, measurements, map, steps, track, run), or what is wrong with it.

    Exit code 0: nothing is wrong with it; 1: something looks wrong (lines that begin with "suspect:"), or
    there is too little to tell ("unsure:"); 2: it can't be read.
    """
    from gridslam.checks.network.tables import describe_network, is_network, judged_by_angles
    from gridslam.checks.signals.files import describe_signal
    from gridslam.checks.verdicts.diagnose import describe
    from gridslam.checks.verdicts.verdict import UNSURE
    from gridslam.measurements.recording import Recording
    from gridslam.measurements.table import Measurements
    from gridslam.runs.parts import refuse_unfinished, waiting_note
    from gridslam.world.columns import require_distances
    from gridslam.world.scene import Scene

    refuse_unfinished(file)
    world = Scene.load(scene) if scene is not None else None
    samples = _holds_samples(file)
    if not (samples or _is_table(file)):
        said = _describe(file)
        _say(said)
        if (waits := waiting_note(file)) is not None:
            warnings.warn(Note(waits), stacklevel=2)
        if "\nsuspect: " in said or ": lost: " in said:
            raise typer.Exit(1)
        return
    several = not samples and is_network(file, world if agent is None else None)
    if several:
        lines = describe_network(file, world)
    else:
        lines = (describe_signal if samples else describe)(file, world, agent)
        lines = judged_by_angles(lines, file, world, agent)
    if world is None and not any(line.startswith("line of sight") for line in lines):
        lines.append(
            "not told without a scene: whether units, angles and anchors' names fit, by lines of sight: add "
            "--scene SCENE (a bundled name or a scene file)"
        )
    for line in lines:
        if not line.startswith("refused: "):
            _say(line)
    if not several:
        # a fault is told as that of every file
        if samples:
            Recording.load(file)
        else:
            whole = Measurements.load(file, pseudo=world is not None and world.clocks is not None)
            with located(file):
                require_distances(whole.columns)
    if any(line.startswith(("suspect: ", UNSURE)) for line in lines):
        raise typer.Exit(1)


def export(
    map_file: Annotated[
        Path, typer.Argument(metavar="MAP.h5", help="or a run's folder, for its tracks as tables, too")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="folder; other files in it stay")],
    raw: Annotated[bool, flag("--raw", "nav2: the cells alone, no walls drawn in")] = False,
    overwrite: Annotated[bool, flag("--overwrite", "replace files of these names")] = False,
) -> None:
    """Export a map for others: nav2 (yaml, pgm), pictures (png), tables (csv), walls, features (GeoJSON).

    Of a run's folder its tracks, too, as tables (csv). What is called features in maps of methods that learn
    none are paths that no surface explains, and files say so.
    """
    from gridslam.importers.geojson import write_features, write_surfaces
    from gridslam.io.files import beside, cannot_write, put_in_place, refuse_taken
    from gridslam.maps.map import Map
    from gridslam.runs.notes import grave_notes, planner_note
    from gridslam.runs.parts import waiting_note
    from gridslam.runs.run_files import read_run
    from gridslam.runs.track_tables import track_columns, write_track
    from gridslam.viewers.export_figures import draw_export

    if output.suffix.lower() in EXPORTED and not output.is_dir():
        named = f"{output.name!r}, which is called as a file is"
        allowed = "the name of a folder: nav2 map, pictures, tables and walls are written into it"
        raise InputError("-o", named, allowed)
    map_in(map_file)
    if not map_file.exists():
        raise InputError(str(map_file), "nothing of this name", "a map (.h5) or a run's folder")
    run = read_run(map_file) if (map_file / "run.json").is_file() else None
    found = Map.load(map_in(map_file) or map_file)
    shown, output = output, output.resolve()
    part = beside(output)
    try:  # all files or none: they are made aside and then moved
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        with busy("writing and drawing the map"):
            found.to_nav2(part, raw)
            found.to_csv(part)
            draw_export(found, part, raw)
        if found.surfaces is not None:
            write_surfaces(part / "surfaces.geojson", found.surfaces, found.wall_segments())
        if found.features is not None:
            points = "features" if _learns(map_file) else "unexplained"
            (part / "features.csv").rename(part / f"{points}.csv")
            write_features(part / f"{points}.geojson", found.features)
        for name, own in run.agents.items() if run is not None else ():
            columns = track_columns(own.estimates, own.trajectory, own.truth)
            write_track(part / f"{name}-track.csv", columns)
        names = sorted(path.name for path in part.iterdir())
        refuse_taken([shown / name for name in names], overwrite)
        output.mkdir(exist_ok=True)
        for name in names:
            put_in_place(part / name, output / name)
    except InputError as error:
        if part not in Path(error.where).parents:
            raise
        raise InputError(str(shown), error.found, error.allowed) from error
    except OSError as error:
        raise cannot_write(shown, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    graves = grave_notes(run) if run is not None else ()
    for note in (waiting_note(map_file), *graves, planner_note(found, map_file)):
        if note is not None:
            warnings.warn(Note(note), stacklevel=2)
    _say(f"wrote {', '.join(names)} to {shown}")


def fuse(
    maps: Annotated[list[Path], typer.Argument(metavar="MAP.h5...", help="two or more")],
    output: Annotated[Path, typer.Option("-o", "--output", help="FILE.h5")],
    same_frame: Annotated[
        bool, flag("--same-frame", "they are in one frame, though they share no anchor")
    ] = False,
    overwrite: Annotated[bool, flag("--overwrite", "replace a file of this name")] = False,
) -> None:
    """Make one map of maps that agents made apart from each other."""
    from gridslam.io.files import new_file
    from gridslam.maps.contradictions import contradictions
    from gridslam.maps.fusion import fuse as fused
    from gridslam.maps.map import Map
    from gridslam.maps.run_identity import alike_runs
    from gridslam.runs.notes import lost_makers

    if output.suffix != ".h5":
        raise InputError("-o", repr(output.name), "a name that ends in .h5")
    if output.is_dir() or (output.exists() and not overwrite):
        raise InputError(str(output), "something of this name", "a new file (or --overwrite)")
    if len(maps) < 2:
        raise InputError("fuse", f"{len(maps)} map", "two or more maps")
    maps = [map_in(path) or path for path in maps]
    loaded, names = [Map.load(path) for path in maps], [str(path) for path in maps]
    whole = fused(loaded, same_frame, names)
    lost = (note for path in maps for note in lost_makers(path))
    for line in (*contradictions(loaded, names), *lost, *alike_runs(whole)):
        warnings.warn(Note(line), stacklevel=2)
    with new_file(output, overwrite) as part:  # whatever has the name, if it was asked to
        whole.save(part)
    _say(f"wrote {output}: map {whole.in_words()}")


def plot(
    directory: Annotated[Path, typer.Argument(help="a run's folder")],
    form: Annotated[str, typer.Option("--format", help="png, pdf or svg")] = "png",
    width: Annotated[
        float | None,
        typer.Option(min=5, max=50, help="of the figures, cm: 8.8 suits a column (default: 18.3)"),
    ] = None,
    rerun: Annotated[bool, flag("--rerun", "show it in the Rerun viewer instead")] = False,
    rerun_to: Annotated[str | None, typer.Option(help="as that of run")] = None,
) -> None:
    """Draw a finished run's figures again."""
    if rerun or rerun_to:
        from gridslam.runs.run_files import read_run
        from gridslam.viewers.rerun_view import replay

        replay(read_run(directory), rerun_to)
        return
    from gridslam.drawing.map_figure import FORMATS
    from gridslam.drawing.widths import PAGE_IN
    from gridslam.viewers.plots import draw_all

    if form not in FORMATS:
        raise InputError("--format", repr(form), ", ".join(FORMATS))
    with busy("drawing figures"):
        drawn = draw_all(directory, form=form, width=PAGE_IN if width is None else width / 2.54)
    for path in drawn:
        _say(str(path))


def _say(text: str) -> None:
    out.print(text, highlight=False, markup=False, soft_wrap=True)


def _learns(map_file: Path) -> bool:
    """Whether features of this map are learned, as far as the run's folder that it lies in, or is, says."""
    from gridslam.runs.run_files import read_summary
    from gridslam.systems.registry import METHODS

    for folder in (map_file, map_file.parent, map_file.parent.parent):
        if (folder / "run.json").is_file():
            with suppress(InputError):  # maps are exported, whatever lies beside them
                method = str(read_summary(folder).get("method"))
                return method not in METHODS or METHODS[method].learns
    return True


def _describe(file: Path) -> str:
    from gridslam.checks.files import other_files, own_tables
    from gridslam.maps.map import Map

    if file.is_dir():
        if other_files.is_export(file):
            return other_files.export_lines(file, _describe)
        study = (file / "study.jsonl").is_file() and not (file / "run.json").exists()
        return other_files.study_line(file) if study else other_files.run_line(file)
    kind = file.suffix.lower()
    if kind == ".toml" or _is_bundled(file):
        return _scene_line(file)
    if kind in other_files.TRACKS:
        return other_files.track_line(file)
    if kind in other_files.NAV2:
        return other_files.nav2_line(file)
    if kind in other_files.PICTURES:
        return other_files.picture_line(file)
    if file.name == "run.json":
        return other_files.run_line(file.parent)
    if file.name == "study.jsonl":
        return other_files.study_line(file.parent)
    if kind == ".csv":
        return own_tables.table_line(file)
    if kind in (".json", ".geojson"):
        return own_tables.json_line(file)
    held = _kind(file)
    lines = {
        "gridslam-map": lambda path: f"map {Map.load(path).in_words()}",
        "gridslam-steps": other_files.steps_line,
        "gridslam-clocks": own_tables.clocks_line,
        "gridslam-checkpoint": own_tables.checkpoint_line,
    }
    if held in lines:
        return lines[held](file)
    raise InputError(str(file), f"an HDF5 file of format {held!r}", KINDS)


def _scene_line(file: Path) -> str:
    from gridslam.checks.scene.lines import scene_lines
    from gridslam.world.scene import Scene

    return "\n".join(scene_lines(Scene.load(file)))


def _is_bundled(file: Path) -> bool:
    """Whether it is the name of a bundled scene, not of a file."""
    from gridslam.world.scene_files import bundled_scenes

    return not file.exists() and str(file) in bundled_scenes()


def _holds_samples(file: Path) -> bool:
    """Whether it is a file of sampled signals."""
    if file.suffix.lower() == ".mat":
        from gridslam.measurements.matlab_signal import is_mat_signal

        return is_mat_signal(file)
    if file.suffix.lower() in (".csv", *OTHERS) or file.is_dir() or _is_bundled(file):
        return False
    return _kind(file) == "gridslam-signal"


def _is_table(file: Path) -> bool:
    if file.is_dir() or file.suffix.lower() in OTHERS or _is_bundled(file):
        return False
    if file.suffix.lower() == ".csv":
        from gridslam.checks.files.own_tables import is_own_table

        return not is_own_table(file)
    return file.suffix.lower() == ".mat" or _kind(file) == "gridslam-measurements"


def _kind(file: Path) -> str:
    """Format that an HDF5 file says it has."""
    import h5py

    from gridslam.io.hdf5_guard import prove
    from gridslam.io.hdf5_limits import most_claimed
    from gridslam.world.scene_files import or_scene

    if not file.is_file():
        raise InputError(str(file), "no file", or_scene(str(file), KINDS))
    try:
        prove(file, most_claimed(file), ["/"])
        with h5py.File(file) as content:
            name = content.attrs.get("format", "")
    except (OSError, KeyError, RuntimeError) as error:
        raise InputError(str(file), _unread(file), KINDS) from error
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)


def _unread(file: Path) -> str:
    """What is said of a file that isn't whole HDF5."""
    from gridslam.io.hdf5_guard import is_hdf5

    try:
        return "HDF5 that is damaged or cut short" if is_hdf5(file) else "nothing that gridslam reads"
    except OSError as error:
        return error.strerror or "an unreadable file"
