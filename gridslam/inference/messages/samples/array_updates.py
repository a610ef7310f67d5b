"""Existence, coefficients and messages by a snapshot of arrays; docs/model.md, (M152), (M155)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.health.monitor import NO_FIT
from gridslam.inference.messages.cells import RAYS
from gridslam.inference.messages.detections import hits_of, latest_hits, with_hits
from gridslam.inference.messages.samples.array_paths import Snapshot, SnapshotLikelihood, log_amplitudes
from gridslam.inference.scans.anchor_measurements import LOUD
from gridslam.inference.state.polylines import Polylines
from gridslam.inference.state.presence import Presence
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels import (
    CAUSED,
    FREEDOM,
    GAIN,
    GAIN_PRECISION,
    LEAST_PARTICLES,
    LEAST_SENDING,
    LOUD_ONES,
    MISFIT,
    SUMS,
)
from gridslam.kernels.primitives.blocks import Coefficients, Drawn
from gridslam.world.radio import BINS, REFLECTION_BINS
from gridslam.world.signal_model import SignalModel

STAY = 0.97
"""Chance that a path is as it was, open and there or not; else the grid and its ray say what it is."""
SUREST = 1e-7
"""Doubt that is always left."""
TELLING = 0.1
"""Information, in ratio to the prior's, from which on a direction of the state tells how well all fits."""
WORST = 30.0
"""Normalised innovation squared, of one direction, at which it is cut off."""


@dataclass(frozen=True, eq=False)
class SnapshotExchange:
    """What one anchor's snapshot says.

    Attributes
    ----------
    anchor : int
    fit : (1, 9)
        See `gridslam.kernels.SUMS`.
    log_evidence : float
        Log density of the samples, at the mode.
    """

    anchor: int
    fit: Array
    log_evidence: float

    effective_sample_size = np.inf

    @classmethod
    def silent(cls, anchor: int) -> SnapshotExchange:
        """Of an anchor that wasn't heard."""
        return cls(anchor, NO_FIT[None].copy(), 0.0)


@timed("updates")
def update_existence(
    state: State, snapshot: Snapshot, likelihood: SnapshotLikelihood, *, work: Workspace
) -> State:
    """Rays and surfaces by the worth of their paths, (M30), (M31), and the messages that cells will get."""
    rays, open_, worth = snapshot.rays, snapshot.open_, np.exp(likelihood.log_worth)
    bank, los, anchor = state.surfaces, state.los.copy(), snapshot.anchor
    single, double = bank.single.copy(), bank.double.copy()
    there, both = rays.existence, rays.surfaces * open_
    ahead = there * (both * worth + 1 - both)
    after = ahead / (ahead + 1 - there)
    whole = there * open_ * (worth - 1) + 1
    direct, once, twice = (rays.bounces == number for number in range(3))
    los[anchor] = after[direct][0]
    single[anchor, rays.last[once]] = after[once]
    double[anchor, rays.last[twice], rays.first[twice]] = after[twice]
    log = np.zeros(len(bank))
    np.add.at(log, rays.last[once], np.log(np.maximum(whole[once], 1e-12)))
    for own, other in ((rays.last, rays.first), (rays.first, rays.last)):
        known = bank.existence[other[twice]]
        np.add.at(log, own[twice], np.log(np.maximum(known * whole[twice] + 1 - known, 1e-12)))
    odds = np.log(np.maximum(bank.existence, 1e-12)) - np.log(np.maximum(1 - bank.existence, 1e-9))
    existence = np.minimum(expit(np.clip(odds + log, -40.0, 40.0)), 1 - SUREST)

    belief, chance = rays.surfaces * there, snapshot.chance
    factor = np.column_stack([belief * worth + 1 - belief, belief > LEAST_SENDING])
    share = chance * worth / (chance * worth + 1 - chance)
    summary = np.stack([rays.surfaces, there * open_, share, snapshot.length])
    work.messages.append(rays.table, factor, summary, (len(bank), len(los)))
    bank = replace(bank, existence=existence, single=single, double=double)
    return replace(state, surfaces=bank, los=los)


def exchange_of(snapshot: Snapshot, likelihood: SnapshotLikelihood, model: SignalModel) -> SnapshotExchange:
    """How well a snapshot fitted, and what the line of sight says of the gain of amplitudes."""
    mode, fit = likelihood.found.mode, np.zeros((1, SUMS))
    value, vector = np.linalg.eigh(mode.information)
    telling = value > TELLING
    moved = np.square(vector.T @ mode.shift)[telling] * (1 + 1 / value[telling])
    fit[0, [MISFIT, FREEDOM]] = np.minimum(moved, WORST).sum(), telling.sum()
    amplitude = np.sqrt(likelihood.matched) / likelihood.own
    loud = snapshot.radio.threshold**2 + LOUD
    count = np.count_nonzero((likelihood.matched / likelihood.own > loud) & (snapshot.chance > 0.5))
    fit[0, [CAUSED, LOUD_ONES]] = count, count + np.count_nonzero(likelihood.found.new.amplitude**2 > loud)
    fit[0, LEAST_PARTICLES] = np.inf
    if snapshot.rays.bounces[0] == 0 and snapshot.chance[0] > 0.5 and not snapshot.fades:
        level = model.radio.amplitude_at_1m / float(snapshot.length[0])
        variance = 0.5 / likelihood.own[0]
        measured = float(np.sqrt(max(amplitude[0] ** 2 - variance, 0.0)))
        if measured > 2 * snapshot.radio.threshold:
            fit[0, [GAIN, GAIN_PRECISION]] = level * measured / variance, level**2 / variance
    return SnapshotExchange(snapshot.anchor, fit, mode.paths.log_density)


@timed("cells")
def update_coefficients_by_ratios(
    state: State, drawn: Polylines, listened: list[tuple[Snapshot, SnapshotLikelihood]],
    model: SignalModel, *, work: Workspace,
) -> State:  # fmt: skip
    """Learn coefficients of surfaces and cells from a step's snapshots, and where surfaces were hit (M155).

    Parameters
    ----------
    drawn : Polylines
        The paths of the step's messages, as cast at sampled states.
    listened : list
        Snapshots and their likelihoods, in the order of the messages.
    """
    runtime.start()
    from gridslam.kernels.propagation.coefficients import learn_ratios

    messages, bank, belief, grid = work.messages, state.surfaces, state.belief, state.require_grid()
    surfaces = len(bank)
    if messages.among[0] > surfaces or len(belief.lines) != surfaces:
        raise ValueError("messages or belief aren't of these surfaces")
    usual = bank.reflection @ REFLECTION_BINS
    presence = (state.presence or Presence.none(len(state.los))).of(bank.identity)
    ratios, chance = [], presence.chance
    for snapshot, likelihood in listened:
        own, chance[snapshot.anchor] = coefficient_ratios(
            snapshot, likelihood, usual, chance[snapshot.anchor]
        )
        ratios.append(own)
    ratio = np.concatenate(ratios)
    reflection, hits = bank.reflection.copy(), hits_of(bank)
    row, used = grid.row.copy(), np.array([len(grid.hit)], np.int32)
    hit = np.empty((len(grid.hit) + 2 * drawn.count * RAYS, BINS), np.float32)
    hit[: len(grid.hit)] = grid.hit
    latest = work.buffers(latest_hits, 0, surfaces)
    learn_ratios(
        belief.layout.head, belief.mean, ratio, work.require_cells().frame_of_messages, model.places,
        Drawn(drawn.drawn, drawn.seen), messages.block(),
        Coefficients(reflection, row, hit, used, usual, latest), hits,
    )  # fmt: skip
    bank = replace(with_hits(bank, hits), reflection=reflection)
    return replace(
        state, surfaces=bank, presence=presence, grid=replace(grid, row=row, hit=hit[: int(used[0])].copy())
    )


def coefficient_ratios(
    snapshot: Snapshot, likelihood: SnapshotLikelihood, usual: Array, before: Array
) -> tuple[Array, Array]:
    """Log-likelihoods over the coefficients at the last and the first hit of every path (M155).

    Parameters
    ----------
    usual : (S,)
        Mean coefficient of each surface, for the other hit of a double bounce.
    before : (S, BINS)
        Chance that each single bounce was there at the snapshot before; -1 for new ones.

    Returns
    -------
    (ratio, after)
        ratio (L, 2, BINS); after (S, BINS): the chances now.
    """
    rays, after = snapshot.rays, before.copy()
    free_space = snapshot.radio.amplitude_at_1m / snapshot.length
    chance = np.tile(np.clip(rays.existence * snapshot.open_, 1e-12, 1 - 1e-9)[:, None], BINS)
    once = np.flatnonzero(rays.bounces == 1)
    earlier = before[rays.last[once]]
    chance[once] = np.where(earlier < 0, chance[once], STAY * earlier + (1 - STAY) * chance[once])
    ratio = np.zeros((len(rays), 2, BINS))
    for corner, other in enumerate((rays.first, rays.last)):
        rest = np.where(rays.bounces == 2, usual[other] if len(usual) else 1.0, 1.0)
        level = (free_space * rest)[:, None] * REFLECTION_BINS
        log = log_amplitudes(likelihood.matched, likelihood.own, level, snapshot.fades)
        there = np.log(chance) + log
        ratio[:, corner] = np.logaddexp(there, np.log1p(-chance))
        if corner == 0:
            after[rays.last[once]] = np.exp(there - ratio[:, corner])[once]
    return ratio, np.clip(after, -1.0, 1 - SUREST)
