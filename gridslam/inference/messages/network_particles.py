"""Messages of network SLAM as published: every agent, clock and virtual anchor by itself.

[Venus2025network], sections IV and V, with the slips mended that docs/differences.md lists; docs/model.md,
(M143) to (M145). Equations without a key are that paper's. What two beliefs share is integrated by pairing
their particles, orders being independent; over a clock, which is one number, by a histogram.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.association import associate
from gridslam.inference.messages.direct_particles import resampled
from gridslam.inference.messages.image_particles import GATE, SPREAD, moved_agents, path_values
from gridslam.inference.messages.likelihood import deviations
from gridslam.inference.state.anchor_measurements import AnchorScan
from gridslam.inference.state.feature_particles import Features
from gridslam.inference.state.network_particles import CLOCK, NetworkParticleState
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit, wrap
from gridslam.world.network_model import NetworkModel
from gridslam.world.radio import RadioModel
from gridslam.world.scan import Scan

FEW = 1e-3
"""Existence below which a virtual anchor is dropped, section VI."""
CELLS = 10.0
"""Cells of a clock's histogram per deviation of a measured distance."""
GIVEN = 0.5
"""Probability from which on a measurement counts as one anchor's."""


@dataclass(frozen=True, eq=False)
class Heard:
    """One pair of a feature and a measurement, where angles fit: particles, and what they say.

    Attributes
    ----------
    feature, measurement : int
    at : (N,) int
        Particles of agent and feature whose angles fit.
    weight : (N,)
        p_d times the density of the angles over that of clutter, at these.
    late : (N,) m
        What is left of the measured distance, the anchor's clock offset if all else is right.
    std : float, m
        Of the measured distance.
    """

    feature: int
    measurement: int
    at: NDArray[np.intp]
    weight: Array
    late: Array
    std: float


@dataclass(frozen=True, eq=False)
class NetworkRatios:
    """All anchors' lines of sight and virtual anchors, F of them, at all particles of one agent.

    Attributes
    ----------
    anchor : (F,) int
        Whose each is; the first J are lines of sight.
    existence : (F,)
        1 for lines of sight.
    missed : float
        1 - p_d.
    pairs : sequence of Heard
    ratio : (F, M, P)
        Likelihood ratios (17), (18), with the clocks integrated out.
    """

    anchor: NDArray[np.int64]
    existence: Array
    missed: float
    pairs: Sequence[Heard]
    ratio: Array


@dataclass(frozen=True, eq=False)
class NetworkBirths:
    """For M measurements and J anchors, a virtual anchor that would be new, as weighted particles.

    Attributes
    ----------
    odds : (M, J)
        I_mj, in ratio to clutter.
    logs : (M, J, P)
    position : (M, J, P, 2) m
    """

    odds: Array
    logs: Array
    position: Array


@dataclass(frozen=True, eq=False)
class NetworkMarginals:
    """What one agent's association says.

    Attributes
    ----------
    nu : (F, M)
        Messages from measurements to features.
    bracket : (F, P)
        sum_m nu_m g_m + 1 - p_d of every feature.
    claimed : (M,)
        What the features send to each measurement.
    given : (M,) int
        The anchor that each measurement is believed to be of; -1 for clutter and doubt.
    """

    nu: Array
    bracket: Array
    claimed: Array
    given: NDArray[np.intp]


def move_network(
    state: NetworkParticleState, time_s: float, scans: Sequence[Scan | None], model: NetworkModel,
    draw: np.random.Generator,
) -> NetworkParticleState:  # fmt: skip
    """Move all particles, and let virtual anchors fade, (12), (13)."""
    here = np.array([scan is not None for scan in scans])
    if state.time_s is None:
        return replace(state, time_s=time_s, here=here)
    dt, settings = time_s - state.time_s, model.settings
    agents, walk = state.agents.copy(), model.clocks.walk_m * np.sqrt(dt)
    for number, own in enumerate(model.agents):
        if here[number] and state.here[number]:
            agents[number, :, :CLOCK] = moved_agents(agents[number, :, :CLOCK], dt, own, draw)
    free = ~model.clocks.known
    anchors = len(state.clocks)
    clocks = state.clocks + walk * free[:anchors, None] * draw.standard_normal(state.clocks.shape)
    agents[:, :, CLOCK] += walk * free[anchors:, None] * draw.standard_normal(agents.shape[:2])
    known = state.features
    position = known.position + 2 * settings.surface_m * draw.standard_normal(known.position.shape)
    features = replace(known, position=position, existence=settings.survival * known.existence)
    return replace(state, agents=agents, clocks=clocks, features=features, time_s=time_s, here=here)


def evaluate_network(
    state: NetworkParticleState, agent: int, heard: AnchorScan, model: FilterModel
) -> NetworkRatios:
    """All features of all anchors at one agent's particles, (3) to (7), (17), (18)."""
    known, own, radio = state.features, state.agents[agent], model.radio
    anchors, count = len(model.anchors), len(own)
    whose = np.concatenate([np.arange(anchors), known.anchor])
    existence = np.concatenate([np.ones(anchors), known.existence])
    several, missed = len(heard), 1 - detection(radio)
    std, base = measured_deviations(heard, radio), np.log1p(-missed) - log_clutter(heard, radio)
    ratio, pairs = np.zeros((len(whose), several, count)), list[Heard]()
    for f, anchor in enumerate(whose.tolist()):
        sight = f < anchors
        fixed = np.broadcast_to(model.anchor_positions[anchor], (1, count, 2))
        place = fixed if sight else known.position[f - anchors][None]
        values = path_values(own[:, :CLOCK], place, np.array([sight]), model.anchors[anchor])[:, 0]
        middle = np.angle(np.exp(1j * values[1:]).mean(-1))
        off = wrap(values[1:] - middle[:, None])
        for m in np.flatnonzero((heard.label < 0) | (heard.label == anchor)):
            at, logs = _angles_fit(middle, off, heard.value[m, 1:], std[m, 1:])
            if not len(at):
                continue
            late = heard.value[m, 0] - values[0, at] + own[at, CLOCK]
            pair = Heard(f, int(m), at, np.exp(logs + base[m]), late, float(std[m, 0]))
            ratio[f, m, at] = pair.weight * blurred(state.clocks[anchor], None, late, pair.std)
            pairs.append(pair)
    return NetworkRatios(whose, existence, missed, pairs, ratio)


def blurred(at: Array, weight: Array | None, where: Array, std: float) -> Array:
    """Mean over all points (N,) of weight times a Gaussian about each, where asked (K,): by a fine histogram.

    Parameters
    ----------
    weight : (N,), optional
        1 if it isn't given.
    """
    reach, cell = GATE * std, std / CELLS
    near = (at > where.min() - reach) & (at < where.max() + reach)
    inside = at[near]
    if not len(inside):
        return np.zeros(len(where))
    own = np.ones(len(inside)) if weight is None else weight[near]
    first = inside.min() - reach - 2 * cell
    size = int((inside.max() + reach - first) / cell) + 3
    place = (inside - first) / cell
    low = place.astype(np.int64)
    share = place - low
    table = np.bincount(low, own * (1 - share), size) + np.bincount(low + 1, own * share, size)
    taps = np.arange(-int(GATE * CELLS), int(GATE * CELLS) + 1) / CELLS
    kernel = np.exp(-0.5 * taps**2) / (std * np.sqrt(2 * np.pi))
    smooth = (
        np.convolve(table, kernel, mode="same") if size >= len(kernel) else np.convolve(kernel, table, "same")
    )
    grid = first + cell * np.arange(len(smooth))
    return np.interp(where, grid, smooth, 0.0, 0.0) / len(at)


def propose_network(
    state: NetworkParticleState, agent: int, heard: AnchorScan, model: FilterModel, draw: np.random.Generator
) -> NetworkBirths:
    """New virtual anchors of every measurement and anchor, (8), (20), (23)."""
    own, radio, anchors = state.agents[agent], model.radio, model.anchors
    count, several, labels = len(own), len(heard), len(anchors)
    side = np.array(model.grid.shape) * model.grid.cell_m
    std = measured_deviations(heard, radio)
    base = np.log(model.settings.births) - np.log(SPREAD**2 * side.prod()) - log_clutter(heard, radio)
    logs = np.full((several, labels, count), -np.inf)
    position = np.zeros((several, labels, count, 2))
    for m in range(several):
        told = int(heard.label[m])
        bearing = own[:, 4] + heard.value[m, 2] + std[m, 2] * draw.standard_normal(count)
        if not np.isfinite(std[m, 2]):
            bearing = draw.uniform(-np.pi, np.pi, count)
        measured = heard.value[m, 0] + std[m, 0] * draw.standard_normal(count) + own[:, CLOCK]
        for j in range(labels) if told < 0 else (told,):
            distance = measured - state.clocks[j]
            position[m, j] = own[:, :2] + np.maximum(distance, 1e-3)[:, None] * unit(bearing)
            value = path_values(own[:, :CLOCK], position[m, j][None], np.zeros(1, bool), anchors[j])[1, 0]
            aod = _log_gaussian(wrap(heard.value[m, 1] - value), std[m, 1])
            possible = distance > 0
            share = 0.0 if told >= 0 else np.log(labels)
            logs[m, j, possible] = base[m] - share + np.log(distance[possible]) + aod[possible]
    return NetworkBirths(np.exp(logs).mean(-1), logs, position)


def associate_network(seen: NetworkRatios, new: NetworkBirths) -> NetworkMarginals:
    """One loopy belief propagation over all anchors' features and all measurements, (21)."""
    beta = seen.existence[:, None] * seen.ratio.mean(-1)
    missed = np.maximum(1 - seen.existence * (1 - seen.missed), 1e-9)
    nu, claimed = associate(beta, missed, 1 + new.odds.sum(1))
    bracket = np.einsum("fm,fmp->fp", nu, seen.ratio) + seen.missed
    share = beta * nu / (missed + (beta * nu).sum(1))[:, None]
    given = np.full(share.shape[1], -1, np.intp)
    if share.size:
        by_anchor = np.zeros((int(seen.anchor.max()) + 1, share.shape[1]))
        np.add.at(by_anchor, seen.anchor, share)
        given = np.where(by_anchor.max(0) > GIVEN, by_anchor.argmax(0), -1).astype(np.intp)
    return NetworkMarginals(nu, bracket, claimed, given)


def update_network(
    state: NetworkParticleState, agent: int, seen: NetworkRatios, found: NetworkMarginals,
    draw: np.random.Generator,
) -> NetworkParticleState:  # fmt: skip
    """Agent, clocks and virtual anchors after an agent's association, each with the others integrated out."""
    anchors, exists = len(state.clocks), seen.existence[:, None]
    agents = state.agents.copy()
    logs = np.log(exists * found.bracket + 1 - exists).sum(0)
    agents[agent] = agents[agent][resampled(logs, draw)]
    clocks = state.clocks.copy()
    clock_logs = clock_messages(state, seen, found)
    for j in range(anchors):
        if np.ptp(clock_logs[j]) > 0 and np.ptp(clocks[j]) > 0:
            clocks[j] = clocks[j][draw.permutation(resampled(clock_logs[j], draw))]
    known, own = state.features, found.bracket[anchors:]
    position = known.position.copy()
    for row in range(len(known)):
        if np.ptp(own[row]) > 0:
            position[row] = position[row][draw.permutation(resampled(np.log(own[row]), draw))]
    odds = known.existence * own.mean(-1)
    features = replace(known, position=position, existence=odds / (odds + 1 - known.existence))
    return replace(state, agents=agents, clocks=clocks, features=features)


def clock_messages(state: NetworkParticleState, seen: NetworkRatios, found: NetworkMarginals) -> Array:
    """Logs of the messages to the anchors' clocks, (J, P): agent and virtual anchors integrated out."""
    count = state.clocks.shape[1]
    bracket = np.full((len(seen.anchor), count), seen.missed)
    for pair in seen.pairs:
        nu = found.nu[pair.feature, pair.measurement]
        beta = state.clocks[seen.anchor[pair.feature]]
        # the particles whose angles don't fit count in the mean, with weight 0
        mean = blurred(pair.late, pair.weight, beta, pair.std) * len(pair.at) / count
        bracket[pair.feature] += nu * mean
    exists = seen.existence[:, None]
    logs = np.zeros(state.clocks.shape)
    np.add.at(logs, seen.anchor, np.log(exists * bracket + 1 - exists))
    return logs


def add_network_births(
    state: NetworkParticleState, new: NetworkBirths, found: NetworkMarginals, draw: np.random.Generator
) -> NetworkParticleState:
    """The state with new virtual anchors that are likely enough, (24) to (26), without unlikely ones."""
    existence = new.odds / (1 + new.odds.sum(1) + found.claimed)[:, None]
    rows, labels = np.nonzero(existence > FEW)
    size, count = len(rows), state.clocks.shape[1]
    place = np.empty((size, count, 2))
    for number, (m, j) in enumerate(zip(rows.tolist(), labels.tolist(), strict=True)):
        place[number] = new.position[m, j][draw.permutation(resampled(new.logs[m, j], draw))]
    born = Features(
        state.next_identity + np.arange(size), labels.astype(np.int64), np.zeros(size, bool),
        existence[rows, labels], place, np.zeros((size, count)),
    )  # fmt: skip
    kept = state.features.take(state.features.existence > FEW)
    return replace(state, features=kept.joined(born), next_identity=state.next_identity + size)


def detection(radio: RadioModel) -> float:
    """p_d of every path: given, or that of a path of 10 m ([Venus2025network] has one for all)."""
    return float(radio.detection_probability(np.asarray(radio.amplitude(10.0))))


def measured_deviations(heard: AnchorScan, radio: RadioModel) -> Array:
    """Deviations (M, 3) that came with the measurements, or by measured amplitudes; infinite for none."""
    level = np.where(np.isnan(heard.amplitude), radio.amplitude(10.0), heard.amplitude)
    return deviations(heard, np.arange(len(heard)), level, heard.value[:, 1:], radio)


def log_clutter(heard: AnchorScan, radio: RadioModel) -> Array:
    """Log of mu_fp f_fp over distance and angles, (M,)."""
    return np.log(radio.false_alarms) + radio.log_clutter(np.full(len(heard), np.nan))


def _angles_fit(middle: Array, off: Array, measured: Array, std: Array) -> tuple[NDArray[np.intp], Array]:
    """Particles whose AoD and AoA are near measured ones (2,), and the log of their density there.

    Parameters
    ----------
    middle, off : (2,), (2, P)
        The angles' mean directions, and how far each particle is from them.
    """
    at, logs = np.arange(off.shape[1]), np.zeros(off.shape[1])
    for kind in (0, 1):
        if np.isinf(std[kind]):
            logs = logs - np.log(2 * np.pi)
            continue
        turn, own = float(wrap(measured[kind] - middle[kind])), off[kind, at]
        gap = turn - own
        if abs(turn) + np.abs(own).max(initial=0.0) > np.pi:
            gap = wrap(gap)
        near = np.abs(gap) < GATE * std[kind]
        at, logs = at[near], logs[near] + _log_gaussian(gap[near], std[kind])
    return at, logs


def _log_gaussian(off: Array, std: float) -> Array:
    """Log density of a measured angle's error; uniform if it wasn't measured."""
    if np.isinf(std):
        return np.full(len(off), -np.log(2 * np.pi))
    return np.asarray(-0.5 * (off / std) ** 2 - np.log(std * np.sqrt(2 * np.pi)))
