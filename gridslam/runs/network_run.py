"""One run of several agents at once: a scene and what all of them heard in, a `NetworkRun` out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.inference.management.network.readout import NetworkEstimate
from gridslam.maps.map import Map
from gridslam.measurements.network import NetworkMeasurements
from gridslam.runs.map_scene import believed_track, check_anchors
from gridslam.runs.run import Run
from gridslam.runs.stopping import asked_to_stop
from gridslam.runs.unfinished import AgentCheckpoint
from gridslam.simulation.network import NetworkTruth
from gridslam.systems.network_front import NetworkFront
from gridslam.systems.registry import method_class
from gridslam.world.clocks import ClockTruth
from gridslam.world.scene import Scene
from gridslam.world.start import Start

SETTLED = 101
"""Step from which on clocks are compared with the bound, as in [Venus2025network], section VI."""
PS = 1e12


@dataclass(frozen=True, eq=False)
class ClockTrack:
    """Estimated offsets of all clocks over time.

    Attributes
    ----------
    device : tuple of str, D = J + I names
        Anchors, then agents.
    anchors : int
        J.
    step : (N,) int
    time_s : (N,)
    offset_s : (N, D)
        What all have in common can't be observed.
    covariance_s2 : (N, D, D)
    unset : (N, J) bool
        Anchors whose clocks were still searched for.
    """

    device: tuple[str, ...]
    anchors: int
    step: NDArray[np.intp]
    time_s: Array
    offset_s: Array
    covariance_s2: Array
    unset: NDArray[np.bool_]

    @classmethod
    def of(cls, estimates: list[NetworkEstimate], anchors: int) -> ClockTrack:
        """Of all steps of a run."""
        return cls(
            estimates[0].device,
            anchors,
            np.array([e.step for e in estimates]),
            np.array([e.time_s for e in estimates]),
            np.array([e.offset_s for e in estimates]),
            np.array([e.offset_covariance_s2 for e in estimates]),
            np.array([e.unset for e in estimates]),
        )

    @property
    def deviation_s(self) -> Array:
        """Standard deviations of the offsets, (N, D) s."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.covariance_s2, axis1=1, axis2=2), 0)))

    def errors(self, truth: ClockTruth) -> Array:
        """Estimated minus true offsets, (N, D) s.

        Raises
        ------
        InputError
            A device of which the truth isn't known.
        """
        for name in self.device:
            if name not in truth.device:
                raise InputError("clocks: device", repr(name), ", ".join(truth.device))
        own = [truth.device.index(name) for name in self.device]
        there = [np.interp(self.time_s, truth.time_s, truth.offset_s[:, column]) for column in own]
        return self.offset_s - np.stack(there, -1)


@dataclass(frozen=True, eq=False)
class NetworkRun:
    """A run of several agents.

    Attributes
    ----------
    runs : dict of str to Run
        One for each agent, with the map of all.
    clocks : ClockTrack
    anchor : (K,) int
        The anchor that each measurement was believed to be of; -1 for clutter and doubt.
    interrupted : bool
        Whether it was stopped before the last step.
    """

    runs: dict[str, Run]
    clocks: ClockTrack
    anchor: NDArray[np.intp]
    interrupted: bool = False

    @property
    def map(self) -> Map:
        """The map at the end."""
        return next(iter(self.runs.values())).map

    def score(self, clocks: ClockTruth | None = None, truth: NetworkTruth | None = None) -> dict[str, Any]:
        """Scores of clocks and labels: what ``run.json`` calls ``network``. What lacks its truth is None.

        Parameters
        ----------
        clocks : ClockTruth, optional
            True offsets.
        truth : NetworkTruth, optional
            Of a simulation: gives the bound and label errors, too.
        """
        from gridslam.evaluation.metrics import rmse
        from gridslam.evaluation.network_bounds import network_bound
        from gridslam.evaluation.network_scores import (
            apparent_biases,
            label_errors,
            steps_to_synchronise,
            without_common,
        )

        scores: dict[str, Any] = dict.fromkeys(NETWORK_KEYS)
        count = len(self.clocks.step)
        late = slice(min(SETTLED, count // 2), None)
        if clocks is not None:
            error = self.clocks.errors(clocks)
            names = self.clocks.device[: self.clocks.anchors]
            scores["apparent_bias_rmse_ps"] = PS * rmse(
                apparent_biases(error, self.clocks.anchors)[late].ravel()
            )
            scores["bias_rmse_without_common_ps"] = PS * rmse(without_common(error)[late].ravel())
            scores["steps_to_synchronise"] = dict(zip(names, steps_to_synchronise(error), strict=False))
        if truth is not None:
            scene = next(iter(self.runs.values())).scene
            bound = network_bound(scene, truth)
            scores["bound_ps"] = PS * rmse(bound.apparent_bias_s[:count][late])
            done = len(self.anchor)
            wrong, judged = label_errors(self.anchor, truth.source[:done])
            scores |= {"label_errors": wrong, "labels_judged": judged}
            position = bound.position_m[:count][late]
            scores["position_bound_m"] = rmse(position[np.isfinite(position)])
        return scores


NETWORK_KEYS = (
    "apparent_bias_rmse_ps",
    "bias_rmse_without_common_ps",
    "bound_ps",
    "position_bound_m",
    "steps_to_synchronise",
    "label_errors",
    "labels_judged",
)


def map_network(
    scene: Scene,
    measurements: NetworkMeasurements,
    seed: int = 0,
    prior_map: Map | None = None,
    particles: int | None = None,
    starts: Mapping[str, Start] | None = None,
    progress: Callable[[NetworkEstimate, int, int], None] | None = None,
    same_frame: bool = False,
    method: str = "network",
    watch: Callable[[NetworkEstimate, Callable[[], Map]], None] | None = None,
    checkpoint: AgentCheckpoint | None = None,
) -> NetworkRun:
    """Run network SLAM over the measurements of several agents.

    Parameters
    ----------
    scene : Scene
    measurements : NetworkMeasurements
        Their truth, if they have one, is never read by the filter.
    seed : int
    prior_map : Map, optional
        What an earlier agent left.
    particles : int, optional
        Instead of ``scene.filter.particles``.
    starts : dict of str to Start, optional
        Told instead of the scene's own starts.
    progress : callable, optional
        Gets (estimate, steps done, steps in all) after every step.
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.
    method : str
        One that takes several agents: "network", or "network_grid" for a grid of all.
    watch : callable, optional
        Gets, after every step, the estimate and a function that returns the map as it stands.
    checkpoint : AgentCheckpoint, optional
        As that of `gridslam.map_scene`.

    Returns
    -------
    NetworkRun
        Ends early, and says so, if it is interrupted.

    Raises
    ------
    InputError
        One agent's measurements, agents or anchors that aren't the scene's, negative distances where it has
        no clocks, a number of particles out of range, or a map of another frame.
    """
    scene = scene if particles is None else scene.with_filter(particles=particles)
    check_network(scene, measurements)
    device, names = runtime.start(), measurements.agents
    system = method_class(method)
    if not issubclass(system, NetworkFront):
        raise InputError("method", repr(method), "one for several agents at once")
    peak, spent = 0.0, 0.0
    resumed = checkpoint.resumed(system) if checkpoint is not None else None
    if checkpoint is not None and resumed is not None:
        slam, estimates = resumed
        peak, spent = checkpoint.progress.peak_mb, checkpoint.progress.seconds
    else:
        slam = system(scene, prior_map, seed=seed, same_frame=same_frame, agents=names)
        estimates = list[NetworkEstimate]()
        if starts is not None:
            slam.start_all(starts)
    began = time.perf_counter() - spent
    with asked_to_stop() as stopped:
        for scan in islice(iter(measurements), len(estimates), None):
            estimates.append(slam.step(scan))
            peak = max(peak, psutil.Process().memory_info().rss / 2**20)
            try:
                if progress is not None:
                    progress(estimates[-1], len(estimates), len(measurements))
                if watch is not None:
                    watch(estimates[-1], slam.map)
            except KeyboardInterrupt:
                stopped.set()
            if checkpoint is not None:
                checkpoint.keep(slam, estimates, time.perf_counter() - began, peak, now=stopped.is_set())
            if stopped.is_set():
                break
    if not estimates:
        raise InputError("measurements", "no step", "at least one step")
    seconds = (time.perf_counter() - began) / len(estimates)
    interrupted, sheet = len(estimates) < len(measurements), slam.map()
    runs = {}
    for name in names:
        own = [e for e in (one.agents[name] for one in estimates) if e is not None]
        if own:
            how = starts[name].how if starts and name in starts else "exact"
            runs[name] = _run(scene, name, method, seed, device, own, sheet, seconds, peak, interrupted, how)
    rows = measurements.table.step < len(estimates)
    given = np.full(int(rows.sum()), -1, np.intp)
    for one in estimates:
        for index, name in enumerate(names):
            if name in one.anchor:
                given[(measurements.table.step == one.step)[rows] & (measurements.agent[rows] == index)] = (
                    one.anchor[name]
                )
    return NetworkRun(runs, ClockTrack.of(estimates, len(scene.anchors)), given, interrupted)


def check_network(scene: Scene, measurements: NetworkMeasurements) -> None:
    """Refuse measurements of other agents or anchors than the scene's, and distances that can't be.

    Raises
    ------
    InputError
        The first that is found.
    """
    if not isinstance(measurements, NetworkMeasurements):
        found = type(measurements).__name__
        raise InputError("measurements", found, "NetworkMeasurements of several agents (one: gs.map_scene)")
    check_names(scene, measurements)
    negative = np.flatnonzero(measurements.table.distance_m <= 0)
    if scene.clocks is None and len(negative):
        found = f"{measurements.table.distance_m[negative[0]]:.6g}"
        raise InputError("measurements: distance_m", found, "above 0, in a scene without [clocks]")


def check_names(scene: Scene, measurements: NetworkMeasurements) -> None:
    """Refuse measurements of other agents or anchors than the scene's.

    Raises
    ------
    InputError
        The first that is found.
    """
    for name in measurements.agents:
        if name not in [agent.name for agent in scene.agents]:
            known = ", ".join(agent.name for agent in scene.agents)
            raise InputError("measurements: agents", repr(name), known or "none here")
    check_anchors(scene, measurements.table)


def _run(
    scene: Scene, name: str, method: str, seed: int, device: str, own: list[Estimate], sheet: Map,
    seconds: float, peak: float, interrupted: bool, how: str,
) -> Run:  # fmt: skip
    track = believed_track(own, scene.agent(name).height_m)
    return Run(
        scene, name, method, seed, device, own, track, np.array([e.covariance for e in own]),
        own[-1].surfaces.take(own[-1].detected), sheet, seconds, peak, interrupted, how,
    )  # fmt: skip
