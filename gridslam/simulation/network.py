"""What several agents would hear at once, of anchors that nobody tells apart and clocks that nobody set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.simulated import Simulated
from gridslam.measurements.table import Measurements
from gridslam.simulation.clocks import apparent_bias, clock_truth
from gridslam.simulation.image_source import Truth, true_paths
from gridslam.simulation.image_source import simulate as simulate_one
from gridslam.simulation.reception import received
from gridslam.simulation.true_paths import TruePaths
from gridslam.world.clocks import ClockTruth
from gridslam.world.columns import OPTIONAL, VALUES
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
    measurements, truth = shared_air(scene, names, seed, len(scene.anchors) if unlabelled else 1)
    return (measurements.without_labels() if unlabelled else measurements), truth


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
    for name in names:
        if scene.agent(name).interval_s != interval:
            where = f"{scene.name}: agents[{scene.agents.index(scene.agent(name))}].interval_s"
            raise InputError(where, str(scene.agent(name).interval_s), f"{interval}, as of {names[0]!r}")
    there = {name: presence(scene, name) for name in names}
    steps = max(first + len(track) for first, track in there.values())
    times = _times(interval, 0, steps)
    paths = {name: true_paths(scene, name, track) for name, (_, track) in there.items()}
    present = {name: (first, first + len(track) - 1) for name, (first, track) in there.items()}
    rows, cause, agent = _received_rows(
        scene, paths, present, times, seed, scene.radio.false_alarms / sharing
    )
    source = np.where(cause < 0, -1, rows["anchor"])
    clocks = clock_truth(scene, names, times, seed)
    table = Measurements(
        anchors=scene.anchor_names,
        anchor_position_m=scene.anchor_places,
        anchor_orientation_rad=scene.anchor_orientations,
        interval_s=interval,
        steps=steps,
        pseudo=scene.clocks is not None,
        simulated=Simulated(scene.name, tuple(names), seed),
        **rows,
    )
    truths = {name: Truth(track, paths[name], scene.segments()) for name, (_, track) in there.items()}
    tracks = {name: track for name, (_, track) in there.items()}
    known, spans = clocks if scene.clocks is not None else None, np.array(list(present.values()))
    measurements = NetworkMeasurements(tuple(names), table, agent, spans, tracks, known)
    firsts = {name: first for name, (first, _) in there.items()}
    return measurements, NetworkTruth(truths, firsts, cause, source, clocks)


def receive_network(
    clean: NetworkMeasurements, scene: Scene, seed: int = 0, unlabelled: bool = False
) -> NetworkMeasurements:
    """What the scene's radio and clocks would make of several agents' exact paths, as of a ray tracer.

    Noise, missed paths, clutter, offsets of clocks and the order of rows as in `simulate`; every path needs
    all four quantities.

    Parameters
    ----------
    clean : NetworkMeasurements
        With labels, as `gs.network_from_sionna` makes them.
    unlabelled : bool
        As of `simulate`.

    Raises
    ------
    InputError
        The anchors or agents aren't the scene's, a label or a quantity is missing.
    """
    if clean.table.anchors != scene.anchor_names:
        raise InputError("measurements: anchors", str(clean.table.anchors), str(scene.anchor_names))
    require_agents(scene, clean.agents)
    if (clean.table.anchor < 0).any():
        raise InputError("measurements: anchor", "rows without it", "the anchor of every path")
    for name in VALUES:
        if np.isnan(getattr(clean.table, name)).any():
            raise InputError(f"measurements: {name}", "paths without it", "a value for every path")
    times, spans = clean.table.times_s, np.asarray(clean.present)
    present = {name: (int(first), int(last)) for name, (first, last) in zip(clean.agents, spans, strict=True)}
    parts = {name: clean[name] for name in clean.agents}
    paths = {name: replace(part, step=part.step - present[name][0]) for name, part in parts.items()}
    rate = scene.radio.false_alarms / (len(scene.anchors) if unlabelled else 1)
    rows, _, agent = _received_rows(scene, paths, present, times, seed, rate)
    known = scene.clocks is not None
    changes = {**dict.fromkeys(OPTIONAL), **rows, "steps": len(clean), "pseudo": known}
    clocks = clock_truth(scene, clean.agents, times, seed) if known else None
    measurements = replace(clean, table=replace(clean.table, **changes), agent=agent, clocks=clocks)
    return measurements.without_labels() if unlabelled else measurements


def _received_rows(
    scene: Scene,
    paths: Mapping[str, TruePaths | Measurements],
    present: Mapping[str, tuple[int, int]],
    times: Array,
    seed: int,
    rate: float,
) -> tuple[dict[str, Any], NDArray[np.intp], NDArray[np.intp]]:
    """Rows of all agents in random order within a step, the path of each (-1: clutter), and its agent.

    Parameters
    ----------
    paths
        Of each agent; their steps count from its first.
    present
        First and last step of each.
    times : (N,) s
    rate : float
        Clutter of each anchor, per step.
    """
    tables = []
    for index, (name, own) in enumerate(paths.items()):
        first, last = present[name]
        there = times[first : last + 1]
        offset = apparent_bias(scene, name, there, seed) if scene.clocks is not None else None
        columns, cause = received(own, scene, name, seed, len(there), offset, rate)
        columns["step"] = columns["step"] + first
        tables.append(columns | {"cause": cause, "agent": np.full(len(cause), index)})
    whole = {
        key: np.concatenate([table.get(key, np.full(len(table["step"]), np.nan)) for table in tables])
        for key in dict.fromkeys(key for table in tables for key in table)
    }  # one agent's array may measure elevations that another's doesn't
    # by what doesn't depend on clocks, so that these don't change which rows come first
    ranked = np.lexsort((whole["aoa_rad"], whole["cause"], whole["agent"], whole["step"]))
    draw = np.empty(len(ranked))
    draw[ranked] = np.random.default_rng([seed, STREAM]).random(len(ranked))
    order = np.lexsort((draw, whole["agent"], whole["step"]))
    rows: dict[str, Any] = {key: column[order] for key, column in whole.items()}
    rows["time_s"] = times[rows["step"]]
    return rows, rows.pop("cause"), rows.pop("agent")


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
        height_m=None if track.height_m is None else track.height_m[:count],
    )


def _times(interval_s: float, first: int, count: int) -> Array:
    return np.asarray(interval_s * (first + np.arange(count)), np.float64)
