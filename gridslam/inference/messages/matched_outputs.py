"""Tables of matched outputs: what of a step's samples the likelihood looks up; docs/model.md, (M123)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.radio import SPEED_OF_LIGHT

Complex = NDArray[np.complex128]
ROWS = 8192
"""Rows over the unambiguous distance; linear between them, 1e-4 of the greatest value off."""


def matched_outputs(samples: Complex, offset_hz: Array, pulse: Complex) -> NDArray[np.float32]:
    """Samples correlated with the pulse from every distance, by a zero-padded FFT.

    Parameters
    ----------
    samples : (N, M) complex128
        Of one anchor, by antenna and frequency.
    offset_hz, pulse : (M,)
        See `Waveform`.

    Returns
    -------
    (N, ROWS + 1, 4) float32
        ``sum_i conj(S_i) z_mi exp(j 2 pi f_i d / c)`` over d = 0 to the unambiguous distance, real and
        imaginary part, and of its slope by d (1/m).
    """
    matched = samples * pulse.conj()
    rate = 2 * np.pi * offset_hz / SPEED_OF_LIGHT
    both = np.stack([matched, 1j * rate * matched], 1)  # (N, 2, M)
    # exp(j 2 pi (f_0 + i step) d / c): an inverse FFT of ROWS points, turned by the lowest frequency
    step = offset_hz[1] - offset_hz[0]
    distance = np.arange(ROWS + 1) * (SPEED_OF_LIGHT / step / ROWS)
    cycle = np.fft.ifft(both, ROWS, axis=-1) * ROWS
    cycle = np.concatenate([cycle, cycle[..., :1]], -1) * np.exp(1j * rate[0] * distance)
    table = np.stack([cycle[:, 0].real, cycle[:, 0].imag, cycle[:, 1].real, cycle[:, 1].imag], -1)
    return np.ascontiguousarray(table, np.float32)


def pulse_correlation(offset_hz: Array, pulse: Complex) -> Array:
    """``sum_i |S_i|^2 cos(2 pi f_i d / c)`` and its slope (1/m), (ROWS + 1, 2), of a spectrum even in f."""
    step = offset_hz[1] - offset_hz[0]
    distance = np.arange(ROWS + 1) * (SPEED_OF_LIGHT / step / ROWS)
    rate, power = 2 * np.pi * offset_hz / SPEED_OF_LIGHT, np.abs(pulse) ** 2
    phase = np.outer(distance, rate)
    return np.stack([np.cos(phase) @ power, -np.sin(phase) @ (rate * power)], -1)


def rows_per_m(offset_hz: Array) -> float:
    """Rows of the tables per metre."""
    return float(ROWS * (offset_hz[1] - offset_hz[0]) / SPEED_OF_LIGHT)
