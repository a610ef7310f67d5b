"""New virtual anchors of network SLAM as published; docs/model.md, (M144), (M145).

[Venus2025network], (8), (19) to (26), with the slips mended that docs/differences.md lists; equations without
a key are that paper's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.published.image_particles import SPREAD, path_values
from gridslam.inference.messages.published.network_particle_ratios import log_clutter, measured_deviations
from gridslam.inference.messages.published.network_particles import FEW, NetworkMarginals
from gridslam.inference.messages.published.sampling import resampled
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.published.feature_particles import Features
from gridslam.inference.state.published.network_particles import CLOCK, NetworkParticleState
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit, wrap


@dataclass(frozen=True, eq=False)
class NetworkBirths:
    """For M measurements and J anchors, a virtual anchor that would be new, as weighted particles.

    Attributes
    ----------
    odds : (M, J)
        I_mj, in ratio to clutter.
    logs : (M, J, P)
    position : (M, J, P, 2) m
    """

    odds: Array
    logs: Array
    position: Array


def propose_network(
    state: NetworkParticleState, agent: int, scan: AnchorScan, model: FilterModel, draw: np.random.Generator
) -> NetworkBirths:
    """New virtual anchors of every measurement and anchor, (8), (20), (23)."""
    own, radio, anchors = state.agents[agent], model.radio, model.anchors
    count, several, labels = len(own), len(scan), len(anchors)
    side = np.array(model.grid.shape) * model.grid.cell_m
    std = measured_deviations(scan, radio)
    base = np.log(model.settings.births) - np.log(SPREAD**2 * side.prod()) - log_clutter(scan, radio)
    logs = np.full((several, labels, count), -np.inf)
    position = np.zeros((several, labels, count, 2))
    for m in range(several):
        label = int(scan.label[m])
        bearing = own[:, 4] + scan.value[m, 2] + std[m, 2] * draw.standard_normal(count)
        if not np.isfinite(std[m, 2]):
            bearing = draw.uniform(-np.pi, np.pi, count)
        measured = scan.value[m, 0] + std[m, 0] * draw.standard_normal(count) + own[:, CLOCK]
        for j in range(labels) if label < 0 else (label,):
            distance = measured - state.clocks[j]
            position[m, j] = own[:, :2] + np.maximum(distance, 1e-3)[:, None] * unit(bearing)
            value = path_values(own[:, :CLOCK], position[m, j][None], np.zeros(1, bool), anchors[j])[1, 0]
            aod = _log_gaussian(wrap(scan.value[m, 1] - value), std[m, 1])
            possible = distance > 0
            share = 0.0 if label >= 0 else np.log(labels)
            logs[m, j, possible] = base[m] - share + np.log(distance[possible]) + aod[possible]
    return NetworkBirths(np.exp(logs).mean(-1), logs, position)


def add_network_births(
    state: NetworkParticleState, new: NetworkBirths, found: NetworkMarginals, draw: np.random.Generator
) -> NetworkParticleState:
    """The state with new virtual anchors that are likely enough, (24) to (26), without unlikely ones."""
    existence = new.odds / (1 + new.odds.sum(1) + found.claimed)[:, None]
    rows, labels = np.nonzero(existence > FEW)
    size, count = len(rows), state.clocks.shape[1]
    place = np.empty((size, count, 2))
    for number, (m, j) in enumerate(zip(rows.tolist(), labels.tolist(), strict=True)):
        place[number] = new.position[m, j][draw.permutation(resampled(new.logs[m, j], draw))]
    born = Features(
        state.next_identity + np.arange(size), labels.astype(np.int64), np.zeros(size, bool),
        existence[rows, labels], place, np.zeros((size, count)),
    )  # fmt: skip
    surviving = state.features.take(state.features.existence > FEW)
    return replace(state, features=surviving.joined(born), next_identity=state.next_identity + size)


def _log_gaussian(off: Array, std: float) -> Array:
    """Log density of a measured angle's error; uniform if it wasn't measured."""
    if np.isinf(std):
        return np.full(len(off), -np.log(2 * np.pi))
    return np.asarray(-0.5 * (off / std) ** 2 - np.log(std * np.sqrt(2 * np.pi)))
