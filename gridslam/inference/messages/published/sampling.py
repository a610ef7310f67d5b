"""What all methods by particles share: agents move, and rows are drawn by their weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.filter_model import FilterModel


def moved_agents(agent: Array, dt: float, model: FilterModel, draw: np.random.Generator) -> Array:
    """Particles (P, 5) of an agent after a time (s): near-constant velocity, and a walk of the heading."""
    agent = agent.copy()
    push = model.settings.acceleration_mps2 * draw.standard_normal((len(agent), 2))
    agent[:, :2] += dt * agent[:, 2:4] + 0.5 * dt**2 * push
    agent[:, 2:4] += dt * push
    agent[:, 4] += np.radians(model.settings.heading_deg) * draw.standard_normal(len(agent))
    return agent


def resampled(logs: Array, draw: np.random.Generator) -> NDArray[np.int64]:
    """Rows (P,) drawn systematically by weights exp(logs)."""
    weight = np.exp(logs - logs.max())
    edges = np.cumsum(weight) / weight.sum()
    points = (np.arange(len(logs)) + draw.random()) / len(logs)
    return np.minimum(np.searchsorted(edges, points), len(logs) - 1)
