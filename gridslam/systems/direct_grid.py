"""Direct grid SLAM: agent, surfaces with coefficients and occupancy grid straight from samples of arrays.

Ours: grid SLAM [Li2026grid] with the likelihood of the samples [LiangDirect] in place of measured paths;
docs/model.md, section 12.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gridslam.errors import InputError
from gridslam.inference.management.merging import merge_and_prune
from gridslam.inference.management.no_mirrors import drop_no_mirrors
from gridslam.inference.management.samples.array_starts import advance_population, begun
from gridslam.inference.management.samples.open_turn import turn_held
from gridslam.inference.management.step_info import StepInfo, conclude
from gridslam.inference.messages.anchor_frames import as_believed, back_in_scene, seen_from
from gridslam.inference.messages.cells import cast_messages, cast_paths, update_cells
from gridslam.inference.messages.faint_births import remember_leftovers
from gridslam.inference.messages.motion import predict
from gridslam.inference.messages.reflection import Reflected
from gridslam.inference.messages.samples.array_births import add_new_surfaces
from gridslam.inference.messages.samples.array_paths import (
    Snapshot,
    SnapshotLikelihood,
    evaluate_snapshot,
    learn_noise,
    start_noise,
    surest_first,
    take_snapshot,
)
from gridslam.inference.messages.samples.array_updates import (
    SnapshotExchange,
    exchange_of,
    update_coefficients_by_ratios,
    update_existence,
)
from gridslam.inference.messages.samples.element_factors import learn_elements
from gridslam.inference.messages.samples.heard_bounces import HeardBounces, weigh_angles, weigh_forms
from gridslam.inference.messages.samples.line_evidence import add_faint_surfaces, gather_evidence
from gridslam.inference.messages.samples.measured_heading import measure_heading
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.arrangement import mountings_followed
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.map import Map
from gridslam.systems import grid
from gridslam.systems.front import SurfaceFront
from gridslam.systems.signal_front import SignalFilter
from gridslam.world.network_scene import require_known_clocks
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan
from gridslam.world.waveform import Waveform


def step(state: State, scan: SignalScan, model: SignalModel, work: Workspace) -> tuple[State, StepInfo]:
    """One step, as the list of its messages (docs/model.md, section 12)."""
    work.begin()
    listened, left = list[tuple[Snapshot, SnapshotLikelihood]](), list[AnchorScan]()
    exchanges = [SnapshotExchange.silent(anchor) for anchor in range(len(model.anchors))]
    state = predict(state, scan.time_s, len(scan), model)
    calibration_used = state.calibration
    model = work.calibrated(model, calibration_used.turned, aside=state.aside)
    for anchor in surest_first(state, scan, model):
        state = framed = seen_from(state, anchor, model)  # (M569)
        state = start_noise(state, anchor, scan, model)
        radio = calibration_used.tuned(model.radio, anchor)
        paths, visible = cast_paths(state, anchor, model, work=work)  # (M36)
        amplitudes = Reflected(visible.products, radio)  # (M41)
        snapshot = take_snapshot(state, anchor, scan, paths, visible, amplitudes, model, work=work)
        state, likelihood = evaluate_snapshot(state, snapshot, model, work=work)  # (M151) to (M153)
        state = update_existence(state, snapshot, likelihood, work=work)
        heard = HeardBounces.of(snapshot, likelihood)  # (M562)
        state = weigh_angles(state, paths, heard)  # (M517)
        state = weigh_forms(state, heard, model)  # (M559)
        state = learn_noise(state, anchor, likelihood)
        state, new = add_new_surfaces(state, snapshot, likelihood, model, work=work)  # (M154), (M516)
        state = gather_evidence(state, snapshot, likelihood, model, work=work)  # (M157)
        state = back_in_scene(framed, state, anchor, model)
        exchanges[anchor] = exchange_of(snapshot, likelihood, model)
        listened.append((snapshot, likelihood))
        left.append(new)
    measured = state = learn_elements(state, listened, model)  # (M565)
    state = measure_heading(state, scan, model)  # (M519)
    state = add_faint_surfaces(state, listened, model, work=work)  # (M158)
    if listened:
        drawn = cast_messages(state, model, work=work)
        state = update_coefficients_by_ratios(state, drawn, listened, model, work=work)  # (M155)
        state = update_cells(state, work=work)
        state = remember_leftovers(state, left, np.ones(sum(map(len, left)), bool), model, work=work)
    state = drop_no_mirrors(state, model, work=work)  # (M517), (M548)
    state = merge_and_prune(state, model, by_ratio=True)
    state = mountings_followed(measured, state)  # (M569)
    return conclude(state, exchanges, calibration_used, model, work)


def require_arrays(waveform: Waveform) -> None:
    """Refuse recordings whose angles of arrival can't be told: no surface could be born.

    Raises
    ------
    InputError
        The agent's elements stand in one line, or there is one alone.
    """
    element = waveform.agent_element_m
    spread = np.linalg.svd(element - element.mean(0), compute_uv=False)
    if len(element) < 3 or spread[-1] < 1e-6 * spread[0]:
        raise InputError(
            "signal: agent element_m", f"{len(element)} in one line" if len(element) > 1 else "one",
            "three or more that don't stand in one line (or one at either end, for virtual anchors)",
        )  # fmt: skip


class DirectGridSlam(SurfaceFront[SignalScan], SignalFilter[Any]):
    """Direct grid SLAM, one step at a time: samples of arrays in, agent, surfaces and cells out.

    Parameters
    ----------
    scene : Scene
        Radio, anchors, grid and filter settings; its walls are never read.
    prior_map : Map, optional
        Map that an earlier agent left: evidence, coefficients and surfaces.
    agent : str, optional
        Which of the scene's agents (default: the first): start and prior.
    seed : int
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.
    waveform : Waveform, optional
        Of the recording. Default: what the scene's radio would sample.

    Raises
    ------
    InputError
        A scene without agents, an unknown one, a map of another frame, a waveform of other anchors or of an
        agent whose elements stand in one line, or too many cells for this machine.
    """

    method = "direct_grid"
    keeps_grid = True
    finds_places = True
    start = staticmethod(grid.start)
    """The state before the first step; arguments are those of `FilterFront.start`."""
    advance = staticmethod(step)
    """One step; arguments are those of `FilterFront.advance`."""

    def __init__(self, scene: Any, *args: Any, **more: Any) -> None:
        super().__init__(scene, *args, **more)
        require_known_clocks(scene, self.agent)
        require_arrays(self.waveform)

    def _begun(self, state: State) -> Population[State]:
        return begun(state)

    def _advanced(self, scan: SignalScan) -> tuple[Population[State], StepInfo]:
        model = as_believed(self.model, self.state)
        believed = turn_held(self.population, scan, model, self.work)
        return advance_population(believed, scan, model, self.work, self.start, self.advance)

    def map(self) -> Map:
        """The map as it stands: evidence, coefficients, detected surfaces."""
        return grid.with_cells(super().map(), self.state)
