"""The upper reference of hybrid SLAM: the same filter, told where the features are that it would learn.

Not a method to map with: it reads the scene's walls and scatterers, which no other filter may. What is left
between it and hybrid SLAM is what learning costs; [HybridSlam], section VII, compares with it, too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import SCATTERER, FeatureEstimate, SurfaceEstimate
from gridslam.inference.management.features.feature_tables import with_features
from gridslam.inference.management.features.hybrid_info import HANDED_ON, SIGHTS, HybridInfo, conclude
from gridslam.inference.management.features.surface_features import image_features
from gridslam.inference.messages.features.following import (
    count_step,
    follow_by_particles,
    follow_jointly,
    predict_agent,
    remember,
    step_samples,
)
from gridslam.inference.messages.features.learning import Learned
from gridslam.inference.messages.features.lessons import SETTLED, HybridWork, apply_lesson, begin_lesson
from gridslam.inference.state.features.hybrid_state import HybridState
from gridslam.maps.map import Map
from gridslam.systems.hybrid import start
from gridslam.systems.hybrid_front import HybridFilter
from gridslam.world.geometry import unit
from gridslam.world.scene import Scene
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan
from gridslam.world.waveform import Waveform

KNOWN_M, KNOWN_RAD = 1e-3, 1e-4
"""Deviations of what is told."""


def step(
    state: HybridState, scan: SignalScan, model: SignalModel, work: HybridWork
) -> tuple[HybridState, HybridInfo]:
    """Hybrid SLAM's step without any learning once particles have settled."""
    work.begin()
    received = step_samples(scan, model)
    state = predict_agent(state, scan.time_s, model, work.seed)
    if state.step < SETTLED:
        state, moments = follow_by_particles(state, received, model, work=work)
        state = remember(state, received, moments)
        state = count_step(state, received, moments, work.front, model)
        state, _ = apply_lesson(state, model, work=work)
        state = begin_lesson(state, model, work=work)
    else:
        state, moments = follow_jointly(state, received, model, work=work)
        state = count_step(state, received, moments, work.front, model)
    return state, conclude(state, moments, Learned(), received.heading_rad, work.times(), model)


def true_features(scene: Scene, model: SignalModel) -> tuple[FeatureEstimate, Array]:
    """Images of all anchors in the walls that reflect, and scatterers; the covariance of all x, y, b."""
    images, joint, _ = image_features(_surfaces(scene), None, model)
    tables = [images, *(_scatterer(one.position_m, one.size_m, model) for one in scene.scatterers)]
    whole = FeatureEstimate.stack(tables)
    count = len(whole)
    square = KNOWN_M**2 * np.eye(3 * count)
    square[: len(joint), : len(joint)] = joint
    return replace(whole, identity=np.arange(count)), square


def _surfaces(scene: Scene) -> SurfaceEstimate:
    """Lines of the walls that reflect, each once."""
    pieces = scene.segments()
    reflects = np.array([wall.reflects for wall in scene.walls], bool)[pieces.wall]
    rows = [np.flatnonzero(reflects & (pieces.surface == s))[0] for s in np.unique(pieces.surface[reflects])]
    if not rows:
        return SurfaceEstimate.empty()
    along = pieces.end[rows] - pieces.start[rows]
    angle = np.arctan2(along[:, 0], -along[:, 1])
    offset = (pieces.start[rows] * np.stack([np.cos(angle), np.sin(angle)], 1)).sum(1)
    turned = np.where(offset < 0, np.pi, 0.0)
    line = np.stack([angle + turned, np.abs(offset)], 1)
    middle = 0.5 * (pieces.start[rows] + pieces.end[rows])
    by_turn = np.stack([np.ones(len(rows)), (middle * unit(line[:, 0] + 0.5 * np.pi)).sum(1)], 1)
    spread = KNOWN_RAD**2 * by_turn[:, :, None] * by_turn[:, None]  # turned about the wall's own middle
    spread[:, 1, 1] += KNOWN_M**2
    count = len(rows)
    ones = np.ones(count)
    return SurfaceEstimate(
        np.arange(count), np.zeros((count, 2)), np.zeros((count, 2, 2)), line, spread,
        pieces.reflection[rows], 0 * ones, ones, np.full((count, 2), np.nan), np.full(count, -1),
    )  # fmt: skip


def _scatterer(place_m: Any, size_m: float, model: SignalModel) -> FeatureEstimate:
    """A scatterer as a feature of every anchor, with its power seen from where the agent starts."""
    anchors, place = model.anchors[:, :2], np.asarray(place_m, float)
    count = len(anchors)
    to = np.maximum(np.hypot(*(anchors - place).T), 1.0)
    fro = max(float(np.hypot(*(model.start_mean[:2] - place))), 1.0)
    level = model.radio.amplitude_at_1m**2 / len(model.waveform.agent_element_m)
    power = level * (size_m * (to + fro) / (to * fro)) ** 2
    covariance = np.tile(np.diag([KNOWN_M**2] * 3 + [0.0]), (count, 1, 1))
    covariance[:, 3, 3] = power**2
    zeros = np.zeros(count, np.int64)
    return FeatureEstimate(
        np.arange(count), np.arange(count), anchors, np.tile(place, (count, 1)),
        np.hypot(*(anchors - place).T), power, np.ones(count), covariance, np.full(count, SCATTERER),
        zeros, zeros - 1,
    )  # fmt: skip


class KnownHybridSlam(HybridFilter):
    """The front of the reference.

    Parameters
    ----------
    scene : Scene
        Walls and scatterers included: they are what it is told.
    prior_map : Map, optional
        Not used.
    agent, seed, same_frame, waveform
        As `SignalFilter`.
    """

    method = "hybrid-known"
    uses_maps = False
    truth_given = "true walls and scatterers"
    start = staticmethod(start)
    advance = staticmethod(step)

    def __init__(
        self, scene: Scene, prior_map: Map | None = None, agent: str | None = None, seed: int = 0,
        same_frame: bool = False, waveform: Waveform | None = None,
    ) -> None:  # fmt: skip
        super().__init__(scene, prior_map, agent, seed, same_frame, waveform)
        table, joint = true_features(scene, self.model)
        belief = with_features(self.state.joint, table, joint, self.model.anchor_positions)
        state = replace(
            self.state, joint=belief, before=belief, next_identity=len(belief.features), sights=SIGHTS,
            sighted=np.full(len(self.model.anchors), SIGHTS),
            unseen=np.full(len(self.model.anchors), HANDED_ON),
        )  # fmt: skip
        self.now = self.now._replace(believed=state)
