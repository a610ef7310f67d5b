"""Prediction of the state over time: motion of the agent, jitter and survival of the surfaces.

[Li2026grid], section III-C and eqs. (4), (5), (12). What paths this predicts stands in `path_prediction`.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs import belief
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.anywhere import anywhere
from gridslam.inference.state import surface_bank
from gridslam.inference.state.rings import Rings
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.world.filter_model import FilterModel
from gridslam.world.filter_settings import FilterSettings
from gridslam.world.geometry import mirror, slant
from gridslam.world.radio import REFLECTION_BINS

BEYOND_DOUBT = 8
"""Detections from which on a surface is beyond doubt: its chances aren't counted any more."""
JITTER = 0.2
"""Share of the papers' surface jitter that is used: it keeps particles apart, a Gaussian needs less."""


def predict(state: State, time_s: float, scan_size: int, model: FilterModel) -> State:
    """The state at the time of a scan, before its measurements are used: [Li2026grid], eqs. (4), (5), (12).

    At the first step nothing has moved yet. The calibration fades.

    Parameters
    ----------
    scan_size : int
        Number of measurements in the scan.
    """
    settings, joint, surfaces, parked = model.settings, state.belief, state.surfaces, state.parked
    mountings = state.mountings
    if state.time_s is not None:
        if parked is not None:
            parked = parked.predicted(time_s - state.time_s, JITTER * settings.surface_m)
        if mountings is not None:
            mountings = mountings.predicted(time_s - state.time_s)
        joint = belief.predict(
            joint, time_s - state.time_s, settings.acceleration_mps2, np.radians(settings.heading_deg),
            JITTER * settings.surface_m, surfaces.foot, np.exp(np.maximum(surfaces.walk, 0.0)),
        )  # fmt: skip
        # rings stand beside virtual anchors, of which no coefficient is learned
        chance = (
            1.0
            if state.rings is not None
            else chances(surfaces, state.belief.lines, state.belief.mean[:2], model)
        )
        surfaces = surface_bank.evolve(surfaces, settings.survival, settings.reflection, chance)
    moved = replace(
        state,
        belief=joint,
        surfaces=surfaces,
        parked=parked,
        mountings=mountings,
        calibration=state.calibration.faded(),
        monitor=state.monitor.next_step(scan_size),
        time_s=time_s,
    )
    free = anywhere(joint, model)
    if free is joint:
        return moved
    rings = None if moved.rings is None else Rings.empty()  # they hang on where the agent was
    return replace(moved.placed(free), rings=rings)


def predict_agent(joint: Belief, elapsed_s: float, settings: FilterSettings) -> Belief:
    """The agent alone after some time, (M16): near-constant velocity, random walk of the heading."""
    alone = Belief(joint.mean[:AGENT], joint.covariance[:AGENT, :AGENT])
    return belief.predict(
        alone, elapsed_s, settings.acceleration_mps2, np.radians(settings.heading_deg), 0.0, np.zeros(0)
    )


def chances(bank: SurfaceBank, lines: Array, position: Array, model: FilterModel) -> Array:
    """Probability (S,) that a single bounce over each surface is detected, of the anchor that hears it best.

    By its coefficient, as it was learned so far. Surfaces that were seen often need none: theirs is 1.
    """
    chance = np.ones(len(bank))
    (few,) = (bank.seen < BEYOND_DOUBT).nonzero()
    if len(few):
        image = mirror(lines[few, None], model.places[:, :2])
        level = np.linalg.norm(image - position, axis=-1)
        distance = slant(level, model.places[:, 3])
        detected = detection_table(model.radio)(model.radio.amplitude(distance[..., None], REFLECTION_BINS))
        chance[few] = (detected * bank.reflection[few, None]).sum(-1).max(1)
    return chance
