"""A start that isn't found yet: one state, the prior, moves on from step to step, and nothing is mapped.

How places are searched for depends on what is measured: `hypotheses` (paths), `image_starts` (samples of one
antenna), `array_starts` (samples of arrays). `Population.searching` says whether one is looked for, and
`Population.waited` how many scans that held anything told too little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.estimates import Health
from gridslam.inference.health.reasons import NOT_FOUND
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel

PATIENCE = 10
"""Scans heard after which a search makes do with less: an incomplete list, or a look at each fifth scan."""


def still_searching(
    population: Population[State], prior: State, audible: bool, model: FilterModel, work: Workspace
) -> tuple[Population[State], StepInfo]:
    """The search goes on: its state is the prior at this step, and nothing was mapped.

    Parameters
    ----------
    prior : State
        As predicted: how long nothing was heard is counted already.
    audible : bool
        Whether the scan held anything.
    """
    calibration, moved_on = prior.calibration, replace(prior, step=prior.step + 1)
    clutter = [calibration.estimate(j, model.radio.false_alarms) for j in range(model.senders)]
    health = Health(
        False, NOT_FOUND, float(work.particles.count), clutter=np.array(clutter), amplitude=calibration.gain,
        turned_rad=calibration.turned.copy(), silent_steps=prior.monitor.silent,
    )  # fmt: skip
    info = StepInfo((), health, work.times(), False, calibration.turned, calibration.gain)
    return replace(population, states=(moved_on,), waited=population.waited + audible), info
