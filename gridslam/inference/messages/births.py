"""Births: new surfaces that measurements call for, and how they join the belief; owner of that kernel.

[Li2025adaptive], section V-B; docs/model.md, (M33), (M34).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.ray_amplitudes import Key
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives import blocks, tables
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import unit, wrap
from gridslam.world.radio import REFLECTION_BINS, RadioModel

MOST_DOUBTFUL_M = 2.0
"""A birth whose offset is less certain than this is put off until the agent knows better where it is."""
MOST_BENT = 6.0
"""Deviations by which a new line may miss its own distance or angle; one that bends too much to be
linearised, as beside an anchor, misses them by hundreds and is put off, too."""
RIVAL, RIVALS, RIVALS_UNLABELLED = 0.2, 1, 4
"""Share of a measurement's births from which on one that isn't the likeliest is followed, too; how many at
most, and where the anchor isn't known: those of one anchor come in pairs, and would leave no other's."""


@dataclass(frozen=True)
class Births:
    """B hypotheses of new surfaces, one or more per measurement.

    Attributes
    ----------
    measurement : (B,) int32
        Row of the scan.
    hit : (B, 2) int32
        Surfaces hit last and first, rows of the state; -1 for the new one, both on a single bounce.
    line : (B, 2) rad, m
        Normal angle and offset of the new surface, at the mean of the belief.
    ratio : (B,)
        I: mean number of such births over that of clutter, weighed by V of their paths; docs/model.md, (M32).
    anchor : (B,) int32
        The anchor that sent the measurement, if so.
    support : (B, BINS), optional
        By the new surface's coefficient, what earlier measurements make of it; see `faint_births`.
    seen : (B,) int64, optional
        How often it was heard before, about.
    """

    measurement: NDArray[np.int32]
    hit: NDArray[np.int32]
    line: Array
    ratio: Array
    anchor: NDArray[np.int32]
    support: Array | None = None
    seen: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.ratio)

    @classmethod
    @cache
    def none(cls) -> Births:
        """No hypotheses."""
        none = np.zeros(0, np.int32)
        return cls(none, np.zeros((0, 2), np.int32), np.zeros((0, 2)), np.zeros(0), none)

    def take(self, rows: NDArray[np.intp]) -> Self:
        """Some of them."""
        return replace(
            self, measurement=self.measurement[rows], hit=self.hit[rows], line=self.line[rows],
            ratio=self.ratio[rows], anchor=self.anchor[rows],
            support=None if self.support is None else self.support[rows],
            seen=None if self.seen is None else self.seen[rows],
        )  # fmt: skip

    def chosen(self, claimed: Array, least: float, most: int = RIVALS) -> list[tuple[int, float]]:
        """Hypotheses to follow and the existence of each new surface, surest measurement first; (M33).

        A measurement's likeliest hypothesis, and rivals that have a fair share of it: the steps to come tell
        which of them was right.

        Parameters
        ----------
        claimed : (M,)
            What the known paths send to each measurement.
        least : float
            Probability of being new below which a measurement bears nothing.
        most : int
            Rivals of a measurement.

        Returns
        -------
        list of (hypothesis, existence)
        """
        followed: list[tuple[int, float]] = []
        if not len(self):
            return followed
        by_measurement: dict[int, list[tuple[float, int]]] = {}
        for one, (m, ratio) in enumerate(zip(self.measurement.tolist(), self.ratio.tolist(), strict=True)):
            by_measurement.setdefault(m, []).append((ratio, one))
        claims, ranked = claimed.tolist(), []
        for m, hypotheses in by_measurement.items():
            total = sum(ratio for ratio, _ in hypotheses)
            ranked.append((total / (1 + total + claims[m]), total, hypotheses))
        for existence, total, hypotheses in sorted(ranked, key=lambda row: -row[0]):
            if existence < least or not total:
                break
            likeliest, *rivals = sorted(hypotheses, key=lambda pair: -pair[0])[: 1 + most]
            fair = [likeliest, *(rival for rival in rivals if rival[0] >= RIVAL * total)]
            followed += [(one, existence * ratio / total) for ratio, one in fair]
        return followed


def with_births(ratios: LikelihoodRatios, births: Births) -> LikelihoodRatios:
    """The ratios with what these births send to each measurement into the association: xi of (M25)."""
    measured = ratios.measured.copy()
    measured[tables.NEW] = 1.0 + np.bincount(births.measurement, births.ratio, measured.shape[1])
    return replace(ratios, measured=measured)


@timed("births")
def add_births(
    state: State,
    births: Births,
    scan: AnchorScan,
    exchange: Exchange,
    radio: RadioModel,
    model: FilterModel,
    shared: bool = True,
    *,
    work: Workspace,
) -> tuple[State, Exchange, list[tuple[Key, int]]]:
    """Add the new surfaces that are likely enough; docs/model.md, (M33), (M34).

    Parameters
    ----------
    radio : RadioModel
        As the radio seems to be.
    shared : bool
        Whether a surface serves all anchors, or only the one whose measurement it came from.

    Returns
    -------
    (state, exchange, bearers)
        exchange: with what was born; bearers: the ray that bore each new surface, and its measurement.
    """
    state, born, bearers = add_chosen(state, births, scan, exchange.claimed, radio, model, shared)
    return state, replace(exchange, born=born), bearers


def add_chosen(
    state: State,
    births: Births,
    scan: AnchorScan,
    claimed: Array,
    radio: RadioModel,
    model: FilterModel,
    shared: bool = True,
) -> tuple[State, Array, list[tuple[Key, int]]]:
    """As `add_births`, of measurements of which known paths claim (M,).

    Returns
    -------
    (state, born, bearers)
        born (B, 2): measurement and existence of every new surface.
    """
    bearers: list[tuple[Key, int]] = []
    born: list[tuple[int, float]] = []
    rivals = RIVALS if scan.anchor >= 0 else RIVALS_UNLABELLED
    for number, existence in births.chosen(claimed, 0.5 * model.settings.prune_below, rivals):
        belief, reflection, misfit = initialise_surface(births, number, scan, state.belief, radio, model)
        if belief.covariance[-1, -1] > MOST_DOUBTFUL_M**2 or not misfit < MOST_BENT:
            continue
        if births.support is not None:
            reflection = reflection * births.support[number]
            reflection /= reflection.sum()
        ends, anchor = births.hit[number].tolist(), int(births.anchor[number])
        bank = state.surfaces.add(
            state.next_identity,
            existence,
            reflection,
            float(belief.mean[:2] @ unit(belief.lines[-1, 0] + 0.5 * np.pi)),
            (anchor, *ends),
            -1 if shared else anchor,
            seen=0 if births.seen is None else int(births.seen[number]),
        )
        state = replace(state, belief=belief, surfaces=bank, next_identity=state.next_identity + 1)
        last, first = (int(bank.identity[s]) for s in ends)  # -1 is the last, which is the new one
        measurement = int(births.measurement[number])
        bearers.append(((anchor, last, first), measurement))
        born.append((measurement, existence))
    return state, np.array(born).reshape(-1, 2), bearers


def initialise_surface(
    births: Births, number: int, scan: AnchorScan, belief: Belief, radio: RadioModel, model: FilterModel
) -> tuple[Belief, Array, float]:
    """Belief with one hypothesis' surface appended, correlated with the agent, and corrected by the AoD.

    Returns
    -------
    (belief, reflection, misfit)
        reflection (BINS,): first belief over the new surface's coefficient, from the amplitude alone; misfit:
        by how many deviations the surface misses the distance or angle that it was made of, NaN if it isn't
        finite.
    """
    runtime.start()
    from gridslam.kernels.management.initialisation import initialise_surface as launch

    row, (last, first), size = int(births.measurement[number]), births.hit[number].tolist(), len(belief.mean)
    anchor = int(births.anchor[number])
    if max(last, first) >= len(belief.lines) or row >= len(scan) or anchor >= len(model.anchors):
        raise ValueError("a birth names a surface, measurement or anchor that doesn't exist")
    mean, covariance = np.empty(size + 2), np.empty((size + 2, size + 2))
    reflection, misfit = np.empty(len(REFLECTION_BINS)), np.empty(1)
    launch(
        belief.layout.head, anchor, row, last, first, blocks.Belief(belief.mean, belief.covariance),
        blocks.Anchors(model.places, radio.numbers), scan.table,
        blocks.Newborn(np.empty(size + 2), mean, covariance, reflection, misfit),
    )  # fmt: skip
    if np.pi < abs(mean[-2]) < np.inf:  # derivatives beside an anchor turn a line by full turns
        mean[-2] = wrap(mean[-2])
    bent = float(misfit[0]) if np.isfinite(mean).all() else np.nan
    return replace(belief, mean=mean, covariance=covariance), reflection, bent
