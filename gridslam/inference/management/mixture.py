"""Reduction of a population: hypotheses that have become one are merged, and unlikely ones pruned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT, HEADING, OF_POSE, POSE
from gridslam.inference.state.arrangement import arranged, unparked
from gridslam.inference.state.population import Population, moments
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit, wrap

SLACK = np.array([0.03, 0.03, 0.02]) ** 2
"""Added to the pooled variances of two poses, m^2 and rad^2."""
TOGETHER = 3.0
"""Squared pooled deviations within which two agents are one."""
TURN_RAD, SHIFT_M, FOUND = 0.1, 0.3, 0.5
"""Within which two surfaces are one; existence from which on a surface needs its twin."""
HOPELESS, CAP = 14.0, 60
"""Log weight behind the best at which a hypothesis is pruned, hypotheses at most."""


def reduce(population: Population[State], model: FilterModel) -> Population[State]:
    """Merge what has become the same, prune what has become unlikely."""
    return population if len(population) == 1 else merged(population, model).pruned(HOPELESS, CAP)


def merged(population: Population[State], model: FilterModel) -> Population[State]:
    """The population with hypotheses of one world merged into the likeliest of them, weights added.

    Where both hold the same surfaces, as siblings of a split do, their beliefs are moment-matched.
    """

    def same(one: State, other: State) -> bool:
        return same_world(one, other, model)

    def join(one: State, other: State, log_one: float, log_other: float) -> State:
        if not same_identities(one, other, model):
            return one
        return moment_matched(one, other, log_one, log_other)

    return population.merged(same, together([state.belief for state in population.states]), join)


def poses(population: Population[State]) -> Array:
    """Means of the agent's pose in every hypothesis, (K, 3) m, m, rad."""
    return np.array([state.belief.mean[POSE] for state in population.states])


def agent_moments(population: Population[State]) -> tuple[Array, Array]:
    """Mean (5,) and covariance (5, 5) of the agent in the mixture of all hypotheses."""
    if len(population) == 1:
        belief = population.best.belief
        return belief.mean[:AGENT].copy(), belief.covariance[:AGENT, :AGENT].copy()
    first = population.best.belief.mean[HEADING]
    means = np.array([state.belief.mean[:AGENT] for state in population.states])
    means[:, HEADING] = first + wrap(means[:, HEADING] - first)
    own = np.array([state.belief.covariance[:AGENT, :AGENT] for state in population.states])
    return moments(population.weights, means, own)


def together(beliefs: Sequence[Belief]) -> NDArray[np.bool_]:
    """Which agents (K, K) are within `TOGETHER` squared pooled deviations of each other, of K beliefs."""
    pose = np.array([belief.mean[POSE] for belief in beliefs])
    spread = np.array([belief.covariance[OF_POSE] for belief in beliefs])
    gap = pose[:, None] - pose[None]
    gap[..., 2] = wrap(gap[..., 2])
    pooled = 0.5 * (spread[:, None] + spread[None]) + np.diag(SLACK)
    far = np.einsum("abi,abi->ab", gap, np.linalg.solve(pooled, gap[..., None])[..., 0])
    return np.asarray(far < TOGETHER)


def same_world(one: State, other: State, model: FilterModel) -> bool:
    """Whether every surface that either believes in has a twin in the other."""
    for here, there in ((one, other), (other, one)):
        believed = here.every_line[here.every_existence > FOUND]
        if len(believed) and not twins(believed, there.every_line, model.middle).any(1).all():
            return False
    return True


def same_identities(one: State, other: State, model: FilterModel) -> bool:
    """Whether both hold the same surfaces, number by number, at the same places."""
    if not np.array_equal(one.surfaces.identity, other.surfaces.identity):
        return False
    if (one.parked is None) != (other.parked is None):
        return False
    if one.parked is not None and other.parked is not None:
        these, those = one.parked.surfaces.identity, other.parked.surfaces.identity
        if not np.array_equal(these, those):
            return False
    return bool(twins(one.every_line, other.every_line, model.middle).diagonal().all())


def twins(these: Array, those: Array, middle: Array) -> NDArray[np.bool_]:
    """Which lines (A, 2) and (B, 2) agree in angle, and in offset at the middle of the region, (A, B)."""
    flip = np.cos(these[:, None, 0] - those[None, :, 0]) < 0
    turn = wrap(these[:, None, 0] - those[None, :, 0] - np.pi * flip)
    first, second = (lines[:, 1] - unit(lines[:, 0]) @ middle for lines in (these, those))
    shift = first[:, None] - np.where(flip, -second, second)
    return np.asarray((np.abs(turn) < TURN_RAD) & (np.abs(shift) < SHIFT_M))


def moment_matched(one: State, other: State, log_one: float, log_other: float) -> State:
    """The first state with the joint belief of both."""
    share = 1 / (1 + np.exp(log_other - log_one))
    here, there = unparked(one), unparked(other)
    gap = there.belief.mean - here.belief.mean
    angles = here.belief.layout.angles
    gap[HEADING], gap[angles] = wrap(gap[HEADING]), wrap(gap[angles])
    mean = here.belief.mean + (1 - share) * gap
    mean[HEADING] = wrap(mean[HEADING])
    covariance = share * here.belief.covariance + (1 - share) * there.belief.covariance
    covariance = covariance + share * (1 - share) * np.outer(gap, gap)
    matched = here.believing(replace(here.belief, mean=mean, covariance=covariance))
    if one.parked is None:
        return matched
    active = np.isin(matched.surfaces.identity, one.surfaces.identity)
    return replace(arranged(matched, active), surfaces=one.surfaces)
