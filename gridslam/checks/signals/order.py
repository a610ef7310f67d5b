"""Whether samples go from the lowest frequency to the highest, as they should, or otherwise, or over time.

The spectrum of paths goes on smoothly from one frequency to the next, and breaks off at the ends. In the
order of an FFT, from the carrier up and then from below, it breaks off in the middle instead, and goes on
from the last sample to the first. Samples over time have peaks of their own, and no profile of delays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, squared
from gridslam.checks.signals.delays import delay_profile
from gridslam.checks.signals.places import Complex
from gridslam.world.waveform import Waveform

EVEN = 2.0
"""How many times its smallest a pulse's largest magnitude may be where breaks tell the order."""
BROKEN, WHOLE, ALONE = 1.3, 1.2, 1.15
"""How large a break is, over what is usual from one frequency to the next, and what beside it is none
(up to its root, too); how many times as large as all others it must be."""
LEAST_COUNT, LEAKS, SCATTER = 24, 2.0, 5.0
"""Frequencies from which on breaks tell the order; how much louder than beside it the middle is where the
carrier leaks; and by how much breaks scatter, times the root of the snapshots and elements."""
LIKE, UNLIKE = 0.9, 0.5
"""Correlation of the power over frequency with the pulse's that tells the order, and that denies another."""
LEAST, MOST, FEW = 20, 240, 60
"""Snapshots from which on an order is told, and by which at most; by about which, before a run,
whether they are times."""
LONE = 0.9
"""Share of snapshots with their peak at the same sample from which on this may be a jammed frequency."""
TIMES = (
    "samples: a response over time, where one over frequency belongs: "
    "np.fft.fftshift(np.fft.fft(samples, axis=-1), axes=-1)"
)
SHARPER, MOSTLY = 2.0, 0.8
"""How many times higher the peaks of samples themselves are than those of delays if they are times; in what
share of snapshots they are higher at all."""


def order_note(samples: NDArray, heard: NDArray[np.bool_], waveform: Waveform) -> str | None:
    """What to say of a recording's samples before they are used; None of right ones.

    Parameters
    ----------
    samples : (K, J, A, B, M) complex
    heard : (K, J) bool
    """
    own = some_of(samples, heard)
    roll = shift_of(own, waveform)
    if roll:
        return shift_line(roll, own.shape[-1])
    highest = squared(own).sum((1, 2)).argmax(-1)
    if len(own) < LEAST or np.bincount(highest).max() > LONE * len(own):
        return None
    return TIMES if over_time(own[:: max(len(own) // FEW, 1)], waveform) else None


def some_of(samples: NDArray, usable: NDArray[np.bool_]) -> Complex:
    """Some of the usable snapshots, from the first to the last, (N, A, B, M).

    Parameters
    ----------
    samples : (K, J, A, B, M) complex
    usable : (K, J) bool
    """
    step, anchor = np.nonzero(usable)
    some = np.unique(np.linspace(0, len(step) - 1, min(len(step), MOST)).astype(int))
    return np.asarray(samples[step[some], anchor[some]], np.complex128)


def shift_of(own: Complex, waveform: Waveform) -> int:
    """By how many samples the last axis must be rolled to rise from the lowest frequency; 0 if it does.

    Parameters
    ----------
    own : (N, A, B, M) complex
        Snapshots.
    """
    count, power = own.shape[-1], np.abs(waveform.pulse)
    if len(own) < LEAST:
        return 0
    rolls = sorted({count // 2, count - count // 2})
    if power.max() > EVEN * power.min():
        level = squared(own).mean((0, 1, 2))
        plain, *fits = (_alike(np.roll(level, roll), squared(waveform.pulse)) for roll in (0, *rolls))
        fair = [roll for roll, fit in zip(rolls, fits, strict=True) if fit > LIKE > UNLIKE > plain]
        sharp = [np.log(_sharpness(np.roll(own, roll, -1), waveform)).mean() for roll in fair]
        return fair[int(np.argmax(sharp))] if fair else 0
    level = squared(own).mean((0, 1, 2))
    middle = count // 2
    if count < LEAST_COUNT or level[middle] > LEAKS * max(level[middle - 1], level[middle + 1]):
        return 0  # the carrier itself leaks into what stands in the middle
    breaks, broken = _breaks(own), max(BROKEN, 1 + SCATTER / np.sqrt(own[..., 0].size))
    for roll in rolls:
        place = count - roll
        others = np.delete(breaks, place)
        beside = max(breaks[place - 1], breaks[(place + 1) % count], breaks[0])
        if breaks[place] > max(broken, ALONE * others.max()) and beside < max(WHOLE, np.sqrt(breaks[place])):
            return roll
    return 0


def shift_line(roll: int, count: int) -> str:
    """What is said of `count` samples that must be rolled by `roll`."""
    cure = "fftshift" if roll == count // 2 else "ifftshift"
    return (
        "samples: in the order of an FFT, from the carrier up and then from below, where rising frequencies "
        f"belong: np.fft.{cure} over the last axis"
    )


def over_time(own: Complex, waveform: Waveform) -> bool:
    """Whether samples (N, A, B, M) look like those of a response over time.

    Parameters
    ----------
    own : (N, A, B, M) complex
        Snapshots.
    """
    as_told, as_times = (_sharpness(z, waveform) for z in (own, spectrum(own)))
    gain = np.log(as_times / as_told)
    return bool(len(gain) and gain.mean() > np.log(SHARPER) and (gain > 0).mean() > MOSTLY)


def spectrum(own: Complex) -> Complex:
    """Spectra (N, A, B, M), from the lowest frequency to the highest, of samples over time."""
    return np.asarray(np.fft.fftshift(np.fft.fft(own, axis=-1), axes=-1))


def _sharpness(own: Complex, waveform: Waveform) -> Array:
    """Highest power over delays of snapshots (N,), over its mean."""
    profile = delay_profile(own, waveform)
    return np.asarray(profile.max(-1) / np.maximum(profile.mean(-1), 1e-300))


def _breaks(own: Complex) -> Array:
    """How far samples (M,) are from what the one before predicts, the first from the last, over the usual."""
    flat = own.reshape(len(own), -1, own.shape[-1]).astype(np.complex128)
    before = np.roll(flat, 1, axis=-1)
    inner = np.ones(flat.shape[-1], bool)
    inner[[0, len(inner) // 2, len(inner) - len(inner) // 2]] = False
    turn = (before.conj() * flat)[..., inner].sum((1, 2))
    turn /= np.maximum(squared(before)[..., inner].sum((1, 2)), 1e-300)
    off = squared(flat - turn[:, None, None] * before).sum(1)
    return np.asarray((off / np.maximum(off[:, inner].mean(1, keepdims=True), 1e-300)).mean(0))


def _alike(level: Array, expected: Array) -> float:
    """Correlation of powers (M,); 0 where one is flat."""
    spread = level.std() * expected.std()
    return float(((level - level.mean()) * (expected - expected.mean())).mean() / spread) if spread else 0.0
