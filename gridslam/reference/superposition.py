"""Plain counterparts of the kernels for snapshots of arrays as sums of paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

Complex = NDArray[np.complex128]
KINDS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])


def respond(
    wavenumber: Array, pulse: Complex, anchor: Array, agent: Array, path: Array
) -> tuple[Complex, Complex, Complex]:
    """Twin of `superposition.respond`: (2, N, M), (2, N, A), (2, N, B)."""
    delay = np.conj(pulse * np.exp(-1j * path[:, :1] * wavenumber))
    turns = [np.stack([delay, 1j * wavenumber * delay])]
    for element, angle in ((anchor, path[:, 1]), (agent, path[:, 2])):
        x, y = np.cos(angle)[:, None], np.sin(angle)[:, None]
        response = np.exp(-1j * (x * element[:, 0] + y * element[:, 1])) / np.sqrt(len(element))
        slope = x * element[:, 1] - y * element[:, 0]
        turns.append(np.stack([response, -1j * slope * response]))
    return turns[0], turns[1], turns[2]


def superpose(
    factors: tuple[Complex, Complex, Complex],
    samples: Complex,
    weight: Array,
    noise: float,
    believed: Complex | None = None,
) -> tuple[Complex, Complex, Array, Array, Array, Array]:
    """Twin of `superposition.superpose`, by the whole covariance of the samples (A, B, M).

    Parameters
    ----------
    factors : (2, N, M), (2, N, A), (2, N, B)
        Of N paths, as `respond` makes them.
    weight : (N,)
        Mean power of each path.
    noise : float
        The noise's power in each sample.
    believed : (N,) complex128, optional
        Amplitudes at which the information is; default: those found.

    Returns
    -------
    (amplitude, matched, own, gradient, information, sums)
        (N,), (N,), (N,), (N, 3), (N, 3, N, 3), (3,); sums: log density, power left, samples' worth of that.
    """
    delay, leaving, arriving = (np.conj(factor) for factor in factors)
    kinds = [
        np.einsum("na,nb,nm->nabm", leaving[t], arriving[r], delay[d]).reshape(len(weight), -1)
        for d, t, r in KINDS
    ]
    plain, steep, z = kinds[0], np.stack(kinds[1:], 1), samples.ravel()
    covariance = noise * np.eye(len(z)) + (plain.T * weight) @ plain.conj()
    inverse = np.linalg.inv(covariance)
    matched = plain.conj() @ inverse @ z
    own = np.einsum("nk,kl,nl->n", plain.conj(), inverse, plain).real
    amplitude = weight * matched
    gradient = 2 * (amplitude.conj()[:, None] * (steep.conj() @ inverse @ z)).real
    gradient -= 2 * weight[:, None] * np.einsum("nk,kl,npl->np", plain.conj(), inverse, steep).real
    scale = amplitude if believed is None else believed
    scaled = scale[:, None, None] * steep
    information = 2 * np.einsum("npk,kl,mql->npmq", scaled.conj(), inverse, scaled).real
    log = -np.linalg.slogdet(covariance)[1] - (z.conj() @ inverse @ z).real
    left = z - amplitude @ plain
    sums = np.array([log, np.vdot(left, left).real, noise * np.trace(inverse).real])
    return amplitude, matched, own, gradient, information, sums


def climb(
    wavenumber: Array, pulse: Complex, anchor: Array, agent: Array, steepness: Array, samples: Complex,
    steps: int, peak: Array,
) -> Array:  # fmt: skip
    """Twin of `superposition.climb`: the top (3,)."""
    for _ in range(steps):
        delay, leaving, arriving = respond(wavenumber, pulse, anchor, agent, peak[None])
        matched = np.array([
            np.einsum("a,b,m,abm", leaving[t, 0], arriving[r, 0], delay[d, 0], samples) for d, t, r in KINDS
        ])  # fmt: skip
        step = np.where(steepness > 0, (matched[1:] / matched[0]).real, 0.0)
        peak = peak + step / np.maximum(steepness, 1e-9) ** 2
    return peak
