"""Where one more path would explain most of what is left of a snapshot, and how surely it isn't noise."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.extraction.fit import Fit
from gridslam.extraction.responses import Band, compose
from gridslam.world.radio import SPEED_OF_LIGHT

Complex = NDArray[np.complex128]
FINE, FINE_ARRAYS = 8, 4
"""Points per resolution cell of the delay, with one antenna and with arrays."""
LEAST_OWN = 0.15
"""Share of a new path's response that isn't explained by the others, at least."""
MOST_POINTS = 2**22
"""Of the grid over all snapshots that are searched at once."""


def strongest(band: Band, samples: Complex, fit: Fit) -> Array:
    """The path (S, 3) that would take most energy out of what is left."""
    left = samples - compose(band, fit.paths, np.where(fit.there, fit.amplitude, 0))
    beams = [_beams(band, factor) for factor in (1, 2)]
    fine = FINE if len(beams[0]) == len(beams[1]) == 1 else FINE_ARRAYS
    length = fine * len(band.waveform.offset_hz)
    found = np.empty((len(samples), 3))
    block = max(1, MOST_POINTS // (length * len(beams[0]) * len(beams[1])))
    for begin in range(0, len(samples), block):
        rows = slice(begin, begin + block)
        power = _power(band, left[rows], beams, length)
        if fine == FINE and fit.paths.shape[1]:
            power[:, 0, 0] /= _own_share(band, fit.take(np.arange(len(samples))[rows]), length)
        best = power.reshape(len(power), -1).argmax(1)
        leaving, arriving, delay = np.unravel_index(best, power.shape[1:])
        found[rows, 0] = delay * band.waveform.folding_m / length
        found[rows, 1], found[rows, 2] = beams[0][leaving], beams[1][arriving]
    return found


def surprise(band: Band, gain: Array, left: Array, count: NDArray[np.intp]) -> Array:
    """How little a path is like noise: minus the log of the expected number of noise peaks as high, (S,).

    Parameters
    ----------
    gain : (S,)
        Energy that the path takes out.
    left : (S,)
        Energy that is left then.
    count : (S,)
        Paths in all, this one included.

    Notes
    -----
    Of one given path, gain / left follows an F distribution whatever the noise's power; the tail of ``x = n
    log(1 + gain / left)`` is exp(-x). Peaks above x among all paths: docs/model.md, (M53).
    """
    parameters = 0.5 * len(band.free) * (count - 1)  # of the paths before
    freedom = np.maximum(band.samples - count - parameters, 1)
    x = freedom * np.log1p(np.maximum(gain, 0) / np.maximum(left, 1e-300))
    return x - _log_peaks(band, np.maximum(x, 1.0))


def _log_peaks(band: Band, x: Array) -> Array:
    """Log of how many independent places there are for a peak of height x."""
    ranges = {0: band.waveform.folding_m, 1: 2 * np.pi, 2: 2 * np.pi}
    log = np.zeros_like(x)
    for factor in band.free:
        log += np.log(np.maximum(band.extent(factor) * ranges[factor], 1)) + 0.5 * np.log(x / np.pi)
    return log


def _beams(band: Band, factor: int) -> Array:
    """Directions that are tried, (n,) rad: the middle alone for one element."""
    if factor not in band.free:
        return np.zeros(1)
    q = band.elements[factor - 1]
    reach = np.linalg.norm(q - q.mean(0), axis=1).max() / band.waveform.wavelength_m
    count = int(np.clip(np.ceil(4 * np.pi * reach * 2), 12, 720))
    return np.linspace(-np.pi, np.pi, count, endpoint=False)


def _power(band: Band, left: Complex, beams: list[Array], length: int) -> Array:
    """Matched power (S, n_aod, n_aoa, length) of what is left, over lengths that cover the folding range."""
    leaving, arriving = (band.factor(factor, beams[factor - 1])[0] for factor in (1, 2))
    part = np.einsum("ta,sabm->stbm", leaving.conj(), left, optimize=True)
    part = np.einsum("rb,stbm->strm", arriving.conj(), part, optimize=True)
    return np.abs(_over_delay(band, part, length)) ** 2


def _over_delay(band: Band, values: Complex, length: int) -> Complex:
    """Inner products with delay responses on a grid of lengths: one transform, but for a phase."""
    return np.fft.ifft(values * band.waveform.pulse.conj(), length, axis=-1) * length


def _own_share(band: Band, fit: Fit, length: int) -> Array:
    """Share (S, length) of a path's response at each length that the present paths don't explain."""
    shares = _responses(band.waveform.offset_hz.tobytes(), band.waveform.pulse.tobytes(), length)
    delay, _ = band.factor(0, fit.paths[..., 0])
    delay = np.where(fit.there[..., None], delay, 0)
    cross = np.einsum("gm,slm->sgl", shares.conj(), delay, optimize=True)
    gram = np.einsum("slm,skm->slk", delay.conj(), delay, optimize=True)
    diagonal = np.arange(gram.shape[1])
    gram[:, diagonal, diagonal] += np.where(fit.there, 1e-6, 1.0)
    explained = np.einsum("sgl,slk,sgk->sg", cross, np.linalg.inv(gram), cross.conj(), optimize=True).real
    return np.maximum(1 - explained, LEAST_OWN)


@lru_cache(maxsize=4)
def _responses(offsets: bytes, pulse: bytes, length: int) -> Complex:
    """Delay responses (length, M) over the folding range."""
    offset, spectrum = np.frombuffer(offsets), np.frombuffer(pulse, np.complex128)
    folding = SPEED_OF_LIGHT / (offset[1] - offset[0])
    lengths = folding * np.arange(length) / length
    return np.asarray(spectrum * np.exp(-2j * np.pi / SPEED_OF_LIGHT * lengths[:, None] * offset))
