"""Grid SLAM (paper 003): agent, surfaces with coefficients and occupancy grid in one filter."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.estimates import Estimate, SurfaceEstimate
from gridslam.inference import surfaces
from gridslam.inference.association import associate
from gridslam.inference.births import draw_births, propose
from gridslam.inference.cells import Cells
from gridslam.inference.correction import correct
from gridslam.inference.evaluation import evaluate, gate
from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import detection, strengths
from gridslam.inference.materials import coefficient_factors, learn_reflection, reflected
from gridslam.inference.particles import sample
from gridslam.inference.polylines import draw_paths
from gridslam.inference.rays import Rays, predict_paths, rays_of, remember
from gridslam.inference.readout import surface_estimate
from gridslam.map import Map
from gridslam.measurements import Scan
from gridslam.scene import Scene
from gridslam.signal import REFLECTION_BINS
from gridslam.systems.surface_slam import SurfaceSlam

Array = NDArray[np.float64]
RAYS = 48
"""Sampled rays per path, from which validity and cell messages are averaged."""
MOSTLY_POSSIBLE = 0.8
"""Share of a path's samples that must be possible before it tells the cells anything."""
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
        self.provenance: dict[str, list] = {"agents": [], "seeds": [], "steps": []}
        if prior_map is not None:
            self._start_from(prior_map)

    def step(self, scan: Scan) -> Estimate:
        """Take in what was heard at one step and return what is believed now."""
        began = time.perf_counter()
        self._move(scan.time_s)
        for heard in self._hear(scan):
            self._take_in(heard)
        self.cells.absorb()
        self._tidy()
        return self._estimate(scan, time.perf_counter() - began)

    def _take_in(self, heard: Heard) -> None:
        """Messages of one anchor, in the paper's order (section IV; model.md, sections 2.1 to 2.6)."""
        signal, settings, bounces = self.signal, self.settings, self.scene.radio.max_bounces
        # prediction: paths, their validity in the grid, eq. (1), and amplitudes, eq. (2)
        rays = rays_of(self.bank, self.sight, heard.anchor, bounces)
        predicted = predict_paths(rays, np.arange(len(rays)), self.belief, heard.place, heard.facing)
        distance = predicted.value[:, 0]
        few = sample(self.belief, RAYS, self._stream(heard.anchor, 0))
        drawn = draw_paths(rays.bounces, rays.last, rays.first, few, heard.place)
        validity = self.cells.validity(drawn)
        at_last, at_first = (self.cells.coefficient_at(p) for p in (drawn.last_points, drawn.first_points))
        amplitudes = reflected(rays, self.bank, at_last, at_first, signal)
        detected = detection(amplitudes, distance, self.detected)

        # measurement evaluation, births, data association
        strength = strengths(amplitudes, heard, distance, self.detected, signal)
        pairs = gate(predicted, heard, strength, rays.existence * rays.surfaces * validity, signal)
        cloud = self.particles.cloud(self.belief)
        ratio, possible = evaluate(rays, cloud, pairs, predicted, heard)
        ratio, validity = ratio / np.maximum(possible, 1e-3)[:, None], validity * possible
        chance = rays.existence * validity
        beta = (rays.surfaces * chance)[:, None] * ratio
        births = propose(
            heard, self.belief, self.bank, cloud, beta.sum(0), signal, settings.births, self.radius_m, bounces
        )
        births = births.weighed(self.cells.validity(draw_births(births, self.belief, heard.place)))
        missed = np.maximum(1 - rays.surfaces * chance * detected, 1e-9)
        nu, claimed = associate(beta, missed, 1 + births.per_measurement(len(heard)))
        worth = (nu * ratio).sum(1) + 1 - detected

        # updates of agent and surfaces, coefficients, existence
        self.belief, responsible = correct(
            self.belief, rays, rays.surfaces * chance, detected, beta, nu, pairs, heard
        )
        self._learn_materials(heard, rays, distance, responsible, chance)
        remember(self.bank, self.sight, rays, heard.anchor, worth, validity)
        surfaces.exist(self.bank, rays, chance, worth)
        self._tell_cells(heard, rays, distance, worth, responsible, chance)
        self._bear(heard, births, claimed)

    def _learn_materials(
        self, heard: Heard, rays: Rays, distance: Array, responsible: Array, chance: Array
    ) -> None:
        """Coefficients of the surfaces, by what the amplitudes of their single bounces said."""
        rows = np.flatnonzero((rays.bounces == 1) & (responsible.sum(1) > AUDIBLE))
        factor = self._factors(heard, distance, np.ones(len(rays)), responsible, chance, rows)
        learn_reflection(self.bank, rays.last[rows], factor)

    def _tell_cells(
        self, heard: Heard, rays: Rays, distance: Array, worth: Array, responsible: Array, chance: Array
    ) -> None:
        """Messages to the cells that each path crosses or meets, eqs. (43) to (45), and to coefficients."""
        belief, share = rays.surfaces * rays.existence, responsible.sum(1)
        few = sample(self.belief, RAYS, self._stream(heard.anchor, 1))
        drawn = draw_paths(rays.bounces, rays.last, rays.first, few, heard.place)
        send = (drawn.valid.mean(1) > MOSTLY_POSSIBLE) & (belief > 0.1)
        rows = np.flatnonzero(send)
        self.cells.tell(drawn.take(rows), belief[rows] * worth[rows] + 1 - belief[rows])
        surfaces.mark(self.bank, self.belief, rays, drawn, share * send)
        # a window isn't the wall around it (model.md, section 2.5)
        usual = np.append(self.bank.reflection @ REFLECTION_BINS, 1.0)
        double = send & (rays.bounces == 2) & (share > AUDIBLE)
        for points, other, chosen in (
            (
                drawn.last_points,
                np.where(double, usual[rays.first], 1.0),
                double | (send & (rays.bounces == 1)),
            ),
            (drawn.first_points, usual[rays.last], double),
        ):
            rows = np.flatnonzero(chosen)
            factor = self._factors(heard, distance, other, responsible, chance, rows)
            self.cells.weigh_coefficient(points[rows], rays.surfaces[rows, None] * factor)

    def _factors(
        self, heard: Heard, distance: Array, other: Array, responsible: Array, chance: Array,
        rows: NDArray[np.intp],
    ) -> Array:  # fmt: skip
        return coefficient_factors(
            heard, distance[rows], other[rows], responsible[rows], chance[rows], self.detected, self.signal
        )

    def map(self) -> Map:
        """The map as it stands: evidence, coefficients, detected surfaces."""
        table = surface_estimate(self.belief, self.bank)
        found = table.existence > self.settings.detect_above
        provenance: dict[str, Any] = {
            "agents": [*self.provenance["agents"], self.agent],
            "seeds": [*self.provenance["seeds"], self.seed],
            "steps": [*self.provenance["steps"], self.steps],
        }
        return Map(
            np.asarray(self.cells.origin), self.cells.cell, self.cells.evidence.astype(np.float32),
            self.cells.coefficient.astype(np.float32), self.cells.observed.copy(), float(self.cells.prior),
            table.take(found), self.bank.reflection[found].copy(), provenance,
        )  # fmt: skip

    def _start_from(self, prior: Map) -> None:
        """Start from another agent's map (paper 003, section IV-C)."""
        prior = prior.resample(self.cells.origin, self.cells.cell, self.cells.shape)
        self.cells.evidence = prior.evidence.astype(np.float64)
        self.cells.observed = prior.observed.copy()
        self.cells.coefficient = prior.coefficient.astype(np.float64)
        for key in self.provenance:
            earlier = prior.provenance.get(key)
            self.provenance[key] = list(earlier) if isinstance(earlier, list) else []
        known = prior.surfaces if prior.surfaces is not None else SurfaceEstimate.empty()
        self._inherit(known, prior.surface_reflection)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, from which `resume` goes on bit for bit."""
        from gridslam.checkpoint import save

        save(self, path)

    @staticmethod
    def resume(path: str | os.PathLike[str]) -> GridSlam:
        """Read a checkpoint; `InputError` if it isn't one."""
        from gridslam.checkpoint import resume

        return resume(path)
