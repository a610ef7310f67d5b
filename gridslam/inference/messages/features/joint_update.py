"""Samples into the joint belief of agent and features; docs/model.md, (M126)-(M130).

The likelihood is that of one complex Gaussian with a covariance of noise, line of sight and features. Its
maximum together with the prior is found by Gauss-Newton steps; the curvature counts the power that a path
has at this step, so that one that isn't heard says nothing. All is reckoned by lengths and angles of paths,
of which there are fewer than entries of the state.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import carry
from gridslam.inference.messages.features.heard_paths import HeardPaths
from gridslam.inference.messages.features.path_products import Products
from gridslam.inference.messages.features.presence import existence_of, powers_of, predicted, presence_of
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
FORGETS = 0.1
"""Share by which powers follow a step's."""
SURE = 9.0
"""Square of a path's amplitude, in that of its deviation, from which on it counts as heard."""
SIGHTED = 0.9
"""Probability from which on a line of sight counts as heard, and a faint feature as there."""
ROUNDS, SETTLED_M = 8, 1e-4
"""Gauss-Newton steps at most, and how little the agent moves (m) where they end."""
CROWD_ROUNDS, FIRST_STEPS = 3, 10
"""The same in a crowd, where they don't come to rest: after three they go to and fro by a centimetre. But for
the filter's first steps, when the agent may be anywhere about its start."""
TURNS_RAD = 1.0
"""Deviation of a direction per metre of a feature's extent: an array of few antennas tells scatterers at one
distance apart badly, and follows now one, now another."""
FAINTEST = 1e-4
"""Least power of a feature, in that of the line of sight."""
NOT_THERE = 1e-12
"""Probability of a line of sight that is taken not to be there."""


def predict(belief: JointBelief, seconds: float, acceleration_mps2: float) -> JointBelief:
    """The belief after a time of constant velocity with white acceleration."""
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    carry(mean, covariance, slice(2), slice(2, MOVING), seconds)
    jolt = np.array([0.5 * seconds**2, seconds])
    for axis in range(2):
        covariance[axis:MOVING:2, axis:MOVING:2] += acceleration_mps2**2 * np.outer(jolt, jolt)
    return replace(belief, mean=mean, covariance=covariance)


def update(
    belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float, model: SignalModel,
    step: int, start: Array | None = None, hidden: NDArray[np.bool_] | None = None,
) -> tuple[JointBelief, float]:  # fmt: skip
    """The belief after the samples (J, N, M) of one step, and the log of their evidence.

    Parameters
    ----------
    start : (4,), optional
        Where the agent is thought to be by other means: from there, all that hangs together with it moved
        along, the maximum is looked for.
    hidden : (J,) bool, optional
        Anchors whose line of sight is taken not to be there, whatever the samples say.
    """
    if not audible.any():
        return belief, 0.0
    size = len(belief.mean)
    scatter = belief.extent**2, (TURNS_RAD * belief.extent) ** 2
    heard = HeardPaths(belief, samples, audible, heading_rad, model, scatter)
    prior = np.zeros((size + 1, size + 1))  # the last entry is an error of this step's heading
    prior[:size, :size] = belief.covariance
    prior[size, size] = model.waveform.heading_std_rad**2
    state = np.zeros((2, size + 1))
    at, base = state
    at[:size] = base[:size] = belief.mean
    if start is not None:
        at[:size] = moved_to(belief, start)
    existence, crowded = belief.existence.copy(), belief.extent > 0 and step >= FIRST_STEPS
    for round_ in range(CROWD_ROUNDS if crowded else ROUNDS):
        heard.place(state, prior)
        known = heard.multiply()
        if not round_:
            for j, products in zip(heard.anchors, known, strict=True):
                gone = hidden is not None and hidden[j]
                existence[j] = NOT_THERE if gone else existence_of(belief, j, products)
            each = zip(heard.anchors, known, strict=True)
            powers = [powers_of(belief, existence, j, products) for j, products in each]
            power = np.concatenate(powers)
        slopes = heard.slopes(power)
        system = slopes.curvature @ heard.spread
        system.ravel()[:: len(system) + 1] += 1
        root, order, wrong = lapack.dgetrf(system)
        assert not wrong
        pull, _ = lapack.dgetrs(root, order, slopes.score + slopes.curvature @ heard.off)
        # Laplace: the value there, how far it is from the prior, and the volume that is left
        volume = np.log(np.abs(np.diagonal(root))).sum()
        evidence = slopes.log_density - 0.5 * float(heard.off @ slopes.score) - 0.5 * float(volume)
        following = base + pull @ heard.towards
        heard.shift[:] = heard.own * pull
        moved = np.abs(following - at)[:2].max()
        at[:] = following
        if moved < SETTLED_M:
            break
    gain, _ = lapack.dgetrs(root, order, slopes.curvature @ heard.towards)
    covariance = (prior - heard.towards.T @ gain)[:size, :size]
    found = replace(
        belief, mean=at[:size].copy(), covariance=0.5 * (covariance + covariance.T), existence=existence
    )
    heard.place(state, prior)
    for j, products, own in zip(heard.anchors, heard.multiply(), powers, strict=True):
        found, surprise = _follow_powers(found, j, products.of(slice(0, len(own))), own, step)
        evidence += surprise
    return _sighted(found, belief, audible), evidence


def moved_to(belief: JointBelief, start: Array) -> Array:
    """The joint mean (n,) given the agent's place, and with the velocity of a start (4,), (M524)."""
    spread = belief.agent_covariance[:2, :2]
    at: Array = belief.mean + belief.covariance[:, :2] @ np.linalg.solve(spread, start[:2] - belief.mean[:2])
    at[:MOVING] = start[:MOVING]
    return at


def _sighted(found: JointBelief, before: JointBelief, audible: NDArray[np.bool_]) -> JointBelief:
    """The belief with the place from where features and lines of sight were heard at a step."""
    bank = found.features
    features = bank.identity[bank.steps_seen > before.features.steps_seen]
    sights = -1 - np.flatnonzero(audible & (found.existence > SIGHTED))
    return replace(found, sightings=found.sightings.add(np.concatenate([features, sights]), found.mean[:2]))


def _follow_powers(
    belief: JointBelief, anchor: int, known: Products, power: Array, step: int
) -> tuple[JointBelief, float]:
    """Powers of line of sight, features and noise, each a running mean of what the step has it at.

    And what features in doubt add to the log of the evidence, see `presence_of`.
    """
    noise, root = belief.noise[anchor], np.sqrt(power)
    inverse = np.linalg.inv(noise * np.eye(len(power)) + root[:, None] * known.gram * root)
    amplitude = root * (inverse @ (root * known.matched))
    spread = power * noise * np.diagonal(inverse)
    square = np.abs(amplitude) ** 2 + spread
    residual = np.vdot(amplitude, known.gram @ amplitude - 2 * known.matched).real
    noise_now = (known.energy + residual) / (known.size - np.count_nonzero(power))
    los_power, noises, bank = belief.los_power.copy(), belief.noise.copy(), belief.features
    rows = np.flatnonzero(bank.anchor == anchor)
    before = predicted(belief)[rows]
    there, surprise = presence_of(before, known, power, bank.power[rows], noise)
    if power[0] > 0:
        los_power[anchor] += FORGETS * (square[0] - los_power[anchor])
    noises[anchor] += FORGETS * (noise_now - noise)
    powers, seen, last = bank.power.copy(), bank.steps_seen.copy(), bank.last_step.copy()
    used = power[1:] > 0
    powers[rows] += FORGETS * np.where(used, there, 0.0) * (square[1:] - powers[rows])
    powers[rows] = np.maximum(powers[rows], FAINTEST * los_power[anchor])
    detected = rows[used & (np.abs(amplitude[1:]) ** 2 > SURE * spread[1:])]
    seen[detected] += 1
    last[detected] = step
    presence = bank.presence.copy()
    presence[rows] = there
    bank = replace(bank, power=powers, steps_seen=seen, last_step=last, presence=presence)
    return replace(belief, los_power=los_power, noise=noises, features=bank), surprise
