"""Adaptive SLAM: agent, surfaces and one state per ray, "soft" ray tracing without a grid.

Equations without a key are those of [Li2025adaptive]; all formulas stand in docs/model.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.inference.management.in_sight import spare_unseen
from gridslam.inference.management.merging import merge_and_prune
from gridslam.inference.management.no_mirrors import drop_no_mirrors
from gridslam.inference.management.poses.pose_recovery import recover_pose
from gridslam.inference.management.representation import representation_of
from gridslam.inference.management.step_info import StepInfo, conclude
from gridslam.inference.messages.anchor_frames import back_in_scene, seen_from, with_mountings
from gridslam.inference.messages.birth_gates import admitted_births
from gridslam.inference.messages.clutter import learn_clutter
from gridslam.inference.messages.detections import mark_detections
from gridslam.inference.messages.double_bounces import put_off_double_bounces
from gridslam.inference.messages.elevations import weigh_by_elevations, weigh_elevations
from gridslam.inference.messages.faint_births import remember_leftovers, unclaimed, weigh_by_leftovers
from gridslam.inference.messages.level_coefficients import learn_levels, with_levels
from gridslam.inference.messages.likelihood_ratios import evaluate
from gridslam.inference.messages.mirrors import weigh_angles
from gridslam.inference.messages.outages import is_outage, through_outage
from gridslam.inference.messages.ray_amplitudes import (
    predict_amplitudes,
    start_amplitudes,
    update_amplitudes,
)
from gridslam.inference.messages.scatterers import weigh_forms
from gridslam.inference.messages.surface_walk import learn_surface_walks
from gridslam.inference.messages.unexplained import gather_unexplained, none_yet
from gridslam.inference.messages.updates import Exchange, in_turn
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.leftovers import Leftovers
from gridslam.inference.state.arrangement import mountings_followed
from gridslam.inference.state.ray_amplitudes import RayAmplitudes
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.map import Map
from gridslam.systems.front import SurfaceFilter, inherit_levels, inherit_surfaces
from gridslam.systems.handed_anchors import learned_anchors
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan


def start(model: FilterModel, prior: Map | None = None) -> State:
    """The state before the first step: the agent's prior, and the surfaces of an earlier agent's map."""
    state = replace(
        State.start(model), amplitudes=RayAmplitudes(), leftovers=Leftovers.none(),
        levels=inherit_levels(model, prior), unexplained=none_yet(model),
    )  # fmt: skip
    if prior is None:
        return with_mountings(state, model)
    state = inherit_surfaces(state, prior)
    return with_mountings(state, model, prior.was_heard, learned_anchors(prior, model))


def step(state: State, scan: Scan, model: FilterModel, work: Workspace) -> tuple[State, StepInfo]:
    """One step, as the list of its messages ([Li2025adaptive], section V)."""
    work.begin()
    exchanges, earlier_s, representation = list[Exchange](), state.time_s, representation_of(state, model)
    state = representation.predict(state, scan.time_s, len(scan), model, work=work)
    calibration_used = state.calibration
    model = work.calibrated(
        with_levels(model, state.levels), calibration_used.turned, state.belief.higher, state.aside
    )
    scans = work.once(split_by_anchor, scan, model)
    state = recover_pose(state, scans, earlier_s, model, work=work)  # (M576)
    recalled = state = representation.recall(state, model, work=work)  # (M575)
    for anchor_scan in scans.surest_first:
        state = framed = seen_from(state, anchor_scan.anchor, model)  # (M569)
        radio = state.calibration.tuned(model.radio, anchor_scan.anchor)
        paths = representation.predict_paths(  # eqs. (13), (14)
            state, anchor_scan.anchor, model, work=work
        )
        amplitudes = predict_amplitudes(  # eq. (13), amplitude
            state, paths, anchor_scan, model.radio, work=work
        )
        cloud, ratios = evaluate(  # eqs. (19)-(21)
            anchor_scan, paths, np.ones(len(paths)), amplitudes, radio, model, work=work
        )
        ratios = weigh_elevations(state, anchor_scan, paths, ratios, radio, model)  # (M302)
        state, ratios, radio = learn_clutter(state, anchor_scan, ratios, radio, model)  # (M46)
        births, ratios = admitted_births(  # eq. (22), (M549)
            state, anchor_scan, cloud, paths, ratios, radio, model, work=work
        )
        births, ratios = weigh_by_leftovers(births, state, anchor_scan, ratios, radio, model)  # (M251)
        births, ratios = weigh_by_elevations(births, state, anchor_scan, ratios, radio, model)  # (M303)
        state, exchange = representation.update_surfaces_and_agent(  # V-B, 4 to 6 and 8
            state, anchor_scan, paths, ratios, calibration_used.turned, model, work=work
        )
        state = weigh_angles(state, paths, ratios, exchange)  # (M517)
        state = weigh_forms(state, paths, ratios, exchange, model)  # (M559)
        state = representation.correct_by_elevations(state, anchor_scan, exchange, radio, model)  # (M304)
        state = learn_levels(state, anchor_scan, paths, exchange, radio, model)  # (M305)
        state = update_amplitudes(  # eq. (26)
            state, paths, amplitudes, anchor_scan, exchange, model, work=work
        )
        state = mark_detections(state, paths.rays, exchange.responsible.sum(1), model, work=work)
        births = put_off_double_bounces(births, state, anchor_scan, radio, model)  # (M516)
        state, exchange, born = representation.add_births(  # eq. (25)
            state, births, anchor_scan, exchange, radio, model, work=work
        )
        state = start_amplitudes(state, born, anchor_scan, model.radio)
        state = back_in_scene(framed, state, anchor_scan.anchor, model)
        exchanges.append(exchange)
    exchanges, measured = in_turn(exchanges), state
    if is_outage(exchanges, recalled):  # (M580)
        state = representation.park(recalled, through_outage(recalled, model), model, work=work)
        return conclude(state, exchanges, calibration_used, model, work)
    state = learn_surface_walks(recalled, state)  # (M361)
    state = drop_no_mirrors(state, model, work=work)  # (M517), (M548)
    state = spare_unseen(recalled, state, model)  # (M495)
    state = merge_and_prune(
        state, model, most=None, exchanges=exchanges, departs=scans.departs
    )  # (M513), (M574)
    state = mountings_followed(measured, state)  # (M569)
    state = representation.park(recalled, state, model, work=work)  # (M575)
    unclaimed_rows = unclaimed(exchanges)
    state = remember_leftovers(state, scans, unclaimed_rows, model, work=work)
    state = gather_unexplained(state, scans, unclaimed_rows, model, work=work)  # (M432)
    return conclude(state, exchanges, calibration_used, model, work)


class AdaptiveSlam(SurfaceFilter):
    """Adaptive SLAM, one step at a time.

    It differs from grid SLAM in two points: a ray's amplitude is a state of its own instead of following
    from reflection coefficients, and what lies between the walls isn't mapped, so that a ray's existence
    alone says whether its path is open.

    Parameters
    ----------
    scene : Scene
        Radio, anchors and filter settings; its walls are never read.
    prior_map : Map, optional
        Map that an earlier agent left, of which the surfaces are used.
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

    method = "adaptive"
    by_particles = True
    over_levels = True
    finds_heights = True
    finds_places = True
    start = staticmethod(start)
    """The state before the first step; arguments are those of `FilterFront.start`."""
    advance = staticmethod(step)
    """One step; arguments are those of `FilterFront.advance`."""
