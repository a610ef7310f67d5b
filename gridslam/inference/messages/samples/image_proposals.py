"""Images proposed where walls that others have shown put them, and paths that stand in for them (M294)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.samples.common_walls import SPREAD_M, image_there, places_by_walls, widest
from gridslam.inference.messages.samples.image_births import FoundDistances
from gridslam.inference.messages.samples.image_prediction import AnchorPaths
from gridslam.inference.messages.samples.signal_likelihood import Inverse, log_ratio
from gridslam.inference.state.rings import MOVING
from gridslam.inference.state.samples.images import DirectState
from gridslam.world.filter_model import FilterModel

Flags = NDArray[np.bool_]
PROPOSED, VISIBLE, HEARD = 0.1, 0.5, 3.0
"""Existence of a proposed image, how visible it is, and as if heard how often."""
CONFIRMED, CONFIRMED_HEARD = 0.9, 13.0
"""Existence above which an image in a common wall is believed in; and how often a proposed one must have been
heard besides (it begins with `HEARD`) to count as any other."""
SHARP_M = 0.08
"""Deviation of a path's length beyond which no image is proposed."""
GATE, GATE_M = 2.0, 0.03
"""Paths within so many deviations, and so much more, are at one place."""
WORTH = 3.0
"""Log ratio at which an image is proposed."""
MOST = 3
"""Images proposed per anchor and step."""
LEAST_SPEED = 1e-6
"""m/s, of an agent that goes somewhere."""
HALVED, SUREST = 0.5, 20.0
"""What a step in a believed image's place does to the odds of what stood there, which are at most this."""
TRAVEL_M, SURELY = 1.0, 2.0
"""A path that the agent's way leads away from another one's place, within so many metres and by so many
deviations of its direction, crosses it and doesn't stand there."""
POINTS = np.linspace(-2, 2, 9)
"""Where a proposed image's path is tried, in deviations."""


def propose_images(
    state: DirectState, paths: AnchorPaths, found: FoundDistances, model: FilterModel
) -> DirectState:
    """Begin images where walls put them, of those whose path may be there now."""
    mode, anchor = found.mode, paths.anchor
    known = (widest(state.place_covariances) < SPREAD_M) | state.images.by_walls
    taken = state.places[known & (state.images.anchor == anchor)]
    places = places_by_walls(state, anchor, model, proven=True, taken=taken)
    if not len(places):
        return state
    places = replace(places, bounces=-places.bounces)
    away = state.belief.mean[:2] - places.place
    distance = np.linalg.norm(away, axis=1)
    toward = away / distance[:, None]
    slope = -np.einsum("ci,cin->cn", toward, places.slope)
    slope[:, :2] += toward
    spread = np.sqrt(np.einsum("cn,nm,cm->c", slope, state.belief.covariance, slope))
    untied, tries = _untied(state, paths, found), list[tuple[float, float, int]]()
    possible = (spread < SHARP_M) & (distance > mode.distance[0])
    for row in np.flatnonzero(possible).tolist():
        near = np.abs(mode.distance - distance[row]) < GATE * spread[row] + GATE_M
        matched, own = _alone(found, untied & near, distance[row] + spread[row] * POINTS)
        best = int((matched / own).argmax())
        power = max(float(matched[best] / own[best] ** 2), 2 * mode.noise)
        tries.append((float(log_ratio(matched[best], own[best], power)), power, row))
    for log, power, row in sorted(tries, reverse=True)[:MOST]:
        if log > WORTH:
            state = image_there(state, anchor, places, row, PROPOSED, VISIBLE, power, HEARD)
            places = replace(places, slope=np.pad(places.slope, ((0, 0), (0, 0), (0, 2))))
    return state


def confirm_proposals(state: DirectState) -> DirectState:
    """The state with proposed images that are believed in, and were heard for long, made images as others."""
    images = state.images
    done = images.proposed & (images.existence > CONFIRMED) & (images.heard > CONFIRMED_HEARD)
    return replace(state, images=replace(images, bounces=np.where(done, -images.bounces, images.bounces)))


def judge_proposals(state: DirectState, paths: AnchorPaths, found: FoundDistances) -> tuple[Array, Array]:
    """|y|^2 and g (1 + S,) of each path; of unsure images in common walls, as if nothing stood in for them.

    Unsure: proposed or tied, with an existence below 0.9. A ring whose bearing is wrong follows any path, and
    would explain that of such an image for ever.
    """
    images, rows, mode = state.images, paths.images, found.mode
    matched, own = found.apart
    open_ones = np.flatnonzero(images.by_walls[rows] & (images.existence[rows] < CONFIRMED))
    if not len(open_ones):
        return matched, own
    matched, own, untied = matched.copy(), own.copy(), _untied(state, paths, found)
    for row in (1 + open_ones).tolist():
        (out,) = untied & _beside(found, [row])
        if out.any():
            out[row] = True
            (matched[row],), (own[row],) = _alone(found, out, mode.distance[[row]])
    return matched, own


def retire_substitutes(state: DirectState, paths: AnchorPaths, found: FoundDistances) -> DirectState:
    """Rings, and images known badly, that stay where the path of a believed image in a common wall is.

    They are hardly there then. Believed: its existence is above 0.9, and its path visible. Two paths that
    cross stand beside each other for some steps, too, and both are there.
    """
    images, rows, joint = state.images, paths.images, paths.joint
    sure = images.by_walls[rows] & (images.existence[rows] > CONFIRMED) & (images.visible[rows] > 0.5)
    untied, known = _untied(state, paths, found), 1 + np.flatnonzero(sure)
    stands = untied & _beside(found, known)
    if not stands.any():
        return state
    stays: Flags = np.any(stands & ~_crossing(state, paths, found, known), axis=0)
    loose = rows[stays[1:joint] & (widest(state.place_covariances)[rows] > SPREAD_M)]
    rings = state.tentative.rings
    idle = paths.tentative[stays[joint : joint + len(paths.tentative)]]
    images = replace(images, existence=_halved(images.existence, loose))
    rings = replace(rings, existence=_halved(rings.existence, idle))
    return replace(state, images=images, tentative=replace(state.tentative, rings=rings))


def _untied(state: DirectState, paths: AnchorPaths, found: FoundDistances) -> Flags:
    """Which of the mode's paths no common wall stands behind: rings, new paths, most images."""
    untied = np.ones(len(found.mode.distance), bool)
    untied[0] = False
    untied[1 : paths.joint] = ~state.images.by_walls[paths.images]
    return untied


def _beside(found: FoundDistances, rows: ArrayLike) -> Flags:
    """Which of the mode's paths are where each of some (R) is, (R, N)."""
    mode, some = found.mode, np.asarray(rows)[:, None]
    reach = GATE * np.sqrt(mode.variance[some]) + GATE_M
    return np.asarray(np.abs(mode.distance - mode.distance[some]) < reach)


def _crossing(state: DirectState, paths: AnchorPaths, found: FoundDistances, rows: NDArray[np.intp]) -> Flags:
    """Which of the mode's paths only cross the place of each of some (R), (R, N) (M543)."""
    mean, spread = _gained(state, paths)
    fill = len(found.mode.distance) - len(mean)  # new paths lead anywhere
    gained, doubt = np.append(mean, np.zeros(fill)), np.append(spread, np.full(fill, np.inf))
    opens = np.abs(gained - gained[rows, None]) - SURELY * np.hypot(doubt, doubt[rows, None])
    reach = GATE * np.sqrt(found.mode.variance[rows, None]) + GATE_M
    return np.asarray(TRAVEL_M * opens > reach)


def _gained(state: DirectState, paths: AnchorPaths) -> tuple[Array, Array]:
    """By how much each path (1 + S + R,) lengthens per metre of the agent's way, and deviations."""
    speed = float(np.hypot(*state.belief.mean[2:4]))
    ahead = state.belief.mean[2:4] / max(speed, LEAST_SPEED)
    aside = np.array([-ahead[1], ahead[0]])
    place, covariance = state.places[paths.images], state.place_covariances[paths.images]
    away = state.belief.mean[:2] - place
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-6)
    toward = away / distance[:, None]
    across = np.stack([-toward[:, 1], toward[:, 0]], -1)
    turn = np.sqrt(np.einsum("si,sij,sj->s", across, covariance, across)) / distance
    rings = state.tentative.rings.take(paths.tentative)
    apart = rings.mean[..., :2] - rings.mean[..., MOVING:]
    gains = (apart @ ahead) / np.maximum(np.linalg.norm(apart, axis=-1), 1e-6)
    mean = (rings.weight * gains).sum(-1)
    deviation = np.sqrt((rings.weight * (gains - mean[:, None]) ** 2).sum(-1))
    own = paths.slope[0, :2] @ ahead
    return (
        np.concatenate([[own], toward @ ahead, mean]),
        np.concatenate([[0.0], turn * np.abs(toward @ aside), deviation]),
    )


def _alone(found: FoundDistances, out: Flags, distance: Array) -> tuple[Array, Array]:
    """|y|^2 and g at distances, on top of all paths but some."""
    mode, inverse = found.mode, found.inverse
    if out.any():
        weight = np.where(out, 0.0, found.prior.weight)
        inverse = Inverse.of(inverse.band, inverse.samples, weight, mode.distance, mode.variance, mode.noise)
    response = inverse.band.response(distance)
    back = np.conj(response)
    own = ((back @ inverse.matrix) * response).sum(-1).real
    return np.abs(back @ (inverse.matrix @ inverse.samples)) ** 2, np.maximum(own, 1e-300)


def _halved(chance: Array, rows: NDArray[np.intp]) -> Array:
    fresh = chance.copy()
    odds = HALVED * np.minimum(chance[rows] / np.maximum(1 - chance[rows], 1e-9), SUREST)
    fresh[rows] = odds / (1 + odds)
    return fresh
