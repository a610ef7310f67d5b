"""Adaptive SLAM (paper 002): agent, surfaces and one state per ray, "soft" ray tracing without a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.messages.births import Births
from gridslam.inference.messages.prediction import foresee
from gridslam.inference.messages.ray_amplitudes import RayAmplitudes
from gridslam.inference.state import surface_bank
from gridslam.inference.state.anchor_measurements import Heard
from gridslam.inference.state.particles import at_mean
from gridslam.inference.state.polylines import draw_paths
from gridslam.inference.state.rays import Rays
from gridslam.maps.map import Map
from gridslam.systems.surface_slam import SurfaceSlam
from gridslam.world.scene import Scene

Array = NDArray[np.float64]


class AdaptiveSlam(SurfaceSlam):
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
    """

    reflects = False

    def __init__(
        self, scene: Scene, prior_map: Map | None = None, agent: str | None = None, seed: int = 0
    ) -> None:
        super().__init__(scene, agent, seed)
        self.amplitudes = RayAmplitudes(self.signal)
        if prior_map is not None:
            self._start_from(prior_map)

    def _take_in(self, heard: Heard) -> None:
        """Messages of one anchor, in the order of the paper's section V."""
        # prediction of paths and amplitudes, eqs. (13), (14)
        rays, predicted, recipe = foresee(
            self.bank, self.sight, self.belief, self.anchors, heard.anchor, self.most_bounces, self.particles,
        )  # fmt: skip
        distance = predicted.value[:, 0]
        amplitudes = self.amplitudes.predict(rays, self.bank.identity, distance)
        # measurement evaluation, births, data association, updates of agent, surfaces and rays
        said, births = self._exchange(heard, rays, predicted, amplitudes, np.ones(len(rays)), recipe)
        # amplitudes, eq. (26); what was seen; new surfaces
        self.amplitudes.correct(
            rays, self.bank.identity, amplitudes, distance, heard, said.responsible, self.detected
        )
        drawn = draw_paths(rays, at_mean(self.belief), self.anchors)
        surface_bank.mark(self.bank, self.belief, rays, drawn, said.responsible.sum(1))
        self._learn_from_births(heard, births, said.claimed)

    def _tidy(self) -> None:
        """Merge and drop surfaces, and the amplitudes of their rays with them."""
        super()._tidy()
        self.amplitudes.forget(self.bank.identity)

    def _learn_from_births(self, heard: Heard, births: Births, claimed: Array) -> None:
        """Add new surfaces; the ray that bore each starts with the amplitude that was measured."""
        for measurement, last, first in self._bear(heard, births, claimed):
            length = float(heard.value[measurement, 0])
            self.amplitudes.start((heard.anchor, last, first), length, float(heard.amplitude[measurement]))

    def _strength(self, rays: Rays, distance: Array) -> Array:
        """Amplitudes of the rays' own states, eq. (18)."""
        return self.amplitudes.mean(rays, self.bank.identity, distance)
