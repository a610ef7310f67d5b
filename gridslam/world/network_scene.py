"""A scene as a filter of several agents may know it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.errors import InputError, located
from gridslam.world.clocks import NS, ClockModel, Clocks
from gridslam.world.columns import require_within
from gridslam.world.filter_model import fixed
from gridslam.world.names import same_folder
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan
from gridslam.world.observation import Observation
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene
from gridslam.world.scene_parts import Agent, Anchor

FEW = 3
"""Distances of a scan from which on their unit is judged."""


def network_model(scene: Scene, agents: Sequence[str]) -> NetworkModel:
    """What a filter may know of a scene and some of its agents.

    Raises
    ------
    InputError
        No agents, one that isn't in the scene, or one twice.
    """
    require_agents(scene, agents)
    return NetworkModel(tuple(scene.filter_model(name) for name in agents), clock_model(scene, agents))


def require_agents(scene: Scene, agents: Sequence[str]) -> None:
    """Refuse a choice of agents that a network can't be made of.

    Raises
    ------
    InputError
        None, one that isn't in the scene, or one twice.
    """
    if not agents:
        raise InputError(f"{scene.name}: agents", "none", "at least one")
    for name in agents:
        scene.agent(name)
    folders = [same_folder(name) for name in agents]
    for index, name in enumerate(agents):
        if folders[index] in folders[:index]:
            raise InputError("agents", f"{name!r} twice", "each agent once")


def clock_model(scene: Scene, agents: Sequence[str] = ()) -> ClockModel:
    """What a filter may know of the clocks of a scene's anchors and of some agents.

    Raises
    ------
    InputError
        There is no agent of one of the names.
    """
    devices: tuple[Anchor | Agent, ...] = (*scene.anchors, *(scene.agent(name) for name in agents))
    anchors, clocks = len(scene.anchors), scene.clocks or Clocks(anchor_prior_ns=0.0)
    half = np.zeros(len(devices))
    if scene.clocks is not None:
        widest = 0.5 * scene.signal_model().span_m / NS
        half[:anchors] = widest if clocks.anchor_prior_ns is None else clocks.anchor_prior_ns
        half[anchors:] = clocks.agent_prior_ns
        for index, device in enumerate(devices):
            if device.clock is not None and device.clock.prior_ns is not None:
                half[index] = device.clock.prior_ns
            if device.name == clocks.reference:
                half[index] = 0.0
    return ClockModel(
        anchors, len(agents), fixed(NS * half), NS * clocks.walk_ns,
        NS * clocks.drift_prior_ppb / float(np.sqrt(3)), NS * clocks.drift_walk_ppb,
    )  # fmt: skip


def clocks_are_known(scene: Scene, agents: Sequence[str]) -> bool:
    """Whether the clocks of all anchors and of some agents are known."""
    return scene.clocks is None or bool(clock_model(scene, agents).known.all())


def require_known_clocks(scene: Scene, agent: str | None = None) -> None:
    """Refuse a scene with clocks that aren't known, for methods that take distances as they are.

    Raises
    ------
    InputError
        A clock isn't known, or there is no such agent.
    """
    if not clocks_are_known(
        scene, [agent] if agent is not None else [body.name for body in scene.agents[:1]]
    ):
        allowed = "none, or a method that finds them: network (network_grid maps cells, too)"
        raise InputError(f"{scene.name}: clocks", "clocks that aren't known", allowed)


def longest_m(scene: Scene) -> float:
    """Longest distance that the radio measures, m; none where clocks may add to it."""
    window = scene.radio.window_m
    most = scene.radio.max_distance_m if window is None else max(window[1], scene.radio.max_distance_m)
    return most if scene.clocks is None else np.inf


def require_in_reach(scan: Observation, scene: Scene) -> None:
    """Refuse what is heard first if it is in another unit, as `columns.require_within` refuses a table.

    Of few distances nothing is said: they may be false alarms.

    Raises
    ------
    InputError
        As there.
    """
    scans = scan.scans if isinstance(scan, NetworkScan) else (scan,)
    distances = [one.distance_m for one in scans if isinstance(one, Scan)]
    heard = np.concatenate([np.zeros(0), *distances])
    if np.isfinite(heard).sum() >= FEW:
        with located("scan"):
            require_within({"distance_m": heard}, longest_m(scene))
