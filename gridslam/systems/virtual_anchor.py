"""SLAM by virtual anchors, independent for every anchor: the reference of [Li2025adaptive], section VI.

After [Leitinger2019bp]; docs/model.md, (M45).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.inference.beliefs.belief import separated
from gridslam.inference.management.merging import merge_and_prune
from gridslam.inference.management.poses.pose_recovery import recover_pose
from gridslam.inference.management.step_info import StepInfo, conclude
from gridslam.inference.messages import ranging
from gridslam.inference.messages.birth_proposals import propose_births
from gridslam.inference.messages.births import add_births
from gridslam.inference.messages.clutter import learn_clutter
from gridslam.inference.messages.detections import mark_detections
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.motion import predict
from gridslam.inference.messages.outages import is_outage, through_outage
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.messages.ray_amplitudes import (
    forget_amplitudes,
    predict_amplitudes,
    start_amplitudes,
    update_amplitudes,
)
from gridslam.inference.messages.updates import Exchange, in_turn, update_surfaces_and_agent
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.state.ray_amplitudes import RayAmplitudes
from gridslam.inference.state.rings import Rings
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.map import Map
from gridslam.systems.front import SurfaceFilter
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan


def start(model: FilterModel, prior: Map | None = None) -> State:
    """The state before the first step; a virtual anchor is nothing that a map's surfaces could stand for."""
    return replace(State.start(model), amplitudes=RayAmplitudes(), rings=Rings.empty())


def step(state: State, scan: Scan, model: FilterModel, work: Workspace) -> tuple[State, StepInfo]:
    """One step, as the list of its messages, with rings beside virtual anchors."""
    work.begin()
    exchanges, earlier_s = list[Exchange](), state.time_s
    state = ranging.move_rings(state, scan.time_s, model)  # (M16)
    state = predict(state, scan.time_s, len(scan), model)  # (M16) to (M19)
    calibration_used = state.calibration
    model = work.calibrated(model, calibration_used.turned)
    scans = work.once(split_by_anchor, scan, model)
    state = recover_pose(state, scans, earlier_s, model, work=work)  # (M576)
    predicted = state
    for anchor_scan in scans.surest_first:
        before, radio_before = state, state.calibration.tuned(model.radio, anchor_scan.anchor)
        paths = predict_paths(state, anchor_scan.anchor, model, work=work)  # (M20), (M21)
        amplitudes = predict_amplitudes(state, paths, anchor_scan, model.radio, work=work)  # (M43)
        cloud, ratios = evaluate(  # (M22) to (M25)
            anchor_scan, paths, np.ones(len(paths)), amplitudes, radio_before, model, work=work
        )
        state, ratios, radio = learn_clutter(state, anchor_scan, ratios, radio_before, model)  # (M46)
        births, ratios = propose_births(  # (M32)
            state, ranging.of_arrivals(anchor_scan), cloud, ratios, radio, model, work=work
        )
        given, tentative = ranging.associate_with_rings(state, anchor_scan, ratios, radio, model)
        state, exchange = update_surfaces_and_agent(  # (M27) to (M31)
            state, anchor_scan, paths, ratios, calibration_used.turned, model, given, work=work
        )
        state = update_amplitudes(state, paths, amplitudes, anchor_scan, exchange, model, work=work)  # (M44)
        state = mark_detections(state, paths.rays, exchange.responsible.sum(1), model, work=work)  # (M391)
        state, exchange, born = add_births(  # (M33), (M34)
            state, births, anchor_scan, exchange, radio, model, shared=False, work=work
        )
        state = start_amplitudes(state, born, anchor_scan, model.radio)
        state = ranging.update_rings(before, state, anchor_scan, tentative, radio, model)  # (M45)
        state = state if model.settings.correlated else replace(state, belief=separated(state.belief))
        exchanges.append(exchange)
    exchanges = in_turn(exchanges)
    if is_outage(exchanges, predicted):  # (M580)
        return conclude(through_outage(predicted, model), exchanges, calibration_used, model, work)
    radio = calibration_used.tuned(model.radio, 0)  # rings ask for amplitudes, which are one for all anchors
    state = ranging.join_shrunk_rings(state, radio, model)  # docs/model.md, section 8
    merged = forget_amplitudes(merge_and_prune(state, model))  # (M513), (M574)
    state = ranging.follow_belief(state, merged)
    state = ranging.prune_rings(state, model)
    return conclude(state, exchanges, calibration_used, model, work)


class VirtualAnchorSlam(SurfaceFilter):
    """SLAM by virtual anchors, one step at a time.

    A virtual anchor is the mirror image of one anchor, so it is kept as the line between the two: that line
    serves its own anchor alone, by single bounces. What an anchor teaches of a wall, the others have to
    learn again; double bounces, whose departure no single bounce explains, count as clutter.

    Of a radio that measures distances alone, the images start as rings about the agent, which shrink while it
    moves (`gridslam.inference.state.rings`); its heading can't be told then.

    Parameters
    ----------
    scene : Scene
        Radio, anchors and filter settings; its walls are never read.
    prior_map : Map, optional
        Its frame is checked; its surfaces aren't used: a virtual anchor is nothing that they could stand for.
    agent : str, optional
        Which of the scene's agents (default: the first): start, prior and array.
    seed : int
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.

    Raises
    ------
    InputError
        A scene without agents, an unknown one, or a map of another frame.
    """

    method = "va"
    uses_maps = False
    branches = False
    start = staticmethod(start)
    """The state before the first step; arguments are those of `FilterFront.start`."""
    advance = staticmethod(step)
    """One step; arguments are those of `FilterFront.advance`."""

    @staticmethod
    def _model(model: FilterModel) -> FilterModel:
        """Single bounces alone."""
        return replace(model, max_bounces=min(model.max_bounces, 1))
