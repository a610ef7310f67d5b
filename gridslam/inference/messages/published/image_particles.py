"""Messages of SLAM by virtual anchors as published: marginal beliefs by particles, of every anchor apart.

[Li2025adaptive], section VI ("REFA"), after [Leitinger2019bp] with angles and amplitudes; docs/model.md,
(M139) to (M141). A message that integrates over two beliefs takes the k-th particle of the one with the k-th
of the other, whose orders are independent ("stacked", [Li2025adaptive], section V-D).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.association import associate
from gridslam.inference.messages.published.sampling import moved_agents, resampled
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.published.feature_particles import Features, ImageState
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import direction, unit, wrap
from gridslam.world.radio import RadioModel

AMPLITUDE_WALK = 0.02
"""Of an amplitude per step, in shares of its mean ([Li2025adaptive], section VI-A)."""
LEAST_SIGHT = 0.01
"""Existence that a line of sight keeps while it is hidden."""
SUREST = 1 - 1e-7
"""Existence that none exceeds, so that no particle's weight is 0."""
SPREAD = 3.0
"""Virtual anchors are born in a rectangle with sides this many times the region's, about its middle."""
GATE = 6.0
"""Deviations beyond which a measurement isn't evaluated at a particle."""
LEAST_LOG = -300.0
UNKNOWN_LOSS = 0.7
"""Amplitude of a new path over that of free space, where amplitudes aren't measured."""


@dataclass(frozen=True, eq=False)
class Evaluated:
    """One anchor's features at all particles.

    Attributes
    ----------
    rows : (N,) int
        The anchor's features.
    ratio : (N, M, P)
        Density of each measurement under the path, with its detection, over that of clutter.
    missed : (N, P)
        1 - p_d.
    """

    rows: NDArray[np.intp]
    ratio: Array
    missed: Array


@dataclass(frozen=True, eq=False)
class Marginals:
    """What an association says of one anchor's features.

    Attributes
    ----------
    bracket : (N, P)
        sum_m nu_m g_m + 1 - p_d of every feature at every particle.
    claimed : (M,)
        What the features send to each measurement.
    """

    bracket: Array
    claimed: Array


@dataclass(frozen=True, eq=False)
class NewImages:
    """A virtual anchor for each of M measurements, as weighted particles.

    Attributes
    ----------
    odds : (M,)
        I_m, in ratio to clutter.
    logs : (M, P)
        Log weights.
    position : (M, P, 2) m
    amplitude : (M, P)
    """

    odds: Array
    logs: Array
    position: Array
    amplitude: Array


def move(state: ImageState, time_s: float, model: FilterModel, draw: np.random.Generator) -> ImageState:
    """Move all particles, and let features fade ([Li2025adaptive], section VI-A)."""
    known, settings = state.features, model.settings
    agent = state.agent
    if state.time_s is not None:
        agent = moved_agents(agent, time_s - state.time_s, model, draw)
    free = np.where(known.fixed, 0.0, 2 * settings.surface_m)[:, None, None]
    position = known.position + free * draw.standard_normal(known.position.shape)
    walk = AMPLITUDE_WALK * known.intensity.mean(-1, keepdims=True)
    amplitude = np.abs(known.intensity + walk * draw.standard_normal(known.intensity.shape))
    existence = np.minimum(settings.survival * known.existence, SUREST)
    existence = np.where(known.fixed, np.maximum(existence, LEAST_SIGHT), existence)
    features = replace(known, position=position, intensity=amplitude, existence=existence)
    return replace(state, agent=agent, features=features, time_s=time_s)


def path_values(agent: Array, place: Array, fixed: NDArray[np.bool_], anchor: Array) -> Array:
    """Distance (m), AoD and AoA (rad) of paths over virtual anchors or in sight, docs/model.md, (M5), (M6).

    Parameters
    ----------
    agent : (P, 5)
    place : (N, P, 2) m
        Of virtual anchors, or of the anchor itself where `fixed`.
    fixed : (N,) bool
    anchor : (3,)
        Position (m) and orientation (rad).

    Returns
    -------
    (3, N, P)
    """
    toward = place - agent[:, :2]
    arrival = np.arctan2(toward[..., 1], toward[..., 0])
    normal = direction(anchor[:2], place)
    departure = np.where(fixed[:, None], arrival + np.pi, 2 * normal - arrival)
    distance = np.hypot(toward[..., 0], toward[..., 1])
    return np.stack([distance, wrap(departure - anchor[2]), wrap(arrival - agent[:, 4])])


def evaluate_images(state: ImageState, scan: AnchorScan, radio: RadioModel, anchor: Array) -> Evaluated:
    """All features of an anchor (3,) at all particles: [Li2025adaptive], eqs. (19), (20)."""
    rows = np.flatnonzero(state.features.anchor == scan.anchor)
    own = state.features.take(rows)
    values = path_values(state.agent, own.position, own.fixed, anchor)
    missed = 1 - detection_table(radio)(own.intensity)
    ratio = np.zeros((len(rows), len(scan), len(state.agent)))
    clutter = np.log(radio.false_alarms) + radio.log_clutter(scan.amplitude)
    every = np.arange(len(scan))
    for n in range(len(rows)):
        level = np.full(len(scan), own.intensity[n].mean())
        angles = np.angle(np.exp(1j * values[1:, n]).mean(-1))
        std = deviations(scan, every, level, np.tile(angles, (len(scan), 1)), radio)
        for m in every:
            at, logs = _fits(values[:, n], scan.value[m], std[m])
            if len(at):
                strength = amplitude_factor(scan.amplitude[m], own.intensity[n, at], missed[n, at], radio)
                ratio[n, m, at] = np.exp(logs + strength - clutter[m])
    return Evaluated(rows, ratio, missed)


def amplitude_factor(measured: float, amplitude: Array, missed: Array, radio: RadioModel) -> Array:
    """Log of detection times density of a measured amplitude (NaN: none) at particles (P,)."""
    if np.isnan(measured):
        return np.log(np.maximum(1 - missed, np.exp(LEAST_LOG)))
    return radio.log_rician(np.asarray(measured), np.maximum(amplitude, 1e-3))


def _fits(values: Array, measured: Array, std: Array) -> tuple[NDArray[np.intp], Array]:
    """Particles near a measurement, and the log of its Gaussian density there.

    Parameters
    ----------
    values : (3, P)
    measured, std : (3,)
        Infinite deviations where nothing was measured.
    """
    at, logs = np.arange(values.shape[1]), np.zeros(values.shape[1])
    for kind in np.flatnonzero(np.isfinite(std)):
        off = measured[kind] - values[kind, at]
        off = (wrap(off) if kind else off) / std[kind]
        near = np.abs(off) < GATE
        at, off, logs = at[near], off[near], logs[near]
        logs = logs - 0.5 * off**2 - np.log(std[kind] * np.sqrt(2 * np.pi))
    # in angles that weren't measured a path is as uniform as clutter
    return at, logs - np.log(2 * np.pi) * np.isinf(std[1:]).sum()


def associate_images(state: ImageState, seen: Evaluated, new: NewImages) -> Marginals:
    """Loopy belief propagation over one anchor's features and measurements, (M26)."""
    existence = state.features.existence[seen.rows]
    beta = existence[:, None] * seen.ratio.mean(-1)
    missed = np.maximum(1 - existence * (1 - seen.missed.mean(-1)), 1e-9)
    nu, claimed = associate(beta, missed, 1 + new.odds)
    bracket = np.einsum("nm,nmp->np", nu, seen.ratio) + seen.missed
    return Marginals(bracket, claimed)


def agent_logs(state: ImageState, seen: Evaluated, found: Marginals) -> Array:
    """Log of one anchor's message to the agent (P,), [Li2025adaptive], supporting document, (32) to (34)."""
    existence = state.features.existence[seen.rows][:, None]
    return np.asarray(np.log(existence * found.bracket + 1 - existence).sum(0))


def updated_images(
    state: ImageState, seen: Evaluated, found: Marginals, draw: np.random.Generator
) -> Features:
    """The anchor's features after its measurements, resampled: supporting document, (37) to (39), (63)."""
    own, count = state.features.take(seen.rows), len(state.agent)
    mean = found.bracket.mean(-1)
    odds = own.existence * mean
    existence = odds / (odds + 1 - own.existence)
    picks = np.zeros((len(own), count), np.int64)
    for n in range(len(own)):
        picks[n] = draw.permutation(resampled(np.log(np.maximum(found.bracket[n], 1e-300)), draw))
    every = np.arange(len(own))[:, None]
    return replace(
        own, existence=existence, position=own.position[every, picks], intensity=own.intensity[every, picks]
    )


def propose_images(
    state: ImageState, scan: AnchorScan, radio: RadioModel, model: FilterModel, draw: np.random.Generator
) -> NewImages:
    """A virtual anchor where each measurement says, from the agent's particles: (31) of the document.

    Distance, AoA and amplitude are drawn from their densities, so that AoD, amplitude and the area of a
    particle are left as its weight.
    """
    count, several = len(state.agent), len(scan)
    anchor, side = model.anchors[scan.anchor], np.array(model.grid.shape) * model.grid.cell_m
    level = np.where(
        np.isnan(scan.amplitude), radio.amplitude(scan.value[:, 0], UNKNOWN_LOSS), scan.amplitude
    )
    std = deviations(scan, np.arange(several), level, scan.value[:, 1:], radio)
    rate = np.log(model.settings.births) - np.log(SPREAD**2 * side.prod())
    base = rate - np.log(radio.false_alarms) - radio.log_clutter(scan.amplitude)
    logs, place = np.empty((several, count)), np.empty((several, count, 2))
    amplitude = np.empty((several, count))
    for m in range(several):
        value = scan.value[m]
        distance = np.abs(value[0] + std[m, 0] * draw.standard_normal(count))
        bearing = draw.uniform(-np.pi, np.pi, count)
        if np.isfinite(std[m, 2]):
            bearing = state.agent[:, 4] + value[2] + std[m, 2] * draw.standard_normal(count)
        amplitude[m] = np.abs(level[m] + radio.amplitude_std(level[m]) * draw.standard_normal(count))
        place[m] = state.agent[:, :2] + distance[:, None] * unit(bearing)
        logs[m] = base[m] + np.log(distance)
        missed = 1 - detection_table(radio)(amplitude[m])
        logs[m] += amplitude_factor(scan.amplitude[m], amplitude[m], missed, radio)
        if np.isfinite(std[m, 1]):
            aod = path_values(state.agent, place[m][None], np.zeros(1, bool), anchor)[1, 0]
            off = wrap(value[1] - aod) / std[m, 1]
            logs[m] += -0.5 * off**2 - np.log(std[m, 1] * np.sqrt(2 * np.pi))
        else:
            logs[m] -= np.log(2 * np.pi)
    odds = np.exp(np.minimum(logs, 300.0)).mean(-1)
    return NewImages(odds, logs, place, amplitude)


def born_images(
    state: ImageState, scan: AnchorScan, new: NewImages, found: Marginals, model: FilterModel,
    draw: np.random.Generator,
) -> Features:  # fmt: skip
    """New virtual anchors that are likely enough to be kept: supporting document, (46), (47).

    Parameters
    ----------
    new : NewImages
        What `propose_images` makes of the scan's M measurements.
    found : Marginals
        What the association says the known features claim of them.

    Returns
    -------
    Features
        At most M, of P particles each, drawn by weight, numbered from `state.next_identity` on.
    """
    existence = new.odds / (1 + new.odds + found.claimed)
    rows = np.flatnonzero(existence > model.settings.prune_below)
    count, size = len(state.agent), len(rows)
    picks = np.zeros((size, count), np.int64)
    for number, m in enumerate(rows):
        picks[number] = draw.permutation(resampled(new.logs[m], draw))
    every = rows[:, None]
    return Features(
        state.next_identity + np.arange(size), np.full(size, scan.anchor, np.int64), np.zeros(size, bool),
        existence[rows], new.position[every, picks], new.amplitude[every, picks],
    )  # fmt: skip


def resample_agent(state: ImageState, logs: Array, draw: np.random.Generator) -> ImageState:
    """The agent by the product of all messages to it: supporting document, (61)."""
    return replace(state, agent=state.agent[resampled(logs, draw)])


def pruned(features: Features, least: float) -> Features:
    """Features that are still likely enough, and all lines of sight."""
    return features.take(features.fixed | (features.existence > least))
