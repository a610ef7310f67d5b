"""Twins of kernels/messages/rings.py, for all hypotheses at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from gridslam.arrays import Array
from gridslam.inference.state.rings import MOVING

Complex = NDArray[np.complex128]


def follow_rings(
    weight: Array,
    before: Array,
    push: Array,
    information: Array,
    doubt: Array,
    mean: Array,
    covariance: Array,
) -> tuple[Array, Array, Array]:
    """Mean (R, K, 6), covariance and log factor (R, K) of all hypotheses; those of weight 0 as they are.

    Parameters
    ----------
    before, push : (4,)
        The agent's mean before, and information times mean that came in.
    information, doubt : (4, 4)
        That came in, and variance that is added first.
    """
    live = weight > 0
    agent, prior = mean[live][:, :MOVING] - before, covariance[live]
    prior[..., :MOVING, :MOVING] += doubt
    both, own = prior[..., :MOVING], prior[..., :MOVING, :MOVING]
    inner = np.eye(MOVING) + information @ own
    pull = push - agent @ information
    solved = np.linalg.solve(
        inner, np.concatenate([np.broadcast_to(information, own.shape), pull[..., None]], -1)
    )
    mean, covariance, log = mean.copy(), covariance.copy(), np.zeros(weight.shape)
    covariance[live] = prior - both @ solved[..., :MOVING] @ np.swapaxes(both, -1, -2)
    step = (both @ solved[..., MOVING:])[..., 0]
    mean[live] += step
    log[live] = (
        (agent * push).sum(-1)
        - 0.5 * ((agent @ information) * agent).sum(-1)
        + 0.5 * (pull * step[..., :MOVING]).sum(-1)
        - 0.5 * np.log(np.linalg.det(inner))
    )
    return mean, covariance, log


def weigh_rings(
    weight: Array, logs: Array, limits: Array, place: Array, mean: Array, covariance: Array
) -> tuple[Array, Array, Array, Array]:
    """Mean (R, K, 6), covariance, log factor (R, K) and chance that the path is there.

    Parameters
    ----------
    weight : (R, K)
        Hypotheses of weight 0 stay as they are.
    logs : (R, G)
        Log ratios of each ring's path at all distances of a folding range.
    limits : (6,)
        As the kernel's.
    place : (I,)
        Where a hypothesis looks, in deviations.
    mean, covariance : (R, K, 6), (R, K, 6, 6)
        Of x, y, vx, vy of the agent and x, y of the image.
    """
    spacing, nearest, doubt, stays = limits[:4]
    live = weight > 0
    ring, points = np.nonzero(live)[0], logs.shape[1]
    own, spread_of = mean[live], covariance[live]
    away = own[:, MOVING:] - own[:, :2]
    distance = np.maximum(np.linalg.norm(away, axis=-1), 1e-6)
    slope = np.concatenate([-away, np.zeros_like(away), away], -1) / distance[:, None]
    gain = np.einsum("hij,hj->hi", spread_of, slope)
    spread = np.maximum((gain * slope).sum(-1), 1e-12)
    node = distance[:, None] + np.sqrt(spread)[:, None] * place
    first = np.floor(node / spacing).astype(np.int64)
    share = node / spacing - first
    four = np.stack([logs[ring[:, None], (first + n) % points] for n in (-1, 0, 1, 2)])
    # Catmull and Rom's cubic, by its basis
    basis = 0.5 * np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]])
    value = np.einsum("pn,phi,nhi->hi", basis, share[None] ** np.arange(4)[:, None, None], four)
    value = value + log_ndtr((node - nearest) / doubt)
    top = value.max(-1)
    mass = np.exp(-0.5 * place**2) * np.exp(value - top[:, None])
    level = np.log(stays * mass.sum(-1) / np.exp(-0.5 * place**2).sum()) + top
    mass = mass / mass.sum(-1, keepdims=True)
    middle = mass @ place
    left = np.maximum(mass @ place**2 - middle**2, 1e-6) * spread
    factor = np.logaddexp(level, np.log1p(-stays))
    chance, moved = np.exp(level - factor), np.sqrt(spread) * middle
    narrower = chance * (spread - left - (1 - chance) * moved**2)
    scaled = gain / spread[:, None]
    mean, covariance, log, there = (
        mean.copy(),
        covariance.copy(),
        np.zeros(weight.shape),
        np.zeros(weight.shape),
    )
    mean[live] += (chance * moved)[:, None] * scaled
    covariance[live] -= narrower[:, None, None] * scaled[:, :, None] * scaled[:, None, :]
    log[live], there[live] = factor, chance
    return mean, covariance, log, there
