"""One run of several agents at once: a scene and what all of them heard in, a `NetworkRun` out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.errors import InputError
from gridslam.inference.management.network.readout import NetworkEstimate
from gridslam.maps.map import Map
from gridslam.measurements.network import NetworkMeasurements
from gridslam.runs.clock_track import ClockTrack
from gridslam.runs.heard_stretches import map_so_far
from gridslam.runs.map_scene import believed_track, check_anchors
from gridslam.runs.run import Run
from gridslam.runs.steps import resumed_or_started, run_steps
from gridslam.runs.stopping import StoppedLate, held_back
from gridslam.runs.summary import NETWORK, blank
from gridslam.runs.unfinished import AgentCheckpoint
from gridslam.simulation.image_source import Truth
from gridslam.simulation.network import NetworkTruth
from gridslam.systems.network_front import NetworkFront
from gridslam.systems.registry import method_class
from gridslam.world.clocks import ClockTruth
from gridslam.world.columns import require_distances, require_within
from gridslam.world.network_scene import longest_m
from gridslam.world.scene import Scene
from gridslam.world.start import Start, require_scene, start_of
from gridslam.world.trajectory import Trajectory

SETTLED = 101
"""Step from which on clocks are compared with the bound, as in [Venus2025network], section VI."""
PS = 1e12


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
            told_errors,
        )

        scores: dict[str, Any] = blank(NETWORK)
        count = len(self.clocks.step)
        late = slice(min(SETTLED, count // 2), None)
        if clocks is not None:
            error = self.clocks.errors(clocks)
            names = self.clocks.device[: self.clocks.anchors]
            scores["apparent_bias_rmse_ps"] = PS * rmse(
                apparent_biases(error, self.clocks.anchors)[late].ravel()
            )
            settled = next(iter(self.runs.values())).scene.clocks
            error = told_errors(error, self.clocks.device, settled.reference if settled is not None else None)
            scores["bias_rmse_without_common_ps"] = PS * rmse(error[late].ravel())
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


def network_scores(
    done: NetworkRun, measurements: NetworkMeasurements, truth: NetworkTruth | None
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Scores of every agent, as of `Run.score`, and those of clocks and labels, as of `NetworkRun.score`.

    Parameters
    ----------
    truth : NetworkTruth or None
        Of a simulation; None for recorded measurements, whose agents are judged by their true tracks, and map
        and surfaces by what those of them whose tracks are known could hear of the scene's walls.
    """
    whole = done.score(measurements.clocks, truth)
    own: dict[str, Truth | Trajectory | None]
    if truth is None:
        own = {name: _recorded_truth(run, measurements.tracks.get(name)) for name, run in done.runs.items()}
    else:
        own = {name: truth.agents[name].first(len(run.estimates)) for name, run in done.runs.items()}
    scores = []
    for name, run in done.runs.items():  # the map is of all that any of them heard
        others = [other for one, other in own.items() if one != name and isinstance(other, Truth)]
        scores.append(run.score(own[name], others))
    return scores, whole


def _recorded_truth(run: Run, track: Trajectory | None) -> Truth | Trajectory | None:
    """What is known of an agent's way by its true track, and its paths where the scene has walls."""
    from gridslam.evaluation.ground_truth import truth_of

    if track is None or not len(run.trajectory):
        return track
    times, slack = run.trajectory.time_s, 1e-6 * max(1.0, float(np.ptp(track.time_s)))
    if times[0] < track.time_s[0] - slack or times[-1] > track.time_s[-1] + slack:
        return track  # which is refused
    return truth_of(run.scene, run.agent, track.at(times))


def map_network(
    scene: Scene,
    measurements: NetworkMeasurements,
    seed: int = 0,
    prior_map: Map | None = None,
    particles: int | None = None,
    starts: Mapping[str, Start] | str | None = None,
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
    starts : "drawn", "exact" or dict of str to Start, optional
        What is told of agents' starts, as `gridslam.map_scene` says, and its default; of agents that a
        dictionary leaves out, the scene's own.
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
        Ends early, and says so, if it is interrupted; as `gridslam.map_scene` does.

    Raises
    ------
    InputError
        One agent's measurements, agents or anchors that aren't the scene's, negative distances where it has
        no clocks, a number of particles out of range, or a map of another frame.
    """
    check_network(scene, measurements)
    scene = scene if particles is None else scene.with_filter(particles=particles)
    device, names = runtime.start(), measurements.agents
    system = method_class(method)
    if not issubclass(system, NetworkFront):
        raise InputError("method", repr(method), "one for several agents at once")

    simulated = measurements.table.simulated is not None
    if isinstance(starts, Mapping):
        told, own = starts, "exact" if simulated else None
        began = {name: told.get(name) or start_of(scene, name, seed, own, simulated) for name in names}
    else:
        began = {name: start_of(scene, name, seed, starts, simulated) for name in names}
        told = {name: one for name, one in began.items() if one.how == "drawn"}  # else the scene's

    def start() -> NetworkFront[Any]:
        slam = system(scene, prior_map, seed=seed, same_frame=same_frame, agents=names)
        if told:
            slam.start_all(told)
        return slam

    slam, before = resumed_or_started(system, checkpoint, start)
    done = run_steps(slam.step, slam, measurements, before, progress, watch, checkpoint)
    with held_back() as asked:
        estimates = done.estimates
        final_map = map_so_far(slam, estimates, prior_map)
        interrupted, runs = len(estimates) < len(measurements), {}
        for name in names:
            own = [one for one in (all_of.agents[name] for all_of in estimates) if one is not None]
            if not own:
                continue
            runs[name] = Run(
                scene=scene,
                agent=name,
                method=method,
                seed=seed,
                device=device,
                estimates=own,
                trajectory=believed_track(own, scene.agent(name).height_m),
                covariance=np.array([one.covariance for one in own]),
                surfaces=own[-1].surfaces.take(own[-1].detected),
                map=final_map,
                seconds_per_step=done.seconds_per_step,
                peak_memory_mb=done.peak_memory_mb,
                began=began[name],
                interrupted=interrupted,
            )
        clocks = ClockTrack.of(estimates, len(scene.anchors))
        whole = NetworkRun(runs, clocks, _labels(measurements, estimates), interrupted)
    if asked.is_set():
        raise StoppedLate(whole)
    return whole


def _labels(measurements: NetworkMeasurements, estimates: Sequence[NetworkEstimate]) -> NDArray[np.intp]:
    """The anchor that each measurement of these steps was believed to be of, -1 for none."""
    rows = measurements.table.step < len(estimates)
    given = np.full(int(rows.sum()), -1, np.intp)
    for one in estimates:
        for index, name in enumerate(measurements.agents):
            if name in one.anchor:
                own = (measurements.table.step == one.step) & (measurements.agent == index)
                given[own[rows]] = one.anchor[name]
    return given


def check_network(scene: Scene, measurements: NetworkMeasurements) -> None:
    """Refuse measurements of other agents or anchors than the scene's, no distances, and some that can't be.

    Raises
    ------
    InputError
        The first that is found.
    """
    require_scene(scene)
    if not isinstance(measurements, NetworkMeasurements):
        found = type(measurements).__name__
        raise InputError("measurements", found, "NetworkMeasurements of several agents (one: gs.map_scene)")
    check_names(scene, measurements)
    require_distances(measurements.table.columns)
    require_within(measurements.table.columns, longest_m(scene))
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
