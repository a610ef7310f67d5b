"""The truth that a run is judged against: of a simulation, of a recorded track, of agents in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.evaluation.array_bounds import array_bound
from gridslam.evaluation.bounds import Bound, known_map_bound
from gridslam.evaluation.signal_bounds import has_single_antennas, scene_signal_bound
from gridslam.maps.map import Map
from gridslam.measurements.recording import Recording
from gridslam.measurements.table import Measurements
from gridslam.simulation.image_source import TruePaths, Truth, ground_truth
from gridslam.wording import counted, time_span
from gridslam.world.observation import Kind
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

SAME_WAY_M = 1e-6
"""Deviation up to which a recorded track is the scene's own, written to a file and read again."""
EXPECTED = 3.0
"""Detections to be expected at a step from which on hearing nothing is silence: by chance 1 in 20 at most."""


Known = TypeVar("Known", Measurements, Recording)


def with_truth(observations: Known, track: Trajectory | None, where: str) -> Known:
    """Return the measurements with a true track that has one pose per step.

    Parameters
    ----------
    observations : Measurements or Recording
    track : Trajectory or None
        At any times, between which it is interpolated; None keeps the measurements' own, if any.
    where : str
        Names the track in errors.

    Raises
    ------
    InputError
        The track doesn't cover the times of the steps.
    """
    known = observations.truth if track is None else track
    if known is None:
        return observations
    way: Trajectory = known
    time = observations.times_s
    slack = 1e-6 * max(observations.interval_s, 1e-3)
    if len(time) and (time[0] < way.time_s[0] - slack or time[-1] > way.time_s[-1] + slack):
        found = f"a track from {time_span(way.time_s[0], way.time_s[-1])}"
        raise InputError(where, found, f"one that covers the steps, {time_span(time[0], time[-1])}")
    if len(time) == len(way) and np.allclose(time, way.time_s, rtol=0, atol=slack):
        return replace(observations, truth=replace(way, time_s=time))
    return replace(observations, truth=way.at(time))


def truth_of(
    scene: Scene, agent: str, track: Trajectory | None, simulated: bool = False
) -> Truth | Trajectory | None:
    """What is known of an agent's way: with the paths where the scene has walls, else the track alone.

    Parameters
    ----------
    simulated : bool
        Whether what was heard was simulated in this scene, so that there are no walls where it has none.
    """
    known = track is not None and (bool(scene.walls) or simulated)
    return ground_truth(scene, agent, track) if known else track


def require_same_world(scene: Scene, agent: str, times_s: Array, truth: Truth) -> None:
    """Refuse the truth of another scene, or one whose steps aren't those of the run.

    Parameters
    ----------
    scene : Scene
    agent : str
    times_s : (N,) float64
        Times of the steps that were made.
    truth : Truth

    Raises
    ------
    InputError
        Other walls than the scene's, or steps at other times.
    """
    if not _has_walls(scene, truth):
        allowed = f"gs.ground_truth(run.scene, {agent!r}), or a Trajectory"
        raise InputError("truth", _other_walls(scene, truth), allowed)
    known, count = truth.trajectory.time_s, len(times_s)
    slack = 1e-6 * max(1.0, float(np.ptp(times_s)) if count else 0.0)
    if len(known) < count or (np.abs(known[:count] - times_s) > slack).any():
        found = f"{counted(len(known), 'step')} at other times than the run's {count}"
        raise InputError("truth", found, "a track with a pose for each step of the run, or a Trajectory")


def require_earlier(scene: Scene, earlier: Sequence[Truth]) -> None:
    """Refuse what can't be the truth of the agents before in a scene.

    Parameters
    ----------
    scene : Scene
    earlier : sequence of Truth

    Raises
    ------
    InputError
        Something else than a list of truths of this scene.
    """
    allowed = "a list of gs.ground_truth(run.scene, NAME), one for each agent before"
    if not isinstance(earlier, Sequence) or isinstance(earlier, str):
        raise InputError("earlier", type(earlier).__name__, allowed)
    for number, truth in enumerate(earlier):
        if not isinstance(truth, Truth):
            raise InputError(f"earlier[{number}]", type(truth).__name__, allowed)
        if not _has_walls(scene, truth):
            raise InputError(f"earlier[{number}]", _other_walls(scene, truth), allowed)


def _has_walls(scene: Scene, truth: Truth) -> bool:
    """Whether a truth is of a scene's walls; of a scene without any it may be of all."""
    walls, there = scene.segments(), truth.segments
    same = (np.array_equal(getattr(walls, name), getattr(there, name)) for name in ("start", "end"))
    return not scene.walls or all(same)


def _other_walls(scene: Scene, truth: Truth) -> str:
    pieces = counted(len(truth.segments), "piece")
    return f"other walls ({pieces}) than those of {scene.name} ({len(scene.segments())})"


def _goes(scene: Scene, agent: str, went: Trajectory) -> bool:
    """Whether a track is the way that the scene gives to an agent."""
    if scene.agent(agent).waypoints_m is None:
        return False
    own = scene.track(agent)
    return len(own) == len(went) and np.allclose(own.position_m, went.position_m, rtol=0, atol=SAME_WAY_M)


def inherited_truth(scene: Scene, grid: Map, latest: bool = True) -> list[Truth]:
    """Truth of the agents that made a map, as far as the scene knows their ways.

    Parameters
    ----------
    scene : Scene
    grid : Map
    latest : bool
        Whether the agent that left the map is one of them, or only those before it.
    """
    agents, steps = (grid.provenance.get(key) for key in ("agents", "steps"))
    if not (scene.walls and isinstance(agents, list) and isinstance(steps, list)):
        return []
    made = list(zip(agents, steps, strict=False))
    ways = {agent.name for agent in scene.agents if agent.waypoints_m is not None}
    return [
        ground_truth(scene, name).first(int(count))
        for name, count in (made if latest else made[:-1])
        if name in ways and isinstance(count, int)
    ]


def tells_heading(scene: Scene, agent: str, takes: Kind = "paths") -> bool:
    """Whether a method finds out which way an agent faces.

    It can't where nothing tells, and needn't where a recording holds the exact heading.

    Parameters
    ----------
    takes : "paths" or "signal"
        What the method is handed.
    """
    given = scene.agent(agent).heading_sensor_deg == 0
    blind = takes == "signal" and (given or has_single_antennas(scene, agent))
    return not blind and "aoa" in scene.radio.measures


def untold_heading(scene: Scene, agent: str, observed: Measurements | Recording) -> str | None:
    """What headings of a method of ours are where nothing that was heard tells them; None where it does."""
    if isinstance(observed, Recording):
        sensed = scene.agent(agent).heading_sensor_deg is not None
        if sensed or not has_single_antennas(scene, agent):
            return None
        return "headings are directions of motion: nothing that was heard tells them"
    if np.isfinite(observed.columns.get("aoa_rad", np.nan)).any():
        return None
    return "headings are unknown: no angle of arrival was measured"


def walls_tell_all(scene: Scene, takes: Kind) -> bool:
    """Whether bounds, which count paths of walls alone, are bounds of a method.

    In sampled signals scatterers are heard, too, and hybrid SLAM makes use of them. No filter of paths does.
    """
    return takes == "paths" or not scene.scatterers


def heard_paths(scene: Scene, agent: str, paths: TruePaths, unheard: Sequence[int]) -> TruePaths:
    """True paths but for those of steps at which nothing was heard though something had to be.

    That is where `EXPECTED` detections or more were to be expected: of faint paths, silence is what their
    detection probabilities price in already.
    """
    chance = scene.signal_model(agent).detection_probability(paths.amplitude)
    size = max(paths.step.max(initial=0), *unheard, 0) + 1
    expected = np.bincount(paths.step, chance, int(size))
    silent = [step for step in unheard if expected[step] >= EXPECTED]
    return paths.take(~np.isin(paths.step, silent)) if silent else paths


def known_bound(
    scene: Scene,
    agent: str,
    truth: Truth | Trajectory | None,
    takes: Kind = "paths",
    unheard: Sequence[int] = (),
) -> Bound | None:
    """Known-map bound, where the walls are known and the agent went the scene's own way; else None.

    Parameters
    ----------
    takes : "paths" or "signal"
        What the method was handed. Of sampled signals, the bound prices overlap in.
    unheard : sequence of int
        Steps at which nothing was heard, see `heard_paths`.
    """
    if not isinstance(truth, Truth) or not _goes(scene, agent, truth.trajectory):
        return None
    if not walls_tell_all(scene, takes):
        return None
    went, paths = truth.trajectory, heard_paths(scene, agent, truth.paths, unheard)
    if takes == "signal":
        single = has_single_antennas(scene, agent)
        bound = scene_signal_bound if single else array_bound
        return bound(scene, agent, True, paths, went)
    return known_map_bound(scene, agent, paths)
