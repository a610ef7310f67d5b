"""Units of what a file of sampled signals says beside its samples: frequencies, times, headings, anchors.

What the scene says of the same is what they are held against; times and deviations show by themselves, too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.columns.time_units import absurd_times, slow_steps
from gridslam.checks.scene.allowed_for import may_stand_aside_m
from gridslam.checks.tables.unit_hypotheses import FOOT_M
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene
from gridslam.world.waveform import Waveform

FREQUENCY_UNITS = {1e3: "kHz", 1e6: "MHz", 1e9: "GHz"}
NEARLY = 0.01
"""By how much of it a spacing in another unit may differ from the scene's."""
LENGTH_UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "feet": FOOT_M}
APART_M, APART = 0.1, 0.005
"""How far apart an anchor of the file and the scene's may be, as rounded or surveyed twice; of their places,
too, where another unit is read."""
SAME_RAD = 1e-3
WIDE_RAD, UNTOLD_RAD, JUMPS = 0.5, 1.0, 0.2
"""Deviation of headings from which on degrees are thought of, also where no scene tells the sensor's; how
much of it they then jump from step to step at most: with errors of their own they jump by nearly all."""
LEAST_STEPS = 5


def frequency_factor(waveform: Waveform, scene: Scene | None) -> float:
    """What frequencies must be multiplied by to be spaced as the scene's are; 1 if no unit does that."""
    step = None if scene is None else scene.radio.frequency_step_hz
    for factor in FREQUENCY_UNITS:
        held = factor * np.abs(waveform.offset_hz).max() < waveform.carrier_hz
        if step is not None and held and abs(factor * waveform.step_hz / step - 1) < NEARLY:
            return factor
    return 1.0


def frequency_line(waveform: Waveform, factor: float) -> str:
    """What is said of frequencies in another unit.

    Parameters
    ----------
    waveform : Waveform
        As it stands in the file.
    factor : float
        As of `frequency_factor`.
    """
    unit, step = FREQUENCY_UNITS[factor], waveform.step_hz
    return (
        f"suspect: frequency_hz: {unit}, where Hz belong (times {factor:g}): steps of {step:g} Hz, where the "
        f"scene's radio.frequency_step_hz is {factor * step:g}; read as {unit} from here on"
    )


def stated_faults(raw: dict[str, Any], scene: Scene | None, agent: str | None) -> list[str]:
    """What looks wrong with times, headings and anchors, a line each.

    Parameters
    ----------
    raw : dict
        What the file holds, as of `gridslam.measurements.signal_hdf5.read_signal`.
    scene : Scene, optional
    agent : str, optional
        Whose recording it is; otherwise the scene's first agent.
    """
    body = None
    if scene is not None and (agent is not None or scene.agents):
        body = scene.agent(agent) if agent is not None else scene.agents[0]
    lines = []
    if raw.get("time_s") is not None:
        time = np.ravel(np.asarray(raw["time_s"], float))
        columns = {"step": np.arange(len(time)), "time_s": time}
        found = absurd_times(columns)
        if not found and body is not None:
            found = slow_steps(columns, body.interval_s, body.step_m)
        lines += [str(item) for item in found]
    sensor = None if body is None else body.heading_sensor_deg
    lines += _headings(raw.get("heading_rad"), float(raw.get("heading_std_rad") or 0.0), sensor)
    if scene is not None and tuple(raw["anchors"]) == scene.anchor_names:
        lines += _anchors(raw, scene)
    return [f"suspect: {line}" for line in lines]


def _headings(heading: Array | None, std: float, sensor_deg: float | None) -> list[str]:
    """Headings (K,) that can't be radians, and a deviation that looks like degrees."""
    if heading is None or not len(heading) or not np.isfinite(heading).all():
        return []
    lines, most = [], float(np.abs(heading).max())
    if most > 2 * np.pi:
        lines.append(f"heading_rad: up to {most:.4g}: degrees?")
    wide = WIDE_RAD if sensor_deg is not None else UNTOLD_RAD
    if not wide <= std <= 90 or len(heading) < LEAST_STEPS:
        return lines
    jump = float(np.median(np.abs(wrap(np.diff(np.radians(heading) if lines else heading)))))
    if jump < JUMPS * std and np.radians(sensor_deg or 0.0) < 0.5 * std:
        lines.append(
            f"heading_std_rad: probably degrees, where radians belong: {std:g} rad are {np.degrees(std):.0f} "
            f"degrees, and headings differ by {np.degrees(jump):.2g} degrees from step to step"
        )
    return lines


def _anchors(raw: dict[str, Any], scene: Scene) -> list[str]:
    """Places and orientations of anchors in other units than the scene's, or places elsewhere."""
    lines = []
    place, facing = raw.get("anchor_position_m"), raw.get("anchor_orientation_rad")
    if place is not None and np.isfinite(place).all():
        lines += _places(np.asarray(place, float)[:, :2], scene)
    if facing is not None and np.isfinite(facing).all():
        given, scenes = np.asarray(facing, float), scene.anchor_orientations
        off = np.abs(wrap(given - scenes)).max(initial=0.0)
        degrees = np.abs(wrap(given - np.degrees(scenes))).max(initial=0.0)  # a recording keeps them wrapped
        if off > SAME_RAD > degrees:
            lines.append("anchor_orientation_rad: degrees, where radians belong: they are the scene's then")
    return lines


def _places(given: Array, scene: Scene) -> list[str]:
    """What is said of the file's anchors at (J, 2) m."""
    scenes = scene.anchor_positions
    apart = np.linalg.norm(given - scenes, axis=1)
    allowed = np.maximum(APART_M, may_stand_aside_m(scene))
    if (apart <= allowed).all():
        return []
    size = np.linalg.norm(scenes, axis=1)
    for unit, factor in LENGTH_UNITS.items():
        if (np.linalg.norm(factor * given - scenes, axis=1) <= np.maximum(allowed, APART * size)).all():
            return [f"anchor_position_m: {unit}, where metres belong: they are the scene's then"]
    return [
        f"anchor_position_m: {name} stands {way:.3g} m from where the scene has it"
        for name, way, most in zip(scene.anchor_names, apart, allowed, strict=True)
        if way > most
    ]
