"""What a receiver makes of exact paths: noise, misses, clutter, clocks (docs/model.md, (M9)-(M13))."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from gridslam.arrays import Array
from gridslam.measurements.table import Measurements
from gridslam.simulation.true_paths import TruePaths
from gridslam.world.columns import ELEVATIONS
from gridslam.world.geometry import elevations, lean, wrap
from gridslam.world.levels import DIRECT
from gridslam.world.radio import RadioModel
from gridslam.world.scene import Scene
from gridslam.world.start import require_seed


def received(
    paths: TruePaths | Measurements,
    scene: Scene,
    agent: str,
    seed: int,
    steps: int,
    offset_m: Array | None = None,
    false_alarms: float | None = None,
) -> tuple[dict[str, Any], NDArray[np.intp]]:
    """Columns of the detected paths with noise and of clutter, and the row of `paths` of each, or -1.

    Parameters
    ----------
    offset_m : (steps, J) m, optional
        What the clocks add to distances; see `clocks.apparent_bias`.
    false_alarms : float, optional
        Per anchor and step, instead of the scene's.
    """
    signal = scene.signal_model(agent)
    names = [a.name for a in scene.agents]
    require_seed(seed)
    draw = np.random.default_rng([seed, names.index(agent), 0x51])
    scale = signal.amplitude_std(paths.amplitude)
    noise = draw.standard_normal((len(paths.step), 5))
    amplitude = np.hypot(paths.amplitude + scale * noise[:, 0], scale * noise[:, 1])
    # a path is missed with probability 1 - p_d(u)
    given = signal.given_detection
    detected = np.flatnonzero(amplitude > signal.threshold if given is None else ndtr(noise[:, 0]) < given)
    clean = paths.amplitude[detected]
    heights = scene.heights(agent)
    over = paths.over[detected] if isinstance(paths, TruePaths) else np.zeros(len(detected), np.intp)
    tall = scene.verticals(agent).heights(over, paths.anchor[detected])
    steep = lean(paths.distance_m[detected], tall)
    apertures = signal.anchor_aperture[paths.anchor[detected]]
    aod_std = signal.angle_std(clean, paths.aod_rad[detected], apertures, steep)
    aoa_std = signal.angle_std(clean, paths.aoa_rad[detected], signal.agent_aperture, steep)
    distance = paths.distance_m[detected] + signal.distance_std(clean) * noise[detected, 2]
    if offset_m is None:
        distance = np.abs(distance)
    else:
        distance += offset_m[paths.step[detected], paths.anchor[detected]]
    table = {
        "step": paths.step[detected],
        "anchor": paths.anchor[detected],
        "distance_m": distance,
        "aod_rad": wrap(paths.aod_rad[detected] + np.nan_to_num(aod_std, posinf=0) * noise[detected, 3]),
        "aoa_rad": wrap(paths.aoa_rad[detected] + np.nan_to_num(aoa_std, posinf=0) * noise[detected, 4]),
        "amplitude": amplitude[detected],
    }
    rate = signal.false_alarms if false_alarms is None else false_alarms
    counts = draw.poisson(rate, (steps, len(scene.anchors)))
    total = int(counts.sum())
    first, last = signal.window_m or (0.0, signal.max_distance_m)
    cell = np.repeat(np.arange(counts.size), counts.ravel())
    false = {
        "step": cell // len(scene.anchors),
        "anchor": cell % len(scene.anchors),
        "distance_m": draw.uniform(first, last, total),
        "aod_rad": draw.uniform(-np.pi, np.pi, total),
        "aoa_rad": draw.uniform(-np.pi, np.pi, total),
        # Rayleigh with scale^2 = 1/2 above the threshold, by inversion
        "amplitude": np.sqrt(signal.threshold**2 + draw.exponential(1.0, total)),
    }
    label = np.concatenate([detected, np.full(total, -1)])
    columns = {name: np.concatenate([table[name], false[name]]) for name in table}
    apertures = signal.anchor_aperture[false["anchor"]]
    for angle, std, aperture in (
        ("aod_rad", aod_std, apertures),
        ("aoa_rad", aoa_std, signal.agent_aperture),
    ):
        # a lone antenna measures no angle, of clutter neither
        wild = signal.angle_std(false["amplitude"], false[angle], aperture, np.ones(total))
        columns[angle][~np.isfinite(np.concatenate([std, wild]))] = np.nan
    if scene.radio.reports_std:
        columns |= _own_deviations(columns, signal, heights)
    for quantity, name in (("aod", "aod_rad"), ("aoa", "aoa_rad"), ("amplitude", "amplitude")):
        if quantity not in signal.measures:
            columns[name] = np.full(len(label), np.nan)
    columns |= _elevations(paths, columns, label, scene, agent, seed)
    order = np.lexsort((columns["distance_m"], columns["anchor"], columns["step"]))
    if signal.window_m is not None:  # what arrives outside of it isn't received
        order = order[(columns["distance_m"][order] >= first) & (columns["distance_m"][order] <= last)]
    return {name: column[order] for name, column in columns.items()}, label[order]


def _elevations(
    paths: TruePaths | Measurements, columns: dict[str, Any], label: NDArray[np.intp], scene: Scene,
    agent: str, seed: int,
) -> dict[str, Any]:  # fmt: skip
    """Elevations, where arrays measure any, by random numbers of their own: all else stays as it was."""
    signal, cause = scene.signal_model(agent), np.maximum(label, 0)
    if not any(signal.elevated):
        return {}
    draw = np.random.default_rng([seed, [a.name for a in scene.agents].index(agent), 0x52])
    noise, false = draw.standard_normal((len(paths.step), 2)), draw.uniform(-0.5, 0.5, (len(label), 2))
    if not len(paths.step):
        cause, clean = label, np.zeros((len(label), 2))
        std = clean
    else:
        clean = true_elevations(paths, scene, agent)[cause]
        amplitude, anchor = paths.amplitude[cause], paths.anchor[cause]
        std = signal.elevation_std(amplitude, anchor, np.cos(clean).max(1))
        noise = noise[cause]
    measured = clean + np.nan_to_num(std, posinf=0.0) * noise
    # beyond the zenith a path looks as if it came from the other side
    measured = np.where((label < 0)[:, None], np.pi * false, np.arcsin(np.sin(measured)))
    loud = np.maximum(columns["amplitude"], signal.threshold)
    own = signal.elevation_std(loud, columns["anchor"], np.cos(measured).max(1))
    found = dict[str, Any]()
    for end, name in enumerate(ELEVATIONS):
        if signal.elevated[end]:
            seen = np.isfinite(own[:, end])
            found[name] = np.where(seen, measured[:, end], np.nan)
            if scene.radio.reports_std:
                found[name.replace("_rad", "_std_rad")] = np.where(seen, own[:, end], np.nan)
    return found


def true_elevations(paths: TruePaths | Measurements, scene: Scene, agent: str) -> Array:
    """Elevations of exact paths (L, 2) rad, of departure and arrival; docs/model.md, (M301)."""
    if isinstance(paths, Measurements):
        departing, arriving = paths.aod_elevation_rad, paths.aoa_elevation_rad
        if departing is not None and arriving is not None:
            return np.column_stack([departing, arriving])
    over = paths.over if isinstance(paths, TruePaths) else np.zeros(len(paths.step), np.intp)
    return elevations(paths.distance_m, scene.verticals(agent).heights(over, paths.anchor), over == DIRECT)


def _own_deviations(columns: dict[str, Any], signal: RadioModel, heights: Array) -> dict[str, Any]:
    """Deviations that a radio reports with its measurements: Fisher information at their own amplitude."""
    amplitude = np.maximum(columns["amplitude"], signal.threshold)
    aperture = signal.anchor_aperture[columns["anchor"]]
    steep = lean(columns["distance_m"], heights[columns["anchor"]])
    std = {
        "distance_std_m": signal.distance_std(amplitude),
        "aod_std_rad": signal.angle_std(amplitude, columns["aod_rad"], aperture, steep),
        "aoa_std_rad": signal.angle_std(amplitude, columns["aoa_rad"], signal.agent_aperture, steep),
    }
    return {name: np.where(np.isfinite(values), values, np.nan) for name, values in std.items()}
