"""Ghosts: surfaces that a double bounce bore while its walls weren't known.

A double bounce has the virtual anchor of a single bounce at some other line. Heard before its walls are known
it bears a surface there, which lives on beside them: once they explain what is heard, its silence is laid
to an obstacle. So a surface yields to a pair of surer ones that makes the same virtual anchor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import mirror, mirror_derivative, unit
from gridslam.inference.belief import AGENT, Belief, keep, slots
from gridslam.inference.surfaces import Bank

Array = NDArray[np.float64]
SURE, OFTEN, SHARP_M = 0.9, 10, 0.1
"""Existence, detections and deviation of the offset from which on a surface may take another's place."""
OFTENER = 2
"""How many times as often as the ghost each of the two was seen: a ghost goes silent when they are found."""
HEARD_ELSEWHERE = 0.3
"""Existence of another anchor's ray at which a surface isn't a ghost."""
NEAR_M, SLACK_M, GATE = 0.5, 0.02, 9.0
"""Gap of the virtual anchors that is looked at; what is always allowed; squared in deviations."""
AROUND_M, THROUGH_M, CROSSING = 1.0, 0.15, 0.2
"""Silent surface through a corner: gap of virtual anchors, distance from it, sine of the corner's angle."""


def lay(bank: Bank, belief: Belief, places: Array) -> tuple[Bank, Belief]:
    """Drop the surfaces that are ghosts of double bounces over surer surfaces.

    Parameters
    ----------
    places : (J, 2) m
        The anchors.
    """
    variance = belief.covariance[AGENT + 1 :: 2, AGENT + 1 :: 2].diagonal()
    sure = np.flatnonzero((bank.existence > SURE) & (bank.seen >= OFTEN) & (variance < SHARP_M**2))
    last, first = (a.ravel() for a in np.meshgrid(sure, sure, indexing="ij"))
    last, first = last[last != first], first[last != first]
    if not len(last):
        return bank, belief
    lines, good = belief.lines, np.ones(len(bank), dtype=bool)
    surer = np.minimum(bank.existence[last], bank.existence[first]) > bank.existence[:, None]
    surer &= np.minimum(bank.seen[last], bank.seen[first]) > OFTENER * bank.seen[:, None]
    if not surer.any():
        return bank, belief
    through = _through_corners(lines, last, first)
    at = places[:, None]
    gap = mirror(lines, at)[:, :, None] - mirror(lines[last], mirror(lines[first], at))[:, None]
    far = np.hypot(gap[..., 0], gap[..., 1])  # (J, S, H)
    # heard loosely, it lies between what AoA and AoD of the double bounce would have it
    silent = bank.single.max(0) < HEARD_ELSEWHERE
    good &= ~(surer & (far < AROUND_M) & through & silent[:, None]).any((0, 2))
    for anchor, ghost, pair in np.argwhere(surer & (far < NEAR_M)).tolist():
        if np.delete(bank.single[:, ghost], anchor).max(initial=0.0) >= HEARD_ELSEWHERE:
            continue
        spread = _spread(belief, places[anchor], ghost, int(last[pair]), int(first[pair]))
        sharp = np.trace(spread) < NEAR_M**2
        here = gap[anchor, ghost, pair]
        if sharp and here @ np.linalg.solve(spread + SLACK_M**2 * np.eye(2), here) < GATE:
            good[ghost] = False
    return (bank, belief) if good.all() else (bank.take(good), keep(belief, good))


def _through_corners(lines: Array, last: NDArray[np.intp], first: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether lines (S,) pass through the corners of pairs (H,) of other lines, (S, H)."""
    normals = unit(lines[:, 0])
    one, other = normals[last], normals[first]
    sine = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    safe = np.where(np.abs(sine) > CROSSING, sine, np.inf)
    a, b = lines[last, 1], lines[first, 1]
    corner = np.stack([a * other[:, 1] - b * one[:, 1], b * one[:, 0] - a * other[:, 0]], -1) / safe[:, None]
    return np.asarray((np.abs(normals @ corner.T - lines[:, 1:]) < THROUGH_M) & (np.abs(sine) > CROSSING))


def _spread(belief: Belief, place: Array, single: int, last: int, first: int) -> Array:
    """Covariance of the gap between the virtual anchors of a single and a double bounce, (2, 2)."""
    lines, jacobian = belief.lines, np.zeros((2, len(belief.mean)))
    normal, image = unit(lines[last, 0]), mirror(lines[first], place)
    turned = np.eye(2) - 2 * np.outer(normal, normal)
    jacobian[:, slots(single)] += mirror_derivative(lines[single], place)
    jacobian[:, slots(last)] -= mirror_derivative(lines[last], image)
    jacobian[:, slots(first)] -= turned @ mirror_derivative(lines[first], place)
    return jacobian @ belief.covariance @ jacobian.T
