"""What network SLAM as published believes: particles of agents, clocks and virtual anchors, each apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.state.published.feature_particles import Features
from gridslam.world.network_model import NetworkModel

CLOCK = 5
"""Entry of an agent's own clock."""


@dataclass(frozen=True, eq=False)
class NetworkParticleState:
    """Equally weighted particles of I agents, J clocks and all virtual anchors.

    Attributes
    ----------
    agents : (I, P, 6) m, m/s, rad, m
        Position, velocity, heading, clock.
    clocks : (J, P) m
        Of the anchors.
    features : Features
        Potential virtual anchors; `anchor` is whose each is, `intensity` isn't used.
    here : (I,) bool
        Which agents were there at the latest step.
    step, next_identity : int
    time_s : float or None
    """

    agents: Array
    clocks: Array
    features: Features
    here: NDArray[np.bool_]
    step: int = 0
    next_identity: int = 0
    time_s: float | None = None

    @classmethod
    def start(cls, model: NetworkModel) -> Self:
        """Particles of all priors, uniform as the scene says, and no virtual anchors."""
        count, several, anchors = model.settings.particles, len(model.agents), len(model.anchors)
        draw = np.random.default_rng([count, anchors, several, model.agents[0].seed])
        agents = np.empty((several, count, CLOCK + 1))
        for number, own in enumerate(model.agents):
            half = np.sqrt(3 * own.start_variance)
            agents[number, :, :CLOCK] = own.start_mean + half * draw.uniform(-1, 1, (count, CLOCK))
        width = model.clocks.half_width_m[:, None]
        offsets = width * draw.uniform(-1, 1, (anchors + several, count))
        agents[:, :, CLOCK] = offsets[anchors:]
        none = np.zeros(0, np.int64)
        features = Features(
            none, none, np.zeros(0, bool), np.zeros(0), np.zeros((0, count, 2)), np.zeros((0, count))
        )
        return cls(agents, offsets[:anchors], features, np.zeros(several, bool))
