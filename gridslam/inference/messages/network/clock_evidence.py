"""What one agent's measurements say of the offset of an anchor's clock; docs/model.md, (M103)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.network.clock_amplitudes import NOTHING, amplitude_ratio
from gridslam.inference.messages.network.clock_votes import Sights, sight_votes
from gridslam.inference.messages.path_prediction import predict_every_path
from gridslam.inference.scans.anchor_measurements import AnchorScan, deviations, whole_scan
from gridslam.inference.state.network.clock_search import CELL_M
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import lean, wrap
from gridslam.world.radio import REFLECTION_BINS, RadioModel
from gridslam.world.scan import Scan

TURN_DENSITY = 1 / (2 * np.pi)
ANY_DIRECTION = 2 * np.pi
"""Variance of an angle of residual 0 whose normal density is that of any angle at all."""
SURE_SURFACE = 0.9
"""Existence from which on a surface's single bounces tell of clocks, too."""
LEAST_CHANCE = 0.1
"""Chance from which on a path of another anchor counts as what caused a measurement."""
PURPOSE, PURPOSE_OF_SIGHTS = 9, 10
"""Of random numbers: with all paths, and with lines of sight alone."""
IN_SIGHT = 0.5
"""Chance of a line of sight at most, where agents' clocks are wide: what says otherwise is mostly a guess."""


def agent_evidence(
    bare: State,
    part: State,
    sought: NDArray[np.bool_],
    known: NDArray[np.bool_],
    witnessed: NDArray[np.bool_],
    centre: Array,
    scan: Scan,
    model: FilterModel,
    work: Workspace,
    mass: Array | None = None,
) -> Array:
    """Log evidence of one agent's measurements about some anchors' clocks.

    What a path of another anchor, whose clock is set, may have caused says that much less.

    Parameters
    ----------
    bare, part : State
        The agent's view without the clocks that are sought, and as believed.
    sought, known : (J,) bool
        Anchors whose clocks are sought, and set.
    witnessed : (S,) bool
        Surfaces of which single bounces may tell of clocks.
    centre : (C,) m
        Offsets.
    mass : (J, C), optional
        Of the offsets that are sought. If it is told, they may have caused a measurement as well, and so may
        as much that is unknown as measurements are left over.

    Returns
    -------
    (J, C)
    """
    radio = model.radio
    believed = predict_every_path(part, model, work=work).prediction
    value, width = believed.value.copy(), believed.spread.copy()  # the next prediction takes their buffer
    paths = predict_every_path(bare, model, work=work)
    rays, length, predicted = paths.rays, paths.prediction.length, paths.prediction.value
    strength = np.append(bare.surfaces.reflection @ REFLECTION_BINS, 1.0)[rays.last]
    amplitude = radio.amplitude(length, strength)
    chance = rays.existence * rays.surfaces * radio.detection_probability(amplitude)
    over_sure = (rays.surfaces > SURE_SURFACE) & np.append(witnessed, True)[rays.last]
    sure = (rays.bounces == 0) | ((rays.bounces == 1) & over_sure)
    anchor_scan = work.once(whole_scan, scan, model)
    steep = lean(length, np.asarray(model.anchor_heights)[rays.anchor])
    spread = paths.prediction.spread
    ratio = amplitude_ratio(anchor_scan.amplitude, amplitude, radio)

    def accuracy(chosen: NDArray[np.intp]) -> Array:
        return _deviations(anchor_scan, amplitude[chosen], predicted[chosen, 1:], steep[chosen], radio)

    caused = over_walls = np.zeros((len(sought), len(anchor_scan)))
    rows = np.flatnonzero(known[rays.anchor] & (chance > LEAST_CHANCE))
    if len(rows):
        density = joint_density(value[rows], width[rows], anchor_scan.value, accuracy(rows))
        may = (anchor_scan.label < 0) | (anchor_scan.label == rays.anchor[rows, None])
        share = np.where(may, chance[rows, None] * ratio[rows] * density, 0.0)
        caused = by_anchor(share, rays.anchor[rows], len(sought))
        over_walls = by_anchor(share * (rays.bounces[rows, None] > 0), rays.anchor[rows], len(sought))
    mine = np.flatnonzero(sure & sought[rays.anchor] & (chance > 0))
    level: float | Array = radio.false_alarms
    total = np.zeros((len(sought), len(centre)))
    if mass is not None and len(mine):
        given = _given_angles(predicted[mine], spread[mine], anchor_scan.value, accuracy(mine))
        may = (anchor_scan.label < 0) | (anchor_scan.label == rays.anchor[mine, None])
        share = chance[mine, None] * ratio[mine] * _over_offsets(given, mass[rays.anchor[mine]], centre)
        caused += by_anchor(np.where(may, share, 0.0), rays.anchor[mine], len(sought))
        level = _unknown(anchor_scan.label, caused, radio)
        direct = np.flatnonzero(rays.bounces == 0)
        direct = direct[np.argsort(rays.anchor[direct])]
        if len(direct) == len(sought):
            flat = level / (radio.span_m * 4 * np.pi**2)
            over = over_walls.sum(0) - over_walls + flat
            able = (anchor_scan.label < 0) | (anchor_scan.label == np.arange(len(sought))[:, None])
            sights = Sights(np.minimum(chance[direct], IN_SIGHT), accuracy(direct), able, over)
            total += sight_votes(
                bare.belief, sights, anchor_scan, model, sought, known, mass, centre,
                np.random.default_rng([work.seed, bare.step, PURPOSE]),
            )  # fmt: skip
            mine = mine[rays.bounces[mine] > 0]
    clutter = level / (radio.span_m * 4 * np.pi**2) + caused.sum(0) - caused
    if len(mine):
        sender = rays.anchor[mine]
        able = (anchor_scan.label < 0) | (anchor_scan.label == sender[:, None])
        others = np.where(able, clutter[sender] / ratio[mine], np.inf)
        each = clock_evidence(
            predicted[mine], spread[mine], chance[mine], anchor_scan.value, accuracy(mine), others, centre
        )
        total += by_anchor(each, sender, len(sought))
    return total


def sights_evidence(
    bare: State,
    sought: NDArray[np.bool_],
    mass: Array,
    centre: Array,
    scan: Scan,
    model: FilterModel,
    work: Workspace,
) -> Array:
    """Log evidence of one agent's lines of sight about some anchors' clocks, whatever was mapped; (M531).

    Arguments and value (J, C) are those of `agent_evidence`; all that isn't a line of sight counts as
    unknown.
    """
    radio, paths = model.radio, predict_every_path(bare, model, work=work)
    direct = np.flatnonzero(paths.rays.bounces == 0)
    direct = direct[np.argsort(paths.rays.anchor[direct])]
    if len(direct) != len(sought):
        return np.zeros((len(sought), len(centre)))
    length, heard = paths.prediction.length[direct], work.once(whole_scan, scan, model)
    amplitude, steep = radio.amplitude(length), lean(length, np.asarray(model.anchor_heights))
    accuracy = _deviations(heard, amplitude, paths.prediction.value[direct, 1:], steep, radio)
    level = _unknown(heard.label, np.zeros((1, len(heard))), radio)
    flat = level / (radio.span_m * 4 * np.pi**2)
    able = (heard.label < 0) | (heard.label == np.arange(len(sought))[:, None])
    chance = IN_SIGHT * radio.detection_probability(amplitude)
    clutter = np.broadcast_to(flat, able.shape)
    return sight_votes(
        bare.belief, Sights(chance, accuracy, able, clutter), heard, model, sought,
        np.zeros_like(sought), mass, centre, np.random.default_rng([work.seed, bare.step, PURPOSE_OF_SIGHTS]),
    )  # fmt: skip


def _over_offsets(given: tuple[Array, Array, Array], mass: Array, centre: Array) -> Array:
    """Density of measurements by paths whose clock's offset has a mass (L, C) over cells, (L, M)."""
    shift, variance, weight = given
    normal = np.exp(-0.5 * (centre - shift[..., None]) ** 2 / variance[..., None])
    return np.asarray(
        weight * (normal * mass[:, None]).sum(-1) / np.sqrt(2 * np.pi * (variance + CELL_M**2 / 12))
    )


def _unknown(labels: NDArray[np.integer[Any]], caused: Array, radio: RadioModel) -> Array:
    """How much of a kind with each measurement nobody knows the cause of, (M,): clutter, or more.

    While walls are unknown, most paths are over them.
    """
    flat = radio.false_alarms / (radio.span_m * 4 * np.pi**2)
    left = flat / (flat + caused.sum(0))
    alike = labels[:, None] == labels
    return np.asarray(np.maximum(alike @ left, radio.false_alarms))


def by_anchor(value: Array, sender: NDArray[np.integer[Any]], anchors: int) -> Array:
    """Sums (J, ...) of the rows of each anchor's paths."""
    return np.array([value[sender == anchor].sum(0) for anchor in range(anchors)])


def clock_evidence(
    predicted: Array, spread: Array, chance: Array, measured: Array, std: Array, clutter: Array, centre: Array
) -> Array:
    """Log evidence of one agent's measurements about the offset of each path's anchor's clock.

    Over its paths l and the measurements m, ``sum_l log(1 - c_l + sum_m c_l r_lm N(angles of m)
    N(distance of m; d_l + beta | angles) / (mu f))``, with c the probability that path l is there and
    detected. Angles and amplitude recognise the path; what the angles say of the pose is taken into its
    length.

    Parameters
    ----------
    predicted : (L, 3)
        Distance (m, without the anchor's clock), AoD and AoA (rad) of paths.
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
        says for the path, see `amplitude_ratio`; infinite for a measurement that isn't of its anchor.
    centre : (C,) m
        Offsets beta.

    Returns
    -------
    (L, C)
        That of an anchor is the sum over its paths.
    """
    known = np.isfinite(measured[:, 0])
    shift, variance, weight = _given_angles(predicted, spread, measured[known], std[:, known])
    variance = variance + CELL_M**2 / 12
    height = chance[:, None] * weight / clutter[:, known] / np.sqrt(2 * np.pi * variance)
    nothing = NOTHING * (1 - chance[:, None])
    supported = height > nothing
    path, late, width, height = (
        np.nonzero(supported)[0],
        shift[supported],
        2 * variance[supported],
        height[supported],
    )
    reach = np.sqrt(width * np.log(height / np.broadcast_to(nothing, supported.shape)[supported]))
    begin, end = np.searchsorted(centre, late - reach), np.searchsorted(centre, late + reach, "right")
    pair = np.repeat(np.arange(len(path)), end - begin)
    cell = np.arange(len(pair)) - np.repeat(np.cumsum(end - begin) - end, end - begin)
    density = height[pair] * np.exp(-((centre[cell] - late[pair]) ** 2) / width[pair])
    caused = np.bincount(path[pair] * len(centre) + cell, density, len(chance) * len(centre))
    return np.asarray(np.log(1 - chance[:, None] + caused.reshape(len(chance), -1)))


def joint_density(predicted: Array, spread: Array, measured: Array, std: Array) -> Array:
    """Density of measurements (M, 3) over distance and both angles, had one of L paths caused them, (L, M).

    Parameters
    ----------
    predicted, spread, measured, std
        As of `clock_evidence`; 0 where no distance was measured.
    """
    known = np.isfinite(measured[:, 0])
    density = np.zeros((len(predicted), len(measured)))
    shift, variance, weight = _given_angles(predicted, spread, measured[known], std[:, known])
    density[:, known] = weight * np.exp(-0.5 * shift**2 / variance) / np.sqrt(2 * np.pi * variance)
    return density


def _given_angles(value: Array, own: Array, measured: Array, deviation: Array) -> tuple[Array, Array, Array]:
    """Distance left over given the angles, its variance, and the angles' density, (L, M) each."""
    residual = measured - value[:, None]
    residual[..., 1:] = wrap(residual[..., 1:])
    missing = ~(np.isfinite(measured[:, 1:]) & np.isfinite(deviation[..., 1:]))
    turn, twist = np.where(missing, 0.0, residual[..., 1:]).transpose(2, 0, 1)
    noise = np.square(deviation)
    # joint covariance of the distance, one angle and the other; an angle without measurement has its own
    one = np.where(missing[..., 0], ANY_DIRECTION, own[:, 1, 1, None] + noise[..., 1])
    other = np.where(missing[..., 1], ANY_DIRECTION, own[:, 2, 2, None] + noise[..., 2])
    both = np.where(missing.any(-1), 0.0, own[:, 1, 2, None])
    near = np.where(missing[..., 0], 0.0, own[:, 0, 1, None])
    far = np.where(missing[..., 1], 0.0, own[:, 0, 2, None])
    size = one * other - both**2
    first, last = (near * other - far * both) / size, (far * one - near * both) / size
    shift = first * turn + last * twist
    variance = own[:, 0, 0, None] + noise[..., 0] - first * near - last * far
    exponent = (turn**2 * other - 2 * turn * twist * both + twist**2 * one) / size
    weight = TURN_DENSITY * np.exp(-0.5 * exponent) / np.sqrt(size)
    return residual[..., 0] - shift, variance, weight


def _deviations(scan: AnchorScan, amplitude: Array, angles: Array, steep: Array, radio: RadioModel) -> Array:
    """Deviations (L, M, 3) of all measurements, if paths of these amplitudes and angles caused them."""
    paths, count = len(amplitude), len(scan)
    every, each = np.tile(np.arange(count), paths), np.repeat(np.arange(paths), count)
    return deviations(scan, every, amplitude[each], angles[each], radio, steep[each]).reshape(paths, count, 3)
