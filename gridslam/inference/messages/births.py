"""Births: the new surfaces that measurements need, and how they join the belief (paper 002, section V-B);
owner of that kernel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.state.anchor_measurements import Heard
from gridslam.inference.state.belief import Belief
from gridslam.world.radio import REFLECTION_BINS

Array = NDArray[np.float64]
RIVAL = 0.2
"""Share of a measurement's births from which on the second likeliest is followed, too."""


@dataclass(frozen=True)
class Births:
    """Hypotheses of new surfaces, one or more per measurement.

    Attributes
    ----------
    measurement : (B,) int32
    hit : (B, 2) int32
        Known surface hit last or first on a double bounce; -1 for the new one.
    line : (B, 2)
    ratio : (B,)
        I: mean number of such births over that of clutter, weighed by V of their paths.
    """

    measurement: NDArray[np.int32]
    hit: NDArray[np.int32]
    line: Array
    ratio: Array

    def __len__(self) -> int:
        return len(self.ratio)

    @classmethod
    @cache
    def none(cls) -> Births:
        """No hypotheses."""
        return cls(np.zeros(0, np.int32), np.zeros((0, 2), np.int32), np.zeros((0, 2)), np.zeros(0))

    def chosen(self, claimed: Array, least: float) -> list[tuple[int, float]]:
        """Hypotheses to follow and the existence of each new surface, surest measurement first.

        A measurement's likeliest hypothesis, and a rival that has a fair share of it: the steps to come tell
        which of the two was right.

        Parameters
        ----------
        claimed : (M,)
            What the known paths send to each measurement.
        least : float
            Probability of being new below which a measurement bears nothing.
        """
        followed: list[tuple[int, float]] = []
        if not len(self):
            return followed
        own: dict[int, list[tuple[float, int]]] = {}
        for one, (m, ratio) in enumerate(zip(self.measurement.tolist(), self.ratio.tolist(), strict=True)):
            own.setdefault(m, []).append((ratio, one))
        claims, ranked = claimed.tolist(), []
        for m, those in own.items():
            born = sum(ratio for ratio, _ in those)
            ranked.append((born / (1 + born + claims[m]), born, those))
        for chance, born, those in sorted(ranked, key=lambda row: -row[0]):
            if chance < least or not born:
                break
            likeliest = sorted(those, key=lambda pair: -pair[0])[:2]
            followed += [
                (one, chance * ratio / born)
                for place, (ratio, one) in enumerate(likeliest)
                if place == 0 or ratio >= RIVAL * born
            ]
        return followed


def bear(
    births: Births, number: int, heard: Heard, belief: Belief, radio: Array, anchors: Array
) -> tuple[Belief, Array]:
    """Belief with one hypothesis' surface appended, correlated with the agent, and corrected by the AoD.

    Parameters
    ----------
    radio : (11,)
        `SignalModel.radio` of the anchor.
    anchors : (J, 3)
        x, y (m) and orientation (rad).

    Returns
    -------
    (belief, reflection)
        reflection (BINS,): first belief over the new surface's coefficient, from the amplitude alone.
    """
    runtime.start()
    from gridslam.kernels.management.bearing import bear as launch

    row, (last, first), size = int(births.measurement[number]), births.hit[number].tolist(), len(belief.mean)
    if max(last, first) >= len(belief.lines) or row >= len(heard) or heard.anchor >= len(anchors):
        raise ValueError("a birth names a surface, measurement or anchor that doesn't exist")
    mean, covariance = np.empty(size + 2), np.empty((size + 2, size + 2))
    reflection = np.empty(len(REFLECTION_BINS))
    launch(
        belief.mean, belief.covariance, heard.anchor, anchors, heard.table, row, last, first, radio,
        runtime.scratch("bear", (size + 2,)), mean, covariance, reflection,
    )  # fmt: skip
    return Belief(mean, covariance), reflection
