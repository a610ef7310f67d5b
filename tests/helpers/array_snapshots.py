"""Tiny snapshots of arrays."""

import numpy as np

from gridslam import reference
from gridslam.inference.messages.samples.array_likelihood import ArrayBand
from gridslam.world.scene_parts import ArraySpec
from gridslam.world.waveform import Waveform

LIGHT = 299_792_458.0
CARRIER, STEP = 6e9, 2.5e7
NOISE = 0.7


def band_of(rows: int = 2, columns: int = 3, frequencies: int = 9) -> ArrayBand:
    scale = LIGHT / CARRIER
    anchor = scale * ArraySpec(rows=rows, columns=columns, spacing_wavelengths=0.4).elements
    agent = scale * ArraySpec(rows=columns, columns=rows, spacing_wavelengths=0.3).elements
    offset = STEP * (np.arange(frequencies) - (frequencies - 1) / 2)
    pulse = np.hanning(frequencies + 2)[1:-1] * np.exp(0.3j * np.arange(frequencies))
    return ArrayBand.of(Waveform(CARRIER, offset, pulse, anchor[None], agent), 0)


def responses(band, path):
    factors = reference.respond(band.wavenumber, band.pulse, band.anchor, band.agent, path)
    delay, leaving, arriving = (np.conj(factor[0]) for factor in factors)
    return np.einsum("nm,na,nb->nabm", delay, leaving, arriving).reshape(len(path), -1)


def snapshot(band, path, amplitude, noise=NOISE, seed=0):
    shape = len(band.anchor), len(band.agent), len(band.wavenumber)
    rest = np.random.default_rng(seed).normal(size=(2, *shape)) * np.sqrt(noise / 2)
    return rest[0] + 1j * rest[1] + (np.asarray(amplitude) @ responses(band, path)).reshape(shape)
