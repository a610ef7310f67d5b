"""Errors of an agent's antenna elements and of the pulse, from samples along a known way; (M234), (M235).

Elements stand elsewhere than the drawing says, and cables and filters bend the pulse. Both change every
path's response in a way that no path's length, direction or power can, so that samples of paths whose places
are known tell them: by the slopes of the log-likelihood that hybrid SLAM learns features by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]
ELEMENT_STD, PULSE_STD = 0.1, 0.2
"""Before any sample: of an element's place in wavelengths, and of the pulse's relative error."""
ROUNDS, SETTLED = 20, 0.05
"""Of Gauss-Newton steps; in deviations of what is found, by which none may move any more."""
LEAST_M = 0.1


@dataclass(frozen=True, eq=False)
class Known:
    """Samples of one anchor at K steps, and where everything is.

    Attributes
    ----------
    samples : (K, N, M) complex128
    pose : (K, 3)
        x, y (m) and heading (rad) of the agent.
    paths : (C, 3)
        x, y, extra length (m) of what is heard: the anchor itself, images, scatterers.
    """

    samples: Complex
    pose: Array
    paths: Array


@dataclass(frozen=True, eq=False)
class RadioErrors:
    """What elements and pulse are, as far as samples say.

    Attributes
    ----------
    waveform : Waveform
        With the elements and the pulse that were found.
    element_error_m, element_std_m : (N, 2)
        Found less assumed places, and deviations. That all are shifted alike can't be told.
    pulse_error : (M,) complex128
        Relative to the assumed pulse.
    pulse_std : (2, M)
        Deviations of its real and imaginary parts.
    """

    waveform: Waveform
    element_error_m: Array
    element_std_m: Array
    pulse_error: Complex
    pulse_std: Array


def radio_errors(anchors: list[Known], waveform: Waveform) -> RadioErrors:
    """Errors of the agent's elements and of the pulse, by Gauss-Newton steps; powers and noise by EM."""
    count, bins = len(waveform.agent_element_m), len(waveform.offset_hz)
    deviation = np.repeat([ELEMENT_STD * waveform.wavelength_m, PULSE_STD], [2 * count, 2 * bins])
    at, levels = np.zeros(len(deviation)), [_first_levels(known, waveform) for known in anchors]
    for _ in range(ROUNDS):
        found = _bent(waveform, at)
        score, curvature = -at / deviation**2, np.diag(1 / deviation**2)
        for j, known in enumerate(anchors):
            one, two, levels[j] = _slopes(known, found, levels[j])
            score, curvature = score + one, curvature + two
        move = np.linalg.solve(curvature, score)
        spread = np.sqrt(np.diagonal(np.linalg.inv(curvature)))
        at = at + move
        if np.abs(move / spread).max() < SETTLED:
            break
    bent = _bent(waveform, at)
    part = at[2 * count :].reshape(2, bins)
    return RadioErrors(
        bent, at[: 2 * count].reshape(count, 2), spread[: 2 * count].reshape(count, 2),
        np.exp(part[0] + 1j * part[1]) - 1, spread[2 * count :].reshape(2, bins),
    )  # fmt: skip


def _bent(waveform: Waveform, at: Array) -> Waveform:
    """The waveform with errors: of elements (2 N), of the pulse's logarithm, real and imaginary (2 M)."""
    count, bins = len(waveform.agent_element_m), len(waveform.offset_hz)
    part = at[2 * count :].reshape(2, bins)
    return replace(
        waveform, agent_element_m=waveform.agent_element_m + at[: 2 * count].reshape(count, 2),
        pulse=waveform.pulse * np.exp(part[0] + 1j * part[1]),
    )  # fmt: skip


def _responses(known: Known, wave: Waveform, step: int) -> tuple[Complex, Array]:
    """Responses (N, M, C) of all paths at a step, and the directions (C, 2) that they come from."""
    way = known.paths[:, :2] - known.pose[step, :2]
    far = np.maximum(np.hypot(*way.T), LEAST_M)
    angle = np.arctan2(way[:, 1], way[:, 0]) - known.pose[step, 2]
    towards = np.column_stack([np.cos(angle), np.sin(angle)])
    antennas = np.exp(2j * np.pi / wave.wavelength_m * wave.agent_element_m @ towards.T)
    length, rate = far + known.paths[:, 2], 2 * np.pi / SPEED_OF_LIGHT * wave.offset_hz
    spectrum = wave.pulse[:, None] * np.exp(-1j * np.outer(rate, length)) / length
    return antennas[:, None] * spectrum[None], towards


def _first_levels(known: Known, wave: Waveform) -> Array:
    """Powers of all paths at 1 m, and of the noise, to begin with (C + 1,)."""
    energy = float(np.mean(np.abs(known.samples) ** 2))
    length = known.paths[:, 2] + np.hypot(*(known.paths[:, :2] - known.pose[:, :2].mean(0)).T)
    power = energy * known.samples[0].size * length**2 / len(wave.agent_element_m) / len(length)
    return np.append(power, 0.1 * energy)


def _slopes(known: Known, wave: Waveform, level: Array) -> tuple[Array, Array, Array]:
    """Slope and curvature of the log-likelihood by all errors, and levels nearer to what was received."""
    count, bins, power, noise = len(wave.agent_element_m), len(wave.offset_hz), level[:-1], level[-1]
    size = 2 * count + 2 * bins
    score, curvature, energy, left = np.zeros(size), np.zeros((size, size)), np.zeros(len(power)), 0.0
    turn = 2j * np.pi / wave.wavelength_m
    for step, z in enumerate(known.samples):
        response, towards = _responses(known, wave, step)
        flat = response.reshape(-1, len(power))
        root = flat * np.sqrt(power)
        inverse = np.linalg.inv(noise * np.eye(len(power)) + root.conj().T @ root)

        def whitened(x: Complex, root: Complex = root, inverse: Complex = inverse) -> Complex:
            out: Complex = (x - root @ (inverse @ (root.conj().T @ x))) / noise
            return out

        rest = whitened(z.ravel())
        amplitude = power * (flat.conj().T @ rest)
        energy += np.abs(amplitude) ** 2 + power * noise * np.real(np.diagonal(inverse))
        left += float(np.vdot(z.ravel() - flat @ amplitude, z.ravel() - flat @ amplitude).real)
        both = whitened(flat).conj() * power * flat  # C^-1 h_n conj times g_n h_n, by sample
        signal = (response @ amplitude).astype(complex)
        shape = (count, bins)
        slope, volume = np.zeros((size, *shape), complex), np.zeros(size)
        shares = both.reshape(*shape, -1)
        for m in range(count):
            for axis in range(2):
                row = 2 * m + axis
                slope[row, m] = (response[m] * (turn * towards[:, axis])) @ amplitude
                volume[row] = np.real((shares[m] * (turn * towards[:, axis])).sum())
        each, bent = np.arange(bins), signal.T
        slope[2 * count + each, :, each] = bent
        slope[2 * count + bins + each, :, each] = 1j * bent
        volume[2 * count : 2 * count + bins] = np.real(shares.sum((0, 2)))
        volume[2 * count + bins :] = np.real(1j * shares.sum((0, 2)))
        whole = slope.reshape(size, -1)
        score += 2 * np.real(whole.conj() @ rest) - 2 * volume
        curvature += 2 * np.real(whole.conj() @ whitened(whole.T))
    steps = len(known.samples)
    free = known.samples[0].size - len(power)
    return score, curvature, np.append(energy / steps, left / steps / free)
