"""Grid SLAM (paper 003): agent, surfaces with coefficients and occupancy grid in one filter."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.inference import surfaces
from gridslam.inference.births import Births, draw_births
from gridslam.inference.cells import Cells
from gridslam.inference.heard import Heard
from gridslam.inference.materials import coefficient_factors, learn_reflection, reflected
from gridslam.inference.particles import sample
from gridslam.inference.prediction import predict_paths
from gridslam.inference.rays import rays_of
from gridslam.inference.told import Told
from gridslam.map import Map
from gridslam.scene import Scene
from gridslam.signal import REFLECTION_BINS
from gridslam.systems.surface_slam import SurfaceSlam

Array = NDArray[np.float64]
RAYS = 48
"""Sampled rays per path, from which validity and cell messages are averaged."""
MOSTLY_POSSIBLE = 0.8
"""Share of a path's samples that must be possible before it tells the cells anything."""
UNTOLD = 0.3
"""V of a birth whose mean path is impossible: others of its samples aren't, or it wouldn't be one."""
AUDIBLE = 0.05
"""Probability of having been heard below which a double bounce says nothing about coefficients."""


class GridSlam(SurfaceSlam):
    """Grid SLAM, one step at a time.

    Parameters
    ----------
    scene : Scene
        Radio, anchors, grid and filter settings; its walls are never read.
    prior_map : Map, optional
        Map that an earlier agent left: evidence, coefficients and surfaces.
    agent : str, optional
        Which of the scene's agents (default: the first): start, prior and array.
    seed : int
    """

    def __init__(
        self, scene: Scene, prior_map: Map | None = None, agent: str | None = None, seed: int = 0
    ) -> None:
        super().__init__(scene, agent, seed)
        grid, free_path = scene.grid, self.settings.mean_free_path_m
        self.cells = Cells(np.array(grid.origin_m), grid.cell_m, grid.shape, free_path, self.places)
        self._to_tell: list[Told] = []
        if prior_map is not None:
            self._start_from(prior_map)

    def _move(self, now: float) -> None:
        """Motion; what a step that was interrupted left to be told is dropped."""
        self._to_tell = []
        self.cells.forget()
        super()._move(now)

    def _take_in(self, heard: Heard) -> None:
        """Messages of one anchor, in the paper's order (section IV; model.md, sections 2.1 to 2.6)."""
        # prediction: paths, their validity in the grid, eq. (1), and amplitudes, eq. (2)
        rays = rays_of(self.bank, self.sight, heard.anchor, self.most_bounces)
        predicted = predict_paths(rays, self.belief, self.anchors)
        few = sample(self.belief, RAYS, self._stream(heard.anchor, 0))
        drawn = self.cells.see(rays, few, self.anchors)
        amplitudes = reflected(rays, self.bank, drawn, self.cells, self.signal)
        # measurement evaluation, births, data association, updates of agent, surfaces and rays
        said = self._exchange(heard, rays, predicted, amplitudes, drawn.validity)
        # what cells and coefficients are to be told; new surfaces
        distance = predicted.value[:, 0]
        self._to_tell.append(Told.of(heard, rays, distance, said.chance, said.worth, said.responsible))
        self._bear(heard, said.births, said.claimed)

    def _reachable(self, heard: Heard, births: Births) -> Births:
        """Births weighed by the validity of their paths in the grid."""
        rays, cloud = draw_births(births, self.belief, heard.anchor)
        drawn = self.cells.see(rays, cloud, self.anchors)
        return births.weighed(np.where(drawn.valid[:, 0] > 0.5, drawn.validity, UNTOLD))

    def _tidy(self) -> None:
        """Messages of all anchors to coefficients and cells; then merge and drop surfaces."""
        self._tell(Told.stack(self._to_tell))
        self.cells.absorb()
        super()._tidy()

    def _tell(self, told: Told) -> None:
        """Messages to the cells that each path crosses or meets, eqs. (43) to (45), and to coefficients."""
        rays, share = told.rays, told.share
        belief = rays.surfaces * rays.existence
        few = sample(self.belief, RAYS, self._stream(len(self.places), 1))
        worth, send = belief * told.worth + 1 - belief, belief > 0.1
        drawn = self.cells.tell(rays, few, self.anchors, worth, send, MOSTLY_POSSIBLE)
        send &= drawn.valid.mean(1) > MOSTLY_POSSIBLE
        surfaces.mark(self.bank, self.belief, rays, drawn, share * send)
        # coefficients of surfaces, by single bounces; of cells, since a window isn't the wall around it
        # (model.md, section 2.5), by both ends of double bounces, too
        usual = np.append(self.bank.reflection @ REFLECTION_BINS, 1.0)
        double = send & (rays.bounces == 2) & (share > AUDIBLE)
        alone = np.flatnonzero((rays.bounces == 1) & (share > AUDIBLE))
        at_last = np.flatnonzero(double | (send & (rays.bounces == 1)))
        at_first = np.flatnonzero(double)
        beyond = np.where(double, usual[rays.first], 1.0)[at_last]
        rows = np.concatenate([alone, at_last, at_first])
        other = np.concatenate([np.ones(len(alone)), beyond, usual[rays.last[at_first]]])
        factor = coefficient_factors(told, rows, other, self.detected, self.signal)
        learn_reflection(self.bank, rays.last[alone], factor[: len(alone)])
        corner = np.concatenate([np.where(double, 2, 1)[at_last], np.ones(len(at_first), np.intp)])
        met, news = rows[len(alone) :], rays.surfaces[rows, None] * factor
        self.cells.weigh_coefficient(rays, drawn, np.stack([met, corner], -1), news[len(alone) :])

    def map(self) -> Map:
        """The map as it stands: evidence, coefficients, detected surfaces."""
        return replace(
            super().map(),
            evidence=self.cells.evidence.astype(np.float32),
            coefficient=self.cells.coefficient.astype(np.float32),
            observed=self.cells.observed.copy(),
        )

    def _start_from(self, prior: Map) -> Map:
        """Start from another agent's map (paper 003, section IV-C)."""
        prior = super()._start_from(prior)
        self.cells.evidence = prior.evidence.astype(np.float64)
        self.cells.observed = prior.observed.copy()
        self.cells.coefficient = prior.coefficient.astype(np.float64)
        return prior

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, from which `resume` goes on bit for bit."""
        from gridslam.checkpoint import save

        save(self, path)

    @staticmethod
    def resume(path: str | os.PathLike[str]) -> GridSlam:
        """Read a checkpoint; `InputError` if it isn't one."""
        from gridslam.checkpoint import resume

        return resume(path)
