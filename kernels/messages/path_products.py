"""Products of the responses of paths, with each other and with samples; docs/model.md, (M126).

The array is symmetric about its centre and the pulse's power even about the carrier, so that products of
responses are real, and those of the spectra follow from the frequencies above the carrier alone.
"""

import taichi as ti

from gridslam.kernels.primitives.functions import cos_of, sin_of
from gridslam.kernels.primitives.launching import quick

RATE, WEIGHT, SLOPED, CURVED = 0, 1, 2, 3
"""Rows of `band`: 2 pi / c times the frequency (rad/m), evenly spaced; the pulse's power there and as far
below the carrier, times the rate to the power of 0, 1 and 2."""
COSINE, SINE, LEAN = 0, 1, 2
"""Of each antenna's phase, and its slope by angle."""


@ti.func
def place_path(
    n, length, angle, band: ti.template(), element: ti.template(), spectrum: ti.template(),
    antennas: ti.template(),
):  # fmt: skip
    """Turns of a path over the frequencies and over the antennas."""
    count, start = band.shape[1], length * band[RATE, 0]
    step = length * (band[RATE, count - 1] - band[RATE, 0]) / ti.max(count - 1, 1)
    c, s = cos_of(start), sin_of(start)
    turn, across = cos_of(step), sin_of(step)
    for h in range(count):
        spectrum[n, COSINE, h], spectrum[n, SINE, h] = c, s
        c, s = c * turn - s * across, s * turn + c * across
    ahead, beside = cos_of(angle), sin_of(angle)
    for m in range(element.shape[0]):
        phase = ahead * element[m, 0] + beside * element[m, 1]
        antennas[n, COSINE, m], antennas[n, SINE, m] = cos_of(phase), sin_of(phase)
        antennas[n, LEAN, m] = ahead * element[m, 1] - beside * element[m, 0]


@ti.func
def match_path(
    a, n, count, fall, band: ti.template(), halves: ti.template(), spectrum: ti.template(),
    antennas: ti.template(), matched: ti.template(),
):  # fmt: skip
    """Products of samples with a path's response, and with its slopes by length and angle."""
    plain, sloped, leant = ti.Vector.zero(ti.f64, 2), ti.Vector.zero(ti.f64, 2), ti.Vector.zero(ti.f64, 2)
    for m in range(antennas.shape[2]):
        re, im, by_re, by_im = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
        for h in range(band.shape[1]):
            c, s, rate = spectrum[n, COSINE, h], spectrum[n, SINE, h], band[RATE, h]
            sum_re, sum_im = halves[a, 4 * m, h], halves[a, 4 * m + 1, h]
            gap_re, gap_im = halves[a, 4 * m + 2, h], halves[a, 4 * m + 3, h]
            re += c * sum_re + s * gap_re
            im += c * sum_im + s * gap_im
            by_re += rate * (c * gap_re - s * sum_re)
            by_im += rate * (c * gap_im - s * sum_im)
        c, s, lean = antennas[n, COSINE, m], antennas[n, SINE, m], antennas[n, LEAN, m]
        here = ti.Vector([c * re + s * im, c * im - s * re])
        plain += here
        sloped += ti.Vector([c * by_re + s * by_im, c * by_im - s * by_re])
        leant += lean * ti.Vector([here[1], -here[0]])
    for part in ti.static(range(2)):
        matched[a, n, part] = plain[part] * fall
        matched[a, count + n, part] = (sloped[part] - plain[part] * fall) * fall
        matched[a, 2 * count + n, part] = leant[part] * fall


@ti.func
def multiply_pair(
    a, n, m, count, fall, other, band: ti.template(), spectrum: ti.template(), antennas: ti.template(),
    gram: ti.template(),
):  # fmt: skip
    """Products of two paths' responses and slopes, either way round."""
    plain, sloped, curved = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
    for h in range(band.shape[1]):
        c, s = spectrum[n, COSINE, h], spectrum[n, SINE, h]
        d, t = spectrum[m, COSINE, h], spectrum[m, SINE, h]
        same, turned = c * d + s * t, c * t - s * d
        plain += band[WEIGHT, h] * same
        sloped += band[SLOPED, h] * turned
        curved += band[CURVED, h] * same
    straight, one, two, both = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
    for k in range(antennas.shape[2]):
        c, s, lean = antennas[n, COSINE, k], antennas[n, SINE, k], antennas[n, LEAN, k]
        d, t, bend = antennas[m, COSINE, k], antennas[m, SINE, k], antennas[m, LEAN, k]
        same, turned = c * d + s * t, c * t - s * d
        straight += same
        one += lean * turned
        two -= bend * turned
        both += lean * bend * same
    over = fall * other
    plain, sloped, curved = plain * over, sloped * over, curved * over
    by_one, by_two = sloped - plain * fall, -sloped - plain * other
    by_both = curved + sloped * (fall - other) + plain * over
    gram[a, n, m], gram[a, m, n] = straight * plain, straight * plain
    gram[a, count + n, m], gram[a, m, count + n] = straight * by_one, straight * by_one
    gram[a, n, count + m], gram[a, count + m, n] = straight * by_two, straight * by_two
    gram[a, count + n, count + m], gram[a, count + m, count + n] = straight * by_both, straight * by_both
    x, y = 2 * count + n, 2 * count + m
    gram[a, x, m], gram[a, m, x] = one * plain, one * plain
    gram[a, n, y], gram[a, y, n] = two * plain, two * plain
    gram[a, x, count + m], gram[a, count + m, x] = one * by_two, one * by_two
    gram[a, count + n, y], gram[a, y, count + n] = two * by_one, two * by_one
    gram[a, x, y], gram[a, y, x] = both * plain, both * plain


@quick
@ti.kernel
def multiply_paths(
    numbers: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [p] of each anchor: all lengths (m), all angles
    first: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [A + 1] of every anchor's numbers
    band: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, H] frequencies above the carrier, see `RATE`
    element: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] 2 pi / wavelength times place, own frame
    halves: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [A, 4 N, H] of each antenna: what cosines meet (re,
    # im), and what sines do
    spectrum: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [C, 2, H] scratch
    antennas: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [C, 3, N] scratch
    gram: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [A, 3 C, 3 C] out: responses, slopes by length, by angle
    matched: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [A, 3 C, 2] out: with the samples, re, im
):
    """Products of every anchor's paths; serial: they are few."""
    ti.loop_config(serialize=True)
    for a in range(first.shape[0] - 1):
        start, count = first[a], (first[a + 1] - first[a]) // 2
        for n in range(count):
            length = numbers[start + n]
            place_path(n, length, numbers[start + count + n], band, element, spectrum, antennas)
            match_path(a, n, count, 1 / length, band, halves, spectrum, antennas, matched)
            for m in range(n + 1):
                multiply_pair(
                    a, n, m, count, 1 / length, 1 / numbers[start + m], band, spectrum, antennas, gram
                )
