"""Snapshots of one antenna at either end: 41 frequencies 10 MHz apart, noise of power 1."""

import numpy as np

from gridslam.inference.messages.samples.signal_likelihood import Band

BAND = Band.of(1e7 * (np.arange(41) - 20))


def noise(draw):
    """Noise alone, (41,)."""
    return np.sqrt(0.5) * (draw.normal(size=41) + 1j * draw.normal(size=41))


def received(draw, distance, amplitude):
    """Paths of these lengths (L,), m, and complex amplitudes (L,) in noise."""
    return np.asarray(amplitude) @ BAND.response(np.asarray(distance)) + noise(draw)


def snapshot(seed, *paths):
    """Paths in noise: distance and amplitude each, the n-th turned by n rad."""
    distance, amplitude = np.reshape(paths, (-1, 2)).T
    return received(np.random.default_rng(seed), distance, amplitude * np.exp(1j * np.arange(len(paths))))
