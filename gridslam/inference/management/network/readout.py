"""Estimates for users of several agents: an `Estimate` of each, the clocks, and whose each measurement is."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.estimates import Estimate
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.management.free_turn import with_turn
from gridslam.inference.management.network.clock_rivals import unset_clocks
from gridslam.inference.management.readout import estimates
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.messages.ray_amplitudes import mean_amplitudes
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.population import Population
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import detected
from gridslam.world.geometry import wrap
from gridslam.world.network_model import NetworkModel
from gridslam.world.network_scan import NetworkScan
from gridslam.world.radio import SPEED_OF_LIGHT

GIVEN = 0.5
"""Probability of a path from which on a measurement counts as its."""
CONFIRMED = 3
"""Detections from which on a surface counts as found: several agents and anchors bear more that are false."""


@dataclass(frozen=True, eq=False)
class NetworkEstimate:
    """What a filter of several agents believes after one step.

    Attributes
    ----------
    step : int
    time_s : float
    agents : dict of str to Estimate or None
        By name; None for one that isn't there.
    device : tuple of str, D = J + I names
        Anchors, then agents.
    offset_s : (D,) s
        Of their clocks. What all have in common can't be observed.
    offset_covariance_s2 : (D, D)
    unset : (J,) bool
        Anchors whose clocks are still searched for.
    anchor : dict of str to (M,) int
        The anchor that each measurement of an agent is believed to be of; -1 for clutter and doubt.
    """

    step: int
    time_s: float
    agents: dict[str, Estimate | None]
    device: tuple[str, ...]
    offset_s: Array
    offset_covariance_s2: Array
    unset: NDArray[np.bool_]
    anchor: dict[str, NDArray[np.intp]]

    def __repr__(self) -> str:
        """One line for each agent."""
        said = (f"{name}: {'not there' if own is None else own}" for name, own in self.agents.items())
        return "\n".join([f"<NetworkEstimate of step {self.step} at {self.time_s} s", *said]) + ">"


def network_estimate(
    population: Population[NetworkState], scan: NetworkScan, infos: Sequence[StepInfo | None],
    model: NetworkModel, began: float, *, works: Sequence[Workspace],
) -> NetworkEstimate:  # fmt: skip
    """MMSE estimates of agents, surfaces and clocks.

    Parameters
    ----------
    infos : sequence of StepInfo or None
        What happened in every agent's turn, by agents as in the model; None for one that wasn't there.
    began : float
        When the step began, by `time.perf_counter`, s.
    works : sequence of Workspace
        One for every agent.
    """
    state, found = population.best, dict[str, Estimate | None]()
    labels = dict[str, NDArray[np.intp]]()
    for agent, (name, anchor_scan, info) in enumerate(zip(model.names, scan.scans, infos, strict=True)):
        found[name] = None
        if anchor_scan is not None and info is not None:
            found[name] = _of_agent(state, agent, scan, info, model, began, works[agent])
            labels[name] = whose(info, anchor_scan.anchor)
    devices = len(model.anchor_names) + len(model.names)
    offset, covariance = np.zeros(devices), np.zeros((devices, devices))
    if state.belief.clocks:
        offset, covariance = state.belief.clock_offsets()
    return NetworkEstimate(
        scan.step, scan.time_s, found, (*model.anchor_names, *model.names), offset / SPEED_OF_LIGHT,
        covariance / SPEED_OF_LIGHT**2, unset_clocks(population), labels,
    )  # fmt: skip


def whose(info: StepInfo, labels: NDArray[np.intp]) -> NDArray[np.intp]:
    """The anchor that each measurement is believed to be of, (M,); what it says of itself where it does."""
    given = labels.copy()
    for exchange in info.exchanges:
        if exchange.anchor < 0 and exchange.responsible.size:
            share = exchange.responsible
            path = exchange.rays.anchor[share.argmax(0)]
            given = np.where(given >= 0, given, np.where(share.max(0) > GIVEN, path, -1))
    return np.asarray(given, np.intp)


def _of_agent(
    state: NetworkState, agent: int, scan: NetworkScan, info: StepInfo, model: NetworkModel, began: float,
    work: Workspace,
) -> Estimate:  # fmt: skip
    part = with_turn(state.part(agent), model.agents[agent])
    own = work.calibrated(model.agents[agent], info.turned)
    mean, covariance, pose = part.belief.mean, part.belief.covariance, part.belief.layout.pose()
    strength = None
    if state.grid is None:  # with a grid, amplitudes follow from coefficients
        strength = partial(mean_amplitudes, part, radio=own.radio)
    table, paths = estimates(part, own, own.radio.amplitude_at_1m * info.gain, strength, work=work)
    sure = detected(table.existence, own.settings) & (part.surfaces.seen >= CONFIRMED)
    return Estimate(
        scan.step, scan.time_s, mean[:2].copy(), mean[2:4].copy(), float(wrap(mean[HEADING])),
        covariance[pose, pose].copy(), table, paths, sure, info.health.effective_sample_size,
        time.perf_counter() - began, info.health,
    )  # fmt: skip
