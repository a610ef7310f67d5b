"""Command line: what an agent heard, of either kind, from a file or simulated."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from gridslam.cli.agents import simulation_note
from gridslam.errors import InputError
from gridslam.systems.registry import METHODS, method_class, taken_by, uses_maps

if TYPE_CHECKING:
    from gridslam.cli.asked import Asked
    from gridslam.measurements.observations import Observations
    from gridslam.measurements.table import Measurements
    from gridslam.viewers.rerun_view import RunView
    from gridslam.world.observation import Kind
    from gridslam.world.scene import Scene


def suited_method(method: str, world: Scene, names: list[str], files: Sequence[Path]) -> str:
    """The method that stands for this one on signals of files, or of the scene: `systems.suited`.

    Raises
    ------
    InputError
        Some files are of single antennas, others of arrays.
    """
    from gridslam.measurements.recording import Recording
    from gridslam.systems.suited import suited

    of_one_kind = method in METHODS and METHODS[method].antennas != "any"
    if not of_one_kind or (not files and world.radio.frequencies is None):
        return method
    if not files:
        return str(suited(method, world.waveform(names[0])))
    suits = {file: str(suited("direct", Recording.load(file).waveform)) for file in files}
    first, *rest = suits
    for file in rest:
        if suits[file] != suits[first]:
            found = f"{first} of {METHODS[suits[first]].antennas}, {file} of {METHODS[suits[file]].antennas}"
            raise InputError("--signal", found, "files of one kind: another run for the others")
    return suits[first] if method == "direct" else method


def require_map_used(map_file: Path | None, system: type, method: str) -> None:
    """Refuse a map that the method would leave aside.

    Raises
    ------
    InputError
        The method goes on from no map.
    """
    if map_file is not None and not uses_maps(system):
        able = ", ".join(name for name in METHODS if uses_maps(method_class(name)))
        found = f"{map_file}, with method {method!r}, which goes on from no map"
        raise InputError("--map", found, f"none, or a method that does: {able}")


def files_of(asked: Asked, takes: Kind) -> Mapping[str | None, Path]:
    """Files of what was heard, by agent; None: of the one agent.

    One table of path measurements is that of each agent that was named, if it says whose its rows are.

    Raises
    ------
    InputError
        As `Asked.files`, or the table can't be read at all.
    """
    from gridslam.checks.network.tables import is_network

    files, chosen = asked.files(takes), asked.agent or ()
    file = files.get(None)
    if takes != "paths" or file is None or len(chosen) < 2 or (file.exists() and not is_network(file)):
        return files
    return dict.fromkeys(chosen, file)


def recorded(
    world: Scene,
    file: Path | None,
    truth: Path | None,
    takes: Kind,
    agent: str | None = None,
    shared: bool = False,
) -> Observations | None:
    """What was heard by a file, with the truth that goes with it.

    Parameters
    ----------
    agent : str, optional
        Whose rows are taken of a table of several agents' path measurements; without it there may be one.
    shared : bool
        Whether others take theirs of it, so that it can't be all of one agent's.

    Raises
    ------
    InputError
        No such file, another kind of file, or one of other anchors than the scene's.
    """
    from gridslam.errors import located
    from gridslam.evaluation.ground_truth import with_truth
    from gridslam.measurements.recording import Recording
    from gridslam.measurements.table import Measurements
    from gridslam.runs.map_scene import check_anchors
    from gridslam.world.trajectory import Trajectory

    if file is None:
        if truth is not None:
            raise InputError("--truth", str(truth), "only together with --measurements or --signal")
        return None
    track = Trajectory.from_tum(truth) if truth is not None else None
    where = f"{file}: /truth" if truth is None else str(truth)
    if takes == "signal":
        received = Recording.load(file)
        with located(file):
            check_anchors(world, received)
        return with_truth(received, track, where)
    with_offsets = world.clocks is not None
    own = None if agent is None else own_rows(file, world.anchor_names, agent, with_offsets, shared)
    measurements = Measurements.load(file, world.anchor_names, with_offsets) if own is None else own
    with located(file):
        check_anchors(world, measurements)
    return with_truth(measurements, track, where)


@contextmanager
def noted() -> Iterator[list[str]]:
    """Collect the notes that are told of files meanwhile, each once; they are shown all the same."""
    import warnings

    from gridslam.errors import Note

    said, shown = list[str](), warnings.showwarning

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if issubclass(category, Note) and str(message) not in said:
            said.append(str(message))
        shown(message, category, filename, lineno, file, line)

    warnings.showwarning = show
    try:
        yield said
    finally:
        warnings.showwarning = shown


def refuse_without_distances(world: Scene, method: str, heard: Iterable[tuple[Path, Observations]]) -> None:
    """Refuse tables in which no row has a distance, or one that the radio measures; methods of one's own may
    do without.

    Raises
    ------
    InputError
        One of them is such a table.
    """
    from gridslam.errors import located
    from gridslam.measurements.table import Measurements
    from gridslam.world.columns import require_distances, require_within
    from gridslam.world.network_scene import longest_m

    for file, own in heard:
        if isinstance(own, Measurements) and method in METHODS:
            with located(file):
                require_distances(own.columns)
                require_within(own.columns, longest_m(world))


def own_rows(
    file: Path, anchors: Sequence[str], agent: str, with_offsets: bool, shared: bool = False
) -> Measurements | None:
    """One agent's rows of a table of several; None if it is one agent's, and not `shared` with others.

    Raises
    ------
    InputError
        It holds none of that agent, or not all of them say of which anchor they are.
    """
    from gridslam.checks.network.tables import is_network
    from gridslam.errors import located
    from gridslam.measurements.network import NetworkMeasurements

    if not is_network(file):
        return None
    several = NetworkMeasurements.load(file, anchors, None, with_offsets)
    if len(several.agents) < 2 and not shared:
        return None
    if agent not in several.agents:
        raise InputError(f"{file}: agent", f"no row of {agent!r}", ", ".join(several.agents))
    with located(file):
        own = several[agent]
    open_ones = int((own.anchor < 0).sum())
    if open_ones:
        found = f"{open_ones} of {len(own.anchor)} rows of {agent} without anchor"
        raise InputError(
            f"{file}: anchor", found, "one in each row, or a method that finds them out: network"
        )
    return own


@contextmanager
def view_of(asked: Asked, agents: Sequence[str]) -> Iterator[RunView | None]:
    """A viewer that shows the run meanwhile, if one is asked for."""
    if not asked.shown:
        yield None
        return
    from gridslam.viewers.rerun_view import open_view

    with open_view(asked.world, agents, asked.rerun_to, asked.overwrite) as view:
        yield view


def simulated_note(
    world: Scene, file: Path, agents: str | tuple[str, ...], observations: Observations | None
) -> str | None:
    """What to say of a file that was simulated in another scene, or for another agent, and fits it too."""
    made = getattr(observations, "simulated", None)
    names = (agents,) if isinstance(agents, str) else agents
    other = None if made is None else made.unlike(world.name, names)
    return None if other is None else f"{file}: {other}"


def source(files: Sequence[Path]) -> dict[str, Any]:
    """What ``run.json`` says of files that were given: name and checksum, of several in the agents' order."""
    if not files:
        return {}
    known = []
    for file in dict.fromkeys(files):
        with file.open("rb") as content:
            digest = hashlib.file_digest(content, "sha256").hexdigest()
        known.append({"file": file.name, "sha256": digest})
    return {"source": known[0] if len(known) == 1 else known}


def hints(world: Scene, method: str, observations: Observations | None) -> list[str]:
    """What to say before a run: what a method doesn't use of what it gets, and which one is made for it."""
    asked = (
        simulation_hint, repeats_hint, strides_hint, order_hint, angles_hint, samples_hint, elevations_hint,
        turn_hint,
    )  # fmt: skip
    return [hint for one in asked if (hint := one(world, method, observations))]


def simulation_hint(world: Scene, method: str, observations: Observations | None) -> str | None:
    """What to say of a scene that is simulated: that it has no walls, or where they hide an anchor."""
    return simulation_note(world) if observations is None else None


def strides_hint(world: Scene, method: str, observations: Observations | None) -> str | None:
    """What to say where numbers of steps count something else."""
    from gridslam.checks.columns.time_units import strides_line
    from gridslam.measurements.table import Measurements

    return strides_line(observations.step) if isinstance(observations, Measurements) else None


def repeats_hint(world: Scene, method: str, observations: Observations | None) -> str | None:
    """What to say where rows are written twice."""
    from gridslam.checks.tables.repeats import repeats_line
    from gridslam.measurements.table import Measurements

    return repeats_line(observations.columns) if isinstance(observations, Measurements) else None


def order_hint(world: Scene, method: str, observations: Observations | None) -> str | None:
    """What to say of samples in another order than that of frequencies, or over time."""
    from gridslam.checks.signals.order import order_note
    from gridslam.measurements.recording import Recording

    own = observations if isinstance(observations, Recording) else None
    return None if own is None else order_note(own.samples, own.heard, own.waveform)


def samples_hint(world: Scene, method: str, observations: Observations | None) -> str | None:
    """What to say where the scene is one of sampled signals, and a method on paths simulates its own."""
    if (
        observations is not None
        or world.radio.frequencies is None
        or taken_by(method_class(method)) == "signal"
    ):
        return None
    return (
        f"{world.name} is a scene of sampled signals, made for --method direct or hybrid; {method} gets "
        "the paths that a perfect front end would measure of them"
    )


def elevations_hint(world: Scene, method: str, observations: Observations | None) -> str | None:
    """What to say where elevations are measured that a method doesn't use."""
    from gridslam.measurements.table import Measurements

    if taken_by(method_class(method)) == "signal":
        return None
    measured = isinstance(observations, Measurements) and (
        observations.aod_elevation_rad is not None or observations.aoa_elevation_rad is not None
    )
    used = getattr(method_class(method), "over_levels", False) and world.has_heights
    if used or not measured:
        return None
    why = "--method grid and adaptive do" if world.has_heights else "the scene gives no heights"
    return f"the elevations that were measured aren't used by {method}: {why}"


def turn_hint(world: Scene, method: str, observations: Observations | None) -> str | None:
    """What to say where one anchor tells no departures: no error of this kind ever shows in what is heard."""
    import numpy as np

    from gridslam.measurements.table import Measurements

    if method not in METHODS or taken_by(method_class(method)) == "signal" or len(world.anchors) != 1:
        return None
    if isinstance(observations, Measurements):
        told = bool(np.isfinite(observations.aod_rad).any())
    else:
        told = observations is None and world.signal_model(world.agents[0].name).departs
    if told:
        return None
    return (
        f"departures from {world.anchors[0].name}, the one anchor, aren't measured: nothing but the start, "
        "or an earlier map, tells how all is turned about it: track and map may be turned as a whole"
    )


def angles_hint(world: Scene, method: str, observations: Observations | None) -> str | None:
    """What to say where a method that lives on angles gets none."""
    import numpy as np

    from gridslam.measurements.table import Measurements

    if method not in METHODS or not METHODS[method].on_angles:
        return None
    if isinstance(observations, Measurements):
        angles = any(bool(np.isfinite(angle).any()) for angle in (observations.aod_rad, observations.aoa_rad))
    else:
        angles = bool({"aod", "aoa"} & set(world.radio.measures))
    words = "--method va is made for them (and often lost where walls or racks hide anchors)"
    return None if angles else f"distances alone, no angles: {words}, {method} is not"
