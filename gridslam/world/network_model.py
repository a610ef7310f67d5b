"""What a filter of several agents may know of a scene: each agent's model, and the clocks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from gridslam.arrays import Array
from gridslam.world.clocks import ClockModel
from gridslam.world.filter_model import FilterModel
from gridslam.world.filter_settings import FilterSettings


@dataclass(frozen=True, eq=False)
class NetworkModel:
    """All that inference about several agents is handed of a scene; `gridslam.world.network_scene` makes one.

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
    def origin_m(self) -> Array:
        """Where its origin lies in the scene's coordinates, (2,) m."""
        return self.agents[0].origin_m

    @property
    def anchor_names(self) -> tuple[str, ...]:
        """Names of the anchors."""
        return self.agents[0].anchor_names
