"""What a filter of several agents may know of a scene: each agent's model, and the clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.world.clocks import NS, ClockModel, Clocks
from gridslam.world.filter_model import FilterModel, fixed
from gridslam.world.names import same_folder
from gridslam.world.scene import Scene
from gridslam.world.scene_parts import Agent, Anchor, FilterSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NetworkModel:
    """All that inference about several agents is handed of a scene; `network_model` makes one.

    Attributes
    ----------
    agents : tuple of FilterModel
        One for each agent, in the order in which they are heard within a step; all of the same anchors.
    clocks : ClockModel
    """

    agents: tuple[FilterModel, ...]
    clocks: ClockModel

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the agents."""
        return tuple(model.agent for model in self.agents)

    @property
    def agent(self) -> str:
        """Names of the agents, with commas between."""
        return ",".join(self.names)

    @property
    def settings(self) -> FilterSettings:
        """Settings of the filter."""
        return self.agents[0].settings

    @property
    def anchors(self) -> Array:
        """The anchors, (J, 3): x, y (m) and orientation (rad)."""
        return self.agents[0].anchors

    @property
    def anchor_positions(self) -> Array:
        """Where the anchors stand, (J, 2) m."""
        return self.agents[0].anchor_positions

    @property
    def anchor_names(self) -> tuple[str, ...]:
        """Names of the anchors."""
        return self.agents[0].anchor_names


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
