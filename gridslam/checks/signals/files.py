"""What is in a file of sampled signals, and whether it is what it says: signs, units of elements, offsets.

The line of sight is where it shows: at known places (a true track in the file, or the scene's start) its
length and directions are known, so of all readings of the samples the right one has a peak there. Delays are
judged first, over all antennas together; then directions, at the delay of that peak.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import gamma

from gridslam.arrays import Array
from gridslam.checks.signals.delays import Delays, delay_profile
from gridslam.checks.signals.directions import Directions, directions
from gridslam.checks.signals.elements import sample_faults
from gridslam.checks.signals.frequency_units import (
    READABLE,
    factor_by_delays,
    half_width,
    possible_units,
)
from gridslam.checks.signals.order import TIMES, over_time, shift_line, shift_of, some_of, spectrum
from gridslam.checks.signals.places import MOST_PLACES, Complex, Places, exchanged, places_of
from gridslam.checks.signals.stated import frequency_factor, frequency_line, stated_faults
from gridslam.errors import InputError, located
from gridslam.measurements.matlab_signal import read_mat_signal
from gridslam.measurements.signal_hdf5 import read_signal
from gridslam.wording import counted
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene
from gridslam.world.waveform import Waveform

THERE, BETTER = 0.5, 0.25
"""Share of the peak that a reading must have at the line of sight; how much more than as it stands."""
OFFSET_THERE = 0.8
"""Such a share with an offset of all delays: where the line of sight is hidden, a later path is the
strongest."""
PLANAR = (
    "and methods on sampled signals (direct, hybrid) refuse such scenes: gridslam extract makes paths of the "
    "samples, for grid and adaptive"
)


def describe_signal(
    path: str | os.PathLike[str], scene: Scene | None = None, agent: str | None = None
) -> list[str]:
    """Say what a file of sampled signals holds and what looks wrong with it.

    Parameters
    ----------
    path : path
        HDF5 or MATLAB file.
    scene : Scene, optional
        Gives anchors and the agent's start, near which the line of sight is looked for.
    agent : str, optional
        Whose recording it is; otherwise the scene's first agent.

    Returns
    -------
    list of str
        Lines for a person; those of suspicions start with ``suspect:``.

    Raises
    ------
    InputError
        Not a file of sampled signals at all, or no such agent.
    """
    with located(path):
        raw = read_mat_signal(path) if Path(path).suffix.lower() == ".mat" else read_signal(path, False)
    samples = np.asarray(raw["samples"])
    samples = samples[:, :, None, None] if samples.ndim == 3 else samples
    lines = [_summary(raw, samples)]
    try:
        count = samples.shape[1]
        pulse = raw.get("pulse")
        flat = np.asarray(np.ones(samples.shape[-1]) if pulse is None else pulse, np.complex128)
        waveform = Waveform(
            raw["carrier_hz"], raw["frequency_hz"], flat, np.zeros((count, 1, 2)), np.zeros((1, 2))
        )
    except (InputError, IndexError):
        return lines  # whoever reads the file is told
    lines += _band(waveform, scene)
    usable = _usable_snapshots(raw, samples)
    places = places_of(raw, usable, scene, agent)
    factor = frequency_factor(waveform, scene)
    told = frequency_line(waveform, factor) if factor != 1.0 else ""
    if factor == 1.0:
        factor, told = factor_by_delays(samples, waveform, places, scene)
    if factor != 1.0:
        lines[1:] = [lines[1], told]
        waveform = replace(waveform, offset_hz=factor * waveform.offset_hz)
    lines += stated_faults(raw, scene, agent)
    if scene is not None and scene.has_heights:
        lines.append(f"note: {scene.name} has heights, {PLANAR}")
    if not usable.any():
        return lines
    roll = shift_of(some_of(samples, usable), waveform)
    if roll:
        lines.append(f"suspect: {shift_line(roll, samples.shape[-1])}; read so from here on")
        samples = np.roll(samples, roll, axis=-1)
    lines += _levels(raw, samples, usable, waveform)
    lines += [f"suspect: samples: {fault}" for fault in sample_faults(samples, usable, raw["anchors"])]
    if scene is not None and tuple(raw["anchors"]) != scene.anchor_names:
        lines.append(f"suspect: anchors: names that aren't the scene's ({', '.join(scene.anchor_names)})")
    if places is None:
        more = "a scene (--scene) or a true track in the file would let the line of sight be looked for"
        return [*lines, f"signs, units of elements and offsets not checked: {more}"]
    others = exchanged(raw, usable, scene, agent)
    return lines + _line_of_sight(raw, samples, waveform, places, others)


def _summary(raw: dict[str, Any], samples: Array) -> str:
    steps, anchors, elements, carried, points = samples.shape if samples.ndim == 5 else (0,) * 5
    names = ", ".join(raw["anchors"])
    size = f"{counted(steps, 'step')}, {counted(anchors, 'anchor')} ({names})"
    return f"sampled signals: {size}, {elements} x {carried} antennas, {points} frequencies"


def _band(waveform: Waveform, scene: Scene | None) -> list[str]:
    """Bandwidth, resolution and folding range, and whether they make sense."""
    step, folding = waveform.step_hz, waveform.folding_m
    resolution = SPEED_OF_LIGHT / waveform.bandwidth_hz
    radio = f"carrier {waveform.carrier_hz / 1e9:.4g} GHz, bandwidth {waveform.bandwidth_hz / 1e6:.4g} MHz"
    reach = f"c/B = {resolution:.3g} m overlap, longer ones than {folding:.4g} m fold back"
    lines = [f"{radio}: paths closer than {reach}"]
    if not READABLE[0] <= step <= READABLE[1]:
        units = " or ".join(possible_units(waveform).values())
        meant = f"which would be {units} rather than Hz" if units else "which no radio has: Hz?"
        lines.append(f"suspect: frequency_hz: steps of {step:g} Hz, {meant}")
    elif scene is not None:
        corners = np.array([[x, y] for x in scene.grid.x_m for y in scene.grid.y_m])
        far = float(np.linalg.norm(corners - scene.anchor_positions[:, None], axis=-1).max())
        if far > folding:
            found = f"lines of sight of up to {far:.3g} m would fold back beyond {folding:.4g} m"
            lines.append(f"suspect: frequency_hz: {found}; smaller steps are needed")
    return lines


def _usable_snapshots(raw: dict[str, Any], samples: Array) -> NDArray[np.bool_]:
    """Snapshots (K, J) that are there and can be looked at."""
    flat = samples.reshape(*samples.shape[:2], -1)
    good = np.isfinite(flat).all(-1) & flat.any(-1)
    received = raw.get("heard")
    return np.asarray(good if received is None else good & np.asarray(received, bool))


def _levels(raw: dict[str, Any], samples: Array, usable: NDArray[np.bool_], waveform: Waveform) -> list[str]:
    """Strongest peak and its SNR, by anchor."""
    lines, antennas = list[str](), samples.shape[2] * samples.shape[3]
    quiet = gamma.median(antennas) / antennas  # of noise whose power is summed over them, median over mean
    for anchor, name in enumerate(raw["anchors"]):
        own = np.flatnonzero(usable[:, anchor])[:MOST_PLACES]
        if not len(own):
            lines.append(f"{name}: never heard")
            continue
        profile = delay_profile(samples[own, anchor], waveform)
        peak, place = profile.max(-1), profile.argmax(-1) * waveform.folding_m / profile.shape[-1]
        noise = np.median(profile, -1) / quiet
        snr = 10 * np.log10(np.median(peak / np.maximum(noise, 1e-300)))
        share = usable[:, anchor].mean()
        spread = f"{place.min():.3g} to {place.max():.3g} m"
        lines.append(f"{name}: heard at {share:.0%} of the steps, strongest peak {snr:.0f} dB, at {spread}")
    return lines


def _line_of_sight(
    raw: dict[str, Any], samples: Array, waveform: Waveform, places: Places, others: Mapping[str, Places]
) -> list[str]:
    """Judge delays, then directions; `others` are the places with two anchors exchanged, by what that is."""
    own, half = Delays.of(samples, waveform, places), half_width(waveform, places)
    plain = own.share(places, half)
    where = f"found at its length, in {len(own.samples)} snapshots"
    lines = [f"line of sight: {plain:.0%} of the strongest peak is {where}"]
    if over_time(own.samples, waveform):
        timed = Delays.alone(spectrum(own.samples), waveform)
        if max(timed.share(places, half, flipped=flipped) for flipped in (False, True)) > THERE:
            return [*lines, f"suspect: {TIMES}"]
    turned = own.share(places, half, flipped=True)
    if turned > THERE and turned > plain + BETTER:
        return lines + _turned(raw, own.samples, waveform, places, half)
    shifts = np.arange(0, waveform.folding_m, 0.5 * half)
    found = np.array([own.share(places, half, shift) for shift in shifts])
    best, rise = own.common(places, half)
    if found.max() > max(OFFSET_THERE, plain + BETTER):
        best = float(shifts[found.argmax()])
        rise = own.rise(places, half, best)
    if rise is not None:
        known = f"lines of sight are as long as to anchors about {rise:.1f} m above or below the agent"
        lines.append(f"suspect: samples: {known}: give the scene heights (position_m of three, height_m)")
        places = replace(places, distance_m=np.hypot(places.distance_m, rise))
    elif best is not None:
        for _ in range(2):  # the first look may have cut some off
            best = own.middle(places, half, best)
        best = best - waveform.folding_m if best > 0.5 * waveform.folding_m else best
        off = f"{best:+.3g} m ({1e9 * best / SPEED_OF_LIGHT:+.3g} ns, to within {places.slack_m:.2g} m)"
        lines.append(f"suspect: samples: all delays are off by about {off}: a cable, a clock, a trigger?")
        places = replace(places, distance_m=places.distance_m + best)
    elif plain < THERE:
        swapped = _exchange(raw, samples, waveform, others, plain, None)
        weak = "the line of sight is weak or hidden there: delays and directions can't be told"
        return [*lines, swapped or weak]
    fit, said = directions(raw, own.samples, waveform, places, half)
    doubtful = fit is not None and fit.doubtful
    swapped = _exchange(raw, samples, waveform, others, plain, fit) if doubtful else None
    return [*lines, *said[:1], swapped] if swapped else lines + said


def _exchange(
    raw: dict[str, Any], samples: Array, waveform: Waveform, others: Mapping[str, Places], plain: float,
    fit: Directions | None,
) -> str | None:  # fmt: skip
    """The two anchors that explain delays as well, and directions better, at each other's places; or None."""
    best, line = 0.0 if fit is None else fit.share, None
    for text, places in others.items():
        own, half = Delays.of(samples, waveform, places), half_width(waveform, places)
        share = own.share(places, half)
        if share < max(THERE, plain - 0.1):
            continue
        new, _ = directions(raw, own.samples, waveform, places, half)
        if new is None:
            better = fit is None and share > plain + BETTER
        else:
            better = not new.misses and new.share > best + 0.5 * BETTER
            best = max(best, new.share)
        if better:
            line = f"suspect: anchors: {text}"
    return line


def _turned(raw: dict[str, Any], own: Complex, waveform: Waveform, places: Places, half: float) -> list[str]:
    """Delays are found backwards: conjugated, or the frequencies run down. Directions tell which."""
    ways = {
        "conjugated: the phase must turn as exp(-2j pi f d / c); take the conjugate": own.conj(),
        "with their frequencies in falling order; reverse that axis": own[..., ::-1],
    }
    tried = {name: directions(raw, z, waveform, places, half)[0] for name, z in ways.items()}
    line = "suspect: samples: delays run backwards, as of samples that are"
    shares = {name: fit.share for name, fit in tried.items() if fit is not None}
    one, other = (shares.get(name, 0.0) for name in ways)
    if abs(one - other) < 0.5 * BETTER * max(
        (fit.left for fit in tried.values() if fit is not None), default=1
    ):
        return [f"{line} {' or '.join(name.split(':')[0].split(';')[0] for name in ways)}"]
    return [f"{line} {max(shares, key=lambda name: shares[name])}"]
