"""Where direct SLAM's agent is by what arrives first from three anchors: docs/model.md, (M534), (M535).

What arrives first has come straight, or the anchor is hidden. Distances to three anchors that cross in one
place, and go on doing so while the agent moves, are lines of sight, or have all come over one wall: then they
are longer than those, and cross where that wall mirrors the agent to. So the place is taken if one of them is
shorter than the belief allows, or the belief is vague enough to hold it.
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
DEVIATIONS = 3.0
"""Of what is believed, for it to be contradicted, or to hold a place."""
TRIAL = 40
"""Steps after which an agent that was found, and is well otherwise, isn't on trial any more."""
UNEVEN = 2.0
"""Longest time between two looks over the shortest."""
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
    three : list of int, 3
        The anchors that tell it.
    """

    place_m: Array
    velocity_mps: Array
    time_s: float
    velocity_std_mps: float
    three: list[int]


def place_told(firsts: Array, anchors: Array, model: SignalModel, band: Band) -> Told | None:
    """The place that the first arrivals of the latest looks tell, if they do (M534).

    Parameters
    ----------
    firsts : (K, 1 + J)
        As in `DirectState`.
    anchors : (J, 2) m
    """
    if len(firsts) < LOOKS or np.ptp(np.log(np.diff(firsts[:, 0]))) > np.log(UNEVEN):
        return None
    time, length = firsts[:, 0], firsts[:, 1:]
    heard = np.flatnonzero((length > 0).all(0))
    heard = heard[np.argsort(length[-1, heard], kind="stable")[:NEAREST]]
    best, told = np.inf, None
    for three in map(list, combinations(heard.tolist(), 3)):
        places, missed = crossings(anchors[three], length[:, three])
        worst = float(missed.max(initial=0.0))
        if not places.size or worst > min(CROSSING * band.resolution_m, best):
            continue
        if not _one_way(places, time, band) or not _inside(places, model):
            continue
        if _disproved(places, anchors, length, band):
            continue
        if only_place(places[-1], anchors[three], APART * band.resolution_m):
            span = float(time[-1] - time[-3])
            moved = np.sqrt(2) * KNOWN * band.resolution_m / span
            deviation = float(np.hypot(moved, model.settings.acceleration_mps2 * span))
            velocity = (places[-1] - places[-3]) / span
            best, told = worst, Told(places[-1], velocity, float(time[-1]), deviation, three)
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
    for _ in range(ITERATIONS + 1):
        away = place[:, None] - anchors
        far = np.maximum(np.sqrt((away**2).sum(-1)), 1e-6)
        toward = away / far[..., None]
        normal = np.swapaxes(toward, 1, 2) @ toward
        if (np.linalg.det(normal) < 1e-9).any():
            return np.zeros((0, 2)), np.zeros(0)
        at, gap = place, length_m - far
        place = place + np.linalg.solve(normal, np.einsum("kji,kj->ki", toward, gap)[..., None])[..., 0]
    if (np.trace(np.linalg.inv(normal), axis1=1, axis2=2) > DILUTION**2).any():
        return np.zeros((0, 2)), np.zeros(0)
    return at, np.sqrt((gap**2).mean(1))


def only_place(place: Array, anchors: Array, apart_m: float) -> bool:
    """Whether no other place has the same distances to these anchors.

    Two circles cross at a second place, mirrored at the line through their anchors; a third anchor tells it
    from the first if it is so much farther from the one than from the other. Nearer, it is the first.

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
    same = np.sqrt(np.square(other - place).sum(-1)) < apart_m
    return bool((same | (np.abs(there - here) > apart_m).any(1)).all())


def borne_out(state: DirectState, model: SignalModel, band: Band) -> DirectState:
    """A state whose place is the one that first arrivals tell is neither mirrored nor on trial any more."""
    if not (state.one_sided.any() or state.found_again):
        return state
    told = _latest(state, model, band)
    if told is None or _elsewhere(state, told, band):
        return state
    return replace(state, one_sided=np.zeros_like(state.one_sided), found_again=False)


def found_again(
    population: Population[DirectState], well: bool, model: SignalModel
) -> Population[DirectState]:
    """One hypothesis that begins where first arrivals tell that a lost agent is, or what there was (M535).

    Parameters
    ----------
    well : bool
        Whether health has nothing to say, but that it is on trial.
    """
    state, band = population.best, band_of(model.waveform)
    if well or population.searching:
        return population
    told = _latest(state, model, band)
    if told is None or not all(_may_go(one, told, model, band) for one in population.states):
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


def tried(state: DirectState, well: bool) -> DirectState:
    """A state that has been well for long enough, but for its trial, isn't on trial any more."""
    over = state.found_again and well and state.step >= TRIAL
    return replace(state, found_again=False) if over else state


def _latest(state: DirectState, model: SignalModel, band: Band) -> Told | None:
    """What first arrivals tell, if they were looked at at this very step."""
    if not len(state.firsts) or state.firsts[-1, 0] != state.time_s:
        return None
    return place_told(state.firsts, model.anchor_positions, model, band)


def _may_go(state: DirectState, told: Told, model: SignalModel, band: Band) -> bool:
    """Whether a state isn't at the place told, and either is contradicted by arrivals or may hold it."""
    if not _elsewhere(state, told, band):
        return False
    place, spread = state.belief.mean[:2], state.belief.covariance[:2, :2]
    gap = told.place_m - place
    if gap @ np.linalg.solve(spread, gap) < DEVIATIONS**2:
        return True
    way = place - model.anchor_positions[told.three]
    far = np.maximum(np.sqrt((way**2).sum(-1)), 1e-6)
    allowed = DEVIATIONS * np.sqrt(np.einsum("ji,ik,jk->j", way, spread, way)) / far
    first = state.firsts[-1, 1:][told.three]
    return bool((first < far - allowed - APART * band.resolution_m).any())


def _one_way(places: Array, time_s: Array, band: Band) -> bool:
    """Whether each place lies where the two before it lead."""
    speed = np.diff(places, axis=0) / np.diff(time_s)[:, None]
    bends = np.abs(np.diff(speed, axis=0) * np.diff(time_s)[1:, None])
    return float(bends.max()) < APART * band.resolution_m


def _disproved(places: Array, anchors: Array, length_m: Array, band: Band) -> bool:
    """Whether anything arrives before a line of sight to the places (K, 2), at looks and anchors (K, J)."""
    far = np.sqrt(np.square(places[:, None] - anchors).sum(-1))
    return bool(((length_m > 0) & (length_m < far - APART * band.resolution_m)).any())


def _inside(places: Array, model: SignalModel) -> bool:
    """Whether places lie in the region."""
    low, high = np.transpose([model.grid.x_m, model.grid.y_m])
    return bool(((places >= low) & (places <= high)).all())
