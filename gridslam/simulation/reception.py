"""What a receiver makes of exact paths: noise, misses, clutter, clocks (docs/model.md, (M9)-(M13))."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from gridslam.arrays import Array
from gridslam.measurements.table import Measurements
from gridslam.simulation.true_paths import TruePaths
from gridslam.world.geometry import lean, wrap
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
    heard = np.flatnonzero(amplitude > signal.threshold if given is None else ndtr(noise[:, 0]) < given)
    clean = paths.amplitude[heard]
    heights = scene.heights(agent)
    over = paths.over[heard] if isinstance(paths, TruePaths) else np.zeros(len(heard), np.intp)
    tall = scene.verticals(agent).heights(over, paths.anchor[heard])
    steep = lean(paths.distance_m[heard], tall)
    apertures = signal.anchor_aperture[paths.anchor[heard]]
    aod_std = signal.angle_std(clean, paths.aod_rad[heard], apertures, steep)
    aoa_std = signal.angle_std(clean, paths.aoa_rad[heard], signal.agent_aperture, steep)
    distance = paths.distance_m[heard] + signal.distance_std(clean) * noise[heard, 2]
    if offset_m is None:
        distance = np.abs(distance)
    else:
        distance += offset_m[paths.step[heard], paths.anchor[heard]]
    table = {
        "step": paths.step[heard],
        "anchor": paths.anchor[heard],
        "distance_m": distance,
        "aod_rad": wrap(paths.aod_rad[heard] + np.nan_to_num(aod_std, posinf=0) * noise[heard, 3]),
        "aoa_rad": wrap(paths.aoa_rad[heard] + np.nan_to_num(aoa_std, posinf=0) * noise[heard, 4]),
        "amplitude": amplitude[heard],
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
    label = np.concatenate([heard, np.full(total, -1)])
    columns = {name: np.concatenate([table[name], false[name]]) for name in table}
    for angle, std in (("aod_rad", aod_std), ("aoa_rad", aoa_std)):  # a lone antenna measures no angle
        columns[angle][: len(heard)][~np.isfinite(std)] = np.nan
    if scene.radio.reports_std:
        columns |= _own_deviations(columns, signal, heights)
    for quantity, name in (("aod", "aod_rad"), ("aoa", "aoa_rad"), ("amplitude", "amplitude")):
        if quantity not in signal.measures:
            columns[name] = np.full(len(label), np.nan)
    order = np.lexsort((columns["distance_m"], columns["anchor"], columns["step"]))
    if signal.window_m is not None:  # what arrives outside of it isn't received
        order = order[(columns["distance_m"][order] >= first) & (columns["distance_m"][order] <= last)]
    return {name: column[order] for name, column in columns.items()}, label[order]


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
