"""Likelihood of sampled signals by the covariance of all samples: twins of the kernels on features."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array

Complex = NDArray[np.complex128]


def response(point: Array, at: Array, extra: float, element: Array, pulse: Complex, rate: Array) -> Complex:
    """What a point sends to an agent at 1 m power 1, (N * M,); docs/model.md, (M121).

    Parameters
    ----------
    point : (3,) x, y (m) and heading (rad) of the agent.
    at : (2,) m
    extra : float, m
        Length beyond the distance.
    element : (N, 2)
        Places of the antennas, times 2 pi / wavelength.
    pulse, rate : (M,)
        Spectrum, and 2 pi f / c (1/m).
    """
    way = at - point[:2]
    length, angle = np.hypot(*way) + extra, np.arctan2(way[1], way[0]) - point[2]
    antennas = np.exp(1j * element @ [np.cos(angle), np.sin(angle)])
    whole: Complex = np.kron(antennas, pulse * np.exp(-1j * rate * length)) / length
    return whole


def columns(
    point: Array, features: Array, anchor: Array, element: Array, pulse: Complex, rate: Array
) -> tuple[Complex, Complex]:
    """The line of sight's response (N M,) and those of the features without it, (N M, D)."""
    los = response(point, anchor, 0.0, element, pulse, rate)
    rows = [response(point, f[:2], f[2], element, pulse, rate) for f in features]
    each = np.array(rows, complex).reshape(len(features), len(los)).T
    return los, each - np.outer(los, los.conj() @ each) / (los.conj() @ los)


def evaluate_features(
    points: Array,
    features: Array,
    anchor: Array,
    element: Array,
    pulse: Complex,
    rate: Array,
    samples: Complex,
) -> Array:
    """Log-likelihood ratio of features to none by the whole covariance, and the line of sight's, (P, 3)."""
    z, out = samples.ravel(), np.zeros((len(points), 3))
    for row, (*point, noise) in enumerate(points):
        los, each = columns(np.array(point), features, anchor, element, pulse, rate)
        covariance = noise * np.eye(len(z)) + (each * features[:, 3]) @ each.conj().T
        _, logdet = np.linalg.slogdet(covariance / noise)
        fit = np.real(z.conj() @ np.linalg.solve(covariance, z))
        out[row] = (
            np.vdot(z, z).real / noise - fit - logdet,
            abs(np.vdot(los, z)) ** 2,
            np.vdot(los, los).real,
        )
    return out


def differentiate_features(
    points: Array,
    features: Array,
    anchor: Array,
    element: Array,
    pulse: Complex,
    rate: Array,
    samples: Complex,
) -> Array:
    """Slopes of that ratio by x, y, extra length and power of every feature, (P, D, 4)."""
    z, out = samples.ravel(), np.zeros((len(points), len(features), 4))
    for row, (*point, noise) in enumerate(points):
        place = np.array(point)
        los, each = columns(place, features, anchor, element, pulse, rate)
        inverse = np.linalg.inv(noise * np.eye(len(z)) + (each * features[:, 3]) @ each.conj().T)
        w = inverse @ z
        for n, feature in enumerate(features):
            column = each[:, n]
            score = w * np.vdot(w, column) - inverse @ column  # slope by the conjugate column
            for entry in range(3):
                slopes = _slope(place, feature, entry, element, pulse, rate)
                slopes = slopes - los * (np.vdot(los, slopes) / np.vdot(los, los))
                out[row, n, entry] = 2 * feature[3] * np.vdot(score, slopes).real
            out[row, n, 3] = np.vdot(column, score).real
    return out


def climb_features(
    points: Array,
    features: Array,
    anchor: Array,
    element: Array,
    pulse: Complex,
    rate: Array,
    samples: Complex,
    kind: NDArray[np.int32],
    plan: Array,
    steps: int,
) -> tuple[Array, Array, Array]:
    """Steps of Adam, (M401): where they end, the best on the way (D, 4), and A where each began (steps,)."""
    known, first = (element, pulse, rate, samples), len(features) - len(kind)
    done, unit, faintest, longest = plan[0], plan[1], plan[2], plan[3:]
    scale, tied, bound = np.array([1, 1, 1, unit]), kind == 1, kind != 2
    best, value, features = features, np.zeros(steps), features.copy()
    mean, square = np.zeros((2, len(kind), 4))
    for i in range(steps):
        value[i] = evaluate_features(points, features, anchor, *known)[:, 0].sum()
        if value[i] >= value[: i + 1].max():
            best = features.copy()
        slope = differentiate_features(points, features, anchor, *known).sum(0)[first:]
        own = features[first:]
        way = own[:, :2] - anchor
        way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-3)
        slope[tied, :2] += slope[tied, 2:3] * way[tied]
        slope[bound, 2] = 0
        slope *= scale
        mean, square = 0.9 * mean + 0.1 * slope, 0.999 * square + 0.001 * slope**2
        root = np.sqrt(square / (1 - 0.999 ** (done + i + 1))) + 1e-12
        own += scale * longest * mean / (1 - 0.9 ** (done + i + 1)) / root
        own[:, 2:] = np.maximum(own[:, 2:], [0, faintest * unit])
        own[tied, 2] = np.linalg.norm(own[tied, :2] - anchor, axis=1)
    return features, best, value


def _slope(point: Array, feature: Array, entry: int, element: Array, pulse: Complex, rate: Array) -> Complex:
    """A response's slope by one of x, y and the extra length, by the product rule."""
    way = feature[:2] - point[:2]
    far = np.hypot(*way)
    length, angle = far + feature[2], np.arctan2(way[1], way[0]) - point[2]
    value = response(point, feature[:2], feature[2], element, pulse, rate)
    by_length = value * (-1j * np.tile(rate, len(element)) - 1 / length)
    if entry == 2:
        return by_length
    turned = element @ [-np.sin(angle), np.cos(angle)]
    by_angle = value * 1j * np.repeat(turned, len(pulse))
    along, across = way[entry] / far, (-way[1], way[0])[entry] / far**2
    return along * by_length + across * by_angle


def back_project(
    candidates: Array,
    points: Array,
    element: Array,
    pulse: Complex,
    rate: Array,
    samples: Complex,
    power: Array,
) -> tuple[Array, Array]:
    """Gain of a feature at each candidate, of samples heard at all points, and its best power, (Q,) each."""
    gain = np.zeros((len(candidates), len(power)))
    for row, (x, y, extra) in enumerate(candidates):
        for *point, noise in points:
            column = response(np.array(point), np.array([x, y]), extra, element, pulse, rate)
            share = 1 + power * np.vdot(column, column).real / noise
            gain[row] += power * abs(np.vdot(column, samples.ravel())) ** 2 / share - np.log(share)
    return gain.max(1), power[gain.argmax(1)]
