"""What is in a file of sampled signals, and whether it is what it says: signs, units of elements, offsets.

The line of sight is where it shows: at known places (a true track in the file, or the scene's start) its
length and directions are known, so of all readings of the samples the right one has a peak there. Delays are
judged first, over all antennas together; then directions, at the delay of that peak.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError, located
from gridslam.measurements.matlab_signal import read_mat_signal
from gridslam.measurements.signal_hdf5 import read_signal
from gridslam.wording import counted
from gridslam.world.geometry import direction
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene
from gridslam.world.waveform import Waveform, steering

Complex = NDArray[np.complex128]
MOST_PLACES, START_STEPS = 60, 3
"""Steps that are looked at: of a known track, and from a known start on."""
FINE = 8
"""Points per resolution cell of the delay."""
THERE, BETTER = 0.5, 0.25
"""Share of the peak that a reading must have at the line of sight; how much more than as it stands."""
READABLE = (1e4, 1e9)
"""Frequency steps (Hz) that a radio may have."""


@dataclass(frozen=True, eq=False)
class Places:
    """What is known of the line of sight: one row per snapshot, N of them.

    Attributes
    ----------
    step, anchor : (N,) int
    distance_m, aod_rad, bearing_rad : (N,)
        Length, departure from the anchor's orientation, direction from the agent in the scene's frame.
    heading_rad : (N,)
        Known without the file's own measurement.
    slack_m : float
        How far off lengths may be.
    """

    step: NDArray[np.intp]
    anchor: NDArray[np.intp]
    distance_m: Array
    aod_rad: Array
    bearing_rad: Array
    heading_rad: Array
    slack_m: float


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
        raw = read_mat_signal(path) if Path(path).suffix.lower() == ".mat" else read_signal(path)
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
    lines += _units(raw, waveform)
    usable = _usable_snapshots(raw, samples)
    if not usable.any():
        return lines
    lines += _levels(raw, samples, usable, waveform)
    if scene is not None and tuple(raw["anchors"]) != scene.anchor_names:
        lines.append(f"suspect: anchors: names that aren't the scene's ({', '.join(scene.anchor_names)})")
    places = _places(raw, usable, scene, agent)
    if places is None:
        more = "a scene (--scene) or a true track in the file would let the line of sight be looked for"
        return [*lines, f"signs, units of elements and offsets not checked: {more}"]
    return lines + _line_of_sight(raw, samples, waveform, places)


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
        lines.append(f"suspect: frequency_hz: steps of {step:g} Hz, which would be MHz or GHz rather than Hz")
    elif scene is not None:
        corners = np.array([[x, y] for x in scene.grid.x_m for y in scene.grid.y_m])
        far = float(np.linalg.norm(corners - scene.anchor_positions[:, None], axis=-1).max())
        if far > folding:
            found = f"lines of sight of up to {far:.3g} m would fold back beyond {folding:.4g} m"
            lines.append(f"suspect: frequency_hz: {found}; smaller steps are needed")
    return lines


def _units(raw: dict[str, Any], waveform: Waveform) -> list[str]:
    """Headings that can't be radians."""
    heading = raw.get("heading_rad")
    if heading is not None and np.isfinite(heading).all() and np.abs(heading).max() > 2 * np.pi:
        return [f"suspect: heading_rad: up to {np.abs(heading).max():.4g}: degrees?"]
    return []


def _usable_snapshots(raw: dict[str, Any], samples: Array) -> NDArray[np.bool_]:
    """Snapshots (K, J) that are there and can be looked at."""
    flat = samples.reshape(*samples.shape[:2], -1)
    good = np.isfinite(flat).all(-1) & flat.any(-1)
    received = raw.get("heard")
    return np.asarray(good if received is None else good & np.asarray(received, bool))


def _levels(raw: dict[str, Any], samples: Array, usable: NDArray[np.bool_], waveform: Waveform) -> list[str]:
    """Strongest peak and its SNR, by anchor."""
    lines = []
    for anchor, name in enumerate(raw["anchors"]):
        own = np.flatnonzero(usable[:, anchor])[:MOST_PLACES]
        if not len(own):
            lines.append(f"{name}: never heard")
            continue
        profile = delay_profile(samples[own, anchor], waveform)
        peak, place = profile.max(-1), profile.argmax(-1) * waveform.folding_m / profile.shape[-1]
        noise = np.median(profile, -1) / np.log(2)
        snr = 10 * np.log10(np.median(peak / np.maximum(noise, 1e-300)))
        share = usable[:, anchor].mean()
        spread = f"{place.min():.3g} to {place.max():.3g} m"
        lines.append(f"{name}: heard at {share:.0%} of the steps, strongest peak {snr:.0f} dB, at {spread}")
    return lines


def delay_profile(samples: Complex, waveform: Waveform) -> Array:
    """Power (N, n) over lengths up to the folding range, of snapshots (N, A, B, M), all antennas together."""
    count = FINE * len(waveform.offset_hz)
    response = np.fft.ifft(samples * waveform.pulse.conj(), count, axis=-1) * count
    return np.asarray((np.abs(response) ** 2).sum((1, 2)))


def _places(
    raw: dict[str, Any], usable: NDArray[np.bool_], scene: Scene | None, agent: str | None
) -> Places | None:
    """Snapshots at which the line of sight is known."""
    anchors, facing = raw.get("anchor_position_m"), raw.get("anchor_orientation_rad")
    if scene is not None and tuple(raw["anchors"]) == scene.anchor_names:
        anchors, facing = scene.anchor_positions, scene.anchor_orientations
    truth, steps = raw.get("truth"), len(usable)
    if anchors is None:
        return None
    facing = np.zeros(len(anchors)) if facing is None else facing
    if truth is not None and len(truth) == steps:
        chosen = np.unique(np.linspace(0, steps - 1, min(steps, MOST_PLACES)).astype(int))
        position, heading, slack = truth.position_m[chosen], truth.heading_rad[chosen], 0.1
    elif scene is not None:
        body = scene.agent(agent) if agent is not None else scene.agents[0] if scene.agents else None
        if body is None:
            return None
        chosen = np.arange(min(steps, START_STEPS))
        position = np.broadcast_to(np.array(body.start_m), (len(chosen), 2))
        heading = np.full(len(chosen), np.radians(body.start_heading_deg))
        slack = body.prior.position_m + START_STEPS * body.step_m
    else:
        return None
    row, anchor = np.nonzero(usable[chosen])
    if not len(row):
        return None
    way = position[row] - np.asarray(anchors)[anchor]
    leaving = direction(np.asarray(anchors)[anchor], position[row])
    return Places(
        chosen[row], anchor, np.hypot(*way.T), leaving - np.asarray(facing)[anchor], leaving + np.pi,
        heading[row], slack,
    )  # fmt: skip


def _line_of_sight(raw: dict[str, Any], samples: Array, waveform: Waveform, places: Places) -> list[str]:
    """Judge delays, then directions."""
    own = samples[places.step, places.anchor].astype(np.complex128)
    profile = delay_profile(own, waveform)
    profile /= profile.max(-1, keepdims=True)
    half = max(0.75 * SPEED_OF_LIGHT / waveform.bandwidth_hz, places.slack_m)

    def share(shift: float = 0.0, flipped: bool = False) -> float:
        """Mean height of what is at the line of sight, over the highest peak."""
        table = np.roll(profile[:, ::-1], 1, axis=1) if flipped else profile
        return float(_at(table, places.distance_m + shift, half, waveform.folding_m).mean())

    plain = share()
    lines = [
        f"line of sight: {plain:.0%} of the strongest peak is found at its length, in {len(own)} snapshots"
    ]
    turned = share(flipped=True)
    if turned > THERE and turned > plain + BETTER:
        return lines + _turned(raw, own, waveform, places, half)
    shifts = np.arange(0, waveform.folding_m, 0.5 * half)
    found = np.array([share(shift) for shift in shifts])
    best = float(shifts[found.argmax()])
    if found.max() > THERE and found.max() > plain + BETTER:
        best = best - waveform.folding_m if best > 0.5 * waveform.folding_m else best
        off = f"{best:+.3g} m ({1e9 * best / SPEED_OF_LIGHT:+.3g} ns)"
        lines.append(f"suspect: samples: all delays are off by about {off}: a cable, a clock, a trigger?")
        places = Places(
            places.step, places.anchor, places.distance_m + best, places.aod_rad, places.bearing_rad,
            places.heading_rad, places.slack_m,
        )  # fmt: skip
    elif plain < THERE:
        lines.append("the line of sight is weak or hidden there: directions not checked")
        return lines
    return lines + _directions(raw, own, waveform, places, half, False)[1]


def _turned(raw: dict[str, Any], own: Complex, waveform: Waveform, places: Places, half: float) -> list[str]:
    """Delays are found backwards: conjugated, or the frequencies run down. Directions tell which."""
    ways = {
        "conjugated: the phase must turn as exp(-2j pi f d / c); take the conjugate": own.conj(),
        "with their frequencies in falling order; reverse that axis": own[..., ::-1],
    }
    tried = {name: _directions(raw, z, waveform, places, half, True) for name, z in ways.items()}
    line = "suspect: samples: delays run backwards, as of samples that are"
    shares = [share for share, _ in tried.values()]
    if any(np.isnan(share) for share in shares) or abs(shares[0] - shares[1]) < BETTER:
        return [f"{line} {' or '.join(name.split(':')[0].split(';')[0] for name in ways)}"]
    return [f"{line} {max(tried, key=lambda name: tried[name][0])}"]


def _directions(
    raw: dict[str, Any], own: Complex, waveform: Waveform, places: Places, half: float, quiet: bool
) -> tuple[float, list[str]]:
    """How well directions fit as they stand, and what would make them fit; NaN where nothing tells them."""
    shape = own.shape[1:3]
    arrays = [raw.get("anchor_element_m"), raw.get("agent_element_m")]
    if shape == (1, 1) or any(q is None and n > 1 for q, n in zip(arrays, shape, strict=True)):
        return np.nan, []
    anchor = np.zeros((len(raw["anchors"]), 1, 2)) if arrays[0] is None else np.asarray(arrays[0])
    carried = np.zeros((1, 2)) if arrays[1] is None else np.asarray(arrays[1])
    matched = _matched(own, waveform, places.distance_m, half)
    measured = raw.get("heading_rad")
    headings = {"": places.heading_rad}
    if measured is not None and shape[1] > 1:
        headings = {"": np.asarray(measured)[places.step]}
        headings |= {"heading_rad: the true one": places.heading_rad}
        headings |= {"heading_rad: degrees, not radians": np.radians(headings[""])}
        headings |= {"heading_rad: the opposite sign": -headings[""]}

    def share(heading: Array, scale: float = 1.0, sign: float = 1.0, turn: float = 0.0) -> float:
        """Mean share of the power at the line of sight that its directions explain."""
        length = waveform.wavelength_m
        total = 0.0
        for row, y in enumerate(matched):
            leaving = steering(sign * scale * anchor[places.anchor[row]], places.aod_rad[row] + turn, length)
            arriving = steering(sign * scale * carried, places.bearing_rad[row] - heading[row], length)
            total += abs(leaving.conj() @ y @ arriving.conj()) ** 2 / max((abs(y) ** 2).sum(), 1e-300)
        return total / len(matched)

    plain = share(headings[""])
    others = {f"suspect: {name}": share(heading) for name, heading in headings.items() if name}
    others |= {
        "suspect: element_m: wavelengths, not metres": share(headings[""], scale=waveform.wavelength_m),
        "suspect: element_m: millimetres, not metres": share(headings[""], scale=1e-3),
        "suspect: element_m: the opposite sign (y to the right, or phases of exp(-j))": share(
            headings[""], sign=-1.0
        ),
    }
    known = others.pop("suspect: heading_rad: the true one", None)
    lines = (
        [] if quiet else [f"directions: {plain:.0%} of the line of sight's power comes from where it should"]
    )
    best = max(others, key=lambda name: others[name])
    as_good = known is None or others[best] > known - 0.4 * BETTER
    if others[best] > THERE and others[best] > plain + BETTER and as_good:
        lines.append(best)
    elif known is not None and known > THERE and known > plain + BETTER:
        lines.append("suspect: heading_rad: another frame or sensor than the agent's: the true heading fits")
    return plain, lines


def _at(table: Array, lengths: Array, half: float, folding: float) -> Array:
    """Largest value (N,) of rows (N, n) within `half` of lengths (N,), around the folding range."""
    count = table.shape[1]
    reach = int(np.ceil(half * count / folding))
    middle = np.rint(lengths * count / folding).astype(int)
    columns = (middle[:, None] + np.arange(-reach, reach + 1)) % count
    return np.asarray(np.take_along_axis(table, columns, 1).max(1))


def _matched(own: Complex, waveform: Waveform, lengths: Array, half: float) -> Complex:
    """Samples (N, A, B) at the delay of the strongest peak within `half` of lengths (N,)."""
    tries = lengths[:, None] + np.linspace(-half, half, 41)
    response = waveform.delay_response(tries)
    found = np.einsum("ntm,nabm->ntab", response.conj(), own, optimize=True)
    best = (np.abs(found) ** 2).sum((2, 3)).argmax(1)
    return np.asarray(found[np.arange(len(own)), best])
