"""Noise that isn't what the radio's would be: numbers on a raster, and lines of sight that jump about."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.columns.deviations import LEAST, MAD
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

COARSE, WIDER = 4.0, 2.0
"""Deviations of loud paths that a raster is wide, and times as far as expected that lines of sight scatter,
from which on it is told."""
LOUD, ALIKE = 0.1, 1e-3
"""Quantile of deviations that is that of loud paths; share of it by which gaps between values may differ that
count as one."""
LEVELS, STEPS = 10, 3
"""Values that a raster must have at least, and how often its step comes between them: a device that stands
still hears a few, over and over."""
ON_RASTER, ROUNDING, REPEATED = 0.98, 0.02, 1.5
"""Share of the values that are on the raster, by how much of its step they may miss it, and how often each
comes in the mean: of what isn't rounded hardly any comes twice."""
BEND = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
"""Weights of a fourth difference, which leaves next to nothing of a smooth way."""
OF_NOISE, OF_MOTION = float(np.sqrt(BEND @ BEND)), float(np.sqrt(6.0))
"""Its deviation for noise of deviation 1, and for accelerations of deviation 1 at each step: their second
differences."""


def noise(table: Columns, sight: Sight, scene: Scene) -> list[Suspicion]:
    """What of distances and angles is coarser or noisier than the radio, or their own deviations, say.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    sight : Sight
        Of that table.
    """
    found = []
    for name in ("distance_m", "aod_rad", "aoa_rad"):
        if name in table and (std := expected_std(name, table, scene)) is not None:
            found += raster(name, table, std) or jumps(name, table, std, sight, scene)
    return found


def std_name(name: str) -> str:
    """Column of a column's own deviations."""
    return name.replace("_m", "_std_m").replace("_rad", "_std_rad")


def expected_std(name: str, table: Columns, scene: Scene) -> Array | None:
    """Deviation (K,) of each value, its own or by the radio at its amplitude; NaN where neither is known.

    None for a column without any.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    """
    if (own := table.get(std_name(name))) is None:
        own = np.full(len(table["step"]), np.nan)
    radio, amplitude = scene.signal_model(), table.get("amplitude", np.full(len(own), np.nan))
    with np.errstate(divide="ignore", invalid="ignore"):
        if name == "distance_m":
            usual = radio.distance_std(amplitude)
        else:
            aperture = radio.anchor_aperture[table["anchor"]] if name == "aod_rad" else radio.agent_aperture
            usual = radio.angle_std(amplitude, table[name], aperture)
    std = np.where(np.isfinite(own), own, np.where(amplitude > 0, usual, np.nan))
    std[~np.isfinite(std) | ~np.isfinite(table[name])] = np.nan
    return None if np.count_nonzero(std > 0) < LEAST else std


def raster(name: str, table: Columns, std: Array) -> list[Suspicion]:
    """Values that are multiples of a step that is wider than what the radio resolves.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    std : (K,) array
        Deviation of each value, see `expected_std`.
    """
    values, usual = table[name][std > 0], float(np.quantile(std[std > 0], LOUD))
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > ALIKE * usual]
    if len(gaps) < LEVELS - 1 or len(values) < REPEATED * len(gaps):
        return []
    _, first, often = np.unique(np.round(gaps / (ALIKE * usual)), return_index=True, return_counts=True)
    step = float(gaps[first[np.argmax(often)]])
    turns = np.exp(2j * np.pi * values / step)
    off = np.abs(np.angle(turns * turns.mean().conj())) / (2 * np.pi)
    if step < COARSE * usual or often.max() < STEPS or (off < ROUNDING).mean() < ON_RASTER:
        return []
    own = std_name(name)
    least = f"{step / np.sqrt(12):.2g}"
    text = f"comes in steps of {in_words(name, step)}: give deviations in {own}, none of them below {least}"
    reason = f"the radio's are {in_words(name, usual)} for loud paths"
    return [Suspicion(name, "raster", text, True, reason)]


def jumps(name: str, table: Columns, std: Array, sight: Sight, scene: Scene) -> list[Suspicion]:
    """Lines of sight whose values jump from step to step by more than noise and motion make of them.

    Arrivals turn with the agent, so that little can be said of them.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    std : (K,) array
        Deviation of each value, see `expected_std`.
    sight : Sight
        Its lines of sight.
    """
    if name == "aoa_rad":
        return []
    rows = sight.row[sight.sure & (std[sight.row] > 0)]
    runs = in_a_row(table["step"][rows], table["anchor"][rows], len(BEND))
    if len(runs) < LEAST:
        return []
    values = table[name][rows][runs]
    if name != "distance_m":
        values = np.unwrap(values, axis=1)
    spread, far = std[rows][runs], table["distance_m"][rows][runs].mean(1)
    jolt = OF_MOTION * scene.filter.acceleration_mps2 * seconds(table) ** 2
    jolt = jolt / (1.0 if name == "distance_m" else np.maximum(far, 0.1))
    scatter = MAD * float(np.median(np.abs(values @ BEND))) / OF_NOISE
    likely = float(np.sqrt(np.median(((BEND * spread) ** 2).sum(1) + jolt**2))) / OF_NOISE
    if scatter < WIDER * likely:
        return []
    own = std_name(name)
    text = (
        f"{scatter / likely:.1f} times as noisy as the scene lets expect: is radio.snr_at_1m_db or "
        f"radio.bandwidth_hz too high? Or give deviations of their own in {own}"
    )
    shown = f"lines of sight scatter by {in_words(name, scatter)} from step to step"
    return [Suspicion(name, "noisy", text, False, f"{shown}, where {in_words(name, likely)} are expected")]


def in_a_row(step: NDArray[np.intp], anchor: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Rows (N, count) of one anchor at so many successive steps.

    Parameters
    ----------
    step, anchor : (M,) int
        Of the rows.
    """
    order = np.lexsort((step, anchor))
    windows = np.lib.stride_tricks.sliding_window_view(order, count) if len(order) >= count else None
    if windows is None:
        return np.zeros((0, count), np.intp)
    successive = (np.diff(step[windows], axis=1) == 1).all(1) & (np.diff(anchor[windows], axis=1) == 0).all(1)
    return windows[successive]


def seconds(table: Columns) -> float:
    """Seconds from step to step; 1 if the table has no times.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`.
    """
    if "time_s" not in table or not np.isfinite(table["time_s"]).all():
        return 1.0
    step, first = np.unique(table["step"], return_index=True)
    gaps = np.diff(table["time_s"][first]) / np.diff(step)
    return float(np.median(gaps)) if len(gaps) else 1.0


def in_words(name: str, value: float) -> str:
    """A distance in metres, or an angle in degrees."""
    return f"{value:.2g} m" if name == "distance_m" else f"{np.degrees(value):.2g} degrees"
