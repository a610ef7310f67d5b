"""What one agent's measurements say of the offset of an anchor's clock; docs/model.md, (M103)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.streams import CLOCK_CANDIDATES, CLOCK_SIGHTS
from gridslam.inference.messages.network.clock_amplitudes import NOTHING
from gridslam.inference.messages.network.clock_candidates import (
    Candidates,
    all_deviations,
    by_anchor,
    density_over_offsets,
    given_angles,
    joint_density,
    may_be_of,
    one_per_anchor,
)
from gridslam.inference.messages.network.clock_votes import Sights, sight_votes
from gridslam.inference.messages.path_prediction import predict_every_path
from gridslam.inference.scans.anchor_measurements import whole_scan
from gridslam.inference.state.network.clock_search import CELL_M
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import lean
from gridslam.world.radio import RadioModel
from gridslam.world.scan import Scan

LEAST_CHANCE = 0.1
"""Chance from which on a path of another anchor counts as what caused a measurement."""
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
    """Log evidence of one agent's measurements about some anchors' clocks, the sum over l of (M103).

    What a path of another anchor, whose clock is set, may have caused says that much less. In frames, lines
    of sight are weighed by (M497) instead, and all that nothing explains counts as clutter.

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
    believed = predict_every_path(part, model, work=work).prediction
    value, width = believed.value.copy(), believed.spread.copy()  # the next prediction takes their buffer
    paths = Candidates.of(bare, scan, model, work)
    sender, total = paths.rays.anchor, np.zeros((len(sought), len(centre)))
    telling = np.flatnonzero(paths.telling(witnessed) & sought[sender] & (paths.chance > 0))
    if not len(telling):
        return total
    of_set = np.flatnonzero(known[sender] & (paths.chance > LEAST_CHANCE))
    caused, over_walls = _by_set_clocks(paths, of_set, value, width, len(sought))
    level: float | Array = model.radio.false_alarms
    if mass is not None:
        caused = caused + _by_open_clocks(paths, telling, mass, centre)
        level = _unknown(paths.scan.label, caused, model.radio)
        lines_of_sight = one_per_anchor(paths.rays, len(sought))
        if lines_of_sight is not None:
            sights = _sights(paths, lines_of_sight, over_walls, level)
            draw = np.random.default_rng([work.seed, bare.step, CLOCK_CANDIDATES])
            total += sight_votes(bare.belief, sights, paths.scan, model, sought, known, mass, centre, draw)
            telling = telling[paths.rays.bounces[telling] > 0]
    if len(telling):
        clutter = _clutter_density(level, model.radio) + caused.sum(0) - caused
        total += by_anchor(_by_paths(paths, telling, clutter, centre), sender[telling], len(sought))
    return total


def _by_set_clocks(
    paths: Candidates, chosen: NDArray[np.intp], value: Array, spread: Array, anchors: int
) -> tuple[Array, Array]:
    """Density of measurements by paths of anchors whose clocks are set: all, and those over walls; (J, M).

    Parameters
    ----------
    value, spread : (L, 3), (L, 3, 3)
        Of all paths, as believed with their clocks.
    """
    if not len(chosen):
        nothing = np.zeros((anchors, len(paths.scan)))
        return nothing, nothing
    density = joint_density(value[chosen], spread[chosen], paths.scan.value, paths.std(chosen))
    share, sender = paths.shares(chosen, density), paths.rays.anchor[chosen]
    over_walls = share * (paths.rays.bounces[chosen, None] > 0)
    return by_anchor(share, sender, anchors), by_anchor(over_walls, sender, anchors)


def _by_open_clocks(paths: Candidates, chosen: NDArray[np.intp], mass: Array, centre: Array) -> Array:
    """Density of measurements by paths of anchors whose offsets have a mass (J, C) over cells, (J, M)."""
    sender, predicted, spread = paths.rays.anchor[chosen], paths.predicted[chosen], paths.spread[chosen]
    given = given_angles(predicted, spread, paths.scan.value, paths.std(chosen))
    return by_anchor(
        paths.shares(chosen, density_over_offsets(given, mass[sender], centre)), sender, len(mass)
    )


def _sights(paths: Candidates, direct: NDArray[np.intp], over_walls: Array, level: Array) -> Sights:
    """Lines of sight (J,) for votes; everything else is over walls of anchors (J, M), or clutter (M,)."""
    others = over_walls.sum(0) - over_walls + _clutter_density(level, paths.radio)
    chance = np.minimum(paths.chance[direct], IN_SIGHT)
    return Sights(chance, paths.std(direct), paths.able(direct), others)


def _by_paths(paths: Candidates, chosen: NDArray[np.intp], clutter: Array, centre: Array) -> Array:
    """Log evidence (K, C) of chosen paths about their clocks; `clutter` is its density by anchor, (J, M)."""
    others = np.where(paths.able(chosen), clutter[paths.rays.anchor[chosen]] / paths.ratio[chosen], np.inf)
    return clock_evidence(
        paths.predicted[chosen], paths.spread[chosen], paths.chance[chosen], paths.scan.value,
        paths.std(chosen), others, centre,
    )  # fmt: skip


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
    direct = one_per_anchor(paths.rays, len(sought))
    if direct is None:
        return np.zeros((len(sought), len(centre)))
    length, heard = paths.prediction.length[direct], work.once(whole_scan, scan, model)
    amplitude, steep = radio.amplitude(length), lean(length, np.asarray(model.anchor_heights))
    accuracy = all_deviations(heard, amplitude, paths.prediction.value[direct, 1:], steep, radio)
    level = _unknown(heard.label, np.zeros((1, len(heard))), radio)
    able = may_be_of(heard.label, np.arange(len(sought)))
    chance = IN_SIGHT * radio.detection_probability(amplitude)
    clutter = np.broadcast_to(_clutter_density(level, radio), able.shape)
    return sight_votes(
        bare.belief, Sights(chance, accuracy, able, clutter), heard, model, sought,
        np.zeros_like(sought), mass, centre, np.random.default_rng([work.seed, bare.step, CLOCK_SIGHTS]),
    )  # fmt: skip


def _clutter_density(level: float | Array, radio: RadioModel) -> Array:
    """Density of so much clutter over distance and both angles, 1 / (m rad^2)."""
    return np.asarray(level / (radio.span_m * 4 * np.pi**2))


def _unknown(labels: NDArray[np.integer[Any]], caused: Array, radio: RadioModel) -> Array:
    """How much of a kind with each measurement nobody knows the cause of, (M,): clutter, or more.

    While walls are unknown, most paths are over them.
    """
    flat = _clutter_density(radio.false_alarms, radio)
    left = flat / (flat + caused.sum(0))
    alike = labels[:, None] == labels
    return np.asarray(np.maximum(alike @ left, radio.false_alarms))


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
    shift, variance, weight = given_angles(predicted, spread, measured[known], std[:, known])
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
