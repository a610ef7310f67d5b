"""What an agent would hear: exact image-source paths among finite walls, noise, misses and clutter.

The truth about every path (walls, bounces, true or clutter) stays in objects of its own; the
`Measurements` that a filter reads never hold it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.measurements.simulated import Simulated
from gridslam.measurements.table import Measurements
from gridslam.simulation.clocks import apparent_bias
from gridslam.simulation.occlusion import visible
from gridslam.simulation.reception import received
from gridslam.simulation.scattering import scattered_paths
from gridslam.simulation.true_paths import TruePaths
from gridslam.wording import counted
from gridslam.world.columns import OPTIONAL, VALUES
from gridslam.world.geometry import Segments, course, crossing, dot, mirror, wrap
from gridslam.world.scene import Scene
from gridslam.world.start import only_agent, require_scene
from gridslam.world.trajectory import Trajectory

__all__ = [
    "TruePaths", "Truth", "ground_truth", "measured_along", "receive", "simulate", "simulate_labelled",
    "true_paths", "visible",
]  # fmt: skip
MOST_AT_ONCE = 200_000
"""Pairs of step and order of walls that are looked at together."""


@dataclass(frozen=True)
class Truth:
    """Everything that is known only in simulation: the track, the visible paths, the walls.

    Attributes
    ----------
    trajectory : Trajectory
        N steps.
    paths : TruePaths
        All paths that are visible at some step.
    segments : Segments
        Straight pieces of the walls.
    """

    trajectory: Trajectory
    paths: TruePaths
    segments: Segments

    def __repr__(self) -> str:
        """One line."""
        size = f"{counted(len(self.paths.step), 'path')} in {counted(len(self.trajectory), 'step')}"
        return f"<Truth: {size}, {counted(len(self.segments), 'piece')} of walls>"

    def first(self, steps: int) -> Truth:
        """Truth about the first steps alone, for a run that ended early."""
        return replace(self, paths=self.paths.take(self.paths.step < steps))

    def joined(self, others: Iterable[Truth]) -> Truth:
        """Truth about this track, with the paths of other agents (their steps count from their own start).

        It is what a run is judged against that began with a map: the walls that earlier agents found are
        no ghosts, even if this agent never hears of them.
        """
        tables = [self.paths, *(other.paths for other in others)]
        columns = (np.concatenate([getattr(t, f.name) for t in tables]) for f in fields(TruePaths))
        return replace(self, paths=TruePaths(*columns))


def _on_piece(point: Array, walls: Segments, index: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether every point on the line of its wall piece lies on the piece itself."""
    span = walls.end[index] - walls.start[index]
    along = dot(point - walls.start[index], span) / dot(span, span)
    return (along > 0) & (along < 1)


def true_paths(scene: Scene, agent: str, track: Trajectory | None = None) -> TruePaths:
    """Trace every visible path of an agent's track (default: the scene's), up to ``radio.max_bounces``.

    Each may go over floor or ceiling, too. A scatterer adds a path of its own. Every leg is checked against
    every wall, and every interaction point must lie on its wall piece.
    """
    track = scene.track(agent) if track is None else track
    walls, signal = scene.segments(), scene.signal_model(agent)
    lines, count = walls.line, len(walls)
    candidates = [np.array([[-1, -1]])]
    mirrors = np.flatnonzero(walls.reflection > 0)
    if scene.radio.max_bounces >= 1:
        candidates.append(np.repeat(mirrors[:, None], 2, axis=1))
    if scene.radio.max_bounces >= 2:
        first, last = (pair.ravel() for pair in np.meshgrid(mirrors, mirrors, indexing="ij"))
        other = walls.surface[first] != walls.surface[last]
        candidates.append(np.stack([first, last], -1)[other])
    pieces = np.concatenate(candidates)
    bounces = np.where(pieces[:, 0] < 0, 0, np.where(pieces[:, 0] == pieces[:, 1], 1, 2))
    safe = np.maximum(pieces, 0)
    lines = lines if count else np.zeros((1, 2))
    block = max(MOST_AT_ONCE // len(pieces), 1)

    rows = []
    ways, senders = scene.verticals(agent), len(scene.anchors)
    for (way, over), number in product(enumerate(ways.over), range(senders)):
        position, height = scene.anchor_positions[number], ways.height[way, number]
        facing = scene.anchor_orientations[number]
        for start in range(0, len(track), block):
            places = track.position_m[start : start + block]
            steps, keep = _plausible(places, position, walls, lines, safe, bounces)
            steps = start + steps
            here = track.position_m[steps]
            geometry = course(
                here,
                np.broadcast_to(position, here.shape),
                lines[safe[keep, 1]],
                lines[safe[keep, 0]],
                bounces[keep],
                height,
            )
            good = geometry.valid.copy()
            if count:
                good &= (bounces[keep] == 0) | _on_piece(geometry.last_point, walls, safe[keep, 1])
                good &= (bounces[keep] < 2) | _on_piece(geometry.first_point, walls, safe[keep, 0])
            piece, kind, steps = pieces[keep][good], bounces[keep][good], steps[good]
            points = np.full((good.sum(), 4, 2), np.nan)
            points[:, 0], points[:, 3] = position, track.position_m[steps]
            points[:, 1] = geometry.first_point[good]
            points[kind == 2, 2] = geometry.last_point[good][kind == 2]
            strength = np.where(kind > 0, walls.reflection[piece[:, 1]], 1.0) if count else np.ones(len(kind))
            if count:
                strength = strength * np.where(kind == 2, walls.reflection[piece[:, 0]], 1.0)
            strength = strength * ways.gain[way]
            distance = geometry.distance[good]
            rows.append(
                TruePaths(
                    steps,
                    np.full(len(kind), number),
                    distance,
                    wrap(geometry.departure[good] - facing),
                    wrap(geometry.arrival[good] - track.heading_rad[steps]),
                    signal.amplitude(distance, strength),
                    kind,
                    np.where(kind[:, None] == 1, np.stack([piece[:, 0], np.full(len(kind), -1)], -1), piece),
                    points,
                    np.full(len(kind), over),
                )
            )
    table = TruePaths(*(np.concatenate([getattr(r, f.name) for r in rows]) for f in fields(TruePaths)))
    starts, ends, owner = table.legs
    clear = np.ones(len(table), dtype=bool)
    screens = np.array([wall.blocks == "sight" for wall in scene.walls], dtype=bool)[walls.wall]
    np.logical_and.at(clear, owner, visible(starts, ends, walls.take(~screens)))
    if screens.any():
        open_sight = visible(starts, ends, walls.take(screens))
        np.logical_and.at(clear, owner, open_sight | (table.bounces[owner] > 0))
    order = np.flatnonzero(clear)[np.argsort(table.step[clear], kind="stable")]
    table = TruePaths(*(getattr(table, f.name)[order] for f in fields(table)))
    sizes = np.array([point.size_m for point in scene.scatterers])
    return table.joined(scattered_paths(scene, agent, track, scene.scatterer_positions, sizes))


def _plausible(
    here: Array, anchor: Array, walls: Segments, lines: Array, pieces: NDArray[np.intp],
    bounces: NDArray[np.intp],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:  # fmt: skip
    """Places (N, 2) and orders of walls (P, 2) that meet a cheap necessary condition, as two indices (L,).

    The segment from the place to the image crosses the last wall on its piece.
    """
    if len(pieces) < 64:
        every = np.ones((len(here), len(pieces)), dtype=bool).nonzero()
        return every[0], every[1]
    image_first = np.where((bounces == 2)[:, None], mirror(lines, anchor)[pieces[:, 0]], anchor)
    image = mirror(lines[pieces[:, 1]], image_first)
    fraction = crossing(here[:, None], image, lines[pieces[:, 1]])
    step, pair = np.nonzero((bounces == 0) | ((fraction > 0) & (fraction < 1)))
    with np.errstate(invalid="ignore"):
        point = here[step] + fraction[step, pair][:, None] * (image[pair] - here[step])
    good = (bounces[pair] == 0) | _on_piece(point, walls, pieces[pair, 1])
    return step[good], pair[good]


def ground_truth(scene: Scene, agent: str | None = None, track: Trajectory | None = None) -> Truth:
    """Track, visible paths and walls of an agent, for scoring.

    Parameters
    ----------
    scene : Scene
        With walls.
    agent : str, optional
        Default: the scene's only one.
    track : Trajectory, optional
        Where the agent was, N steps; default: its way through the scene's waypoints.

    Raises
    ------
    InputError
        No scene or such agent, none named of several, or one without waypoints and without a track.
    """
    require_scene(scene)
    agent = only_agent(scene) if agent is None else agent
    track = scene.track(agent) if track is None else track
    return Truth(track, true_paths(scene, agent, track), scene.segments())


def simulate(scene: Scene, agent: str, seed: int = 0) -> Measurements:
    """Measurements of an agent on its track: detected paths with noise, and clutter.

    Paths by image sources [Borish1984image], the rest by docs/model.md, (M9)-(M13).

    Examples
    --------
    >>> import gridslam as gs
    >>> heard = gs.simulate(gs.Scene.load("room"), "agent1", seed=1)
    >>> heard.anchors
    ('A', 'B')
    """
    return simulate_labelled(scene, agent, seed)[0]


def simulate_labelled(scene: Scene, agent: str, seed: int = 0) -> tuple[Measurements, NDArray[np.intp]]:
    """As `simulate`, with the row in `true_paths` that caused each measurement, or -1 for clutter (K,)."""
    return measured_along(scene, agent, scene.track(agent), true_paths(scene, agent), seed)


def measured_along(
    scene: Scene, agent: str, track: Trajectory, paths: TruePaths, seed: int = 0
) -> tuple[Measurements, NDArray[np.intp]]:
    """As `simulate_labelled`, of any track and of paths that were traced (or made up) before."""
    offset = apparent_bias(scene, agent, track.time_s, seed) if scene.clocks is not None else None
    columns, label = received(paths, scene, agent, seed, len(track), offset)
    measurements = Measurements(
        anchors=scene.anchor_names,
        anchor_position_m=scene.anchor_places,
        anchor_orientation_rad=scene.anchor_orientations,
        interval_s=scene.agent(agent).interval_s,
        steps=len(track),
        time_s=track.time_s[columns["step"]],
        truth=track,
        pseudo=scene.clocks is not None,
        simulated=Simulated(scene.name, (agent,), seed),
        **columns,
    )
    return measurements, label


def receive(clean: Measurements, scene: Scene, agent: str, seed: int = 0) -> Measurements:
    """What the scene's radio would make of exact paths, from a ray tracer for example.

    Noise, missed paths and clutter as in `simulate`; every path needs all four quantities.

    Raises
    ------
    InputError
        The anchors aren't the scene's, there is no such agent, or a quantity is missing.
    """
    if clean.anchors != scene.anchor_names:
        raise InputError("measurements: anchors", str(clean.anchors), str(scene.anchor_names))
    for name in VALUES:
        if np.isnan(getattr(clean, name)).any():
            raise InputError(f"measurements: {name}", "paths without it", "a value for every path")
    columns, _ = received(clean, scene, agent, seed, len(clean))
    times = np.array([clean.scan(step).time_s for step in range(len(clean))])
    changes: dict[str, Any] = {"time_s": times[columns["step"]], **dict.fromkeys(OPTIONAL), **columns}
    return replace(clean, **changes)
