"""Grid SLAM (paper 003): agent, surfaces with coefficients and occupancy grid in one filter."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.messages.cells import Cells
from gridslam.inference.messages.prediction import look_ahead
from gridslam.inference.messages.reflection import Reflected, learn
from gridslam.inference.state.anchor_measurements import Heard
from gridslam.inference.state.path_messages import Notes
from gridslam.maps.frames import assured
from gridslam.maps.map import Map
from gridslam.systems.surface_slam import SurfaceSlam
from gridslam.world.scene import Scene

Array = NDArray[np.float64]
RAYS = 48
"""Sampled rays per path, from which validity and cell messages are averaged."""
MOSTLY_POSSIBLE = 0.8
"""Share of a path's samples that must be possible before it tells the cells anything."""


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
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.
    """

    def __init__(
        self,
        scene: Scene,
        prior_map: Map | None = None,
        agent: str | None = None,
        seed: int = 0,
        same_frame: bool = False,
    ) -> None:
        super().__init__(scene, agent, seed)
        grid, free_path = scene.grid, self.settings.mean_free_path_m
        self.cells = Cells(np.array(grid.origin_m), grid.cell_m, grid.shape, free_path, self.places)
        self.notes = Notes()
        if prior_map is not None:
            self._start_from(assured(prior_map, scene) if same_frame else prior_map)

    def _move(self, now: float) -> None:
        """Motion; what a step that was interrupted left to be told is dropped."""
        self.notes.clear()
        self.cells.forget()
        super()._move(now)

    def _take_in(self, heard: Heard) -> None:
        """Messages of one anchor, in the paper's order (section IV; model.md, sections 2.1 to 2.6)."""
        # prediction: paths, their validity in the grid, eq. (1), and amplitudes, eq. (2)
        ahead, recipe = look_ahead(
            self.bank, self.sight, self.belief, self.anchors, heard.anchor, self.most_bounces, self.particles,
            self._number(heard.anchor), RAYS,
        )  # fmt: skip
        validity, products = self.cells.see(ahead, self.bank.reflection)
        rays, predicted = ahead.paths()
        amplitudes = Reflected(products, self.signal)
        # measurement evaluation, births, data association, updates of agent, surfaces and rays
        said, births = self._exchange(heard, rays, predicted, amplitudes, validity, recipe)
        # new surfaces; what cells and coefficients are to be told was noted
        self._bear(heard, births, said.claimed)

    def _number(self, anchor: int) -> int:
        """Which points states are sampled by: others for every step and anchor."""
        return self.steps * (len(self.places) + 1) + anchor

    def _space(self) -> Cells:
        return self.cells

    def _tidy(self) -> None:
        """Messages of all anchors to coefficients and cells; then merge and drop surfaces."""
        self._tell()
        self.cells.absorb()
        super()._tidy()

    def _tell(self) -> None:
        """Messages to the cells that each path crosses or meets, eqs. (43) to (45), and to coefficients."""
        few = self.particles.samples(self.belief, self._number(len(self.places)), RAYS)
        drawn = self.cells.tell(self.notes, few, self.anchors, MOSTLY_POSSIBLE)
        learn(
            self.notes, self.bank, self.belief, drawn, MOSTLY_POSSIBLE, self.cells, self.detected, self.signal
        )

    def map(self) -> Map:
        """The map as it stands: evidence, coefficients, detected surfaces."""
        return replace(
            super().map(),
            evidence=self.cells.evidence.astype(np.float32),
            coefficient=self.cells.coefficient.copy(),
            observed=self.cells.observed.copy(),
        )

    def _start_from(self, prior: Map) -> Map:
        """Start from another agent's map (paper 003, section IV-C)."""
        prior = super()._start_from(prior)
        self.cells.evidence = prior.evidence.astype(np.float64)
        self.cells.observed = prior.observed.copy()
        self.cells.coefficient = prior.coefficient.copy()
        return prior

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, from which `resume` goes on bit for bit."""
        from gridslam.systems.checkpoint import save

        save(self, path)

    @staticmethod
    def resume(path: str | os.PathLike[str]) -> GridSlam:
        """Read a checkpoint; `InputError` if it isn't one."""
        from gridslam.systems.checkpoint import resume

        return resume(path)
