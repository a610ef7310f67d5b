"""What one agent's measurements say of the offset of an anchor's clock; docs/model.md, (M103)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.likelihood import deviations
from gridslam.inference.messages.prediction import EVERY_ANCHOR, predict_paths
from gridslam.inference.state.anchor_measurements import AnchorScan, of_all_anchors
from gridslam.inference.state.clock_search import CELL_M
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import lean, wrap
from gridslam.world.radio import REFLECTION_BINS, RadioModel
from gridslam.world.scan import Scan

TURN_DENSITY = 1 / (2 * np.pi)
UNMEASURED = 2 * np.pi
"""Variance of an angle of residual 0 whose normal density is that of any angle at all."""
SURE_SURFACE = 0.9
"""Existence from which on a surface's single bounces tell of clocks, too."""
LIKELY = 0.1
"""Chance from which on a path of another anchor counts as what caused a measurement."""
LEVEL_SHARE, WEAKENED = 0.12, 0.02
"""Deviation of a path's amplitude from what its length makes it (1 dB), and share of those far off it."""


def agent_evidence(
    bare: State,
    part: State,
    sought: NDArray[np.bool_],
    known: NDArray[np.bool_],
    centre: Array,
    scan: Scan,
    model: FilterModel,
    work: Workspace,
) -> Array:
    """Log evidence of one agent's measurements about some anchors' clocks.

    What a path of another anchor, whose clock is set, may have caused says that much less.

    Parameters
    ----------
    bare, part : State
        The agent's view without the clocks that are sought, and as believed.
    sought, known : (J,) bool
        Anchors whose clocks are sought, and set.
    centre : (C,) m
        Offsets.

    Returns
    -------
    (J, C)
    """
    radio = model.radio
    believed = predict_paths(part, EVERY_ANCHOR, model, work=work).prediction
    value, width = believed.value.copy(), believed.spread.copy()  # the next prediction takes their buffer
    paths = predict_paths(bare, EVERY_ANCHOR, model, work=work)
    rays, length, predicted = paths.rays, paths.prediction.length, paths.prediction.value
    level = np.append(bare.surfaces.reflection @ REFLECTION_BINS, 1.0)[rays.last]
    amplitude = radio.amplitude(length, level)
    chance = rays.existence * rays.surfaces * radio.detection_probability(amplitude)
    sure = (rays.bounces == 0) | ((rays.bounces == 1) & (rays.surfaces > SURE_SURFACE))
    heard, total = of_all_anchors(scan, radio.threshold), np.zeros((len(sought), len(centre)))
    steep = lean(length, np.asarray(model.anchor_heights)[rays.anchor])
    ratio = amplitude_ratio(heard.amplitude, amplitude, radio)
    spread = paths.prediction.spread

    def accuracy(row: np.intp) -> Array:
        return _deviations(heard, amplitude[row], predicted[row, 1:], steep[row], radio)

    caused = np.zeros((len(sought), len(heard)))
    for row in np.flatnonzero(known[rays.anchor] & (chance > LIKELY)):
        density = joint_density(value[row], width[row], heard.value, accuracy(row))
        may = (heard.label < 0) | (heard.label == rays.anchor[row])
        caused[rays.anchor[row]] += np.where(may, chance[row] * ratio[row] * density, 0.0)
    clutter = radio.false_alarms / (radio.span_m * 4 * np.pi**2) + caused.sum(0) - caused
    for anchor in np.flatnonzero(sought):
        mine = np.flatnonzero(sure & (rays.anchor == anchor))
        able = (heard.label < 0) | (heard.label == anchor)
        if len(mine):
            own = np.array([accuracy(row)[able] for row in mine])
            total[anchor] = clock_evidence(
                predicted[mine], spread[mine], chance[mine], heard.value[able], own,
                clutter[anchor, able] / ratio[mine][:, able], centre,
            )  # fmt: skip
    return total


def clock_evidence(
    predicted: Array, spread: Array, chance: Array, measured: Array, std: Array, clutter: Array, centre: Array
) -> Array:
    """Log evidence of one agent's measurements about the offset of one anchor's clock.

    Over its paths l and the measurements m, ``sum_l log(1 - c_l + sum_m c_l r_lm N(angles of m)
    N(distance of m; d_l + beta | angles) / (mu f))``, with c the probability that path l is there and
    detected. Angles and amplitude recognise the path; what the angles say of the pose is taken into its
    length.

    Parameters
    ----------
    predicted : (L, 3)
        Distance (m, without the anchor's clock), AoD and AoA (rad) of the anchor's paths.
    spread : (L, 3, 3)
        Their covariance by the belief, without that clock.
    chance : (L,)
        c.
    measured : (M, 3)
        NaN where not measured.
    std : (L, M, 3)
        Deviations, if path l caused m.
    clutter : (L, M)
        mu f / r: density of clutter over distance and both angles, 1 / (m rad^2), by what the amplitude
        says for the path, see `amplitude_ratio`.
    centre : (C,) m
        Offsets beta.

    Returns
    -------
    (C,)
    """
    total = np.zeros(len(centre))
    heard = np.isfinite(measured[:, 0])
    for value, own, c, deviation, other in zip(predicted, spread, chance, std, clutter, strict=True):
        if not c:
            continue
        shift, variance, weight = _given_angles(value, own, measured[heard], deviation[heard])
        variance = variance + CELL_M**2 / 12
        far = centre[:, None] - shift
        density = np.exp(-0.5 * far**2 / variance) / np.sqrt(2 * np.pi * variance)
        total += np.log(1 - c + c * (density @ (weight / other[heard])))
    return total


def joint_density(predicted: Array, spread: Array, measured: Array, std: Array) -> Array:
    """Density of measurements (M, 3) over distance and both angles, had one path caused them, (M,).

    Parameters
    ----------
    predicted, spread, measured, std
        As of `clock_evidence`, for one path; 0 where no distance was measured.
    """
    density, heard = np.zeros(len(measured)), np.isfinite(measured[:, 0])
    shift, variance, weight = _given_angles(predicted, spread, measured[heard], std[heard])
    density[heard] = weight * np.exp(-0.5 * shift**2 / variance) / np.sqrt(2 * np.pi * variance)
    return density


def _given_angles(value: Array, own: Array, measured: Array, deviation: Array) -> tuple[Array, Array, Array]:
    """Distance left over given the angles, its variance, and the angles' density, (M,) each."""
    residual = measured - value
    residual[:, 1:] = wrap(residual[:, 1:])
    joint = np.broadcast_to(own, (len(measured), 3, 3)).copy()
    joint += np.square(deviation)[:, :, None] * np.eye(3)
    for angle in (1, 2):
        missing = ~(np.isfinite(measured[:, angle]) & np.isfinite(deviation[:, angle]))
        joint[missing, angle], joint[missing, :, angle] = 0.0, 0.0
        joint[missing, angle, angle], residual[missing, angle] = UNMEASURED, 0.0
    inverse = np.linalg.inv(joint[:, 1:, 1:])
    cross = np.einsum("mi,mij->mj", joint[:, 0, 1:], inverse)
    shift = (cross * residual[:, 1:]).sum(1)
    variance = joint[:, 0, 0] - (cross * joint[:, 0, 1:]).sum(1)
    exponent = np.einsum("mi,mij,mj->m", residual[:, 1:], inverse, residual[:, 1:])
    weight = TURN_DENSITY * np.sqrt(np.linalg.det(inverse)) * np.exp(-0.5 * exponent)
    return residual[:, 0] - shift, variance, weight


def amplitude_ratio(measured: Array, expected: Array, radio: RadioModel) -> Array:
    """What amplitudes say for paths of known strength, against any amplitude up to twice theirs.

    A reflection may well have a line of sight's angles, but hardly its strength. One path in fifty counts as
    weakened by something unknown, so that no amplitude rules a path out.

    Parameters
    ----------
    measured : (M,)
        NaN where not measured.
    expected : (L,)

    Returns
    -------
    (L, M)
    """
    level = np.asarray(expected)[:, None]
    deviation = np.hypot(radio.amplitude_std(level), LEVEL_SHARE * level)
    density = np.exp(-0.5 * ((measured - level) / deviation) ** 2) / (np.sqrt(2 * np.pi) * deviation)
    return np.where(np.isnan(measured), 1.0, WEAKENED + (1 - WEAKENED) * 2 * level * density)


def _deviations(heard: AnchorScan, amplitude: float, angles: Array, steep: float, radio: RadioModel) -> Array:
    """Deviations (M, 3) of all measurements, if a path of this amplitude and these angles caused them."""
    count = len(heard)
    every = np.arange(count)
    return deviations(heard, every, np.full(count, amplitude), np.tile(angles, (count, 1)), radio, steep)
