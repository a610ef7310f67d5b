"""Management of surfaces: duplicates merge into the older one, the unlikely are pruned; owner of the kernel
that finds duplicates."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief, keep, update
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.management.ghosts import drop_ghosts
from gridslam.inference.messages.motion import BEYOND_DOUBT
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.kernels import LIKELIER_THAN_NOT
from gridslam.world.filter_model import FilterModel, detected, fixed
from gridslam.world.filter_settings import FilterSettings

MOST_SURFACES = 24
TIE = fixed(np.array([1e-4, 1e-6]))
"""Variances of gap (m^2) and turn (rad^2) between two lines that are one."""
BY_CHANCE = 0.1
"""Lines that would lie where another does if one of the two didn't exist, per m and rad."""
CONFIRMED = ((60, 8), (25, 6), (5, 2))
"""Ages from which on a surface must have been seen so often; docs/model.md, (M574), as the next ones."""
ON_TRIAL, TRIAL_AGE, TRIAL_SEEN = 0.3, 3, 3
"""Existence that a surface needs at least from this age on, until it was seen so often."""


def prune(
    bank: SurfaceBank, belief: Belief, threshold: float, most: int | None = MOST_SURFACES
) -> tuple[SurfaceBank, Belief]:
    """Drop unlikely surfaces: [Li2026grid], section III-F; docs/model.md, (M574).

    A birth must be confirmed by detections soon, and the number may be bounded. Without
    confirmation a false birth hides: once its rays are believed blocked, no miss counts against it.
    """
    rows = zip(bank.existence.tolist(), bank.age.tolist(), bank.seen.tolist(), strict=True)
    passes = [
        existence >= (max(threshold, ON_TRIAL) if age >= TRIAL_AGE and seen < TRIAL_SEEN else threshold)
        and seen >= next((least for after, least in CONFIRMED if age >= after), 0)
        for existence, age, seen in rows
    ]
    if all(passes) and (most is None or len(passes) <= most):
        return bank, belief
    good = np.array(passes)
    if most is not None and good.sum() > most:
        order = np.argsort(-bank.existence * good, kind="stable")
        good = np.zeros(len(bank), dtype=bool)
        good[order[:most]] = True
    return bank.take(good), keep(belief, good)


def known_apart(bank: SurfaceBank, exchanges: Sequence[Exchange]) -> NDArray[np.bool_]:
    """Which pairs of surfaces are two, however well their lines agree, (S, S); docs/model.md, (M481).

    A line sends one single bounce from an anchor, so two that each caused a measurement of one scan are two.
    And of two that were seen often, one that walks has come from elsewhere: that it agrees now says little.

    Parameters
    ----------
    exchanges : sequence of Exchange
        Of the step's anchors.
    """
    often, walks = bank.seen >= BEYOND_DOUBT, bank.walk.max(1) > 0
    apart = (often[:, None] & often) & (walks[:, None] | walks)
    for exchange in exchanges:
        path, share = exchange.rays.table, exchange.responsible
        row, measurement = np.nonzero((share > LIKELIER_THAN_NOT) & (path[:, :1] == 1))
        surface, anchor = path[row, 1], path[row, 3]
        one, other = np.nonzero((anchor[:, None] == anchor) & (measurement[:, None] != measurement))
        apart[surface[one], surface[other]] = True
    return apart


def merge(
    bank: SurfaceBank, belief: Belief, apart: Callable[[], NDArray[np.bool_]] | None = None
) -> tuple[SurfaceBank, Belief]:
    """Merge duplicates into the older surface by the joint belief that both are one line.

    Two lines are one when they agree, within their joint covariance plus a centimetre, in angle and in
    offset at the place where the younger was hit. What that says of all else counts as far as both exist:
    docs/model.md, (M513). One that was born at this step tells nothing of one that was there before: its
    measurement may have come over that, and the association has said how likely.

    Parameters
    ----------
    apart : callable, optional
        Gives the pairs that are known to be two, (S, S) bool, as `known_apart`. It is asked where lines agree
        alone, as at most steps none do.
    """
    if belief.layout.surfaces != len(bank):
        raise ValueError("belief and bank don't hold the same surfaces")
    two = np.zeros((len(bank), len(bank)), bool)
    older, younger, tie = _alike(bank, belief, two)
    if older >= 0 and apart is not None:
        two = apart()
        older, younger, tie = _alike(bank, belief, two)
    while older >= 0:
        news = bank.age[younger] > 0 or bank.age[older] == 0
        if news:  # else what bore it was held against the older one's paths already
            belief = _tied(bank, belief, older, younger, tie)
        rest = np.arange(len(bank)) != younger
        bank, belief = _united(bank, older, younger).take(rest), keep(belief, rest)
        either = two[older] | two[younger]
        two = two.copy()
        two[older], two[:, older] = either, either
        two = np.ascontiguousarray(two[rest][:, rest])
        older, younger, tie = _alike(bank, belief, two)
    return bank, belief


def _tied(bank: SurfaceBank, belief: Belief, older: int, younger: int, tie: Array) -> Belief:
    """The belief that two lines are one, as far as both surfaces exist; (M513)."""
    jacobian, line = np.zeros((2, len(belief.mean))), belief.layout.line
    jacobian[:, line(older)], jacobian[:, line(younger)] = tie[:, :2], tie[:, 2:4]
    both = both_exist(float(bank.existence[older] * bank.existence[younger]), belief, jacobian, tie[:, 4])
    return update(belief, jacobian, tie[None, :, 4], TIE[None], np.array([both]))


def both_exist(apart: float, belief: Belief, jacobian: Array, residual: Array) -> float:
    """Probability that two surfaces exist whose lines agree as they do, from that without looking, (M513)."""
    spread = jacobian @ belief.covariance @ jacobian.T + np.diag(TIE)
    square = float(residual @ np.linalg.solve(spread, residual))
    likely = math.exp(-0.5 * square) / (2 * math.pi * math.sqrt(np.linalg.det(spread)))
    return apart * likely / (apart * likely + (1 - apart) * BY_CHANCE)


def _alike(bank: SurfaceBank, belief: Belief, two: NDArray[np.bool_]) -> tuple[int, int, Array]:
    """Two surfaces whose lines agree and that may be one, and their tie (2, 5); -1 if there are none."""
    found, tie = np.empty(2, np.int32), np.empty((2, 5))
    _finding()(
        belief.mean, belief.covariance, belief.layout.head, bank.foot, bank.owner, two.view(np.uint8),
        found, tie,
    )  # fmt: skip
    older, younger = found.tolist()
    return older, younger, tie


def are_one(older: Array, younger: Array, covariance: Array, foot: float) -> bool:
    """Whether two lines are one, as `merge` tells it of those of one belief.

    Parameters
    ----------
    older, younger : (2,)
        Angle (rad) and offset (m).
    covariance : (4, 4)
        Of the older one, then the younger.
    foot : float, m
        Tangential coordinate of the younger one's latest hit.
    """
    mean, joint = np.zeros(AGENT + 4), np.zeros((AGENT + 4, AGENT + 4))
    mean[AGENT:], joint[AGENT:, AGENT:] = np.concatenate([older, younger]), covariance
    found, all_anchors = np.empty(2, np.int32), np.full(2, -1)
    _finding()(
        mean, joint, AGENT, np.array([0.0, foot]), all_anchors, np.zeros((2, 2), np.uint8), found,
        np.empty((2, 5)),
    )  # fmt: skip
    return bool(found[0] >= 0)


def _united(bank: SurfaceBank, older: int, younger: int) -> SurfaceBank:
    """The bank with the better of two surfaces' records in the older one's place."""
    existence, seen, single = bank.existence.copy(), bank.seen.copy(), bank.single.copy()
    double, extent = bank.double.copy(), bank.extent.copy()
    existence[older] = max(existence[older], existence[younger])
    seen[older] = max(seen[older], seen[younger])
    single[:, older] = np.maximum(single[:, older], single[:, younger])
    double[:, older] = np.maximum(double[:, older], double[:, younger])
    double[:, :, older] = np.maximum(double[:, :, older], double[:, :, younger])
    angles = bank.angles.copy()
    angles[older] += angles[younger]
    forms = bank.forms.copy()
    if not forms[older].any():
        forms[older] = forms[younger]
    outermost, both = bank.outermost.copy().reshape(-1, 2, 4), np.array([older, younger])
    for side, beyond in enumerate((-1.0, 1.0)):
        farthest = both[np.argmax(np.nan_to_num(beyond * extent[both, side], nan=-np.inf))]
        extent[older, side], outermost[older, side] = extent[farthest, side], outermost[farthest, side]
    return replace(
        bank, existence=existence, seen=seen, single=single, double=double, extent=extent,
        outermost=outermost.reshape(-1, 8), angles=angles, forms=forms,
    )  # fmt: skip


def merge_and_prune(
    state: State, model: FilterModel, most: int | None = MOST_SURFACES, by_ratio: bool = False,
    exchanges: Sequence[Exchange] = (), departs: bool = True,
) -> State:  # fmt: skip
    """Merge duplicates, drop ghosts and the unlikely; docs/model.md, (M513), (M574).

    Parameters
    ----------
    most : int, optional
        How many surfaces are kept at most; None where others are parked.
    by_ratio : bool
        How ghosts are told: see `drop_ghosts`.
    exchanges : sequence of Exchange
        Of the step's anchors, if surfaces that they show to be two aren't to be merged.
    departs : bool
        Whether the step told departures; that those before did is known of the state.
    """
    apart = partial(known_apart, state.surfaces, exchanges)
    bank, belief = merge(state.surfaces, state.belief, apart)
    if model.max_bounces > 1:
        departs = departs or state.calibration.turns_told
        bank, belief = drop_ghosts(bank, belief, model.anchor_positions[: model.senders], by_ratio, departs)
    before = bank
    bank, belief = prune(bank, belief, model.settings.prune_below, most)
    monitor = state.monitor
    if most is not None and len(bank) == most < len(before):
        monitor = replace(monitor, dropped=dropped(before, bank, model.settings))
    return replace(state, surfaces=bank, belief=belief, monitor=monitor)


def dropped(before: SurfaceBank, after: SurfaceBank, settings: FilterSettings) -> int:
    """How many surfaces that were believed in are no longer there."""
    gone = ~np.isin(before.identity, after.identity)
    return int(np.count_nonzero(gone & detected(before.existence, settings)))


@runtime.once_started
def _finding() -> Any:
    """The kernel that finds duplicates."""
    from gridslam.kernels.management.merging import find_duplicates

    return find_duplicates
