"""Twin of kernels/messages/particle_densities.py, by the sum over all samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

Complex = NDArray[np.complex128]


def weigh_particles(
    wavenumber: Array, pulse: Complex, samples: Complex, base: Complex, distance: Array, weight: Array
) -> Array:
    """Log density of a snapshot at every particle (P,), less that without its paths.

    Parameters
    ----------
    wavenumber, pulse, samples : (M,)
    base : (M, M)
        Covariance of the samples but for the particles' paths.
    distance, weight : (N, P); m, power
    """
    whiten = np.linalg.inv(np.linalg.cholesky(base))
    seen = whiten @ samples
    found = np.empty(distance.shape[1])
    for p in range(len(found)):
        waves = whiten @ (pulse[:, None] * np.exp(-1j * np.outer(wavenumber, distance[:, p])))
        covariance = np.eye(len(samples)) + (waves * weight[:, p]) @ np.conj(waves).T
        power = np.vdot(seen, seen) - np.vdot(seen, np.linalg.solve(covariance, seen))
        found[p] = power.real - np.linalg.slogdet(covariance)[1]
    return found
