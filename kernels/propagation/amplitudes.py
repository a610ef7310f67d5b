"""Likelihoods of measured amplitudes: Rician densities over a belief about each path's amplitude."""

import taichi as ti

from gridslam.kernels import FAINTEST
from gridslam.kernels.primitives.radio import (
    FALSE_ALARMS,
    SAMPLES,
    clutter_of,
    detection_of,
    ranging_variance,
    rician,
    rician_about,
)
from gridslam.kernels.primitives.tables import (
    AMPLITUDE,
    ANCHOR,
    COVARIANCE,
    DETECTED,
    DISTANCE,
    EXISTENCE,
    LEARNT,
    LENGTH,
    OPEN,
    OWN_STD,
    SURFACES,
    UNCLEAR,
)

NEGLIGIBLE = 1e-6
"""Probability of being there below which a path is left out."""
NEVER = 1e-30
"""Likelihood below which a measured amplitude leaves the belief as it is."""
CLEAR, LEAST_VARIANCE = 0.01, 1e-12
"""Share of a path's length up to which its deviation counts as none; variance (m^2) that is divided by at
least."""


@ti.func
def prior_existence(odds: ti.template(), row):
    """Prior probability that a path is there."""
    return odds[EXISTENCE, row] * odds[SURFACES, row] * odds[OPEN, row]


@ti.func
def is_clear(rows: ti.template(), row):
    """Whether a measured distance tells a path's length to `CLEAR`, whatever its clocks are."""
    learnt = rows.predicted[row, LEARNT]
    variance = ti.max(rows.predicted[row, COVARIANCE], LEAST_VARIANCE)
    left = rows.predicted[row, UNCLEAR] - learnt * learnt / variance
    return left <= (CLEAR * rows.predicted[row, LENGTH]) ** 2


@ti.func
def length_given(rows: ti.template(), row, distance, variance):
    """A path's length given its measured distance, and the share of it that remains unknown; (M541)."""
    length = distance - rows.predicted[row, DISTANCE] + rows.predicted[row, LENGTH]
    length, unsure = ti.max(length, 1e-3), ti.f64(0.0)
    if not is_clear(rows, row):
        learnt = rows.predicted[row, LEARNT]
        gain = learnt / (rows.predicted[row, COVARIANCE] + variance)
        left = ti.sqrt(ti.max(rows.predicted[row, UNCLEAR] - gain * learnt, 0.0))
        length = rows.predicted[row, LENGTH] + gain * (distance - rows.predicted[row, DISTANCE])
        length = ti.max(length, ti.max(left, 1e-3))
        unsure = left / length
    return length, unsure


@ti.func
def weigh(
    amplitudes: ti.template(), spreading, step, rows: ti.template(), scan: ti.template(),
    radio: ti.template(), scratch: ti.template(), odds: ti.template(),
):  # fmt: skip
    """Mean likelihood of every amplitude under every path, and the path's mean amplitude given it.

    Of a measurement without amplitude, the amplitude that has the mean variance of (M10) instead: (M578).

    The factor of the amplitude in [Li2026grid], eqs. (8) to (10), and p_d.
    A path whose length is measured has that length: the distance less the difference of the clocks, so far
    as that is known. A measurement without amplitude has the likelihood p_d. All paths have the first one's
    level of clutter. Arguments are those of `evaluation.evaluate`.
    """
    count, one, known = amplitudes.nodes.shape[0], ti.f64(1.0), -1
    for row in range(amplitudes.probability.shape[0]):
        anchor, clear = rows.path[row, ANCHOR], spreading < 0.5 or is_clear(rows, row)
        if known < 0 or not clear or (known != anchor and spreading > 0.5):
            known, samples = (anchor if clear else -1), radio[anchor, SAMPLES]
            for m in range(scan.shape[0]):
                if scan[m, OWN_STD] >= 0 and scan[m, AMPLITUDE] >= 0:
                    per_metre, unsure = one, 0 * one
                    if spreading > 0.5:
                        variance = ranging_variance(radio, anchor, scan[m, OWN_STD], scan[m, AMPLITUDE])
                        length, unsure = length_given(rows, row, scan[m, DISTANCE], variance)
                        per_metre = 1 / length
                    for n in range(count):
                        level = amplitudes.nodes[n] * per_metre
                        density = rician_about(scan[m, AMPLITUDE], level, samples, unsure)
                        scratch.density[0, m, n], scratch.density[1, m, n] = density, density * level
        per_metre = 1 / ti.max(rows.predicted[row, LENGTH], 1e-3) if spreading > 0.5 else one
        usual, seen, faint = 0 * one, 0 * one, 0 * one
        for n in range(count):
            p = amplitudes.probability[row, n]
            if p > 0:
                level = amplitudes.nodes[n] * per_metre
                sure = p * detection_of(level, amplitudes.chance, step)
                usual += p * level
                seen += sure
                faint += sure / ti.max(level, FAINTEST) ** 2
        odds[DETECTED, row] = seen
        for m in range(scan.shape[0]):
            total, mean = 0 * one, 0 * one
            if prior_existence(odds, row) > NEGLIGIBLE:
                if scan[m, AMPLITUDE] < 0:
                    total, mean = seen, seen * ti.sqrt(seen / ti.max(faint, NEVER))
                elif scan[m, OWN_STD] >= 0:
                    for n in range(count):
                        total += amplitudes.probability[row, n] * scratch.density[0, m, n]
                        mean += amplitudes.probability[row, n] * scratch.density[1, m, n]
                else:
                    for n in range(count):
                        level = amplitudes.nodes[n] * per_metre
                        density = amplitudes.probability[row, n] * rician(
                            scan[m, AMPLITUDE], level, radio[anchor, SAMPLES]
                        )
                        total += density
                        mean += density * level
            scratch.strength[0, row, m] = total
            scratch.strength[1, row, m] = mean / total if total > NEVER else usual
    for m in range(scan.shape[0]):
        clutter = ti.f64(1.0)
        if amplitudes.probability.shape[0] > 0:
            first = rows.path[0, ANCHOR]
            clutter = radio[first, FALSE_ALARMS] * clutter_of(radio, first, scan[m, AMPLITUDE])
        for row in range(amplitudes.probability.shape[0]):
            before = scratch.strength[0, row, m]
            scratch.strength[0, row, m] = before / clutter
