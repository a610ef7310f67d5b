"""Levels of direct SLAM: which paths are there, how strong they are, how loud the noise is (M85), (M86)."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, put, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.samples.distance_mode import Mode
from gridslam.inference.messages.samples.image_births import FoundDistances
from gridslam.inference.messages.samples.image_prediction import AnchorPaths, image_distances
from gridslam.inference.messages.samples.image_proposals import judge_proposals
from gridslam.inference.messages.samples.noise_levels import learned_noise, quiet_noise
from gridslam.inference.messages.samples.signal_likelihood import Band, log_ratio
from gridslam.inference.state.rings import follow, symmetric
from gridslam.inference.state.samples.images import MEMORY, DirectState, Links
from gridslam.world.filter_model import FilterModel

Complex = NDArray[np.complex128]
FIRST_SHARE, FIRST_HEARD = 0.5, 3.0
"""An anchor's own path begins with no less than this share of the strongest, as if heard so often: it may
have faded, and a reflection next to it that is believed to be stronger would take its place."""
CERTAIN = 1 - 1e-7
USURPED_BELOW, USURPER_ABOVE, USURPER_M, USURPED_STEPS = 0.3, 0.5, 0.2, 5
"""When another path has taken the line of sight's place: visibility below, existence above, gap, steps."""
RECLAIMED = 0.9
FIRST_ABOVE, REACH, ERROR_M = 0.9, 2.0, 0.03
"""Where the agent has drifted: existence of the path that is its line of sight, how far off that may be, in
deviations of the predicted length, and what its length is off beside its variance."""


def start_levels(
    state: DirectState, anchor: int, band: Band, samples: Complex, model: FilterModel
) -> DirectState:
    """Noise, see `first_noise`, and the line of sight's intensity, where none is known yet (M86)."""
    links = state.links
    if links.noise[anchor] > 0 and links.intensity[anchor] > 0:
        return state
    cells = np.asarray(band.folding_m / len(band) * np.arange(len(band)), np.float64)
    power = np.abs(np.conj(band.response(cells)) @ samples) ** 2
    if links.noise[anchor] <= 0:
        links = replace(links, noise=put(links.noise, anchor, first_noise(band, samples, cells)))
    if links.intensity[anchor] <= 0:
        away = float(np.linalg.norm(state.belief.mean[:2] - model.anchor_positions[anchor]))
        near = away + 0.25 * band.resolution_m * np.linspace(-1, 1, 9)
        level = float((np.abs(np.conj(band.response(near)) @ samples) ** 2).max())
        floor = max(2.0 * float(links.noise[anchor]), FIRST_SHARE * float(power.max()))
        links = replace(
            links,
            intensity=put(links.intensity, anchor, max(level, floor)),
            heard=put(links.heard, anchor, FIRST_HEARD),
        )
    return replace(state, links=links)


def first_noise(band: Band, samples: Complex, cells: Array) -> float:
    """Power of the noise by the quieter delay cells, seen through a window without far sidelobes."""
    window = np.hanning(len(band) + 2)[1:-1]
    power = np.abs(np.conj(band.response(cells)) @ (window * samples)) ** 2
    share = float(np.square(np.abs(band.pulse)) @ np.square(window))
    return quiet_noise(power, share)


def update_levels(state: DirectState, paths: AnchorPaths, found: FoundDistances) -> DirectState:
    """Visibility and intensity of all paths of an anchor, and its noise."""
    mode = found.mode
    anchor, images, links, tentative = paths.anchor, state.images, state.links, state.tentative
    joint, rows = paths.joint, paths.images
    intensity = np.append(links.intensity[anchor], images.intensity[rows])
    matched, own = judge_proposals(state, paths, found)
    ratio = np.exp(np.clip(log_ratio(matched[:joint], own[:joint], intensity), -50.0, 50.0))
    there = paths.visible * ratio
    whole = there + 1 - paths.visible
    visible = np.minimum(there / whole, CERTAIN)
    exists = images.existence[rows] * whole[1:]
    exists = np.minimum(exists / (exists + 1 - images.existence[rows]), CERTAIN)

    noise = float(links.noise[anchor])
    power, count = np.maximum(mode.paths.power, 0.0), np.append(links.heard[anchor], images.heard[rows])
    strength, counts = _averaged(intensity, count, power[:joint], visible, noise)
    ring_rows = paths.tentative
    ring_strength, ring_heard = _averaged(
        tentative.intensity[ring_rows], tentative.heard[ring_rows],
        power[joint : joint + len(ring_rows)], tentative.rings.existence[ring_rows], noise,
    )  # fmt: skip
    links = Links(
        put(links.visible, anchor, visible[0]), put(links.intensity, anchor, strength[0]),
        put(links.heard, anchor, counts[0]),
        put(links.noise, anchor, learned_noise(noise, mode.noise_ratio, state.step)),
        links.usurped,
    )  # fmt: skip
    images = dataclasses.replace(
        images, visible=put(images.visible, rows, visible[1:]),
        existence=put(images.existence, rows, exists),
        intensity=put(images.intensity, rows, strength[1:]), heard=put(images.heard, rows, counts[1:]),
    )  # fmt: skip
    tentative = replace(
        tentative, intensity=put(tentative.intensity, ring_rows, ring_strength),
        heard=put(tentative.heard, ring_rows, ring_heard),
    )  # fmt: skip
    return replace(state, links=links, images=images, tentative=tentative)


def _averaged(level: Array, count: Array, power: Array, chance: Array, noise: float) -> tuple[Array, Array]:
    """Running means of power, weighted by the chance that it was there; at least the noise."""
    counted = np.minimum(count + chance, MEMORY)
    return np.maximum(level + chance / np.maximum(counted, 1.0) * (power - level), noise), counted


def watch_fit(state: DirectState, paths: AnchorPaths, found: FoundDistances) -> DirectState:
    """How well an anchor's samples fitted: shifts of distances, and the power that known paths explain.

    Known are the paths of the joint belief. Tentative ones tell nothing of the agent: where it is lost, they
    alone explain what is received.
    """
    joint, mode = paths.joint, found.mode
    power = np.maximum(mode.paths.power / float(state.links.noise[paths.anchor]) - 1, 0.0)
    watch = state.watch.fitted(
        mode.distance[:joint] - paths.prior.mean[:joint], paths.covariance, mode.covariance[:joint, :joint],
        float(power[:joint].sum()), float(power.sum()),
    )  # fmt: skip
    return replace(state, watch=watch)


def reclaim_line_of_sight(
    state: DirectState, paths: AnchorPaths, mode: Mode, model: FilterModel
) -> DirectState:
    """Where another path has stood in the line of sight's place for some steps, it was the line of sight.

    Of two paths within the resolution either may settle on the other's energy at the start, and what holds
    the larger intensity then wins for good. If the agent has drifted since, its place is put right (M544).
    """
    anchor, links, joint = paths.anchor, state.links, paths.joint
    chances = np.concatenate(
        [state.images.existence[paths.images] * state.images.visible[paths.images],
         state.tentative.rings.existence[paths.tentative]]
    )  # fmt: skip
    gap = mode.distance[1 : 1 + len(chances)] - paths.prior.mean[0]
    deviation = float(np.sqrt(paths.covariance[0, 0]))
    drifted = USURPER_M < deviation < mode.band.resolution_m
    near = USURPER_M + (REACH * deviation if drifted else 0.0)
    beside = (np.abs(gap) < near) & (chances > (FIRST_ABOVE if drifted else USURPER_ABOVE))
    if links.visible[anchor] >= USURPED_BELOW or not beside.any():
        return replace(state, links=replace(links, usurped=put(links.usurped, anchor, 0)))
    steps = int(links.usurped[anchor]) + 1
    links = replace(links, usurped=put(links.usurped, anchor, steps))
    if steps < USURPED_STEPS:
        return replace(state, links=links)
    which = int(np.flatnonzero(beside)[(gap if drifted else np.abs(gap))[beside].argmin()])
    if which < joint - 1:
        row = paths.images[which]
        intensity = state.images.intensity[row]
        state = state.keep(np.arange(len(state.images)) != row)
    else:
        ring = paths.tentative[which - (joint - 1)]
        intensity = state.tentative.intensity[ring]
        state = replace(state, tentative=state.tentative.take(np.arange(len(state.tentative)) != ring))
    links = replace(
        links, visible=put(links.visible, anchor, RECLAIMED), usurped=put(links.usurped, anchor, 0),
        intensity=put(links.intensity, anchor, float(intensity)), heard=put(links.heard, anchor, 1.0),
    )  # fmt: skip
    if drifted:
        variance = float(mode.variance[1 + which]) + ERROR_M**2
        state = _as_far(state, model.anchor_positions[anchor], float(mode.distance[1 + which]), variance)
    return replace(state, links=links)


def _as_far(state: DirectState, position: Array, distance: float, variance: float) -> DirectState:
    """Correct the belief by the agent's distance from an anchor at a position (2,)."""
    before = state.belief
    (mean,), (slope,), ((spread,),) = image_distances(state, np.zeros(0, np.intp), position)
    whole, cross = spread + variance, before.covariance @ slope
    after = Belief(
        before.mean + cross * ((distance - mean) / whole),
        symmetric(before.covariance - np.outer(cross, cross) / whole),
    )
    rings = follow(state.tentative.rings, before, after)
    return replace(state, belief=after, tentative=replace(state.tentative, rings=rings))
