"""Tables of matched outputs: what of a step's samples the likelihood looks up; docs/model.md, (M123)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from gridslam.arrays import Array
from gridslam.world.radio import SPEED_OF_LIGHT

Complex = NDArray[np.complex128]
ROWS = 8192
"""Rows over the unambiguous distance; linear between them, 1e-4 of the greatest value off."""
COARSE_ROWS = 1024
"""The same where places are looked for; 8e-3 of the greatest value off."""


def matched_outputs(samples: Complex, offset_hz: Array, pulse: Complex) -> NDArray[np.float32]:
    """Samples correlated with the pulse from every distance, by a zero-padded FFT.

    Parameters
    ----------
    samples : (..., N, M) complex128
        Of one anchor, by antenna and frequency.
    offset_hz, pulse : (M,)
        See `Waveform`.

    Returns
    -------
    (..., N, ROWS + 1, 4) float32
        ``sum_i conj(S_i) z_mi exp(j 2 pi f_i d / c)`` over d = 0 to the unambiguous distance, real and
        imaginary part, and of its slope by d (1/m).
    """
    matched = samples * pulse.conj()
    rate = 2 * np.pi * offset_hz / SPEED_OF_LIGHT
    both = np.empty((*samples.shape[:-1], ROWS + 1, 2), np.complex64)
    both[..., 0] = _over_distances(matched, offset_hz, ROWS)
    both[..., 1] = _over_distances(1j * rate * matched, offset_hz, ROWS)
    return both.view(np.float32)


def coarse_outputs(samples: Complex, offset_hz: Array, pulse: Complex) -> NDArray[np.float32]:
    """Matched outputs without slopes, antennas of a distance side by side, (..., COARSE_ROWS + 1, N, 2)."""
    value = _over_distances(samples * pulse.conj(), offset_hz, COARSE_ROWS)
    turned = np.ascontiguousarray(np.moveaxis(value, -1, -2))
    return turned.view(np.float32).reshape(*turned.shape, 2)


def _over_distances(spectrum: Complex, offset_hz: Array, rows: int) -> NDArray[np.complex64]:
    """``sum_i spectrum_i exp(j 2 pi f_i d / c)`` of spectra (..., M) at every row's d, (..., rows + 1)."""
    # exp(j 2 pi (f_0 + i step) d / c): an inverse FFT, turned by the lowest frequency
    step = offset_hz[1] - offset_hz[0]
    distance = np.arange(rows + 1) * (SPEED_OF_LIGHT / step / rows)
    turn = np.exp(2j * np.pi / SPEED_OF_LIGHT * offset_hz[0] * distance).astype(np.complex64)
    cycle = fft.ifft(spectrum.astype(np.complex64), rows, norm="forward")
    out: NDArray[np.complex64] = np.concatenate([cycle, cycle[..., :1]], -1) * turn
    return out


def pulse_correlation(offset_hz: Array, pulse: Complex) -> Array:
    """``sum_i |S_i|^2 cos(2 pi f_i d / c)`` and its slope (1/m), (ROWS + 1, 2), of a spectrum even in f."""
    step = offset_hz[1] - offset_hz[0]
    distance = np.arange(ROWS + 1) * (SPEED_OF_LIGHT / step / ROWS)
    rate, power = 2 * np.pi * offset_hz / SPEED_OF_LIGHT, np.abs(pulse) ** 2
    phase = np.outer(distance, rate)
    return np.stack([np.cos(phase) @ power, -np.sin(phase) @ (rate * power)], -1)


def rows_per_m(offset_hz: Array, rows: int = ROWS) -> float:
    """Rows of the tables per metre."""
    return float(rows * (offset_hz[1] - offset_hz[0]) / SPEED_OF_LIGHT)
