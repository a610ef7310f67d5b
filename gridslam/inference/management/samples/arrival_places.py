"""Where direct SLAM's agent is by what arrives first from three anchors: docs/model.md, (M534), (M535).

What arrives first has come straight, or the anchor is hidden. Distances to three anchors that cross in one
place, and go on doing so while the agent moves, are lines of sight. That needs neither images nor a belief,
and so tells where a lost agent is, and that a mirrored world isn't the true one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.messages.samples.early_paths import LOOKS
from gridslam.inference.messages.samples.signal_likelihood import Band, band_of
from gridslam.inference.state.past import Past
from gridslam.inference.state.population import Population
from gridslam.inference.state.rings import MOVING
from gridslam.inference.state.samples.images import DirectState
from gridslam.world.geometry import direction, unit
from gridslam.world.signal_model import SignalModel

CROSSING, APART, KNOWN = 1 / 15, 0.5, 1 / 8
"""In c/B: by how much (root mean square) distances that cross in one place may miss it, from where on places
are different ones, and deviation of a place found."""
DILUTION = 5.0
"""Deviation of a place over that of its distances, at most."""
NEAREST = 6
"""Anchors whose arrivals are looked at."""
ITERATIONS = 5


@dataclass(frozen=True)
class Told:
    """Where the agent is by first arrivals at the latest look.

    Attributes
    ----------
    place_m, velocity_mps : (2,)
    time_s : float
    velocity_std_mps : float
    """

    place_m: Array
    velocity_mps: Array
    time_s: float
    velocity_std_mps: float


def place_told(firsts: Array, anchors: Array, model: SignalModel, band: Band) -> Told | None:
    """The place that the first arrivals of the latest looks tell, if they do (M534).

    Parameters
    ----------
    firsts : (K, 1 + J)
        As in `DirectState`.
    anchors : (J, 2) m
    """
    if len(firsts) < LOOKS:
        return None
    time, length = firsts[:, 0], firsts[:, 1:]
    heard = np.flatnonzero((length > 0).all(0))
    heard = heard[np.argsort(length[-1, heard], kind="stable")[:NEAREST]]
    best, told = np.inf, None
    for three in map(list, combinations(heard, 3)):
        places, missed = crossings(anchors[three], length[:, three])
        if not places.size or not _one_way(places, band) or not _inside(places, model):
            continue
        worst = float(missed.max())
        if worst > CROSSING * band.resolution_m or worst > best:
            continue
        if only_place(places[-1], anchors[three], APART * band.resolution_m):
            span = float(time[-1] - time[-3])
            velocity, deviation = (places[-1] - places[-3]) / span, np.sqrt(2) * KNOWN * band.resolution_m
            best, told = worst, Told(places[-1], velocity, float(time[-1]), deviation / span)
    return told


def crossings(anchors: Array, length_m: Array) -> tuple[Array, Array]:
    """Places (K, 2) of these distances (K, 3) to three anchors, and by how much they miss them (K,).

    None (0, 2) if the anchors stand so that distances hardly tell a place.
    """
    slope = 2 * (anchors[1:] - anchors[0])
    if abs(np.linalg.det(slope)) < 1e-9:
        return np.zeros((0, 2)), np.zeros(0)
    square = (anchors**2).sum(1) - length_m**2
    place = np.linalg.solve(slope, (square[:, 1:] - square[:, :1])[..., None])[..., 0]
    for _ in range(ITERATIONS):
        away = place[:, None] - anchors
        far = np.maximum(np.sqrt((away**2).sum(-1)), 1e-6)
        toward = away / far[..., None]
        normal = np.swapaxes(toward, 1, 2) @ toward
        if (np.linalg.det(normal) < 1e-9).any():
            return np.zeros((0, 2)), np.zeros(0)
        pull = np.einsum("kji,kj->ki", toward, length_m - far)
        place = place + np.linalg.solve(normal, pull[..., None])[..., 0]
    if (np.trace(np.linalg.inv(normal), axis1=1, axis2=2) > DILUTION**2).any():
        return np.zeros((0, 2)), np.zeros(0)
    far = np.sqrt(((place[:, None] - anchors) ** 2).sum(-1))
    return place, np.sqrt(((far - length_m) ** 2).mean(1))


def only_place(place: Array, anchors: Array, apart_m: float) -> bool:
    """Whether no other place has the same distances to these anchors.

    Two circles cross at a second place, mirrored at the line through their anchors; a third anchor tells it
    from the first if it is so much farther from the one than from the other.

    Parameters
    ----------
    place : (2,) m
    anchors : (J, 2) m
    apart_m : float
    """
    first, second = np.triu_indices(len(anchors), 1)
    along = unit(direction(anchors[first], anchors[second]))
    away = place - anchors[first]
    other = anchors[first] + 2 * (away * along).sum(-1, keepdims=True) * along - away
    there, here = (np.sqrt(np.square(at - anchors).sum(-1)) for at in (other[:, None], place))
    return bool((np.abs(there - here) > apart_m).any(1).all())


def borne_out(state: DirectState, model: SignalModel, band: Band) -> DirectState:
    """A state whose place is the one that first arrivals tell is neither mirrored nor on trial any more."""
    if not (state.one_sided.any() or state.found_again):
        return state
    told = place_told(state.firsts, model.anchor_positions, model, band)
    if told is None or told.time_s != state.time_s or _elsewhere(state, told, band):
        return state
    return replace(state, one_sided=np.zeros_like(state.one_sided), found_again=False)


def found_again(
    population: Population[DirectState], well: bool, model: SignalModel
) -> Population[DirectState]:
    """One hypothesis that begins where first arrivals tell that a lost agent is, or what there was (M535).

    Parameters
    ----------
    well : bool
        Whether health has nothing to say.
    """
    state, band = population.best, band_of(model.waveform)
    if well or population.searching:
        return population
    told = place_told(state.firsts, model.anchor_positions, model, band)
    if told is None or told.time_s != state.time_s or not _elsewhere(state, told, band):
        return population
    mean = np.concatenate([told.place_m, told.velocity_mps])
    variance = np.repeat(np.square([KNOWN * band.resolution_m, told.velocity_std_mps]), 2)
    fresh = DirectState.start(mean[:MOVING], variance, len(model.anchors), state.links.noise)
    fresh = replace(fresh, time_s=state.time_s, found_again=True)
    past = None if population.past is None else Past(fresh)
    return replace(Population.of(fresh), past=past)


def _elsewhere(state: DirectState, told: Told, band: Band) -> bool:
    """Whether the place told isn't where the state has the agent, or this is vague."""
    off = float(np.linalg.norm(told.place_m - state.belief.mean[:2]))
    return max(off, state.spread_m) > APART * band.resolution_m


def _one_way(places: Array, band: Band) -> bool:
    """Whether the places of successive looks lie as on a way."""
    bends = np.abs(np.diff(places, 2, axis=0))
    return float(bends.max()) < APART * band.resolution_m


def _inside(places: Array, model: SignalModel) -> bool:
    """Whether places lie in the region."""
    low, high = np.transpose([model.grid.x_m, model.grid.y_m])
    return bool(((places >= low) & (places <= high)).all())
