"""The only anchor in sight, where nothing tells a departure; docs/model.md, (M514), (M551).

Distances and arrivals of one anchor stay the same when agent and walls turn about it together. Anchors that
are hidden are heard over walls, and over which nobody can tell while the turn is open: what they seem to say
of it is mostly wrong. So they wait until the line of sight of one of them is heard.
"""

from __future__ import annotations

from dataclasses import replace as changed

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.health.sight_watch import Sight
from gridslam.inference.management.free_turn import held_at_least, turn_followed, with_turn
from gridslam.inference.messages.motion import predict_agent
from gridslam.inference.scans.anchor_measurements import split_by_anchor, whole_of
from gridslam.inference.scans.deviations import own_deviations
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives.tables import AMPLITUDE, AOA
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan

AGREE = 4.0
"""Deviations within which a line of sight has the distance and the arrival that follow from the pose."""
AS_LOUD, REFLECTED = 0.75, 0.7
"""Of its loudness: what is taken for it, at least; what a wall would leave, against which it is held."""
BY_METAL = 0.9
"""What of it metal would leave, about, where it bears out a start."""
BEYOND_DOUBT, WITHOUT_AMPLITUDE = 5.0, 2.0
"""Nats from which on it is one; what a scan tells in radios that measure no amplitude."""


def as_far_as_told(
    population: Population[State], scan: Scan, model: FilterModel, work: Workspace
) -> tuple[Population[State], Scan]:
    """The population before a scan with the turn held out or put back, and what of the scan it may use.

    With distances alone nothing waits: a place that one anchor tells alone is a ring, and others are needed.
    Of the scan that tells the turn those are lines of sight: what else is heard of other anchors means
    something from the next one on, once the turn is known.
    """
    state, departs = population.best, bool(np.isfinite(scan.aod_rad).any())
    if model.senders == 1:
        mounted = model.mounting_variance and state.mountings is None  # of which it would be part
        if departs and mounted and not population.searching and state.samples is None:
            return held_at_least(population, model.mounting_variance, model), scan
        return turn_followed(population, departs, model), scan
    held, arrives = state.turn_variance is not None, bool(np.isfinite(scan.aoa_rad).any())
    may_begin = arrives and not departs and not state.next_identity
    if population.searching or state.samples is not None or not (held or may_begin):
        return population, scan
    loudness, expected = sights_heard(state, scan, model, work)
    if not held and (expected > 0).sum() != 1:
        return population, scan
    anchor = state.turn_anchor if held else int(expected.argmax())
    before = np.zeros(model.senders) if state.sight_nats is None else state.sight_nats
    nats = np.where(expected > 0, before + _against_reflection(loudness, expected), 0.0)
    nats[anchor] = 0.0
    seen, rows = nats > BEYOND_DOUBT, scan.anchor == anchor
    told = departs or bool(seen.any()) or not rows.any()
    if not departs and rows.any():
        for other in np.flatnonzero(seen):
            rows[_loudest(scan, other)] = True
        scan = scan.only(rows)
    population = turn_followed(population, told, model, anchor)
    states = tuple(replace(one, sight_nats=None if told else nats) for one in population.states)
    return changed(population, states=states), scan


def for_sights(state: State, scan: Scan, model: FilterModel, work: Workspace) -> float:
    """What a scan's loudness says for lines of sight against walls' reflections as far away, nats; (M551).

    0 where departures or amplitudes aren't measured: a line of sight leaves places open there, or any
    reflection may be one.
    """
    if not model.radio.departs or np.isnan(scan.amplitude).any():
        return 0.0
    loudness, expected = sights_heard(state, scan, model, work, least=0.0)
    return float(_against_reflection(loudness, expected, BY_METAL).sum())


def sights_heard(
    state: State, scan: Scan, model: FilterModel, work: Workspace, least: float = AS_LOUD
) -> tuple[Array, Array]:
    """How loud what may be an anchor's line of sight is in a scan, and how loud it should be, (J,) each.

    Both are 0 where a scan holds none; loudness is NaN where amplitudes aren't measured.

    Parameters
    ----------
    least : float
        Of how loud it should be, what is taken for it.
    """
    scans = work.once(split_by_anchor, scan, model)
    belief = with_turn(state, model).belief
    if state.time_s is not None:
        belief = predict_agent(belief, scan.time_s - state.time_s, model.settings)
    whole = whole_of(scans)
    sight = Sight.of(
        scans, work.once(own_deviations, scans, model.radio), belief, state.calibration.turned, model
    )
    off, strength = np.abs(sight.off) / sight.std, whole.table[:, AMPLITUDE]
    at_place = (off[:, 0] < AGREE) & ((off[:, 2] < AGREE) | ~whole.measured[:, AOA])
    should = state.calibration.tuned(model.radio, 0).amplitude(sight.length, 1.0)
    loud = ~(strength > 0) | (strength > least * should)
    loudness, expected = np.zeros((2, model.senders))
    for row in np.flatnonzero(at_place & loud & whole.loud):
        own = whole.label[row]
        if not expected[own] or strength[row] > loudness[own]:
            loudness[own] = strength[row] if strength[row] > 0 else np.nan
            expected[own] = should[row]
    return loudness, expected


def _against_reflection(loudness: Array, expected: Array, reflected: float = REFLECTED) -> Array:
    """What loudness says for a line of sight, against a wall's reflection as far away (J,), nats."""
    walls = reflected * expected
    ratio = 0.5 * ((loudness - walls) ** 2 - (loudness - expected) ** 2)
    return np.where(np.isnan(ratio), WITHOUT_AMPLITUDE, ratio)


def _loudest(scan: Scan, anchor: np.intp) -> NDArray[np.intp]:
    """The row of an anchor that is loudest, as lines of sight are; all where amplitudes aren't measured."""
    own = np.flatnonzero(scan.anchor == anchor)
    loudness = scan.amplitude[own]
    return own if np.isnan(loudness).all() else own[[np.nanargmax(loudness)]]
