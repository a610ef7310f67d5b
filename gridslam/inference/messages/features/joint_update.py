"""Samples into the joint belief of agent and features; docs/model.md, (M126)-(M130).

The likelihood is that of one complex Gaussian with a covariance of noise, line of sight and features. Its
maximum together with the prior is found by Gauss-Newton steps; the curvature counts the power that a path
has at this step, so that one that isn't heard says nothing. All is reckoned by lengths and angles of paths,
of which there are fewer than entries of the state.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.path_products import (
    Paths,
    Products,
    Received,
    paths_at,
    products,
    received,
    whiten,
)
from gridslam.inference.messages.features.presence import existence_of, powers_of, predicted, presence_of
from gridslam.inference.messages.features.regaining import regained
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


def predict(belief: JointBelief, seconds: float, acceleration_mps2: float) -> JointBelief:
    """The belief after a time of constant velocity with white acceleration."""
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    mean[:2] += seconds * mean[2:MOVING]
    covariance[:2] += seconds * covariance[2:MOVING]
    covariance[:, :2] += seconds * covariance[:, 2:MOVING]
    jolt = np.array([0.5 * seconds**2, seconds])
    for axis in range(2):
        covariance[axis:MOVING:2, axis:MOVING:2] += acceleration_mps2**2 * np.outer(jolt, jolt)
    return replace(belief, mean=mean, covariance=covariance)


@dataclass(frozen=True, eq=False)
class _Anchor:
    """What one anchor sent, and which of the paths' numbers are its own."""

    index: int
    got: Received
    numbers: slice


@dataclass(frozen=True, eq=False)
class _Place:
    """Paths of all anchors at a state: numbers (p,), slopes by it (p, n + 1), scatter of their own (p,)."""

    numbers: Array
    jacobian: Array
    own: Array


def update(
    belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float, model: SignalModel,
    step: int, start: Array | None = None,
) -> tuple[JointBelief, float]:  # fmt: skip
    """The belief after the samples (J, N, M) of one step, and the log of their evidence.

    Parameters
    ----------
    start : (4,), optional
        Where the agent is thought to be by other means: from there the maximum is looked for.
    """
    if not audible.any():
        return belief, 0.0
    size, wave = len(belief.mean), model.waveform
    anchors, first = [], 0
    for j in np.flatnonzero(audible):
        after = first + 2 + 2 * int((belief.features.anchor == j).sum())
        anchors.append(_Anchor(int(j), received(samples[j], wave), slice(first, after)))
        first = after
    prior = np.zeros((size + 1, size + 1))  # the last entry is an error of this step's heading
    prior[:size, :size] = belief.covariance
    prior[size, size] = wave.heading_std_rad**2
    base, at = np.append(belief.mean, 0.0), np.append(belief.mean, 0.0)
    if start is None:
        at[:size] = regained(belief, samples, audible, heading_rad, model)
    else:
        at[:MOVING] = start
    shift = np.zeros(first)
    existence, powers = belief.existence.copy(), list[Array]()
    crowded = belief.extent > 0 and step >= FIRST_STEPS
    for round_ in range(CROWD_ROUNDS if crowded else ROUNDS):
        place = _place(at, belief, anchors, heading_rad, model)
        score, curvature, value = np.zeros(first), np.zeros((first, first)), 0.0
        for n, one in enumerate(anchors):
            known = products(place.numbers[one.numbers] + shift[one.numbers], one.got, wave)
            if not round_:
                existence[one.index] = existence_of(belief, one.index, known)
                powers.append(powers_of(belief, existence, one.index, known))
            mine = one.numbers, one.numbers
            score[one.numbers], curvature[mine], log_density = slopes(
                known, powers[n], belief.noise[one.index]
            )
            value += log_density
        towards = place.jacobian @ prior
        spread = towards @ place.jacobian.T  # of the paths' numbers
        spread[np.arange(first), np.arange(first)] += place.own
        off = place.jacobian @ (at - base) + shift
        system = np.eye(first) + curvature @ spread
        pull = np.linalg.solve(system, score + curvature @ off)
        # Laplace: the value there, how far it is from the prior, and the volume that is left
        evidence = value - 0.5 * float(off @ score) - 0.5 * float(np.linalg.slogdet(system)[1])
        following, shift = base + towards.T @ pull, place.own * pull
        moved = np.abs(following - at)[:2].max()
        at = following
        if moved < SETTLED_M:
            break
    covariance = (prior - towards.T @ np.linalg.solve(system, curvature @ towards))[:size, :size]
    found = replace(belief, mean=at[:size], covariance=0.5 * (covariance + covariance.T), existence=existence)
    place = _place(at, belief, anchors, heading_rad, model)
    for one, power in zip(anchors, powers, strict=True):
        known = products(place.numbers[one.numbers] + shift[one.numbers], one.got, wave)
        found, surprise = _follow_powers(found, one.index, known.of(slice(0, len(power))), power, step)
        evidence += surprise
    return _sighted(found, belief, audible), evidence


def _sighted(found: JointBelief, before: JointBelief, audible: NDArray[np.bool_]) -> JointBelief:
    """The belief with the place from where features and lines of sight were heard at a step."""
    bank = found.features
    features = bank.identity[bank.steps_seen > before.features.steps_seen]
    sights = -1 - np.flatnonzero(audible & (found.existence > SIGHTED))
    return replace(found, sightings=found.sightings.add(np.concatenate([features, sights]), found.mean[:2]))


def _place(
    at: Array, belief: JointBelief, anchors: list[_Anchor], heading_rad: float, model: SignalModel
) -> _Place:
    """Paths of these anchors at a joint state and an error of the heading."""
    paths = [paths_at(at[:-1], belief, one.index, heading_rad + at[-1], model) for one in anchors]
    if len(paths) == 1:
        return _Place(paths[0].numbers, paths[0].jacobian, _scatter(paths[0], belief.extent))
    return _Place(
        np.concatenate([one.numbers for one in paths]), np.concatenate([one.jacobian for one in paths]),
        np.concatenate([_scatter(one, belief.extent) for one in paths]),
    )  # fmt: skip


def _scatter(paths: Paths, extent: float) -> Array:
    """Variances (2 C,) of lengths and angles about what the features' places say."""
    own, count = np.zeros(len(paths.numbers)), len(paths.far)
    own[1:count], own[count + 1 :] = extent**2, (TURNS_RAD * extent) ** 2
    return own


def slopes(known: Products, power: Array, noise: float) -> tuple[Array, Array, float]:
    """Slope (2 C,) and curvature (2 C, 2 C) of the log-likelihood by lengths and angles, and its value."""
    white, count = whiten(known, power, noise), len(power)
    amplitude = power * white.matched[:count]  # posterior means of what each path carries
    twice = np.concatenate([amplitude, amplitude])
    volume = white.gram[np.arange(count, 3 * count), np.tile(np.arange(count), 2)]
    score = 2 * np.real(twice * white.matched[count:].conj()) - 2 * np.tile(power, 2) * volume
    product = np.outer(twice.real, twice.real) + np.outer(twice.imag, twice.imag)
    return score, 2 * product * white.gram[count:, count:], white.log_density


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
