"""One mapping run: a scene and what an agent heard in, a `Run` out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial

import numpy as np

from gridslam import runtime
from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.maps.feature_rows import SAME_PLACE_M
from gridslam.maps.frames import fitted, stamped
from gridslam.maps.map import Map
from gridslam.measurements.observations import Observations, require_kind
from gridslam.measurements.recording import Recording
from gridslam.measurements.table import Measurements
from gridslam.runs.heard_stretches import map_so_far
from gridslam.runs.run import Run
from gridslam.runs.step_files import storable
from gridslam.runs.steps import resumed_or_started, run_steps
from gridslam.runs.stopping import StoppedLate, held_back, keep_with
from gridslam.runs.unfinished import AgentCheckpoint
from gridslam.runs.unheard import unheard_steps
from gridslam.systems.registry import DEFAULT, METHODS, method_class, method_name, taken_by
from gridslam.systems.slam import Slam, built, stepped
from gridslam.systems.suited import clocked, suited
from gridslam.world.columns import require_distances, require_within
from gridslam.world.geometry import wrap
from gridslam.world.network_scene import longest_m
from gridslam.world.observation import Observation
from gridslam.world.scene import Scene
from gridslam.world.start import Start, require_scene, start_of
from gridslam.world.trajectory import Trajectory
from gridslam.world.waveform import Waveform

SAME_FACING_RAD = 1e-3


def map_scene(
    scene: Scene,
    measurements: Observations,
    method: str | type[Slam] = DEFAULT,
    agent: str | None = None,
    seed: int = 0,
    prior_map: Map | None = None,
    progress: bool | Callable[[Estimate, int, int], None] = False,
    particles: int | None = None,
    watch: Callable[[Estimate, Callable[[], Map]], None] | None = None,
    same_frame: bool = False,
    start: Start | Sequence[float] | str | None = None,
    checkpoint: AgentCheckpoint | None = None,
) -> Run:
    """Run a method over all measurements of one agent.

    Parameters
    ----------
    scene : Scene
    measurements : Measurements or Recording
        As the method takes: path measurements, or sampled signals. Its truth, if it has one, is never read by
        the filter.
    method : str or class
        One of `gridslam.systems.registry.METHODS` ("grid" and others), a class of your own (`Slam` says what
        it needs), "package.module:Class", or the name of an entry point of the group "gridslam.methods".
        "direct" is "direct_grid" where the samples are those of arrays; "grid" and "adaptive" are
        "network_grid" and "network" where the scene's clocks aren't known.
    agent : str, optional
        Default: the scene's first.
    seed : int
    prior_map : Map, optional
        What an earlier agent left; resampled if its grid is another one.
    progress : bool or callable, optional
        True shows a bar on a terminal; a callable gets (estimate, steps done, steps in all) after every step.
    particles : int, optional
        Instead of ``scene.filter.particles``.
    watch : callable, optional
        Gets, after every step, the estimate and a function that returns the map as it stands.
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.
    start : "drawn", "exact", (x m, y m, heading rad) or Start, optional
        What is told of the start: drawn from the agent's prior by the seed, the scene's own, or this pose.
        Default: drawn where `gridslam.simulate` made the measurements, as `gridslam run` and `study` do;
        else the scene's, and ``run.start`` is "scene": nobody knows how exact it is.
    checkpoint : AgentCheckpoint, optional
        Where the run goes on from, if it was interrupted, and keeps what it needs to do so again: of
        `gridslam.runs.unfinished.Unfinished.agent`.

    Returns
    -------
    Run
        Ends early, and says so, if it is interrupted: Ctrl-C lets the step in hand finish, a second one
        doesn't (and raises `KeyboardInterrupt`; after the last step one that has the run as ``run``).

    Raises
    ------
    Exception
        What a step of a method of one's own raised; `gridslam.runs.stopping.run_before` has the steps before.
    InputError
        No scene, unknown method or agent, a class that is no method, a step that returns no estimate, a
        number of particles out of range, a map of another frame, measurements of anchors that aren't the
        scene's, or of the kind that the method doesn't take, or (for methods of ours) without distances, or
        with none that the scene's radio measures.
    """
    require_scene(scene)
    waveform = measurements.waveform if isinstance(measurements, Recording) else None
    method = suited(method, waveform)
    if particles is not None:
        scene = scene.with_filter(particles=particles)
    if agent is None and not scene.agents:
        raise InputError(f"{scene.name}: agents", "none", "at least one, to say where it starts")
    method = clocked(method, scene, [agent or scene.agents[0].name])
    found = method_class(method)
    require_kind(measurements, taken_by(found), method_name(method))
    check_anchors(scene, measurements)
    if isinstance(measurements, Measurements) and method_name(method) in METHODS:  # others may do without
        require_distances(measurements.columns)
        require_within(measurements.columns, longest_m(scene))
    if prior_map is not None:
        prior_map, _ = fitted(prior_map, scene, same_frame=same_frame)
    simulated = measurements.simulated is not None
    began = start_of(scene, agent or scene.agents[0].name, seed, start, simulated)
    told = began if isinstance(start, Start) or began.how in ("drawn", "told") else None  # else the scene's
    device = runtime.start()
    slam, before = resumed_or_started(
        found, checkpoint, lambda: _started(found, scene, prior_map, agent, seed, told, waveform)
    )
    with _watcher(progress, slam.agent, measurements) as tell:
        own = not type(slam).__module__.startswith("gridslam.")
        done = run_steps(_stepping(slam), slam, measurements, before, tell, watch, checkpoint, own)
    with held_back() as asked:  # a map of many cells takes a moment
        estimates = done.estimates
        with _after(done.fault):
            last, final_map = estimates[-1], stamped(map_so_far(slam, estimates, prior_map), scene)
        surfaces = last.surfaces.take(last.detected)
        if final_map.surfaces is not None and not any(len(e.surfaces) for e in estimates):
            surfaces = final_map.surfaces  # of features: no step tells them
        trajectory = believed_track(estimates, scene.agent(slam.agent).height_m)
        run = Run(
            scene=scene,
            agent=slam.agent,
            method=method_name(method),
            seed=seed,
            device=device,
            estimates=estimates,
            trajectory=trajectory,
            covariance=np.array([e.covariance for e in estimates]),
            surfaces=surfaces,
            map=final_map,
            seconds_per_step=done.seconds_per_step,
            peak_memory_mb=done.peak_memory_mb,
            began=began,
            interrupted=len(estimates) < len(measurements),
            unheard=unheard_steps(measurements, len(estimates)),
        )
    if done.fault is not None:
        keep_with(done.fault, run)
        raise done.fault
    if asked.is_set():
        raise StoppedLate(run)
    return run


@contextmanager
def _after(fault: Exception | None) -> Iterator[None]:
    """Let what a step raised pass where the map fails after it, too."""
    try:
        yield
    except Exception:
        if fault is not None:
            raise fault from None
        raise


def _stepping(slam: Slam) -> Callable[[Observation], Estimate]:
    """How a method is stepped; what one that isn't ours returns has to be what files can hold."""
    if type(slam).__module__.startswith("gridslam."):
        return partial(stepped, slam)
    where = f"{type(slam).__name__}.step"
    return lambda scan: storable(stepped(slam, scan), where)


def believed_track(estimates: Sequence[Estimate], height_m: float | None = None) -> Trajectory:
    """The track that estimates make, at the heights that they hold, else at the one that is known."""
    high = [e.heights["agent"][0] if "agent" in e.heights else height_m for e in estimates]
    return Trajectory(
        np.array([e.time_s for e in estimates]),
        np.array([e.position_m for e in estimates]),
        np.array([e.velocity_mps for e in estimates]),
        np.array([e.heading_rad for e in estimates]),
        None if any(one is None for one in high) else np.array(high, np.float64),
    )


def _started(
    method: type[Slam],
    scene: Scene,
    prior_map: Map | None,
    agent: str | None,
    seed: int,
    start: Start | None,
    waveform: Waveform | None,
) -> Slam:
    """A method's object, told of a start: by `start_at` where it has one, else by its scene."""
    start_at = getattr(method, "start_at", None)
    who = agent or scene.agents[0].name
    if start is not None and (start.heights_m or start.coefficients):
        scene = scene.at_heights(who, start.heights_m).at_coefficients(start.coefficients)
    if start is not None and start_at is None:
        scene = scene.starting(who, start.position_m, start.heading_rad)
    slam = built(method, scene, prior_map, agent, seed, waveform)
    if start is not None and start_at is not None:
        start_at(slam, start.position_m, start.heading_rad)
    return slam


def check_anchors(scene: Scene, measurements: Observations) -> None:
    """Refuse measurements of other anchors than the scene's.

    Raises
    ------
    InputError
        Other names or another order or, where the measurements tell them, other places or orientations.
    """
    if tuple(measurements.anchors) != scene.anchor_names:
        raise InputError(
            "measurements: anchors", ", ".join(measurements.anchors), ", ".join(scene.anchor_names)
        )
    place, facing = measurements.anchor_position_m, measurements.anchor_orientation_rad
    for index, name in enumerate(scene.anchor_names):
        here, turn = scene.anchor_places[index], scene.anchor_orientations[index]
        both = min(
            len(here), 3 if place is None else place.shape[1]
        )  # tables made by hand may say no heights
        if place is not None and (
            not np.linalg.norm(place[index, :both] - here[:both]) < SAME_PLACE_M or place.shape[1] > len(here)
        ):
            found = f"anchor {name!r} at {place[index].tolist()} m"
            raise InputError("measurements: anchors", found, f"{here.tolist()} m, as in the scene")
        if facing is not None and not abs(wrap(facing[index] - turn)) < SAME_FACING_RAD:
            found = f"anchor {name!r} facing {facing[index]:.6g} rad"
            raise InputError("measurements: anchors", found, f"{turn:.6g} rad, as in the scene")


def _watcher(
    progress: bool | Callable[[Estimate, int, int], None], name: str, measurements: Observations
) -> AbstractContextManager[Callable[[Estimate, int, int], None] | None]:
    """Whoever is told of each step, if anyone."""
    if progress is True:
        from gridslam.runs.progress import progress_bar

        return progress_bar(name, measurements.truth)
    return nullcontext(progress if callable(progress) else None)
