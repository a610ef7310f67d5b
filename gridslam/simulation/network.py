"""What several agents would hear at once, of anchors that nobody tells apart and clocks that nobody set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.table import Measurements
from gridslam.simulation.clocks import apparent_bias, clock_truth
from gridslam.simulation.image_source import Truth, true_paths
from gridslam.simulation.image_source import simulate as simulate_one
from gridslam.simulation.reception import received
from gridslam.world.clocks import ClockTruth
from gridslam.world.network_scene import require_agents
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

STREAM = 0x5F
Names = list[str] | tuple[str, ...]


@dataclass(frozen=True, eq=False)
class NetworkTruth:
    """Everything that is known of a network only in simulation.

    Attributes
    ----------
    agents : dict of str to Truth
        Steps of paths count from the agent's first.
    first : dict of str to int
        The agent's first step, of all steps.
    cause : (K,) int
        Row in the agent's paths that caused each measurement; -1 for clutter.
    source : (K,) int
        Anchor that caused each measurement; -1 for clutter.
    clocks : ClockTruth
    """

    agents: dict[str, Truth]
    first: dict[str, int]
    cause: NDArray[np.intp]
    source: NDArray[np.intp]
    clocks: ClockTruth


@overload
def simulate(scene: Scene, agent: str, seed: int = 0) -> Measurements: ...
@overload
def simulate(scene: Scene, agent: Names, seed: int = 0, unlabelled: bool = False) -> NetworkMeasurements: ...
def simulate(
    scene: Scene, agent: str | Names, seed: int = 0, unlabelled: bool = False
) -> Measurements | NetworkMeasurements:
    """Measurements of one agent on its track, or of several: detected paths with noise, and clutter.

    Paths by image sources [Borish1984image], the rest by docs/model.md, (M9)-(M13).

    Parameters
    ----------
    scene : Scene
    agent : str or sequence of str
        One agent's name gives `Measurements`, a list of names `NetworkMeasurements`.
    seed : int
    unlabelled : bool
        Of several agents: nothing says whose a measurement is, and ``radio.false_alarms`` counts the clutter
        of all anchors together.

    Raises
    ------
    InputError
        No such agent, one without waypoints, or several whose steps take different times.

    Examples
    --------
    >>> import gridslam as gs
    >>> heard = gs.simulate(gs.Scene.load("room"), "agent1", seed=1)
    >>> heard.anchors
    ('A', 'B')
    >>> gs.simulate(gs.Scene.load("room"), ["agent1"], seed=1, unlabelled=True).scan(0).scans[0].anchor[:3]
    array([-1, -1, -1])
    """
    if isinstance(agent, str):
        return simulate_one(scene, agent, seed)
    return simulate_network(scene, agent, seed, unlabelled)[0]


def simulate_network(
    scene: Scene, names: Sequence[str], seed: int = 0, unlabelled: bool = False
) -> tuple[NetworkMeasurements, NetworkTruth]:
    """As `simulate` of several agents, with the truth. With and without labels of one seed differ in more.

    Labels can be taken away from measurements that have some: `NetworkMeasurements.without_labels`.
    """
    heard, truth = shared_air(scene, names, seed, len(scene.anchors) if unlabelled else 1)
    return (heard.without_labels() if unlabelled else heard), truth


def shared_air(
    scene: Scene, names: Sequence[str], seed: int = 0, sharing: int = 1
) -> tuple[NetworkMeasurements, NetworkTruth]:
    """Labelled measurements of several agents, rows of a step in random order.

    Parameters
    ----------
    sharing : int
        How many anchors ``radio.false_alarms`` counts together: the clutter of each is this share of it, so
        that labels may be taken away afterwards, and what was heard stays the same.

    Raises
    ------
    InputError
        No such agent, one without waypoints, or several whose steps take different times.
    """
    require_agents(scene, names)
    interval = scene.agent(names[0]).interval_s
    tables, truths, firsts = [], dict[str, Truth](), dict[str, int]()
    for index, name in enumerate(names):
        if scene.agent(name).interval_s != interval:
            where = f"{scene.name}: agents[{scene.agents.index(scene.agent(name))}].interval_s"
            raise InputError(where, str(scene.agent(name).interval_s), f"{interval}, as of {names[0]!r}")
        first, track = presence(scene, name)
        paths = true_paths(scene, name, track)
        rate = scene.radio.false_alarms / sharing
        offset = apparent_bias(scene, name, track.time_s, seed) if scene.clocks is not None else None
        columns, cause = received(paths, scene, name, seed, len(track), offset, rate)
        columns["step"] = columns["step"] + first
        tables.append(columns | {"cause": cause, "agent": np.full(len(cause), index)})
        truths[name], firsts[name] = Truth(track, paths, scene.segments()), first
    whole = {key: np.concatenate([table[key] for table in tables]) for key in tables[0]}
    # by what doesn't depend on clocks, so that these don't change which rows come first
    ranked = np.lexsort((whole["aoa_rad"], whole["cause"], whole["agent"], whole["step"]))
    draw = np.empty(len(ranked))
    draw[ranked] = np.random.default_rng([seed, STREAM]).random(len(ranked))
    order = np.lexsort((draw, whole["agent"], whole["step"]))
    rows: dict[str, Any] = {key: column[order] for key, column in whole.items()}
    cause, agent = rows.pop("cause"), rows.pop("agent")
    source = np.where(cause < 0, -1, rows["anchor"])
    steps = max(firsts[name] + len(truths[name].trajectory) for name in names)
    present = [[firsts[name], firsts[name] + len(truths[name].trajectory) - 1] for name in names]
    clocks = clock_truth(scene, names, _times(interval, 0, steps), seed)
    table = Measurements(
        anchors=scene.anchor_names,
        anchor_position_m=scene.anchor_places,
        anchor_orientation_rad=scene.anchor_orientations,
        interval_s=interval,
        steps=steps,
        time_s=interval * rows["step"],
        pseudo=scene.clocks is not None,
        **rows,
    )
    tracks = {name: truth.trajectory for name, truth in truths.items()}
    known = clocks if scene.clocks is not None else None
    heard = NetworkMeasurements(tuple(names), table, agent, np.array(present), tracks, known)
    return heard, NetworkTruth(truths, firsts, cause, source, clocks)


def presence(scene: Scene, name: str) -> tuple[int, Trajectory]:
    """First step at which an agent is there, and its track from then on, for as long as it stays."""
    body, track = scene.agent(name), scene.track(name)
    if body.present_s is None:
        return 0, track
    first = int(np.ceil(body.present_s[0] / body.interval_s - 1e-9))
    count = min(len(track), int(np.floor(body.present_s[1] / body.interval_s + 1e-9)) - first + 1)
    if count < 1:
        where = f"{scene.name}: agents[{scene.agents.index(body)}].present_s"
        raise InputError(where, str(list(body.present_s)), f"at least a step of {body.interval_s} s")
    time = _times(body.interval_s, first, count)
    return first, replace(
        track,
        time_s=time,
        position_m=track.position_m[:count],
        velocity_mps=track.velocity_mps[:count],
        heading_rad=track.heading_rad[:count],
    )


def _times(interval_s: float, first: int, count: int) -> Array:
    return np.asarray(interval_s * (first + np.arange(count)), np.float64)
