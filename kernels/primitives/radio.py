"""The radio's numbers as kernels take them, and what follows from them."""

import taichi as ti

from gridslam.kernels.primitives.functions import cos_of, decay_of, logarithm_of, sin_of

SCALE, GIVEN, ANCHOR_APERTURE, AGENT_APERTURE, SPAN, AT_1M, SAMPLES, THRESHOLD, FALSE_ALARMS, SENDER = (
    0,
    1,
    2,
    4,
    6,
    7,
    8,
    9,
    10,
    11,
)
"""Columns of `RadioModel.numbers`, a row for each anchor: sigma_d times u; sigma_d if given, else 0;
apertures of anchor and agent (2 each); width of the window of distances; u at 1 m; number of samples;
threshold; mean clutter; the anchor that sends: itself, or the one whose image in floor or ceiling it is."""
FLOOR = -25.0
"""Log of the Rayleigh density that clutter has at least, or a ratio to it would overflow."""
STEEPEST = 1 - 2.0**-10
"""Sine of the elevation up to which an array is said to see azimuths."""
TURN_SQUARED = 39.47841760435743


@ti.func
def amplitude_of(at_1m, length):
    """u of a path of a length, m, if `at_1m` is what it would have at 1 m: [Li2026grid], eq. (2)."""
    return at_1m / ti.max(length, 1e-3)


@ti.func
def angle_std(angle, along_x, along_y, amplitude):
    """sigma of an angle seen by an array with mean square extents (along x, along y), rad."""
    s, c = sin_of(angle), cos_of(angle)
    return 1 / (8.885765876316732 * amplitude * ti.sqrt(ti.max(s * s * along_x + c * c * along_y, 1e-30)))


@ti.func
def lean_of(length, height):
    """cos(elevation) of a path of a length, measured or predicted, to an anchor so high above the agent."""
    sine = ti.min(ti.abs(height) / ti.max(length, 1e-3), STEEPEST)
    return ti.sqrt(1 - sine * sine)


@ti.func
def deviations_of(radio: ti.template(), anchor, amplitude, departure, arrival, lean):
    """sigma of distance, AoD and AoA by Fisher information; horizontal arrays see cos(elevation) `lean`."""
    std = ti.Vector([radio[anchor, SCALE] / amplitude, 0.0, 0.0], dt=ti.f64)
    if radio[anchor, GIVEN] > 0:
        std[0] = radio[anchor, GIVEN]
    there, here = ti.static(ANCHOR_APERTURE, AGENT_APERTURE)
    std[1] = angle_std(departure, radio[anchor, there], radio[anchor, there + 1], amplitude) / lean
    std[2] = angle_std(arrival, radio[anchor, here], radio[anchor, here + 1], amplitude) / lean
    return std


@ti.func
def ranging_variance(radio: ti.template(), anchor, given, amplitude):
    """sigma_d^2 of a measurement: as `given` with it, if that is positive, or as the radio has it."""
    std = radio[anchor, GIVEN] if radio[anchor, GIVEN] > 0 else radio[anchor, SCALE] / amplitude
    std = given if given > 0 else std
    return std * std


@ti.func
def scaled_bessel(x):
    """I_0(x) e^-x for x >= 0, relative error below 5e-7 [Abramowitz1964handbook], 9.8.1, 9.8.2."""
    t = (x / 3.75) ** 2
    near = 1 + t * (
        3.5156229 + t * (3.0899424 + t * (1.2067492 + t * (0.2659732 + t * (0.0360768 + t * 0.0045813))))
    )
    value = near * decay_of(-ti.min(x, 3.75))
    if x > 3.75:
        s = 3.75 / x
        far = 0.39894228 + s * (
            0.01328592
            + s * (0.00225319 + s * (-0.00157565 + s * (0.00916281 + s * (-0.02057706 + s * 0.02635537))))
        )
        value = (far + s**7 * (-0.01647633 + s * 0.00392377)) / ti.sqrt(x)
    return value


@ti.func
def rician(measured, amplitude, samples):
    """p_d(u) times the density, truncated at the threshold, of a measured amplitude; docs/model.md, (M12)."""
    return rician_about(measured, amplitude, samples, 0.0)


@ti.func
def rician_about(measured, amplitude, samples, unsure):
    """As `rician`, of an amplitude u that is known to a share `unsure` of it; docs/model.md, (M541)."""
    variance = 0.5 + amplitude * amplitude / (4 * samples) + unsure * unsure * measured * amplitude
    gap = measured - amplitude
    bessel = scaled_bessel(measured * amplitude / variance)
    return measured / variance * decay_of(-gap * gap / (2 * variance)) * bessel


@ti.func
def log_rician(measured, amplitude, samples):
    """Logarithm of `rician`, which doesn't underflow."""
    variance = 0.5 + amplitude * amplitude / (4 * samples)
    gap = measured - amplitude
    bessel = logarithm_of(scaled_bessel(measured * amplitude / variance))
    return logarithm_of(measured / variance) - gap * gap / (2 * variance) + bessel


@ti.func
def clutter_of(radio: ti.template(), anchor, amplitude):
    """Density of a clutter measurement over distance, both angles and amplitude (negative: not measured)."""
    tail = ti.f64(0.0)
    if amplitude >= 0:
        excess = amplitude * amplitude - radio[anchor, THRESHOLD] * radio[anchor, THRESHOLD]
        tail = ti.max(logarithm_of(2 * ti.max(amplitude, 1e-30)) - excess, FLOOR)
    return decay_of(tail) / (radio[anchor, SPAN] * TURN_SQUARED)


@ti.func
def detection_of(amplitude, table: ti.template(), step):
    """p_d(u), interpolated in a table over ``0, step, ...``; beyond its end it is that of the end."""
    place = ti.max(ti.min(amplitude / step, table.shape[0] - 1.0), 0.0)
    low = ti.min(ti.cast(place, ti.i32), table.shape[0] - 2)
    return table[low] + (place - low) * (table[low + 1] - table[low])
