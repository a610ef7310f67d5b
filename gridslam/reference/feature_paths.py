"""Plain counterparts of the kernels on paths of learned features: responses made in full, dense slopes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.path_products import paths_at
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.signal_model import SignalModel
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]


def place_paths(
    state: Array, prior: Array, belief: JointBelief, anchor: int, heading_rad: float, model: SignalModel
) -> tuple[Array, Array, Array, Array]:
    """Twin of `path_places.place_paths` for one anchor, without epsilon and its variances.

    Parameters
    ----------
    state : (2, n + 1)
        Where slopes are taken, and the prior's mean; the last entry is the error of the heading, rad.
    prior : (n + 1, n + 1)
        Covariance.

    Returns
    -------
    (numbers, off, towards, spread)
        (p,), (p,), (p, n + 1), (p, p)
    """
    paths = paths_at(state[0, :-1], belief, anchor, heading_rad + state[0, -1], model)
    towards = paths.jacobian @ prior
    return paths.numbers, paths.jacobian @ (state[0] - state[1]), towards, towards @ paths.jacobian.T


def multiply_paths(numbers: Array, samples: Complex, wave: Waveform) -> tuple[Array, Complex]:
    """Twin of `path_products.multiply_paths` for one anchor's samples (N, M), by all responses in full.

    Returns
    -------
    (gram, matched)
        (3 C, 3 C), (3 C,)
    """
    count = len(numbers) // 2
    rate = 2 * np.pi / SPEED_OF_LIGHT * wave.offset_hz
    element = 2 * np.pi / wave.wavelength_m * wave.agent_element_m
    length, (x, y) = numbers[:count, None], (f(numbers[count:, None]) for f in (np.cos, np.sin))
    antenna = np.exp(1j * (x * element[:, 0] + y * element[:, 1]))
    bent = 1j * (x * element[:, 1] - y * element[:, 0]) * antenna
    spectrum = wave.pulse * np.exp(-1j * rate * length) / length
    sloped = (-1j * rate - 1 / length) * spectrum
    kinds = ((antenna, spectrum), (antenna, sloped), (bent, spectrum))
    whole = np.concatenate([one[:, :, None] * two[:, None] for one, two in kinds]).reshape(3 * count, -1)
    return (whole.conj() @ whole.T).real, whole.conj() @ samples.ravel()


def slope_paths(
    gram: Array, matched: Complex, power: Array, noise: float, energy: float, size: int
) -> tuple[Array, Array, float]:
    """Twin of `path_slopes.slope_paths` for one anchor: score, curvature and log density.

    Parameters
    ----------
    gram, matched : (3 C, 3 C), (3 C,)
        As `multiply_paths` makes them of C paths.
    power : (C,)
        Of the paths.
    noise : float
        The noise's power in each sample.
    energy, size : float, int
        Sum of the squares of all samples, and their number.

    Returns
    -------
    (score, curvature, density)
        (2 C,), (2 C, 2 C), by lengths, then angles; float
    """
    count = len(power)
    root = np.sqrt(power)
    cross, met = gram[:, :count] * root, root * matched[:count]
    small = noise * np.eye(count) + root[:, None] * cross[:count]
    inverse = np.linalg.inv(small)
    white = (gram - cross @ inverse @ cross.T) / noise
    heard = (matched - cross @ inverse @ met) / noise
    fit = (energy - np.vdot(met, inverse @ met).real) / noise
    density = -fit - np.linalg.slogdet(small / noise)[1] - size * np.log(np.pi * noise)
    twice = np.tile(power * heard[:count], 2)
    volume = white[np.arange(count, 3 * count), np.tile(np.arange(count), 2)]
    score = 2 * np.real(twice * heard[count:].conj()) - 2 * np.tile(power, 2) * volume
    curvature = 2 * np.real(np.outer(twice.conj(), twice)) * white[count:, count:]
    return score, curvature, float(density)
