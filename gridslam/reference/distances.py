"""Twin of kernels/messages/distances.py, by the inverse covariance itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from gridslam.arrays import Array

Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class _Point:
    """Log posterior somewhere, its gradient and curvature, and the information of the snapshot."""

    value: float
    gradient: Array
    curvature: Array
    information: Array


def climb_distances(
    wavenumber: Array, pulse: Complex, samples: Complex, mean: Array, precision: Array, weight: Array,
    chance: Array, limits: Array, start: Array,
) -> tuple[Array, Array, float]:  # fmt: skip
    """Distances (N,) at the joint mode, information (N, N) there, and the log posterior.

    Parameters
    ----------
    wavenumber : (M,) rad/m
    pulse, samples : (M,)
    mean, start : (N,) m
        Predicted distances, and where the search begins.
    precision : (N, N) 1/m^2
    weight, chance : (N,)
        Mean power of each path, and chance that it is there.
    limits : (7,)
        As the kernel's.
    """

    def at(distance: Array) -> _Point:
        return _point(wavenumber, pulse, samples, mean, precision, weight, chance, limits, distance)

    distance, here = np.array(start), at(start)
    for _ in range(int(limits[3])):
        step = np.linalg.solve(here.curvature, here.gradient)
        if here.gradient @ step < limits[5]:
            break
        step = step * min(1.0, limits[1] / np.abs(step).max())
        trials = ((distance + step / 2**n, at(distance + step / 2**n)) for n in range(int(limits[4])))
        risen = next(((where, point) for where, point in trials if point.value > here.value), None)
        if risen is None:
            break
        distance, here = risen
    return distance, here.information, here.value


def _point(
    wavenumber: Array, pulse: Complex, samples: Complex, mean: Array, precision: Array, weight: Array,
    chance: Array, limits: Array, distance: Array,
) -> _Point:  # fmt: skip
    noise, scale = limits[0], limits[2]
    response = pulse[:, None] * np.exp(-1j * np.outer(wavenumber, distance))
    slope = -1j * wavenumber[:, None] * response
    covariance = noise * np.eye(len(samples)) + (response * weight) @ np.conj(response).T
    inverse = np.linalg.inv(covariance)
    _, log_det = np.linalg.slogdet(covariance)
    white = inverse @ samples
    amplitude = weight * (np.conj(response).T @ white)
    information = 2 * (np.conj(amplitude)[:, None] * (np.conj(slope).T @ inverse @ slope) * amplitude).real
    gradient = 2 * (np.conj(amplitude) * (np.conj(slope).T @ white)).real
    gradient -= 2 * weight * (np.conj(response) * (inverse @ slope)).sum(0).real
    off, gap = distance - mean, (distance[1:] - distance[0]) / scale
    value = -log_det - np.vdot(samples, white).real - 0.5 * off @ precision @ off
    with np.errstate(divide="ignore"):  # of a path that is surely there, or surely gone
        log_there, log_gone = np.log(chance[1:]), np.log1p(-chance[1:])
        behind = np.logaddexp(log_there + log_ndtr(gap), log_gone)
    value += behind.sum()
    push = np.exp(log_there - 0.5 * gap**2 - behind) * limits[6]
    order = np.concatenate([-np.ones((len(gap), 1)), np.eye(len(gap))], 1)  # derivatives of differences
    gradient = gradient - precision @ off + order.T @ push / scale
    curvature = precision + information + (order.T * np.maximum(push * (push + gap), 0.0)) @ order / scale**2
    return _Point(float(value), gradient, curvature, information)
