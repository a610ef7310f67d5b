"""Twins of the kernels that pick, weigh and associate pairs of a path and a measurement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

from gridslam.arrays import Array
from gridslam.kernels import FAINTEST, PATH_BLOCK, UNMEASURED
from gridslam.kernels.primitives.blocks import Amplitudes, Anchors, Drawing, PathRows, Ratios
from gridslam.kernels.primitives.tables import OPEN
from gridslam.reference.paths import densities, draw
from gridslam.world.geometry import lean, wrap

Whole = NDArray[np.int32]
GATE, MARGIN = 6.0, 0.3
"""Deviations within reach; m or rad by which the gate is wider."""
NEVER = 1e-30
"""Likelihood below which the mean amplitude is that of the belief."""


def log_rician(measured: Array, amplitude: Array, samples: float, unsure: Array | float = 0.0) -> Array:
    """Log density of a measured amplitude, not truncated, which is known to a share `unsure` of it."""
    variance = 0.5 + amplitude**2 / (4 * samples) + np.square(unsure) * measured * amplitude
    gap = measured - amplitude
    bessel = np.log(i0e(measured * amplitude / variance))
    return np.asarray(np.log(measured / variance) - gap**2 / (2 * variance) + bessel)


def clutter(amplitude: Array, radio: Array) -> Array:
    """Density of clutter at amplitudes, negative for none, times its mean number, by an anchor's radio."""
    max_distance, threshold, false_alarms = radio[[6, 9, 10]]
    tail = np.log(2 * np.maximum(amplitude, 1e-30)) - (amplitude**2 - threshold**2)
    density = np.exp(np.where(amplitude < 0, 0.0, np.maximum(tail, -25.0)))
    return np.asarray(false_alarms * density / (max_distance * 4 * np.pi**2))


def deviations(amplitude: Array, angles: Array, radio: Array, steep: Array | float = 1.0) -> Array:
    """Deviations (..., 3) by Fisher information, of paths with AoD and AoA `angles` (..., 2).

    `steep` is the cosine of the elevation.
    """
    std = np.empty((*amplitude.shape, 3))
    std[..., 0] = np.where(radio[..., 1] > 0, radio[..., 1], radio[..., 0] / amplitude)
    for q in (1, 2):
        across, along = radio[..., 2 * q], radio[..., 2 * q + 1]
        square = np.sin(angles[..., q - 1]) ** 2 * across + np.cos(angles[..., q - 1]) ** 2 * along
        with np.errstate(divide="ignore"):
            std[..., q] = 1 / (np.sqrt(8) * np.pi * amplitude * steep * np.sqrt(square))
    return std


def length_given(predicted: Array, distance: Array | float, variance: Array) -> Array:
    """Twin of `amplitudes.length_given`: lengths and shares, (L, 2)."""
    length, unclear, learnt = predicted[:, 12:].T
    clear = unclear - learnt**2 / np.maximum(predicted[:, 3], 1e-12) <= (0.01 * length) ** 2
    gain = np.where(clear, 1.0, learnt / (predicted[:, 3] + variance))
    left = np.where(clear, 0.0, np.sqrt(np.maximum(unclear - gain * learnt, 0.0)))
    length = np.maximum(length + gain * (distance - predicted[:, 0]), np.maximum(left, 1e-3))
    return np.stack([length, left / length], -1)


def weigh(
    belief: Array, nodes: Array, spreading: float, path: Whole, predicted: Array, worth: Array,
    scan: Array, chance: Array, step: float, radio: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Twin of `amplitudes.weigh`: detection probability (L,), and strength (2, L, M)."""
    ranged, loud = scan[:, 3] >= 0, scan[:, 6] >= 0
    own = nodes / np.maximum(predicted[:, 12, None], 1e-3) if spreading else np.tile(nodes, (len(belief), 1))
    table = np.interp(own, step * np.arange(len(chance)), chance)
    detected = (belief * table).sum(1)
    strength, mean = np.zeros((2, len(belief), len(scan)))
    for m in range(len(scan)):
        level, unsure = own, np.zeros((len(belief), 1))
        if ranged[m] and spreading and loud[m]:
            given = radio[path[:, 3]]
            std = np.where(given[:, 1] > 0, given[:, 1], given[:, 0] / scan[m, 6])
            variance = np.where(scan[m, 3] > 0, scan[m, 3], std) ** 2
            length, unsure = length_given(predicted, scan[m, 0], variance).T[..., None]
            level = nodes / length
        density = np.exp(log_rician(scan[m, 6], level, radio[0, 8], unsure)) if loud[m] else table
        strength[:, m] = (belief * density).sum(1)
        mean[:, m] = (belief * density * level).sum(1)
    variance = (belief * table / np.maximum(own, FAINTEST) ** 2).sum(1)  # of (M10), but for a factor
    mean[:, ~loud] = (detected * np.sqrt(detected / np.maximum(variance, NEVER)))[:, None]
    strength[worth <= 1e-6] = mean[worth <= 1e-6] = 0.0
    usual = (belief * own).sum(1)[:, None]
    mean = np.where(strength > NEVER, mean / np.maximum(strength, NEVER), usual)
    first = radio[path[0, 3]] if len(path) else radio[0]
    return detected, np.stack([strength / clutter(scan[:, 6], first), mean])


def gate(
    belief: Array, nodes: Array, spreading: float, path: Whole, predicted: Array, scan: Array, chance: Array,
    step: float, places: Array, radio: Array, bandwidth: float, odds: Array,
) -> tuple[Whole, Array, Array, Array, Array]:  # fmt: skip
    """Twin of `evaluation.gate`: index, table and inverse covariance of the pairs; p_d; strength.

    Parameters
    ----------
    belief, nodes : (L, B), (B,)
        Belief of every path's amplitude; amplitudes of the nodes, at 1 m if `spreading`.
    spreading : float
        1 if amplitudes fall with the path's length, else 0.
    path, predicted : (L, 4), (L, 15)
        As `blocks.PathRows` has them.
    scan : (M, 10)
        As `AnchorScan.table`.
    chance, step : (T,), float
        p_d over amplitudes 0, step, ...
    places, radio : (J, 6), (J, 12)
        As `blocks.Anchors` has them.
    bandwidth : float
        Share of the belief's covariance.
    odds : (12, L)
        Of which the first three rows are given.

    Returns
    -------
    (index, pair, inverse, detected, strength)
        (K, 2), (K, 8) as `blocks.Pairs` has them, (K, 3, 3), (L,), (2, L, M)
    """
    worth = odds[:3].prod(0)
    detected, strength = weigh(belief, nodes, spreading, path, predicted, worth, scan, chance, step, radio)
    value, spread = predicted[:, None, :3], predicted[:, 3:12].reshape(-1, 3, 3)
    angles = np.broadcast_to(value[..., 1:], (*strength[1].shape, 2))
    own = radio[path[:, 3]]
    steep = lean(predicted[:, 12], places[path[:, 3], 3])[:, None]
    std = deviations(np.maximum(strength[1], FAINTEST), angles, own[:, None], steep)
    std = np.where(scan[:, 3:6] > 0, scan[:, 3:6], std)
    std[..., :] = np.where(scan[:, 3:6] < 0, np.inf, std)
    missing = np.square(std) >= UNMEASURED
    gap = scan[:, :3] - value
    gap[..., 1:] = wrap(gap[..., 1:])
    gap = np.where(scan[:, 3:6] < 0, 0.0, np.abs(gap))
    known = np.where(missing, 0.0, std) ** 2
    reach = GATE * np.sqrt(np.diagonal(spread, axis1=1, axis2=2)[:, None] + known) + MARGIN
    label = scan[:, 9]
    ours = (label < 0) | (label == own[:, 11, None])
    chosen = ours & (gap < reach).all(-1) & (worth > 1e-6)[:, None] & (strength[0] > 0)
    row, measurement = np.nonzero(chosen)
    std, missing = std[chosen], missing[chosen]
    flat = np.stack([own[row, 6], *np.full((2, len(row)), 2 * np.pi)], -1)
    density = strength[0][chosen] * np.where(missing, np.sqrt(2 * np.pi * UNMEASURED) / flat, 1.0).prod(1)
    variance = np.where(missing, UNMEASURED, np.maximum(std, 1e-6) ** 2)
    total = bandwidth * spread[row] + variance[:, :, None] * np.eye(3)
    pair: Array = np.column_stack([scan[measurement, :3], variance, density, np.linalg.det(total)])
    index = np.stack([row, measurement], -1).astype(np.int32)
    return index, pair, np.asarray(np.linalg.inv(total), np.float64), detected, strength


def enter(
    blocks: Array, start: Whole, index: Whole, pair: Array, odds: Array, message: Array, measured: Array
) -> tuple[Array, Array, Array]:
    """Twin of `association.enter`: odds, message and measured with what it writes.

    Parameters
    ----------
    blocks, start, index, pair
        (L + K or more, P / PATH_BLOCK), (L + 1,), (K or more, 2), (K or more, 8), as `blocks.Pairs` has them.
    odds, message, measured : (12, L), (5, L, M), (5, M)
        Rows as in `primitives.tables`; copies are returned.
    """
    paths, particles, count = odds.shape[1], PATH_BLOCK * blocks.shape[1], start[-1]
    odds, message, measured = odds.copy(), message.copy(), measured.copy()
    mean = blocks.sum(1, dtype=np.float64) / particles
    possible = mean[:paths]
    path, measurement = index[:count].T
    found = np.zeros(message.shape[1:])
    scale = np.sqrt((2 * np.pi) ** 3 * pair[:count, 7])
    found[path, measurement] = pair[:count, 6] * mean[paths : paths + count] / scale
    found /= np.maximum(possible, 1e-3)[:, None]
    odds[4] = odds[2] * possible
    odds[5] = odds[0] * odds[4]
    odds[6] = odds[1] * odds[5]
    odds[7] = np.maximum(1 - odds[6] * odds[3], 1e-9)
    message[0], message[1] = found, odds[6][:, None] * found
    among = np.maximum(message[1].sum(1, keepdims=True), 1e-30)
    measured[0] = (message[1] ** 2 / among).sum(0)
    return odds, message, measured


def evaluate(
    spreading: float, step: float, head: int, bandwidth: float, amplitudes: Amplitudes, rows: PathRows,
    scan: Array, anchors: Anchors, drawing: Drawing, ratios: Ratios,
) -> dict[str, Array | Whole]:  # fmt: skip
    """Twin of `evaluation.evaluate`: what it writes, by the names of the blocks' arrays.

    Parameters
    ----------
    spreading : float
        1 if amplitudes fall with the path's length, else 0.
    step : float
        Of the table of p_d.
    head : int
        Entry of the belief where the lines begin.
    bandwidth : float
        Share of the belief's covariance.
    scan : (M, 10)
        As `AnchorScan.table`.
    """
    (probability, nodes, chance), (path, predicted), (odds, message, measured) = amplitudes, rows, ratios
    index, pair, inverse, detected, _ = gate(
        probability, nodes, spreading, path, predicted, scan, chance, step, *anchors, bandwidth, odds
    )
    odds, start = odds.copy(), np.searchsorted(index[:, 0], np.arange(len(path) + 1)).astype(np.int32)
    odds[3] = detected
    apart = inverse[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    state = draw(drawing.root, drawing.base, drawing.points[:, : drawing.state.shape[1]], head)
    weight, valid = densities(
        state, head, path, anchors.places, start, np.column_stack([pair[:, :3], apart]), PATH_BLOCK
    )
    valid[(odds[OPEN] == 0) & (np.diff(start) == 0)] = 0.0  # what isn't open needn't be possible
    blocks = np.concatenate([valid, weight])
    odds, message, measured = enter(blocks, start, index, pair, odds, message, measured)
    measured[1] = scan[:, 8]
    whole: dict[str, Array | Whole] = {"start": start, "index": index}
    return whole | {
        "pair": pair, "state": state, "blocks": blocks, "odds": odds, "message": message, "measured": measured
    }  # fmt: skip


def associate(odds: Array, message: Array, measured: Array, rounds: int) -> tuple[Array, Array, Array]:
    """Twin of `association.associate`: messages from paths and measurements; sums of the former."""
    beta, missed, new = message[1], odds[7], measured[2]
    paths, measurements = beta.shape
    nu = np.broadcast_to(1 / new, (paths, measurements)).copy()
    claim = np.zeros_like(nu)
    for _ in range(rounds if paths and measurements else 0):
        weight = beta * nu
        others = np.maximum(weight.sum(1, keepdims=True) - weight, 0.0)
        claim = beta / (missed[:, None] + others)
        rest = np.maximum(claim.sum(0, keepdims=True) - claim, 0.0)
        fresh = 1 / (new + rest)
        change = np.abs(fresh - nu).max()
        nu = fresh
        if change < 1e-6:
            break
    return claim, nu, claim.sum(0)
