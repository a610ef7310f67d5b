"""Paths out of sampled signals: one by one, and after each that is added, all of a snapshot refined together.

Each snapshot of each anchor stands alone. A path is kept if noise would give one as good less often than
`false_alarms` says, whatever the noise's power; deviations are those of the joint Fisher information. An
angle that the snapshot leaves open between two directions or more isn't told.
Amplitudes are held against the snapshot's strongest peak, so two paths that melt into one don't cancel.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.extraction.ambiguity import ambiguous
from gridslam.extraction.fit import Fit, amplitudes, deviations, noise_power, refine, refit
from gridslam.extraction.responses import Band, Products
from gridslam.extraction.search import strongest, surprise
from gridslam.measurements.recording import Recording
from gridslam.measurements.table import Measurements
from gridslam.world.scene import Scene
from gridslam.world.scene_parts import QUANTITIES
from gridslam.world.start import require_scene

Complex = NDArray[np.complex128]
STDS = "distance_std_m", "aod_std_rad", "aoa_std_rad"
COLUMNS = "step", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude", *STDS
BY_QUANTITY = {
    "aod": ("aod_rad", "aod_std_rad"), "aoa": ("aoa_rad", "aoa_std_rad"), "amplitude": ("amplitude",)
}  # fmt: skip
FALSE_ALARMS = 0.1
MOST_PATHS = 24
BLOCK_SAMPLES = 2**21
"""Samples of the snapshots that are worked at together."""
LEAST_LENGTH = 1e-6
ROUNDING = 1e-15
"""Noise of samples in single precision, over their mean power: the least there can be."""
BELIEVED = 16.0
"""Power that a path's amplitude is believed to have, over that of the snapshot's strongest peak: (M295)."""


def extract(
    recording: Recording,
    scene: Scene | None = None,
    *,
    false_alarms: float | None = None,
    most_paths: int = MOST_PATHS,
) -> Measurements:
    """Find the paths in sampled signals: lengths, angles and amplitudes, with deviations.

    Parameters
    ----------
    recording : Recording
        Any number of antennas. An angle is measured where the elements don't lie in one line, and given
        where no other direction explains the path nearly as well.
    scene : Scene, optional
        Gives `false_alarms`, a detection threshold, and what its radio measures: nothing else is kept. Its
        anchors must be the recording's.
    false_alarms : float, optional
        Mean number of noise peaks per anchor and step that pass for paths. Default: the scene's, or 0.1.
    most_paths : int
        Per anchor and step.

    Returns
    -------
    Measurements
        One row per path, amplitudes as square roots of the SNR, with the recording's anchors and truth.

    Raises
    ------
    InputError
        No recording, `false_alarms` isn't above 0, or the scene's anchors aren't the recording's.
    """
    if not isinstance(recording, Recording):
        found = type(recording).__name__
        raise InputError("extract", found, "a Recording, as gs.Recording.from_h5(path) returns")
    if scene is not None:
        require_scene(scene)
    rate = false_alarms if false_alarms is not None else scene.radio.false_alarms if scene else FALSE_ALARMS
    if not 0 < rate <= 10:
        raise InputError("false_alarms", str(rate), "a number above 0, at most 10")
    if scene is not None and scene.anchor_names != recording.anchors:
        raise InputError("signal: anchors", ", ".join(recording.anchors), ", ".join(scene.anchor_names))
    least = 0.0 if scene is None else 10 ** (scene.radio.detection_threshold_db / 20)
    with runtime.one_blas_thread():
        tables = [_paths_of(recording, anchor, rate, most_paths) for anchor in range(len(recording.anchors))]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    order = np.lexsort((columns["distance_m"], columns["anchor"], columns["step"]))
    order = order[columns["amplitude"][order] >= least]
    columns = {name: column[order] for name, column in columns.items()}
    measured = QUANTITIES if scene is None else scene.radio.measures
    for quantity, names in BY_QUANTITY.items():
        if quantity not in measured:
            columns |= {name: np.full(len(order), np.nan) for name in names}
    table: dict[str, Any] = {**columns, **{name: None for name in STDS if np.isnan(columns[name]).all()}}
    return Measurements(
        anchors=recording.anchors, anchor_position_m=recording.anchor_position_m,
        anchor_orientation_rad=recording.anchor_orientation_rad, interval_s=recording.interval_s,
        steps=len(recording), truth=recording.truth, time_s=recording.time_s[columns["step"]],
        **table,
    )  # fmt: skip


def _paths_of(recording: Recording, anchor: int, rate: float, most: int) -> dict[str, NDArray]:
    """Columns of one anchor's paths, of all steps."""
    band = Band(recording.waveform, anchor)
    steps = np.flatnonzero(recording.heard[:, anchor])
    tables = []
    block = max(1, BLOCK_SAMPLES // band.samples)
    for begin in range(0, len(steps), block):
        own = steps[begin : begin + block]
        samples = recording.samples[own, anchor].astype(np.complex128)
        fit = find_paths(band, samples, rate, most)
        # what is left of noiseless samples is rounding, and may fall below 0
        rounding = ROUNDING * (np.abs(samples) ** 2).mean((1, 2, 3))
        noise = np.maximum(noise_power(band, fit), rounding)
        spread = deviations(band, samples, fit, noise)
        row, column = np.nonzero(fit.there)
        values, errors = fit.paths[row, column], spread[row, column]
        unknown = ambiguous(band, samples, fit, spread, noise)[row, column]
        unknown[:, [factor for factor in (1, 2) if not band.sees(factor)]] = True
        values[unknown] = errors[unknown] = np.nan
        tables.append({
            "step": own[row],
            "anchor": np.full(len(row), anchor),
            "distance_m": np.maximum(values[:, 0], LEAST_LENGTH),
            "aod_rad": values[:, 1],
            "aoa_rad": values[:, 2],
            "amplitude": np.abs(fit.amplitude[row, column]) / np.sqrt(noise[row]),
            **dict(zip(STDS, errors.T, strict=True)),
        })  # fmt: skip
    if not tables:
        tables = [{name: np.zeros(0, int if name in ("step", "anchor") else float) for name in COLUMNS}]
    return {name: np.concatenate([table[name] for table in tables]) for name in COLUMNS}


def find_paths(band: Band, samples: Complex, rate: float, most: int = MOST_PATHS) -> Fit:
    """Paths of S snapshots (S, A, B, M) of one anchor.

    Parameters
    ----------
    rate : float
        Mean number of noise peaks per snapshot that may pass.
    """
    needed = -np.log(rate)
    fit = Fit.none(samples)
    busy = np.arange(len(samples))
    believed = np.full(len(samples), np.inf)
    most = min(most, (band.samples - 2) // (1 + len(band.free)))
    for _ in range(most):
        part, own = fit.take(busy), samples[busy]
        new = refine(band, own, part.with_path(strongest(band, own, part)), believed[busy])
        if not fit.paths.shape[1]:
            believed = BELIEVED * np.maximum(part.energy - new.energy, 1e-300)
        part = refit(band, own, replace(part, ridge=new.ridge))
        sure = surprise(band, part.energy - new.energy, new.energy, new.count) > needed
        fit = fit.put(busy[sure], new.take(sure))
        busy = busy[sure]
        if not len(busy):
            break
    return _without_weakest(band, samples, fit, believed, needed)


def _without_weakest(band: Band, samples: Complex, fit: Fit, believed: Array, needed: float) -> Fit:
    """Paths that aren't needed any longer beside those that were found after them, taken out one by one."""
    busy = np.flatnonzero(fit.count > 0)
    while len(busy):
        part, own = fit.take(busy), samples[busy]
        weakest, loss = _least_needed(band, own, part)
        doubtful = surprise(band, loss, part.energy, part.count) <= needed
        busy, part, own, weakest = busy[doubtful], part.take(doubtful), own[doubtful], weakest[doubtful]
        if not len(busy):
            break
        there = part.there.copy()
        there[np.arange(len(busy)), weakest] = False
        fewer = replace(part, there=there)
        new = refine(band, own, fewer, believed[busy])
        loss = new.energy - refit(band, own, replace(part, ridge=new.ridge)).energy
        gone = surprise(band, loss, part.energy, part.count) <= needed
        fit = fit.put(busy[gone], new.take(gone))
        busy = busy[gone]
        busy = busy[fit.count[busy] > 0]
    return refit(band, samples, fit)


def _least_needed(band: Band, samples: Complex, fit: Fit) -> tuple[NDArray[np.intp], Array]:
    """Which path (S,) leaves least energy behind if it goes, and how much (S,)."""
    products = Products.of(band, samples, fit.paths, derivatives=False)
    found, inverse, _ = amplitudes(products, fit.there, fit.ridge)
    loss = np.abs(found) ** 2 / np.einsum("sll->sl", inverse).real
    loss = np.where(fit.there, loss, np.inf)
    weakest = loss.argmin(1)
    return weakest, loss[np.arange(len(loss)), weakest]
