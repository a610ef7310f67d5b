"""Prediction of the state over time: motion of the agent, jitter and survival of the surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.inference.state import belief, surface_bank
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel

JITTER = 0.2
"""Share of the papers' surface jitter that is used: it keeps particles apart, a Gaussian needs less."""


def predict(state: State, time_s: float, scan_size: int, model: FilterModel) -> State:
    """The state at the time of a scan, before its measurements are used ([Li2026grid], section III-C).

    At the first step nothing has moved yet. The calibration fades.

    Parameters
    ----------
    scan_size : int
        Number of measurements in the scan.
    """
    settings, joint, surfaces, parked = model.settings, state.belief, state.surfaces, state.parked
    if state.time_s is not None:
        if parked is not None:
            parked = parked.predicted(time_s - state.time_s, JITTER * settings.surface_m)
        joint = belief.predict(
            joint, time_s - state.time_s, settings.acceleration_mps2, np.radians(settings.heading_deg),
            JITTER * settings.surface_m, surfaces.foot,
        )  # fmt: skip
        surfaces = surface_bank.evolve(surfaces, settings.survival, settings.reflection)
    return replace(
        state,
        belief=joint,
        surfaces=surfaces,
        parked=parked,
        calibration=state.calibration.faded(),
        monitor=state.monitor.begun(scan_size),
        time_s=time_s,
    )
