"""One mapping run: a scene and what an agent heard in, a `Run` out."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

import numpy as np
import psutil

from gridslam import runtime
from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.frames import SAME_PLACE_M
from gridslam.geometry import wrap
from gridslam.map import Map
from gridslam.measurements import Measurements
from gridslam.result import Run
from gridslam.scene import Scene
from gridslam.start import Start
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.grid import GridSlam
from gridslam.systems.virtual_anchor import VirtualAnchorSlam
from gridslam.trajectory import Trajectory

METHODS = {"grid": GridSlam, "adaptive": AdaptiveSlam, "va": VirtualAnchorSlam}
SAME_FACING_RAD = 1e-3


def map_scene(
    scene: Scene,
    measurements: Measurements,
    method: str = "grid",
    agent: str | None = None,
    seed: int = 0,
    prior_map: Map | None = None,
    progress: bool | Callable[[Estimate, int, int], None] = False,
    particles: int | None = None,
    watch: Callable[[Estimate, Callable[[], Map]], None] | None = None,
    start: Start | None = None,
) -> Run:
    """Run a method over all measurements of one agent.

    Parameters
    ----------
    scene : Scene
    measurements : Measurements
        Its truth, if it has one, is never read by the filter.
    method : str
        "grid" (paper 003), "adaptive" or "va" (paper 002 and its reference).
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
    start : Start, optional
        Told instead of the scene's own start, e.g. `gridslam.start.told_start(scene, agent, seed)`: drawn
        from the agent's prior, as `gridslam run` and `study` do where they simulate.

    Returns
    -------
    Run
        Ends early, and says so, if it is interrupted: Ctrl-C lets the step in hand finish, a second one
        doesn't (and raises `KeyboardInterrupt`).

    Raises
    ------
    InputError
        Unknown method or agent, a number of particles out of range, a map of another frame, or
        measurements of anchors that aren't the scene's.
    """
    if method not in METHODS:
        raise InputError("method", repr(method), ", ".join(METHODS))
    if particles is not None:
        scene = scene.with_filter(particles=particles)
    if agent is None and not scene.agents:
        raise InputError(f"{scene.name}: agents", "none", "at least one, to say where it starts")
    check_anchors(scene, measurements)
    device = runtime.start()
    slam = METHODS[method](scene, prior_map=prior_map, agent=agent, seed=seed)
    if start is not None:
        slam.start_at(start.position_m, start.heading_rad)
    estimates: list[Estimate] = []
    peak, began = 0.0, time.perf_counter()
    with _watcher(progress, slam.agent, measurements) as tell, _stop() as stopped:
        for scan in measurements:
            estimates.append(slam.step(scan))
            peak = max(peak, psutil.Process().memory_info().rss / 2**20)
            try:
                if tell is not None:
                    tell(estimates[-1], len(estimates), len(measurements))
                if watch is not None:
                    watch(estimates[-1], slam.map)
            except KeyboardInterrupt:
                stopped.set()
            if stopped.is_set():
                break
    if not estimates:
        raise InputError("measurements", "no step", "at least one step")
    last = estimates[-1]
    trajectory = Trajectory(
        np.array([e.time_s for e in estimates]),
        np.array([e.position_m for e in estimates]),
        np.array([e.velocity_mps for e in estimates]),
        np.array([e.heading_rad for e in estimates]),
    )
    return Run(
        scene=scene,
        agent=slam.agent,
        method=method,
        seed=seed,
        device=device,
        estimates=estimates,
        trajectory=trajectory,
        covariance=np.array([e.covariance for e in estimates]),
        surfaces=last.surfaces.take(last.detected),
        map=slam.map(),
        seconds_per_step=(time.perf_counter() - began) / len(estimates),
        peak_memory_mb=peak,
        interrupted=len(estimates) < len(measurements),
        start=start.how if start is not None else "exact",
    )


def check_anchors(scene: Scene, measurements: Measurements) -> None:
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
        here, turn = scene.anchor_positions[index], scene.anchor_orientations[index]
        if place is not None and not np.linalg.norm(place[index] - here) < SAME_PLACE_M:
            found = f"anchor {name!r} at {place[index].tolist()} m"
            raise InputError("measurements: anchors", found, f"{here.tolist()} m, as in the scene")
        if facing is not None and not abs(wrap(facing[index] - turn)) < SAME_FACING_RAD:
            found = f"anchor {name!r} facing {facing[index]:.6g} rad"
            raise InputError("measurements: anchors", found, f"{turn:.6g} rad, as in the scene")


def _watcher(
    progress: bool | Callable[[Estimate, int, int], None], name: str, measurements: Measurements
) -> AbstractContextManager[Callable[[Estimate, int, int], None] | None]:
    """Whoever is told of each step, if anyone."""
    if progress is True:
        from gridslam.progress import progress_bar

        return progress_bar(name, measurements.truth)
    return nullcontext(progress if callable(progress) else None)


@contextmanager
def _stop() -> Iterator[threading.Event]:
    """Set the event at the first Ctrl-C, so that no step is cut in half; let the second one through."""
    stopped = threading.Event()
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield stopped  # somebody else decides what Ctrl-C means
        return

    def ask(*_: object) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        stopped.set()

    signal.signal(signal.SIGINT, ask)
    try:
        yield stopped
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
