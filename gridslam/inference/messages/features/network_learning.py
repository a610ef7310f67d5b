"""Learning as published: networks from random places, up the gradient; docs/model.md, (M324)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.features import sight
from gridslam.inference.messages.features.feature_likelihood import Front, Tables
from gridslam.inference.messages.features.following import FeatureWork
from gridslam.inference.messages.features.lessons import LEARN_EVERY
from gridslam.inference.state.features.features import MOVING, FeatureBank, entries
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment
from gridslam.inference.state.features.networks import (
    FEATURES,
    SCALE_M,
    FeatureNetworks,
    Network,
    hidden,
)
from gridslam.inference.workspace.workspace import timed
from gridslam.world.signal_model import SignalModel

NETWORKS = 4
"""Purpose of the random numbers that they are drawn by."""
ITERATIONS = 300
PLACE_RATE, POWER_RATE = 5e-3, 1e-4
"""Steps of Adam."""
FORGETS = 0.9, 0.999
LEAST_POWER = 1e-6
PLACE_STD_M = 1.0
"""The networks tell no deviations; of places and extra lengths, in maps."""


@timed("learn")
def learn_by_networks(state: HybridState, model: SignalModel, *, work: FeatureWork) -> HybridState:
    """The state after a segment, at its end, with features where networks have them; else as it was.

    Parameters
    ----------
    work : FeatureWork
        Its seed says which places features start from.
    """
    cloud, anchors = state.particles, model.anchors[:, :2]
    if cloud is None or state.step % LEARN_EVERY:
        return state
    networks = state.networks
    if networks is None:
        networks = FeatureNetworks.drawn(anchors, [work.seed, 0, NETWORKS])
    unit, noise = sight.los_power(cloud), cloud.noise.mean(1)
    parts = [_stretch(state.segment, j, float(noise[j]), work.front) for j in range(len(unit))]
    for _ in range(ITERATIONS):
        table, extra, power = _table(networks, anchors, unit)
        slope = np.zeros_like(table)
        for j, (points, tables) in enumerate(parts):
            if len(points):
                steps = np.arange(len(points), dtype=np.int32)
                slope[j] = work.front.slopes(points, steps, table[j], anchors[j], tables)[0]
        slope[~np.isfinite(slope)] = 0.0
        slope[..., 2] *= np.sign(extra)
        by_power = slope[..., 3] * unit[:, None] * np.sign(power)
        networks = FeatureNetworks(
            moved(networks.places, anchors, slope[..., :3].reshape(len(anchors), -1), PLACE_RATE),
            moved(networks.powers, anchors, by_power, POWER_RATE),
        )
    empty = Segment.empty(*state.segment.samples.shape[1:])
    joint = placed(state.joint, networks, unit, state.step, model)
    return replace(
        state, joint=joint, before=joint, segment=empty, before_s=state.time_s, networks=networks,
        next_identity=len(joint.features),
    )  # fmt: skip


def placed(
    belief: JointBelief, networks: FeatureNetworks, unit: Array, step: int, model: SignalModel
) -> JointBelief:
    """The belief with the features that networks say, (J, FEATURES) of them, in place of those before.

    Parameters
    ----------
    unit : (J,)
        Power of the lines of sight.
    """
    agent = belief.mean[:MOVING], belief.covariance[:MOVING, :MOVING]
    found = replace(belief, mean=agent[0], covariance=agent[1], features=FeatureBank.empty())
    origin, spread = belief.mean[:2], PLACE_STD_M**2 * np.eye(3)
    for j, rows in enumerate(_table(networks, model.anchors[:, :2], unit)[0]):
        for n, row in enumerate(rows):
            entry = entries(row[:3], origin)
            found = found.with_feature(j, entry, spread, origin, row[3], j * FEATURES + n, step)
    return found


def weight_slopes(network: Network, anchors: Array, slope: Array) -> tuple[Array, ...]:
    """Slopes by every weight of what has the slope (J, n) by the outputs at the anchors (J, 2)."""
    one, two = hidden(network.weights, anchors)
    by_two = (slope @ network.weights[4]) * (two > 0)
    by_one = (by_two @ network.weights[2]) * (one > 0)
    return (
        by_one.T @ (anchors / SCALE_M), by_one.sum(0), by_two.T @ one, by_two.sum(0), slope.T @ two,
        slope.sum(0),
    )  # fmt: skip


def moved(network: Network, anchors: Array, slope: Array, rate: float) -> Network:
    """A network after a step of Adam up the slope (J, n) of its outputs at the anchors."""
    slopes = weight_slopes(network, anchors, slope)
    moves, (keep, keep_squares) = network.moves + 1, FORGETS
    first = tuple(keep * m + (1 - keep) * g for m, g in zip(network.first, slopes, strict=True))
    second = tuple(
        keep_squares * v + (1 - keep_squares) * g**2 for v, g in zip(network.second, slopes, strict=True)
    )
    weights = tuple(
        w + rate * (m / (1 - keep**moves)) / (np.sqrt(v / (1 - keep_squares**moves)) + 1e-8)
        for w, m, v in zip(network.weights, first, second, strict=True)
    )
    return Network(weights, first, second, moves)


def _table(networks: FeatureNetworks, anchors: Array, unit: Array) -> tuple[Array, Array, Array]:
    """Features (J, D, 4) as kernels take them; extra lengths and powers (J, D) with the networks' signs."""
    place = networks.places.at(anchors).reshape(len(anchors), FEATURES, 3)
    power = networks.powers.at(anchors)
    table = np.empty((*power.shape, 4))
    table[..., :2], table[..., 2] = place[..., :2], np.abs(place[..., 2])
    table[..., 3] = np.maximum(np.abs(power), LEAST_POWER) * unit[:, None]
    return table, place[..., 2], power


def _stretch(segment: Segment, anchor: int, noise: float, front: Front) -> tuple[Array, Tables]:
    """Points (K, 4) and tables of the steps at which an anchor was heard."""
    used = np.flatnonzero(segment.heard[:, anchor])
    level = np.full(len(used), noise)
    points = np.column_stack([segment.agent[used, :2], segment.heading_rad[used], level])
    return points, front.tables(segment.samples[used, anchor])
