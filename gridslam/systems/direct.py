"""Direct SLAM: agent and images of the anchors straight from sampled signals."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.errors import InputError
from gridslam.estimates import Estimate, Health
from gridslam.inference.health import reasons
from gridslam.inference.management.samples.arrival_places import borne_out, found_again, tried
from gridslam.inference.management.samples.image_merging import merge_images
from gridslam.inference.management.samples.image_readout import (
    image_hypotheses,
    image_paths,
    image_rings,
    image_surfaces,
    motion_heading,
    moving_moments,
    note_hits,
)
from gridslam.inference.management.samples.image_ties import share_walls
from gridslam.inference.management.samples.mirrored_places import watch_mirrors
from gridslam.inference.management.samples.second_look import LAST, advance_population, begun
from gridslam.inference.messages.samples.early_paths import watch_arrivals
from gridslam.inference.messages.samples.image_births import (
    FIRST_STEPS,
    FoundDistances,
    birth_rate,
    find_births,
)
from gridslam.inference.messages.samples.image_prediction import (
    AnchorPaths,
    predict_paths,
    predict_state,
    update_state,
)
from gridslam.inference.messages.samples.image_proposals import (
    confirm_proposals,
    propose_images,
    retire_substitutes,
)
from gridslam.inference.messages.samples.image_rings import (
    forbid_own_place,
    join_straight_rings,
    learn_rings,
    prune,
)
from gridslam.inference.messages.samples.path_levels import (
    reclaim_line_of_sight,
    start_levels,
    update_levels,
    watch_fit,
)
from gridslam.inference.messages.samples.ring_births import add_tentative
from gridslam.inference.messages.samples.ring_motion import tell_motion
from gridslam.inference.messages.samples.signal_likelihood import band_of
from gridslam.inference.state.population import Population
from gridslam.inference.state.rings import MOVING
from gridslam.inference.state.samples.images import DirectState
from gridslam.maps.frames import stamped
from gridslam.maps.map import Map
from gridslam.systems.signal_front import SignalFilter
from gridslam.systems.soundness import require_sound_weights
from gridslam.world.filter_model import detected
from gridslam.world.radio import REFLECTION_BINS
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan
from gridslam.world.waveform import Waveform


@dataclass(frozen=True, eq=False)
class DirectInfo:
    """What happened at a step.

    Attributes
    ----------
    paths : sequence of AnchorPaths
        Of every anchor that was heard: its paths as predicted.
    found : sequence of FoundDistances
        Of the same: joint mode, new paths, and C^-1.
    health : Health
    """

    paths: Sequence[AnchorPaths]
    found: Sequence[FoundDistances]
    health: Health


def start(model: SignalModel, prior: Map | None = None) -> DirectState:
    """The state before the first step; an image is nothing that a map's surfaces could stand for."""
    waveform = model.waveform
    noise = None if waveform.noise_std is None else np.square(waveform.noise_std)
    return DirectState.start(
        model.start_mean[:MOVING], model.start_variance[:MOVING], len(model.anchors), noise
    )


def step(
    state: DirectState, scan: SignalScan, model: SignalModel, work: None = None
) -> tuple[DirectState, DirectInfo]:
    """One step, as the list of its messages ([LiangDirect], section III; docs/model.md, section 12)."""
    band = band_of(model.waveform)
    all_paths, all_found = list[AnchorPaths](), list[FoundDistances]()
    rate = birth_rate(state.step, model.max_bounces)  # (M81)
    state = predict_state(state, scan.time_s, len(scan), model)  # (M16)
    for anchor in np.flatnonzero(scan.heard).tolist():
        samples = scan.samples[anchor, 0, 0]
        state = start_levels(state, anchor, band, samples, model)  # (M86)
        paths = predict_paths(state, anchor, model)  # (M156)
        noise = float(state.links.noise[anchor])
        found = find_births(  # (M79), (M81), (M82)
            band, samples, paths.prior, noise, rate, state.step < FIRST_STEPS
        )
        state = before_rings = update_state(state, paths, found)  # (M80), (M443)
        state = learn_rings(state, paths, found)  # (M83)
        state = tell_motion(before_rings, state, paths)  # (M538)
        state = watch_fit(state, paths, found)
        state = update_levels(state, paths, found)  # (M85), (M86)
        state = retire_substitutes(state, paths, found)  # (M543)
        state = add_tentative(state, anchor, found.new, model)  # (M82)
        state = propose_images(state, paths, found, model)  # (M292) to (M294)
        state = reclaim_line_of_sight(state, paths, found.mode, model)  # (M544); rows may go
        all_paths.append(paths)
        all_found.append(found)
    state = forbid_own_place(state, model)
    state = join_straight_rings(state)  # (M84)
    state = merge_images(state)
    state = confirm_proposals(state)  # (M294)
    state = share_walls(state, model)  # (M293), (M545)
    state = prune(state)
    state = note_hits(state, model)
    state = watch_mirrors(state, band, model)  # (M444)
    state = watch_arrivals(state, scan, model)  # (M451)
    state = borne_out(state, model, band)  # (M534)
    health = state.watch.assess(state.spread_m, len(model.anchors), bool(state.one_sided.any()))
    state = tried(state, health.ok)  # (M535)
    return replace(state.packed(), step=state.step + 1), DirectInfo(all_paths, all_found, health)


def require_single_antennas(waveform: Waveform) -> None:
    """Refuse recordings of arrays.

    Raises
    ------
    InputError
        More than one element at either end.
    """
    _, at_anchor, at_agent, _ = waveform.shape
    if at_anchor * at_agent > 1:
        raise InputError(
            "signal: elements", f"{at_anchor} at anchors, {at_agent} at the agent",
            "one at either end (arrays: --method direct_grid, gs.DirectGridSlam; or extract paths)",
        )  # fmt: skip


class DirectSlam(SignalFilter[Population[DirectState]]):
    """Direct SLAM, one step at a time: samples of single antennas in, agent and images out.

    An image serves its own anchor, by single bounces; every path's amplitude may fade anew at each step.
    Distances tell nothing of a heading: what is reported is the direction of motion.

    Parameters
    ----------
    scene : Scene
        Anchors, region and filter settings; its walls are never read.
    prior_map : Map, optional
        Its frame is checked; its surfaces aren't used: an image is nothing that they could stand for.
    agent : str, optional
        Which of the scene's agents (default: the first): start and prior.
    seed : int
        Nothing here is random.
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.
    waveform : Waveform, optional
        Of the recording. Default: what the scene's radio would sample.

    Raises
    ------
    InputError
        A scene without agents, an unknown one, a map of another frame, a waveform of other anchors, or of
        arrays.
    """

    method = "direct"
    uses_maps = False
    start = staticmethod(start)
    """The state before the first step; arguments are those of `FilterFront.start`."""
    advance = staticmethod(step)
    """One step; arguments are those of `FilterFront.advance`."""

    def __init__(self, scene: Any, *args: Any, **more: Any) -> None:
        super().__init__(scene, *args, **more)
        require_single_antennas(self.waveform)

    @property
    def state(self) -> DirectState:
        """What is believed after the latest step; of several hypotheses, the likeliest."""
        return self.population.best

    @property
    def population(self) -> Population[DirectState]:
        """All hypotheses after the latest step."""
        population: Population[DirectState] = self.now.believed
        return population

    def _begun(self, state: DirectState) -> Population[DirectState]:
        return begun(state, self.model)

    def _advanced(self, scan: SignalScan) -> tuple[Population[DirectState], DirectInfo]:
        population, info, amiss = advance_population(self.population, scan, self.model, self.advance)
        state = population.best
        trial = reasons.found_again(state.step - 1) if state.found_again else ""
        why = "; ".join(reason for reason in (amiss, info.health.why) if reason)
        population = found_again(population, not why, self.model)
        why = "; ".join(reason for reason in (why, trial) if reason)
        return population, replace(info, health=replace(info.health, ok=not why, why=why))

    @staticmethod
    def moved(state: DirectState, position_m: Array, heading_rad: float) -> DirectState:
        """The state before the first step, with its prior about another start (m)."""
        mean = state.belief.mean.copy()
        mean[:2] = position_m
        return replace(state, belief=replace(state.belief, mean=mean))

    @staticmethod
    def require_sound(population: Population[DirectState], model: SignalModel, where: str) -> None:
        """Refuse hypotheses from a file whose numbers can't be."""
        require_sound_weights(population, where)
        states = {f"states/{number}": state for number, state in enumerate(population.states)}
        if population.past is not None:
            states["past/start"] = population.past.start
            if len(population.past.scans) > LAST:
                raise InputError(f"{where}/past/scans", f"{len(population.past.scans)}", f"{LAST} at most")
            for scan in population.past.scans:
                scan.checked(len(model.anchors), shape=model.waveform.shape)
        for name, state in states.items():
            for part, holds, allowed in state.claims(len(model.anchors)):
                if not holds:
                    raise InputError(f"{where}/{name}/{part}", "numbers that can't be", allowed)

    def estimate(
        self, population: Population[DirectState], scan: SignalScan, info: DirectInfo, began: float
    ) -> Estimate:
        """Mean agent; images of the likeliest hypothesis, and the paths over them; all hypotheses.

        The heading is that of the motion.
        """
        state = population.best
        mean, moving = moving_moments(population)
        heading, covariance = motion_heading(mean, moving)
        table = image_surfaces(state, self.model)
        return Estimate(
            scan.step, scan.time_s, mean[:2].copy(), mean[2:4].copy(), heading, covariance, table,
            image_paths(state, self.model, heading), detected(table.existence, self.model.settings),
            np.nan, time.perf_counter() - began, info.health, image_hypotheses(population),
            rings=image_rings(state),
        )  # fmt: skip

    def map(self) -> Map:
        """The map as it stands: surfaces behind images, and a grid of which nothing was observed."""
        table = image_surfaces(self.state, self.model)
        found, blank = detected(table.existence, self.model.settings), Map.of_scene(self.scene)
        uniform = np.full((int(found.sum()), len(REFLECTION_BINS)), 1 / len(REFLECTION_BINS))
        own_map = dataclasses.replace(
            blank, surfaces=table.take(found), surface_reflection=uniform, provenance=self.latest()
        )
        return stamped(own_map, self.scene)
