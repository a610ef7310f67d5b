"""Births that earlier measurements bear out: walls that are heard too seldom to be told from clutter at once.

docs/model.md, (M251), (M252). Ours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.likelihood import detection_table
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.anchor_measurements import AnchorScan, deviations, own_deviations, whole_of
from gridslam.inference.state.leftovers import Leftovers
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import tables
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import mirror, slant, wrap
from gridslam.world.radio import REFLECTION_BINS, RadioModel
from gridslam.world.single_bounces import single_bounces

POSE = np.array([0, 1, 4])
OF_POSE = np.ix_(POSE, POSE)
NEAR_M, NEAR_RAD = 0.6, 0.6
"""By how much distance and angles of an earlier measurement may miss what a new line predicts, roughly."""
OPEN = 0.5
"""Chance that a line which one anchor hears is heard by another one, too."""
CERTAIN = 5.0
"""Ratio to clutter from which on a birth needs no help, and known causes from which on it gets none."""
KNOWN = 0.5
"""Probability from which on a measurement counts as a known path's, or as what bore a surface."""
WIDEST = 1e3
"""Deviation that stands for "tells nothing"."""
MOST_LOG, LEAST_DOUBT = 25.0, 1e-9
"""Largest log ratio of one measurement; least probability of a miss."""


def recall_leftovers(
    births: Births, state: State, scan: AnchorScan, ratios: LikelihoodRatios, radio: RadioModel,
    model: FilterModel,
) -> tuple[Births, LikelihoodRatios]:  # fmt: skip
    """Births of single bounces weighed by what was left unexplained before, and the ratios with their sums.

    Parameters
    ----------
    radio : RadioModel
        As the radio seems to be.
    """
    left = state.leftovers
    if left is None or not len(left) or not len(births):
        return births, ratios
    unsure = (births.ratio < CERTAIN) & (ratios.explained[births.measurement] < CERTAIN)
    (rows,) = (unsure & scan.whole[births.measurement] & (births.hit < 0).all(1)).nonzero()
    if len(rows):
        rows = rows[_has_company(births.line[rows], left, model.places)]
    if not len(rows):
        return births, ratios
    support = np.ones((len(births), len(REFLECTION_BINS)))
    seen = np.zeros(len(births), np.int64)
    m = births.measurement[rows].astype(np.intp)
    gain, seen[rows] = borne_out(births.line[rows], scan, m, state, left, radio, model)
    support[rows] += gain
    level = REFLECTION_BINS * radio.amplitude(scan.value[m, 0])[:, None]
    prior = np.exp(radio.log_rician(scan.amplitude[m, None], level))
    prior /= prior.sum(1, keepdims=True)
    ratio = births.ratio.copy()
    ratio[rows] *= (prior * support[rows]).sum(1)
    measured = ratios.measured.copy()
    np.add.at(measured[tables.NEW], m, ratio[rows] - births.ratio[rows])
    return replace(births, ratio=ratio, support=support, seen=seen), replace(ratios, measured=measured)


def _has_company(line: Array, left: Leftovers, places: Array) -> NDArray[np.bool_]:
    """Whether any leftover lies roughly where a single bounce over each line (B, 2) is predicted, (B,)."""
    b, h, image = _about(line, left, places)
    found = np.zeros(len(line), np.bool_)
    if not len(b):
        return found
    path = single_bounces(line[b], places[left.anchor[h]], left.taken_at[h], image)
    found[b[_near(left.value[h], path.value)[0]]] = True
    return found


def _about(line: Array, left: Leftovers, places: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Lines and leftovers (N,) whose distances are about the same, and the anchors' images there, (N, 2)."""
    image = mirror(line[:, None], places[:, :2])
    away = image.take(left.anchor, 1) - left.taken_at[:, :2]
    far = slant(np.hypot(away[..., 0], away[..., 1]), places[:, 3].take(left.anchor))
    b, h = (np.abs(left.value[:, 0] - far) < NEAR_M).nonzero()
    return b, h, image[b, left.anchor[h]]


def _near(value: Array, predicted: Array) -> tuple[NDArray[np.bool_], Array]:
    """Which measurements (..., 3) lie roughly where they are predicted, and by how much they miss it."""
    gap = value - predicted
    gap[..., 1:] = wrap(gap[..., 1:])
    return np.asarray((np.abs(gap) < (NEAR_M, NEAR_RAD, NEAR_RAD)).all(-1)), gap


def borne_out(
    line: Array, scan: AnchorScan, m: NDArray[np.intp], state: State, left: Leftovers, radio: RadioModel,
    model: FilterModel,
) -> tuple[Array, NDArray[np.int64]]:  # fmt: skip
    """Likelihood of what was left over if a line has been there for some steps, over that if it hasn't.

    Misses alone tell nothing for a line and are left out.

    Parameters
    ----------
    line : (B, 2)
        Lines of single bounces.
    m : (B,)
        Which measurement each is born of.

    Returns
    -------
    (gain, seen)
        gain (B, BINS): by the line's coefficient; seen (B,): how often it was heard before.
    """
    gain, seen = np.zeros((len(line), len(REFLECTION_BINS))), np.zeros(len(line), np.int64)
    line, covariance = _corrected(line, scan, m, state, radio, model)
    places = model.places
    b, h, image = _about(line, left, places)
    one = single_bounces(line[b], places[left.anchor[h]], left.taken_at[h], image)
    near, gap = _near(left.value[h], one.value)
    (fits,) = (near & one.possible).nonzero()
    if not len(fits):
        return gain, seen
    b, h, gap, image = b[fits], h[fits], gap[fits], image[fits]
    log = _log_density(line[b], covariance[b], gap, h, left, places, image)
    log -= radio.log_clutter(left.amplitude[h]) + np.log(radio.false_alarms)
    # of the lines that have any: paths of all anchors, at all steps
    rows, b = np.unique(b, return_inverse=True)
    path = single_bounces(line[rows, None, None], places[:, None], left.pose)
    level, possible = REFLECTION_BINS * radio.amplitude(path.value[..., :1]), path.possible
    missed = np.ones(level.shape)
    missed[possible] = np.maximum(1 - detection_table(model.radio)(level[possible]), LEAST_DOUBT)
    at = b, left.anchor[h], left.back[h]
    loud = radio.log_rician(left.amplitude[h, None], level[at])
    ratio, either = np.exp(np.minimum(log[:, None] + loud, MOST_LOG)), missed.copy()
    np.add.at(either, at, ratio)
    seen[rows] = np.rint(np.bincount(b, (ratio / either[at]).max(1), len(rows)))
    # of the latest 1, 2 ... steps: if nothing was the line's, and if anything may have been
    logs = np.empty((2, *missed.shape))
    logs[:] = np.log(missed)
    logs[1][at] = np.log(either[at])
    logs = logs.cumsum(3)
    others = np.arange(len(places)) != scan.anchor
    logs[:, :, others] = np.log(1 - OPEN + OPEN * np.exp(np.minimum(logs[:, :, others], 500.0)))
    silent, borne = np.exp(np.minimum(logs.sum(2), 50.0)).mean(2)
    gain[rows] = borne - silent
    return gain, seen


def _corrected(
    line: Array, scan: AnchorScan, m: NDArray[np.intp], state: State, radio: RadioModel,
    model: FilterModel,
) -> tuple[Array, Array]:  # fmt: skip
    """Lines (B, 2) and their covariances (B, 2, 2) by one measurement each, at the pose that is believed."""
    value = scan.value[m]
    std = np.minimum(deviations(scan, m, scan.amplitude[m], value[:, 1:], radio), WIDEST)
    here = single_bounces(line, model.places[scan.anchor], state.belief.mean[POSE])
    by_line, by_pose = here.slopes()
    spread = _spread(by_pose, state.belief.covariance[OF_POSE], std)
    weighed = np.linalg.solve(spread, by_line)
    covariance = np.linalg.inv(by_line.transpose(0, 2, 1) @ weighed + 1e-9 * np.eye(2))
    gap = value - here.value
    gap[:, 1:] = wrap(gap[:, 1:])
    moved = covariance @ (weighed.transpose(0, 2, 1) @ gap[..., None])
    return line + moved[..., 0], np.asarray(covariance, np.float64)


def _log_density(
    line: Array, covariance: Array, gap: Array, h: NDArray[np.intp], left: Leftovers, places: Array,
    image: Array,
) -> Array:  # fmt: skip
    """Log densities (N,) of leftovers `h` that miss what lines with covariances predict by `gap` (N, 3)."""
    back = left.back[h]
    by_line, by_pose = single_bounces(line, places[left.anchor[h]], left.pose[back], image).slopes()
    spread = by_line @ covariance @ by_line.transpose(0, 2, 1)
    spread += _spread(by_pose, left.covariance[back], left.std[h])
    far = np.einsum("ni,ni->n", gap, np.linalg.solve(spread, gap[..., None])[..., 0])
    return np.asarray(-0.5 * far - 0.5 * np.linalg.slogdet(2 * np.pi * spread)[1])


def _spread(slope: Array, covariance: Array, std: Array) -> Array:
    """Covariances (N, 3, 3) of measurements with deviations (N, 3) that depend on what is known so well."""
    spread = slope @ covariance @ slope.transpose(0, 2, 1)
    spread[:, range(3), range(3)] += std**2
    return np.asarray(spread)


def remember_leftovers(
    state: State, scans: Sequence[AnchorScan], exchanges: Sequence[Exchange], model: FilterModel, *,
    work: Workspace,
) -> State:  # fmt: skip
    """Keep what was probably no known path's, nor bore a surface, for later steps.

    Measurements that lack distance, an angle or the amplitude aren't kept.
    """
    if state.leftovers is None:
        return state
    own = work.once(own_deviations, scans, model.radio)
    whole, anchor, value, std, amplitude = work.once(_stated, scans, own)
    (rows,), belief = (whole & unclaimed(exchanges)).nonzero(), state.belief
    leftovers = state.leftovers.joined(
        belief.mean[POSE], belief.covariance[OF_POSE], anchor[rows], value[rows], std[rows], amplitude[rows]
    )
    return replace(state, leftovers=leftovers)


def unclaimed(exchanges: Sequence[Exchange]) -> NDArray[np.bool_]:
    """Measurements (M,) of all anchors that were probably no known path's, nor bore a surface."""
    free = np.concatenate([exchange.responsible.sum(0) for exchange in exchanges]) < KNOWN
    first = 0
    for exchange in exchanges:
        if len(exchange.born):
            free[first + exchange.born[exchange.born[:, 1] > KNOWN, 0].astype(np.intp)] = False
        first += exchange.message.shape[2]
    return np.asarray(free)


def _stated(
    scans: Sequence[AnchorScan], std: Array
) -> tuple[NDArray[np.bool_], NDArray[np.int64], Array, Array, Array]:
    """Of all measurements whether they lack nothing, anchor, value, deviations (M, 3) and amplitude."""
    scan, std = whole_of(scans), np.minimum(std, WIDEST)
    return scan.whole, scan.label.astype(np.int64, copy=False), scan.value, std, scan.amplitude
