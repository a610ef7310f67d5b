"""One mapping run: a scene and what an agent heard in, a `Run` out."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import psutil

from gridslam import runtime
from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.map import Map
from gridslam.measurements import Measurements
from gridslam.result import Run
from gridslam.scene import Scene
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.grid import GridSlam
from gridslam.systems.virtual_anchor import VirtualAnchorSlam
from gridslam.trajectory import Trajectory

METHODS = {"grid": GridSlam, "adaptive": AdaptiveSlam, "va": VirtualAnchorSlam}


def map_scene(
    scene: Scene,
    measurements: Measurements,
    method: str = "grid",
    agent: str | None = None,
    seed: int = 0,
    prior_map: Map | None = None,
    progress: Callable[[Estimate, int, int], None] | None = None,
) -> Run:
    """Run a method over all measurements of one agent.

    Parameters
    ----------
    scene : Scene
    measurements : Measurements
        Its truth, if it has one, is never read.
    method : str
        "grid" (paper 003), "adaptive" or "va" (paper 002 and its reference).
    agent : str, optional
        Default: the scene's first.
    seed : int
    prior_map : Map, optional
        What an earlier agent left.
    progress : callable, optional
        Called after every step with (estimate, steps done, steps in all).

    Returns
    -------
    Run
        Ends early, and says so, if it is interrupted (Ctrl-C).

    Raises
    ------
    InputError
        Unknown method or agent, or measurements of anchors that aren't the scene's.
    """
    if method not in METHODS:
        raise InputError("method", repr(method), ", ".join(METHODS))
    if tuple(measurements.anchors) != scene.anchor_names:
        raise InputError("measurements: anchors", str(measurements.anchors), str(scene.anchor_names))
    device = runtime.start()
    slam = METHODS[method](scene, prior_map=prior_map, agent=agent, seed=seed)
    estimates: list[Estimate] = []
    peak, interrupted, began = 0.0, False, time.perf_counter()
    try:
        for scan in measurements:
            estimates.append(slam.step(scan))
            peak = max(peak, psutil.Process().memory_info().rss / 2**20)
            if progress is not None:
                progress(estimates[-1], len(estimates), len(measurements))
    except KeyboardInterrupt:
        interrupted = True
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
        scene,
        slam.agent,
        method,
        seed,
        device,
        estimates,
        trajectory,
        np.array([e.covariance for e in estimates]),
        last.surfaces.take(last.detected),
        slam.map(),
        (time.perf_counter() - began) / len(estimates),
        peak,
        interrupted,
    )
