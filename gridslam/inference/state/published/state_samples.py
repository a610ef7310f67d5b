"""The papers' representation: equally weighted particles of the agent and of every surface, each apart."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT, HEADING, POSE
from gridslam.kernels import PATH_BLOCK
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap

LEAST_VARIANCE = 1e-10
"""Added to variances, so that particles that are all the same have a covariance."""


@dataclass(frozen=True, eq=False)
class StateSamples:
    """Particles of agent and surfaces, in independent orders ([Li2025adaptive], section V-D).

    Attributes
    ----------
    agent : (P, 5) m, m/s, rad
        x, y, vx, vy, heading.
    lines : (S, P, 2)
        Normal angle (rad) and offset (m) of every surface.
    identity : (S,) int64
        Of the surfaces.
    """

    agent: Array
    lines: Array
    identity: NDArray[np.int64]

    @classmethod
    def start(cls, model: FilterModel) -> Self:
        """Particles of the agent's prior, uniform as the scene says, and no surfaces."""
        count = -(-model.settings.particles // PATH_BLOCK) * PATH_BLOCK
        draw = np.random.default_rng([count, len(model.anchors), model.seed])
        half = np.sqrt(3 * model.start_variance)
        agent = model.start_mean + half * draw.uniform(-1, 1, (count, AGENT))
        return cls(agent, np.zeros((0, count, 2)), np.zeros(0, np.int64))

    def __len__(self) -> int:
        return len(self.agent)

    def shifted(self, pose: Array) -> Self:
        """The same about another mean of x, y and heading (3,)."""
        mean = self.moments().mean[POSE]
        off = np.zeros(AGENT)
        off[POSE] = pose - mean
        return replace(self, agent=self.agent + off)

    def moments(self) -> Belief:
        """The Gaussian with their means and covariances; between agent and surfaces there is none."""
        size = AGENT + 2 * len(self.lines)
        heading = np.angle(np.exp(1j * self.agent[:, HEADING]).mean())
        agent = self.agent.copy()
        agent[:, HEADING] = heading + wrap(agent[:, HEADING] - heading)
        mean, covariance = np.empty(size), np.zeros((size, size))
        for start, values in ((0, agent), *((AGENT + 2 * s, line) for s, line in enumerate(self.lines))):
            rows = slice(start, start + values.shape[1])
            middle = values.mean(0)
            off = values - middle
            mean[rows] = middle
            covariance[rows, rows] = off.T @ off / len(off) + LEAST_VARIANCE * np.eye(values.shape[1])
        mean[HEADING] = wrap(mean[HEADING])
        return Belief(mean, covariance)

    def having(self, identity: NDArray[np.int64], belief: Belief, draw: np.random.Generator) -> Self:
        """Particles of exactly these surfaces (S,): those at hand, others drawn from a belief of all."""
        rows = {int(one): row for row, one in enumerate(self.identity)}
        lines = np.empty((len(identity), len(self), 2))
        for number, one in enumerate(identity.tolist()):
            if one in rows:
                lines[number] = self.lines[rows[one]]
                continue
            entries = belief.layout.line(number)
            root = np.linalg.cholesky(
                belief.covariance[np.ix_(entries, entries)] + LEAST_VARIANCE * np.eye(2)
            )
            lines[number] = belief.mean[entries] + draw.standard_normal((len(self), 2)) @ root.T
        return replace(self, lines=lines, identity=identity.copy())
