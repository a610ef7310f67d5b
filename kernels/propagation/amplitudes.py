"""Likelihoods of measured amplitudes: Rician densities over a belief about each path's amplitude."""

import taichi as ti

from gridslam.kernels.primitives.radio import FALSE_ALARMS, SAMPLES, clutter_of, detection_of, rician
from gridslam.kernels.primitives.tables import ANCHOR, DETECTED, EXISTENCE, LENGTH, OPEN, SURFACES

NEGLIGIBLE = 1e-6
"""Probability of being there below which a path is left out."""
NEVER = 1e-30
"""Likelihood below which a measured amplitude leaves the belief as it is."""


@ti.func
def prior_existence(odds: ti.template(), row):
    """Prior probability that a path is there."""
    return odds[EXISTENCE, row] * odds[SURFACES, row] * odds[OPEN, row]


@ti.func
def weigh(
    amplitudes: ti.template(), spreading, step, rows: ti.template(), scan: ti.template(),
    radio: ti.template(), scratch: ti.template(), odds: ti.template(),
):  # fmt: skip
    """Mean likelihood of every amplitude under every path, and the path's mean amplitude given it.

    The factor of the amplitude in [Li2026grid], eqs. (8) to (10), and p_d.
    A path whose length is measured has that length: the distance less the difference of the clocks. A
    measurement without amplitude has the likelihood p_d. All paths have the first one's level of clutter.
    Arguments are those of `evaluation.evaluate`.
    """
    count, one, known = amplitudes.nodes.shape[0], ti.f64(1.0), -1
    for row in range(amplitudes.probability.shape[0]):
        anchor, late = rows.path[row, ANCHOR], rows.predicted[row, 0] - rows.predicted[row, LENGTH]
        if known < 0 or (known != anchor and spreading > 0.5):
            known, samples = anchor, radio[anchor, SAMPLES]
            for m in range(scan.shape[0]):
                if scan[m, 3] >= 0 and scan[m, 6] >= 0:
                    per_metre = 1 / ti.max(scan[m, 0] - late, 1e-3) if spreading > 0.5 else one
                    for n in range(count):
                        level = amplitudes.nodes[n] * per_metre
                        density = rician(scan[m, 6], level, samples)
                        scratch.density[0, m, n], scratch.density[1, m, n] = density, density * level
        per_metre = 1 / ti.max(rows.predicted[row, LENGTH], 1e-3) if spreading > 0.5 else one
        usual, seen, both = 0 * one, 0 * one, 0 * one
        for n in range(count):
            p = amplitudes.probability[row, n]
            if p > 0:
                level = amplitudes.nodes[n] * per_metre
                sure = p * detection_of(level, amplitudes.chance, step)
                usual += p * level
                seen += sure
                both += sure * level
        odds[DETECTED, row] = seen
        for m in range(scan.shape[0]):
            total, mean = 0 * one, 0 * one
            if prior_existence(odds, row) > NEGLIGIBLE:
                if scan[m, 6] < 0:
                    total, mean = seen, both
                elif scan[m, 3] >= 0:
                    for n in range(count):
                        total += amplitudes.probability[row, n] * scratch.density[0, m, n]
                        mean += amplitudes.probability[row, n] * scratch.density[1, m, n]
                else:
                    for n in range(count):
                        level = amplitudes.nodes[n] * per_metre
                        density = amplitudes.probability[row, n] * rician(
                            scan[m, 6], level, radio[anchor, SAMPLES]
                        )
                        total += density
                        mean += density * level
            scratch.strength[0, row, m] = total
            scratch.strength[1, row, m] = mean / total if total > NEVER else usual
    for m in range(scan.shape[0]):
        clutter = ti.f64(1.0)
        if amplitudes.probability.shape[0] > 0:
            first = rows.path[0, ANCHOR]
            clutter = radio[first, FALSE_ALARMS] * clutter_of(radio, first, scan[m, 6])
        for row in range(amplitudes.probability.shape[0]):
            before = scratch.strength[0, row, m]
            scratch.strength[0, row, m] = before / clutter
