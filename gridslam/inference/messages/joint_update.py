"""Samples into the joint belief of agent and features; docs/model.md, (M126)-(M130).

The likelihood is that of one complex Gaussian with a covariance of noise, line of sight and features. Its
maximum together with the prior is found by Gauss-Newton steps; the curvature counts the power that a path
has at this step, so that one that isn't heard says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.state.features import ENTRIES, MOVING
from gridslam.inference.state.hybrid_state import JointBelief
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
STAYS, APPEARS = 0.95, 0.01
"""Probability that a line of sight is there after a step, if it was and if it wasn't."""
FORGETS = 0.1
"""Share by which powers follow a step's."""
SURE = 9.0
"""Square of a path's amplitude, in that of its deviation, from which on it counts as heard."""
ROUNDS, SETTLED_M = 8, 1e-4
LEAST_M = 0.1
"""Shorter paths are taken to be as long as this."""
NEAR_M = 1.0
"""Features turn as if they were no nearer."""
FAINTEST = 1e-4
"""Least power of a feature, in that of the line of sight."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Responses of the line of sight (first) and the features of one anchor, C of them.

    Each is the product of what antennas and what frequencies respond, so that products of responses are
    products of both, and no response of all samples has to be made.

    Attributes
    ----------
    antennas, bent : (N, C) complex128
        Of the antennas, and its slope by the angle.
    spectrum, sloped : (M, C) complex128
        Of the frequencies, and its slope by the length.
    jacobian : (2 C, 4 + 3 F + 1) float64
        Slopes of all lengths, then all angles, by the joint state and by an error of the heading.
    rows : (C - 1,) int64
        The features.
    """

    antennas: Complex
    bent: Complex
    spectrum: Complex
    sloped: Complex
    jacobian: Array
    rows: NDArray[np.int64]

    @property
    def value(self) -> Complex:
        """Responses of all samples, (N M, C)."""
        whole: Complex = self.antennas[:, None] * self.spectrum[None]
        return whole.reshape(-1, self.antennas.shape[1])


@dataclass(frozen=True, eq=False)
class Products:
    """Products of responses H (N M, C) with each other, and with the samples z.

    Attributes
    ----------
    gram : (C, C) complex128
        ``H^H H``.
    matched : (C,) complex128
        ``H^H z``.
    energy : float
        ``z^H z``.
    size : int
        How many samples there are.
    """

    gram: Complex
    matched: Complex
    energy: float
    size: int

    def of(self, rows: slice) -> Products:
        """Some of the responses alone."""
        return replace(self, gram=self.gram[rows, rows], matched=self.matched[rows])


def products(found: Columns, samples: Complex) -> Products:
    """Those of responses and samples (N, M)."""
    adjoint = found.spectrum.conj().T
    gram = (found.antennas.conj().T @ found.antennas) * (adjoint @ found.spectrum)
    matched = ((adjoint @ samples.T) * found.antennas.conj().T).sum(1)
    return Products(gram, matched, float(np.vdot(samples, samples).real), samples.size)


def predict(belief: JointBelief, seconds: float, acceleration_mps2: float) -> JointBelief:
    """The belief after a time of constant velocity with white acceleration; features wander, if at all."""
    size = len(belief.mean)
    move = np.eye(size)
    move[0, 2] = move[1, 3] = seconds
    covariance = move @ belief.covariance @ move.T
    for axis in range(2):
        jolt = np.zeros(size)
        jolt[[axis, axis + 2]] = 0.5 * seconds**2, seconds
        covariance += acceleration_mps2**2 * np.outer(jolt, jolt)
    if belief.wander > 0:
        length, _, extra = belief.mean[MOVING:].reshape(-1, ENTRIES).T
        far = np.maximum(length - extra, NEAR_M)
        square = (
            belief.wander**2 * abs(seconds) * np.stack([np.ones_like(far), far**-2, np.zeros_like(far)], 1)
        )
        each = np.arange(MOVING, size)
        covariance[each, each] += square.ravel()
    return replace(belief, mean=move @ belief.mean, covariance=covariance)


def columns(mean: Array, belief: JointBelief, anchor: int, heading_rad: float, model: SignalModel) -> Columns:
    """Responses at a joint state, and their slopes."""
    wave, bank = model.waveform, belief.features
    rows = np.flatnonzero(bank.anchor == anchor)
    own = MOVING + ENTRIES * rows[:, None] + np.arange(ENTRIES)
    total, bearing, extra = mean[own].T
    ahead, beside = np.cos(bearing), np.sin(bearing)
    place, behind = np.empty((1 + len(rows), 2)), np.append(0.0, extra)
    place[0] = model.anchors[anchor, :2]
    place[1:, 0] = bank.origin_m[rows, 0] + (total - extra) * ahead
    place[1:, 1] = bank.origin_m[rows, 1] + (total - extra) * beside
    way = place - mean[:2]
    far = np.maximum(np.hypot(way[:, 0], way[:, 1]), LEAST_M)
    length = np.maximum(far + behind, LEAST_M)
    angle = np.arctan2(way[:, 1], way[:, 0]) - heading_rad
    element = 2 * np.pi / wave.wavelength_m * wave.agent_element_m
    antennas = np.exp(1j * element @ np.stack([np.cos(angle), np.sin(angle)]))
    bent = antennas * 1j * (element @ np.stack([-np.sin(angle), np.cos(angle)]))
    rate = 2 * np.pi / SPEED_OF_LIGHT * wave.offset_hz
    spectrum = wave.pulse[:, None] * np.exp(-1j * np.outer(rate, length)) / length
    sloped = spectrum * (-1j * rate[:, None] - 1 / length)
    count, size = len(place), len(mean)
    along = way / far[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], 1) / far[:, None]
    jacobian = np.zeros((2, count, size + 1))
    jacobian[0, :, :2], jacobian[1, :, :2] = -along, -across
    jacobian[1, :, -1] = -1.0
    each = np.arange(1, count)
    for entry, towards in ((0, along[1:]), (1, across[1:])):
        ray = towards[:, 0] * ahead + towards[:, 1] * beside
        jacobian[entry, each, own[:, 0]] = ray
        jacobian[entry, each, own[:, 1]] = (total - extra) * (towards[:, 1] * ahead - towards[:, 0] * beside)
        jacobian[entry, each, own[:, 2]] = 1 - entry - ray
    return Columns(antennas, bent, spectrum, sloped, jacobian.reshape(2 * count, size + 1), rows)


def log_likelihood(known: Products, power: Array, noise: float) -> float:
    """Log density of samples whose covariance is noise and responses of given powers (C,)."""
    root = np.sqrt(power)
    small = noise * np.eye(len(power)) + root[:, None] * known.gram * root
    matched = root * known.matched
    fit = known.energy - np.vdot(matched, np.linalg.solve(small, matched)).real
    logdet = float(np.linalg.slogdet(small / noise)[1])
    return float(-fit / noise - logdet - known.size * np.log(np.pi * noise))


def update(
    belief: JointBelief, samples: Complex, heard: NDArray[np.bool_], heading_rad: float, model: SignalModel,
    step: int, start: Array | None = None,
) -> tuple[JointBelief, float]:  # fmt: skip
    """The belief after the samples (J, N, M) of one step, and the log of their evidence.

    Parameters
    ----------
    start : (4,), optional
        Where the agent is thought to be by other means: from there the maximum is looked for.
    """
    size, anchors = len(belief.mean), np.flatnonzero(heard)
    each = {int(j): np.ascontiguousarray(samples[j]) for j in anchors}
    origin = belief.mean.copy()
    if start is not None:
        origin[:MOVING] = start
    existence = belief.existence.copy()
    for j, z in each.items():
        existence[j] = _existence(belief, origin, j, z, heading_rad, model)
    prior = np.zeros((size + 1, size + 1))  # the last entry is an error of this step's heading
    prior[:size, :size] = belief.covariance
    prior[size, size] = model.waveform.heading_std_rad**2
    base, at = np.append(belief.mean, 0.0), np.append(origin, 0.0)
    for _ in range(ROUNDS):
        score, curvature, value = np.zeros(size + 1), np.zeros((size + 1, size + 1)), 0.0
        for j, z in each.items():
            gain = _powers(belief, existence, j)
            one, two, three = slopes(at, belief, j, z, heading_rad, gain, model)
            score, curvature, value = score + one, curvature + two, value + three
        system = np.eye(size + 1) + prior @ curvature
        following = base + np.linalg.solve(system, prior @ (score + curvature @ (at - base)))
        # Laplace: the value there, how far it is from the prior, and the volume that is left
        evidence = value - 0.5 * float((at - base) @ score) - 0.5 * float(np.linalg.slogdet(system)[1])
        moved = np.abs(following - at)[:2].max()
        at = following
        if moved < SETTLED_M:
            break
    covariance = np.linalg.solve(system, prior)[:size, :size]
    found = replace(belief, mean=at[:size], covariance=0.5 * (covariance + covariance.T), existence=existence)
    for j, z in each.items():
        found = _follow_powers(found, j, z, heading_rad + at[size], model, step)
    return found, evidence


def _existence(
    belief: JointBelief, at: Array, anchor: int, samples: Complex, heading_rad: float, model: SignalModel
) -> float:
    """Probability of the line of sight, after the samples."""
    before = belief.existence[anchor]
    before = STAYS * before + APPEARS * (1 - before)
    found = columns(at, belief, anchor, heading_rad, model)
    noise, power = belief.noise[anchor], belief.features.power[found.rows]
    known = products(found, samples)
    there = log_likelihood(known, np.append(belief.los_power[anchor], power), noise)
    absent = log_likelihood(known.of(slice(1, None)), power, noise)
    return float(1 / (1 + (1 - before) / before * np.exp(np.clip(absent - there, -500, 500))))


def _powers(belief: JointBelief, existence: Array, anchor: int) -> Array:
    """Power of every column of an anchor; of a line of sight that isn't there, 0."""
    rows = belief.features.anchor == anchor
    los = belief.los_power[anchor] if existence[anchor] > 0.5 else 0.0
    return np.append(los, belief.features.power[rows])


def slopes(
    at: Array, belief: JointBelief, anchor: int, samples: Complex, heading_rad: float, power: Array,
    model: SignalModel,
) -> tuple[Array, Array, float]:  # fmt: skip
    """Slope and curvature of the log-likelihood by the joint state and the heading's error, and its value."""
    found = columns(at[:-1], belief, anchor, heading_rad + at[-1], model)
    noise, count = belief.noise[anchor], len(power)
    gram, matched, value = _whitened(found, power, noise, samples)
    amplitude = power * matched[:count]  # posterior means of what each path carries
    each = np.arange(count)
    score, curvature = np.zeros(2 * count), np.zeros((2 * count, 2 * count))
    product = np.outer(amplitude.conj(), amplitude)
    for c in range(2):
        mine = slice((c + 1) * count, (c + 2) * count)
        score[c * count : (c + 1) * count] = 2 * np.real(amplitude * matched[mine].conj())
        score[c * count : (c + 1) * count] -= 2 * power * np.real(gram[each, (c + 1) * count + each])
        for e in range(2):
            theirs = slice((e + 1) * count, (e + 2) * count)
            curvature[c * count : (c + 1) * count, e * count : (e + 1) * count] = 2 * np.real(
                product * gram[mine, theirs]
            )
    jacobian = found.jacobian
    return jacobian.T @ score, jacobian.T @ curvature @ jacobian, value


def _whitened(found: Columns, power: Array, noise: float, samples: Complex) -> tuple[Complex, Complex, float]:
    """``T^H C^-1 T``, ``T^H C^-1 z`` for all columns and slopes T, and the log-likelihood."""
    count = len(power)
    antennas = np.concatenate([found.antennas, found.antennas, found.bent], 1)
    adjoint = np.concatenate([found.spectrum, found.sloped], 1).conj().T
    which = np.concatenate([np.arange(2 * count), np.arange(count)])  # slopes by angle keep the spectrum
    turned = antennas.conj().T
    both = adjoint @ adjoint.conj().T
    plain = (turned @ antennas) * both[np.ix_(which, which)]
    output = ((adjoint @ samples.T)[which] * turned).sum(1)
    root = np.sqrt(power)
    cross = plain[:, :count] * root
    small = noise * np.eye(count) + root[:, None] * cross[:count]
    matched = root * output[:count]
    solved = np.linalg.solve(small, np.column_stack([cross.conj().T, matched]))
    gram = (plain - cross @ solved[:, :-1]) / noise
    fit = (np.vdot(samples, samples) - np.vdot(matched, solved[:, -1])).real / noise
    logdet = float(np.linalg.slogdet(small / noise)[1])
    return (
        gram,
        (output - cross @ solved[:, -1]) / noise,
        float(-fit - logdet - samples.size * np.log(np.pi * noise)),
    )


def _follow_powers(
    belief: JointBelief, anchor: int, samples: Complex, heading_rad: float, model: SignalModel, step: int
) -> JointBelief:
    """Powers of line of sight, features and noise, each a running mean of what the step has it at."""
    power, noise = _powers(belief, belief.existence, anchor), belief.noise[anchor]
    found = columns(belief.mean, belief, anchor, heading_rad, model)
    known, root = products(found, samples), np.sqrt(power)
    inverse = np.linalg.inv(noise * np.eye(len(power)) + root[:, None] * known.gram * root)
    amplitude = root * (inverse @ (root * known.matched))
    spread = power * noise * np.real(np.diagonal(inverse))
    square = np.abs(amplitude) ** 2 + spread
    kept = np.vdot(amplitude, known.gram @ amplitude - 2 * known.matched).real
    noise_now = (known.energy + kept) / (samples.size - np.count_nonzero(power))
    los_power, noises, bank = belief.los_power.copy(), belief.noise.copy(), belief.features
    if power[0] > 0:
        los_power[anchor] += FORGETS * (square[0] - los_power[anchor])
    noises[anchor] += FORGETS * (noise_now - noise)
    powers, seen, last = bank.power.copy(), bank.steps_seen.copy(), bank.last_step.copy()
    rows = found.rows
    powers[rows] += FORGETS * (square[1:] - powers[rows])
    powers[rows] = np.maximum(powers[rows], FAINTEST * los_power[anchor])
    heard = rows[np.abs(amplitude[1:]) ** 2 > SURE * spread[1:]]
    seen[heard] += 1
    last[heard] = step
    bank = replace(bank, power=powers, steps_seen=seen, last_step=last)
    return replace(belief, los_power=los_power, noise=noises, features=bank)
