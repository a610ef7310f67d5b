"""Ghosts: surfaces that a double bounce bore while its walls weren't known.

A double bounce has the virtual anchor of a single bounce at some other line. Heard before its walls are known
it bears a surface there, which lives on beside them: once they explain what is heard, its silence is laid
to an obstacle. So a surface yields to a pair of surer ones that makes the same virtual anchor and was seen
more often: in all, or, where samples tell faint paths from none, and the surface is silent and older than one
of the pair, in ratio to their ages. (Peaks don't: true walls of `hall` out of sight would go.) Without
departures both predict the very same, and share what is heard: how often doesn't count then.

Owner of the kernel that finds them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief, keep
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.kernels import OFTENER, REPLACES, SEEN_ELSEWHERE


def drop_ghosts(
    bank: SurfaceBank, belief: Belief, places: Array, by_ratio: bool = False, departs: bool = True
) -> tuple[SurfaceBank, Belief]:
    """Drop the surfaces that are ghosts of double bounces over surer surfaces.

    Parameters
    ----------
    places : (J, 2) m
        The anchors; of the bank's rays, the first J are theirs.
    by_ratio : bool
        Whether sightings in ratio to ages count, too.
    departs : bool
        Whether departures tell double bounces from others.
    """
    if belief.layout.surfaces != len(bank) or len(places) > len(bank.single):
        raise ValueError("surfaces or anchors don't belong together")
    often = sorted(bank.seen.tolist())
    if len(often) < 3 or often[-2] < REPLACES:
        return bank, belief  # no two that were seen often
    head, single = belief.layout.head, bank.single[: len(places)]
    by_ratio = by_ratio and bool(single.max(0).min() < SEEN_ELSEWHERE)
    least = float(OFTENER) if departs else 0.0
    if often[-2] <= least * often[0] and not by_ratio:
        return bank, belief  # none that was seen much less often, and none that is silent
    ghost = np.empty(len(bank), np.int32)
    age = bank.age if by_ratio else np.zeros(len(bank))
    _finding()(
        belief.mean, belief.covariance, head, bank.existence, bank.seen, age, single, places, least, ghost
    )  # fmt: skip
    if not ghost.any():
        return bank, belief
    return bank.take(ghost == 0), keep(belief, ghost == 0)


@runtime.once_started
def _finding() -> Any:
    """The kernel that finds them."""
    from gridslam.kernels.management.merging import find_ghosts

    return find_ghosts
