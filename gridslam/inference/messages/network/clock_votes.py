"""What lines of sight say together of open clocks, pose by pose; docs/model.md, (M497).

Near an anchor, or with a heading known roughly, angles of each line of sight alone fit reflections as well.
But all of an agent's lines of sight share its pose: what fits one anchor's only from poses that another's
rules out says little. And a length that isn't known makes an amplitude that isn't: pose by pose, both are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT, HEADING
from gridslam.inference.messages.network.clock_amplitudes import NOTHING, amplitude_ratio
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.network.clock_search import CELL_M
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import direction, slant, wrap

POSES = 3000
BLUR = 0.15
"""Deviations of what a sight is predicted by that are added to a measurement's: poses are that few."""


class Sights(NamedTuple):
    """What is told of the lines of sight of all anchors.

    Attributes
    ----------
    chance : (J,)
        That each is there and detected.
    std : (J, M, 3)
        Deviations of the measurements, if they were of it.
    able : (J, M) bool
        Whether they may be of it.
    clutter : (J, M)
        Density of everything else but lines of sight, 1 / (m rad^2).
    """

    chance: Array
    std: Array
    able: NDArray[np.bool_]
    clutter: Array


def sight_votes(
    view: Belief,
    sights: Sights,
    scan: AnchorScan,
    model: FilterModel,
    sought: NDArray[np.bool_],
    known: NDArray[np.bool_],
    mass: Array,
    centre: Array,
    draw: np.random.Generator,
) -> Array:
    """Log evidence of one agent's lines of sight about the offsets of sought clocks, (J, C).

    With poses p drawn from the view, and L_j(p) what line of sight j makes of all measurements there,

        log H_j(beta) += log mean_p prod_(k != j) L_k(p) L_j(p, beta)

    Parameters
    ----------
    view : Belief
        The agent's, with sought clocks at their frame's zero.
    sought, known : (J,) bool
        Clocks that are searched for, and set.
    mass : (J, C)
        Of sought offsets.
    """
    rows = np.flatnonzero(np.isfinite(scan.value[:, 0]))
    total = np.zeros((len(sought), len(centre)))
    if not len(rows) or not sought.any():
        return total
    head = AGENT + len(sought)
    drawn = draw.multivariate_normal(
        view.mean[:head], view.covariance[:head, :head], POSES, check_valid="ignore", method="eigh"
    )
    claims, apart = {}, {}
    for anchor in np.flatnonzero(sought | known).tolist():
        own = _claims(drawn, anchor, sights, scan, rows, model, None if known[anchor] else mass, centre)
        apart[anchor], claims[anchor] = own
    everyone = sum(claim.whole for claim in claims.values())
    likely = {
        anchor: np.log(
            1 - sights.chance[anchor]
            + (claim.whole / (sights.clutter[anchor, rows] + everyone - claim.whole)).sum(1)
        )
        for anchor, claim in claims.items()
    }  # fmt: skip
    together = sum(likely.values())
    for anchor in np.flatnonzero(sought).tolist():
        claim, weight = claims[anchor], together - likely[anchor]
        weight = np.exp(weight - weight.max())
        weight /= weight.sum()
        share = weight[:, None] * claim.angles / (sights.clutter[anchor, rows] + everyone - claim.whole)
        total[anchor] = _over_cells(share, apart[anchor], claim.width, centre, 1 - sights.chance[anchor])
    return total


class _Claim(NamedTuple):
    """What a line of sight makes of measurements at poses: by angles and amplitude alone, and by all; (N, M)
    each; and the deviation of its distances, (M,)."""

    angles: Array
    whole: Array
    width: Array


def _claims(
    drawn: Array, anchor: int, sights: Sights, scan: AnchorScan, rows: NDArray[np.intp],
    model: FilterModel, mass: Array | None, centre: Array,
) -> tuple[Array, _Claim]:  # fmt: skip
    """By how much measurements (M,) are longer than a line of sight at poses (N,), and its claims."""
    x, y, facing, height = model.places[anchor, :4]
    place, heading, late = drawn[:, :2], drawn[:, HEADING], drawn[:, AGENT + anchor]
    length = slant(np.hypot(*(place - [x, y]).T), height)
    back = direction(place, np.array([x, y]))
    density = np.where(sights.able[anchor, rows], sights.chance[anchor], 0.0) * np.ones((len(drawn), 1))
    for axis, predicted in ((1, back + np.pi - facing), (2, back - heading)):
        value, std = scan.value[rows, axis], sights.std[anchor, rows, axis]
        there = np.isfinite(value) & np.isfinite(std)
        mean = np.angle(np.exp(1j * predicted).mean())
        wide = np.hypot(np.where(there, std, 1.0), BLUR * np.sqrt(np.mean(wrap(predicted - mean) ** 2)))
        off = wrap(np.where(there, value, 0.0) - predicted[:, None])
        normal = np.exp(-0.5 * (off / wide) ** 2) / (np.sqrt(2 * np.pi) * wide)
        density = density * np.where(there, normal, 1 / (2 * np.pi))
    density = density * amplitude_ratio(scan.amplitude[rows], model.radio.amplitude(length), model.radio)
    apart = scan.value[rows, 0] - (length + late)[:, None]
    width = np.hypot(sights.std[anchor, rows, 0], BLUR * np.std(length + late))
    if mass is None:
        given = np.exp(-0.5 * (apart / width) ** 2) / (np.sqrt(2 * np.pi) * width)
    else:
        cell = np.rint((apart - centre[0]) / CELL_M).astype(int)
        inside = (cell >= 0) & (cell < len(centre))
        given = np.where(inside, mass[anchor, np.clip(cell, 0, len(centre) - 1)] / CELL_M, 0.0)
    return apart, _Claim(density, density * given, width)


def _over_cells(share: Array, apart: Array, width: Array, centre: Array, nothing: float) -> Array:
    """Log of the chance of nothing and of shares (N, M) at offsets, spread over cells (C,)."""
    from scipy.ndimage import gaussian_filter1d

    cell = np.rint((apart - centre[0]) / CELL_M).astype(int)
    inside = (cell >= 0) & (cell < len(centre))
    found = np.zeros(len(centre))
    for column in range(share.shape[1]):
        own = inside[:, column]
        if share[own, column].sum() > NOTHING * nothing:
            one = np.bincount(cell[own, column], share[own, column], len(centre)) / CELL_M
            found += gaussian_filter1d(one, max(width[column] / CELL_M, 1.0), mode="constant")
    return np.asarray(np.log(nothing + found))
