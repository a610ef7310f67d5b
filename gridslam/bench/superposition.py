"""The kernels that take a snapshot for a sum of paths, for direct grid SLAM, against their twins."""

from __future__ import annotations

import numpy as np

from gridslam import reference
from gridslam.bench.kernels import KernelSpeed, race
from gridslam.inference.messages.samples.array_likelihood import ArrayBand, climbed, superpose_arrays

NAMES = ("respond", "superpose", "climb")
PATHS, SIDE, FREQUENCIES = 13, 3, 21


def superposition_speeds(seconds: float) -> list[KernelSpeed]:
    """Times of the kernels for so many paths of one anchor, each with the NumPy around it.

    Parameters
    ----------
    seconds : float
        At least so long each; a kernel runs three times or more, its twin once.
    """
    draw, element = np.random.default_rng(1), np.pi * np.mgrid[:SIDE, :SIDE].reshape(2, -1).T
    band = ArrayBand(
        np.linspace(-5.0, 5.0, FREQUENCIES),
        np.full(FREQUENCIES, FREQUENCIES**-0.5, complex),
        element,
        element,
    )
    path = np.column_stack([draw.uniform(2, 12, PATHS), draw.uniform(-3, 3, (PATHS, 2))])
    size = (SIDE**2, SIDE**2, FREQUENCIES)
    samples, weight = draw.normal(size=size) + 1j * draw.normal(size=size), np.full(PATHS, 10.0)
    of_band = (band.wavenumber, band.pulse, band.anchor, band.agent)
    where, none = f"{PATHS} paths", path[:0]
    return [
        race(
            "respond", where, "path", PATHS, seconds, 1.0,
            lambda: band.factors(path), lambda: band.factors(none), lambda: reference.respond(*of_band, path),
        ),
        race(
            "superpose", where, "path", PATHS, seconds, 1.0,
            lambda: superpose_arrays(band, samples, path, weight, 1.0),
            lambda: superpose_arrays(band, samples, none, weight[:0], 1.0),
            lambda: reference.superpose(reference.respond(*of_band, path), samples, weight, 1.0),
        ),
        race(
            "climb", "one peak", "step", 3, seconds, 1.0,
            lambda: climbed(band, samples, path[0], 3), lambda: climbed(band, samples, path[0], 0),
            lambda: reference.climb(*of_band, band.steepness, samples, 3, path[0]),
        ),
    ]  # fmt: skip
