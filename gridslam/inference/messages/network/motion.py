"""Prediction of several agents, clocks and shared surfaces over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.messages.anywhere import anywhere
from gridslam.inference.messages.motion import JITTER, chances
from gridslam.inference.messages.network.walk import walk_covariance
from gridslam.inference.state import surface_bank
from gridslam.inference.state.network.belief import predict_network
from gridslam.inference.state.network.state import NetworkState
from gridslam.world.network_model import NetworkModel
from gridslam.world.scan import Scan


def predict_all(
    state: NetworkState, time_s: float, scans: Sequence[Scan | None], model: NetworkModel
) -> NetworkState:
    """The state at the time of a step, before its measurements are used; docs/model.md, (M16)-(M19), (M104).

    An agent moves from the second step on at which it is there.

    Parameters
    ----------
    scans : sequence of Scan or None
        What each agent heard; None for one that isn't there.
    """
    here: NDArray[np.bool_] = np.array([scan is not None for scan in scans])
    labels = np.concatenate([scan.anchor for scan in scans if scan is not None] or [np.zeros(0, np.intp)])
    labelled = bool((labels >= 0).all()) if len(labels) else state.labelled
    belief, surfaces, clocks = state.belief, state.surfaces, state.clocks
    if state.time_s is not None:
        settings, dt = model.agents[0].settings, time_s - state.time_s
        belief = predict_network(
            belief, dt, model.agents, model.clocks, here & state.here, JITTER * settings.surface_m,
            surfaces.foot, np.exp(np.maximum(surfaces.walk, 0.0)),
            None if state.walks is None else walk_covariance(state, model),
        )  # fmt: skip
        for agent, own in enumerate(model.agents):
            belief = anywhere(belief, own, agent)
        surfaces = surface_bank.evolve(
            surfaces, settings.survival, settings.reflection, best_chances(state, scans, model)
        )
        clocks = clocks.walked(model.clocks.walk_m**2 * dt + (model.clocks.drift_m * dt) ** 2)
    records = tuple(
        record
        if scan is None
        else replace(
            record, calibration=record.calibration.faded(), monitor=record.monitor.next_step(len(scan))
        )
        for record, scan in zip(state.records, scans, strict=True)
    )
    return replace(
        state, belief=belief, surfaces=surfaces, clocks=clocks, records=records, here=here,
        labelled=labelled, time_s=time_s, began_s=time_s if state.time_s is None else state.began_s,
    )  # fmt: skip


def best_chances(state: NetworkState, scans: Sequence[Scan | None], model: NetworkModel) -> Array | float:
    """Probability (S,) that a single bounce over each surface is detected by the agent that hears it best."""
    lines, mean, layout = state.belief.lines, state.belief.mean, state.belief.layout
    each = [
        chances(state.surfaces, lines, mean[layout.pose(agent)][:2], model.agents[agent])
        for agent, scan in enumerate(scans)
        if scan is not None
    ]
    return np.max(each, axis=0) if each else 0.0
