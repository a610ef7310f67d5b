"""Samples into the joint belief of agent and features; docs/model.md, (M126)-(M130).

The likelihood is that of one complex Gaussian with a covariance of noise, line of sight and features. Its
maximum together with the prior is found by Gauss-Newton steps; the curvature counts the power that a path
has at this step, so that one that isn't heard says nothing. All is reckoned by lengths and angles of paths,
of which there are fewer than entries of the state.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

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
    state, prior = _with_heading(belief, start, model)
    at, base = state
    crowded = belief.extent > 0 and step >= FIRST_STEPS
    for round_ in range(CROWD_ROUNDS if crowded else ROUNDS):
        heard.place(state, prior)
        known = heard.multiply()
        if not round_:
            existence, powers = _levels(belief, heard.anchors, known, hidden)
        newton = _Newton.of(heard, np.concatenate(powers))
        following = base + newton.pull @ heard.towards
        heard.shift[:] = heard.own * newton.pull
        moved = np.abs(following - at)[:2].max()
        at[:] = following
        if moved < SETTLED_M:
            break
    covariance = (prior - newton.learned(heard))[:size, :size]
    found = replace(
        belief, mean=at[:size].copy(), covariance=0.5 * (covariance + covariance.T), existence=existence
    )
    heard.place(state, prior)
    evidence = newton.log_evidence
    for j, products, own in zip(heard.anchors, heard.multiply(), powers, strict=True):
        found, surprise = _follow_powers(found, j, products.of(slice(0, len(own))), own, step)
        evidence += surprise
    return _sighted(found, belief, audible), evidence


def _with_heading(belief: JointBelief, start: Array | None, model: SignalModel) -> tuple[Array, Array]:
    """State (2, n + 1), where slopes are taken and the prior's, and covariance; last, the heading's error.

    Arguments are those of `update`.
    """
    size = len(belief.mean)
    prior = np.zeros((size + 1, size + 1))
    prior[:size, :size] = belief.covariance
    prior[size, size] = model.waveform.heading_std_rad**2
    state = np.zeros((2, size + 1))
    state[:, :size] = belief.mean
    if start is not None:
        state[0, :size] = moved_to(belief, start)
    return state, prior


def _levels(
    belief: JointBelief, anchors: list[int], known: list[Products], hidden: NDArray[np.bool_] | None
) -> tuple[Array, list[Array]]:
    """Existence (J,) of lines of sight, and the powers that paths of each heard anchor have at this step.

    Parameters
    ----------
    anchors, known : list of int, list of Products
        Which were heard, and what of each, at the start.
    hidden : (J,) bool, optional
        Anchors whose line of sight is taken not to be there.
    """
    existence = belief.existence.copy()
    for j, products in zip(anchors, known, strict=True):
        gone = hidden is not None and hidden[j]
        existence[j] = NOT_THERE if gone else existence_of(belief, j, products)
    each = zip(anchors, known, strict=True)
    return existence, [powers_of(belief, existence, j, products) for j, products in each]


@dataclass(frozen=True, eq=False)
class _Newton:
    """A Gauss-Newton step on p numbers of paths.

    Attributes
    ----------
    pull : (p,)
        What moves the state from the prior's mean, by its covariances with the numbers.
    log_evidence : float
        Laplace's, about where the step began.
    curvature : (p, p)
        Of the samples.
    factors : tuple
        Of the system that it solved, by LU.
    """

    pull: Array
    log_evidence: float
    curvature: Array
    factors: tuple[Array, NDArray[np.int32]]

    @classmethod
    def of(cls, heard: HeardPaths, power: Array) -> Self:
        """From where paths are placed, with so much power (p / 2,) in each."""
        slopes = heard.slopes(power)
        system = slopes.curvature @ heard.spread
        system.ravel()[:: len(system) + 1] += 1
        root, order, wrong = lapack.dgetrf(system)
        assert not wrong
        pull, _ = lapack.dgetrs(root, order, slopes.score + slopes.curvature @ heard.off)
        # the value there, how far it is from the prior, and the volume that is left
        volume = np.log(np.abs(np.diagonal(root))).sum()
        evidence = slopes.log_density - 0.5 * float(heard.off @ slopes.score) - 0.5 * float(volume)
        return cls(pull, evidence, slopes.curvature, (root, order))

    def learned(self, heard: HeardPaths) -> Array:
        """By how much the covariance of the state (n + 1, n + 1) shrinks, where the step began."""
        gain, _ = lapack.dgetrs(*self.factors, self.curvature @ heard.towards)
        return np.asarray(heard.towards.T @ gain)


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
