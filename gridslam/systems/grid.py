"""Grid SLAM (paper 003): agent, surfaces with coefficients and occupancy grid in one filter."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.estimates import Estimate, PathEstimate, SurfaceEstimate
from gridslam.geometry import unit, wrap
from gridslam.inference import surfaces as bank_of
from gridslam.inference.association import associate
from gridslam.inference.belief import AGENT, Belief, predict, update
from gridslam.inference.births import Candidate, bear, birth_ratios, birth_reflection
from gridslam.inference.cells import Cells
from gridslam.inference.rays import (
    AmplitudeTable,
    Rays,
    coefficient_beliefs,
    likelihood,
    predict_paths,
    rays_of,
    sample_traces,
)
from gridslam.map import Map
from gridslam.measurements import Scan
from gridslam.scene import Scene
from gridslam.signal import REFLECTION_BINS

Array = NDArray[np.float64]
RAYS = 48
"""Sampled rays per path, from which validity and cell messages are averaged."""


@dataclass
class _Heard:
    """What one anchor's measurements said of its paths, for the cells and the estimate."""

    rays: Rays
    bracket: Array
    validity: Array
    existence: Array
    responsible: Array
    rows: NDArray[np.intp]
    detection: Array


class GridSlam:
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
        self.scene, self.seed = scene, seed
        body = scene.agent(agent) if agent else scene.agents[0]
        self.agent, self.settings = body.name, scene.filter
        self.signal = scene.signal_model(body.name)
        self.places, self.facings = scene.anchor_positions, scene.anchor_orientations
        half = np.array(
            [body.prior.position_m] * 2 + [body.prior.velocity_mps] * 2 + [np.radians(body.prior.heading_deg)]
        )
        half = np.maximum(half, 1e-4)
        mean = np.array([*body.start_m, 0.0, 0.0, np.radians(body.start_heading_deg)])
        # the agent moves at an unknown speed from the first step on
        variance = half**2 / 3
        variance[2:4] += (body.step_m / body.interval_s) ** 2
        self.belief = Belief(mean, np.diag(variance))
        self.bank = bank_of.Bank.empty(len(self.places))
        self.sight = np.full(len(self.places), 0.9)
        grid = scene.grid
        self.cells = Cells(
            np.array(grid.origin_m), grid.cell_m, grid.shape, self.settings.mean_free_path_m, self.places
        )
        self.region_m2 = float(np.prod(np.array(grid.shape)) * grid.cell_m**2)
        self._middle = np.asarray(grid.origin_m) + 0.5 * grid.cell_m * np.array(grid.shape[::-1])
        self._table = AmplitudeTable(self.signal)
        self.last_time: float | None = None
        self.next_identity, self.steps = 0, 0
        self.provenance: dict[str, list] = {"agents": [], "seeds": [], "steps": []}
        if prior_map is not None:
            self._inherit(prior_map)

    def step(self, scan: Scan) -> Estimate:
        """Take in what was heard at one step and return what is believed now."""
        began = time.perf_counter()
        self._predict(scan.time_s)
        rows = [np.flatnonzero(scan.anchor == anchor) for anchor in range(len(self.places))]
        heard = [self._hear(scan, anchor, rows[anchor]) for anchor in range(len(self.places))]
        self.cells.absorb()
        self.bank, self.belief = bank_of.merge(self.bank, self.belief, self._middle)
        self.bank, self.belief = bank_of.prune(self.bank, self.belief, self.settings.prune_below)
        self.steps += 1
        return self._estimate(scan, heard, time.perf_counter() - began)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, from which `resume` goes on bit for bit."""
        from gridslam.checkpoint import save

        save(self, path)

    @staticmethod
    def resume(path: str | os.PathLike[str]) -> GridSlam:
        """Read a checkpoint; `InputError` if it isn't one."""
        from gridslam.checkpoint import resume

        return resume(path)

    # ---- messages of one step -------------------------------------------------------------------

    def _predict(self, now: float) -> None:
        """Motion of the agent, jitter of the surfaces, survival (paper 003, section III-C)."""
        if self.last_time is not None:
            self.belief = predict(
                self.belief,
                now - self.last_time,
                self.settings.acceleration_mps2,
                np.radians(self.settings.heading_deg),
                self.settings.surface_m * 0.2,
                self.bank.foot,
            )
            bank_of.evolve(self.bank, self.settings.survival, self.settings.reflection)
        self.last_time = now

    def _hear(self, scan: Scan, anchor: int, rows: NDArray[np.intp]) -> _Heard:
        """Measurement evaluation, association, updates and births of one anchor."""
        place, facing = self.places[anchor], self.facings[anchor]
        rays = rays_of(self.bank, self.sight, anchor, self.scene.radio.max_bounces)
        everything = np.arange(len(rays))
        corners, normals, valid = self._corners(rays, anchor, 0)
        validity = (self.cells.cast(corners, normals, rays.bounces, np.ones(len(rays)), False) * valid).mean(
            1
        )
        at_cells = np.zeros((len(rays), 2, len(REFLECTION_BINS)))
        for ray in np.flatnonzero(rays.bounces > 0):
            at_cells[ray, 0] = self.cells.coefficient_at(corners[ray, :, rays.bounces[ray]])
            at_cells[ray, 1] = self.cells.coefficient_at(corners[ray, :, 1])
        coefficients = coefficient_beliefs(rays, self.bank, at_cells)
        predicted = predict_paths(rays, everything, self.belief, place, facing)
        detection = np.array(
            [
                p @ self._table(self.signal.amplitude(d, c))
                for d, (c, p) in zip(predicted.value[:, 0], coefficients, strict=True)
            ]
        )
        ratio = np.zeros((len(rays), len(rows)))
        for ray in everything:
            reach = 6 * np.sqrt(predicted.spread[ray, 0, 0]) + 0.5
            near = np.isnan(scan.distance_m[rows]) | (
                np.abs(scan.distance_m[rows] - predicted.value[ray, 0]) < reach
            )
            if near.any() and validity[ray] > 1e-6:
                ratio[ray, near] = likelihood(
                    scan,
                    rows[near],
                    predicted.value[ray],
                    predicted.spread[ray],
                    coefficients[ray],
                    anchor,
                    self.signal,
                )[0]
        exist = rays.existence * validity
        candidates = birth_ratios(
            scan, rows, self.belief, self.bank, anchor, place, facing, self.signal,
            self.settings.births, self.region_m2, self.scene.radio.max_bounces,
        )  # fmt: skip
        self._shade(candidates, anchor)
        born = np.array([sum(c.ratio for c in found) for found in candidates])
        beta = (rays.surfaces * exist)[:, None] * ratio
        missed = np.maximum(1 - rays.surfaces * exist * detection, 1e-9)
        nu, claimed = associate(beta, missed, 1 + born)

        responsible = self._update(scan, rows, anchor, rays, nu, beta, exist, detection, coefficients)
        bracket = (nu * ratio).sum(1) + 1 - detection
        self._reflect(scan, rows, rays, nu, ratio, exist, coefficients, responsible, predicted.value)
        self._exist(rays, exist, validity, bracket, nu, ratio, detection, anchor)
        self._map(scan, rows, rays, bracket, responsible, anchor, predicted.value, exist, coefficients)
        self._births(scan, candidates, born, claimed, anchor)
        return _Heard(rays, bracket, validity, exist, responsible, rows, detection)

    def _update(
        self, scan: Scan, rows: NDArray[np.intp], anchor: int, rays: Rays, nu: Array, beta: Array,
        exist: Array,
        detection: Array, coefficients: list[tuple[Array, Array]],
    ) -> Array:  # fmt: skip
        """Update agent and surfaces by every path in turn, surest first; return who caused what (L, M)."""
        weight = beta * nu
        total = weight.sum(1) / (weight.sum(1) + np.maximum(1 - rays.surfaces * exist * detection, 1e-9))
        responsible = np.zeros_like(weight)
        for ray in np.argsort(-total, kind="stable"):
            if total[ray] < 1e-3:
                break
            near = np.flatnonzero(weight[ray] > 1e-6 * weight[ray].max())
            now = predict_paths(rays, np.array([ray]), self.belief, self.places[anchor], self.facings[anchor])
            ratio, residual, variance = likelihood(
                scan, rows[near], now.value[0], now.spread[0], coefficients[ray], anchor, self.signal
            )
            share = rays.surfaces[ray] * exist[ray] * nu[ray, near] * ratio
            share = share / (share.sum() + max(1 - rays.surfaces[ray] * exist[ray] * detection[ray], 1e-9))
            responsible[ray, near] = share
            self.belief = update(self.belief, now.jacobian[0], residual, variance, share)
        return responsible

    def _reflect(
        self, scan: Scan, rows: NDArray[np.intp], rays: Rays, nu: Array, ratio: Array, exist: Array,
        coefficients: list[tuple[Array, Array]], responsible: Array, value: Array,
    ) -> None:  # fmt: skip
        """Update the surfaces' reflection coefficients by what their paths' amplitudes said."""
        for ray in np.flatnonzero((rays.bounces == 1) & (responsible.sum(1) > 0.05)):
            factor = self._coefficient_factor(scan, rows, responsible[ray], value[ray, 0], 1.0, exist[ray])
            surface = rays.last[ray]
            posterior = self.bank.reflection[surface] * np.exp(factor - factor.max()) + 1e-9
            self.bank.reflection[surface] = posterior / posterior.sum()

    def _coefficient_factor(
        self, scan: Scan, rows: NDArray[np.intp], share: Array, distance: float, other: float, exist: float
    ) -> Array:
        """Log-likelihood over the coefficient: Rician for detections, 1 - p_d for misses, softly weighted."""
        level = self.signal.amplitude(distance, REFLECTION_BINS * other)
        factor = max(1 - share.sum(), 0.0) * np.log(1 - exist * self._table(level) + 1e-9)
        for row, weight in zip(rows, share, strict=True):
            if weight > 1e-3 and not np.isnan(scan.amplitude[row]):
                factor = factor + weight * self.signal.log_rician(
                    np.full(len(level), scan.amplitude[row]), level
                )
        return factor

    def _exist(
        self,
        rays: Rays,
        exist: Array,
        validity: Array,
        bracket: Array,
        nu: Array,
        ratio: Array,
        detection: Array,
        anchor: int,
    ) -> None:
        """Existence of surfaces and rays (model.md, sections 2.2 and 2.6 (a))."""
        whole = exist * bracket + 1 - exist
        old = self.bank.existence.copy()
        log = np.zeros(len(old))
        for ray in np.flatnonzero(rays.bounces > 0):
            last, first = rays.last[ray], rays.first[ray]
            for own, other in {(last, first), (first, last)}:
                partner = 1.0 if own == other else old[other]
                log[own] += np.log(max(partner * whole[ray] + 1 - partner, 1e-12))
        odds = np.log(np.maximum(old, 1e-12)) - np.log(np.maximum(1 - old, 1e-9)) + log
        self.bank.existence = np.clip(1 / (1 + np.exp(-np.clip(odds, -40, 40))), 0, 1 - 1e-7)
        ahead = rays.surfaces * validity * bracket + 1 - rays.surfaces * validity
        after = rays.existence * ahead / (rays.existence * ahead + 1 - rays.existence)
        for number, value in enumerate(after):
            ray = np.intp(number)
            if rays.bounces[ray] == 0:
                self.sight[anchor] = value
            elif rays.bounces[ray] == 1:
                self.bank.single[anchor, rays.last[ray]] = value
            else:
                self.bank.double[anchor, rays.last[ray], rays.first[ray]] = value

    def _map(
        self, scan: Scan, rows: NDArray[np.intp], rays: Rays, bracket: Array, responsible: Array, anchor: int,
        value: Array,
        exist: Array, coefficients: list[tuple[Array, Array]],
    ) -> None:  # fmt: skip
        """Send the messages of eqs. (43)-(45) to the cells that each path crosses or meets, and mark hits."""
        corners, normals, valid = self._corners(rays, anchor, 1)
        solid = valid.mean(1) > 0.8
        belief = rays.surfaces * rays.existence
        send = np.flatnonzero(solid & (belief > 0.1))
        chosen = Rays(
            *(getattr(rays, name)[send] for name in ("bounces", "last", "first", "existence", "surfaces"))
        )
        worth = belief[send] * bracket[send] + 1 - belief[send]
        self.cells.cast(corners[send], normals[send], chosen.bounces, worth, True)
        share = responsible.sum(1)
        for ray in send[rays.bounces[send] > 0]:
            ends = (rays.last[ray], rays.first[ray]) if rays.bounces[ray] == 2 else (rays.last[ray],)
            for number, surface in enumerate(ends):
                points = corners[ray, :, rays.bounces[ray] if number == 0 else 1]
                other = (
                    1.0 if len(ends) == 1 else float(self.bank.reflection[ends[1 - number]] @ REFLECTION_BINS)
                )
                if share[ray] > 0.05 or rays.bounces[ray] == 1:
                    factor = self._coefficient_factor(
                        scan, rows, responsible[ray], value[ray, 0], other, exist[ray]
                    )
                    self.cells.weigh_coefficient(points, rays.surfaces[ray] * factor)
                if share[ray] > 0.5:
                    angle = self.belief.lines[surface, 0]
                    along = float(points.mean(0) @ unit(angle + 0.5 * np.pi))
                    bank_of.mark(self.bank, int(surface), along)
        detected = {
            int(s) for ray in np.flatnonzero(share > 0.5) for s in (rays.last[ray], rays.first[ray]) if s >= 0
        }
        for surface in detected:
            self.bank.seen[surface] += 1

    def _births(
        self, scan: Scan, candidates: list[list[Candidate]], born: Array, claimed: Array, anchor: int
    ) -> None:
        """Add the new surfaces that are likely enough, each by its best hypothesis."""
        chance = born / (1 + born + claimed) if len(born) else born
        for number in np.argsort(-chance, kind="stable"):
            if chance[number] < 0.5 * self.settings.prune_below:
                break
            best = max(candidates[number], key=lambda c: c.ratio)
            fresh = bear(
                best, scan, self.belief, self.places[anchor], self.facings[anchor], anchor, self.signal
            )
            if fresh.covariance[-1, -1] > 4.0 or not np.isfinite(fresh.mean).all():
                continue
            self.belief = fresh
            foot = float(self.belief.mean[:2] @ unit(self.belief.lines[-1, 0] + 0.5 * np.pi))
            existence = float(chance[number] * best.ratio / born[number])
            reflection = birth_reflection(best, scan, self.signal)
            bearer = (anchor, best.last, best.first)
            self.bank = self.bank.add(self.next_identity, existence, reflection, foot, bearer)
            self.next_identity += 1

    def _shade(self, candidates: list[list[Candidate]], anchor: int) -> None:
        """Weigh births by the validity of their path: the grid says whether a wall stands in the way."""
        flat = [c for found in candidates for c in found]
        corners = np.stack([c.corners for c in flat])[:, None] if flat else np.zeros((0, 1, 4, 2))
        bounces = np.array([2 if max(c.last, c.first) >= 0 else 1 for c in flat], dtype=np.intp)
        normals = np.zeros((len(flat), 1, 2, 2))
        for number, c in enumerate(flat):
            lines = [self.belief.lines[i] if i >= 0 else c.line for i in (c.first, c.last)]
            normals[number, 0] = [unit(line[0]) for line in lines]
        validity = self.cells.cast(corners, normals, bounces, np.ones(len(flat)), False)[:, 0]
        open_path = dict(zip(map(id, flat), validity, strict=True))
        for found in candidates:
            found[:] = [replace(c, ratio=c.ratio * open_path[id(c)]) for c in found]

    def _corners(self, rays: Rays, anchor: int, purpose: int) -> tuple[Array, Array, Array]:
        """Sampled polylines of all rays: corners (L, R, 4, 2), normals (L, R, 2, 2), validity (L, R)."""
        draw = np.random.default_rng([self.seed, self.steps, anchor, purpose])
        size = len(self.belief.mean)
        values, vectors = np.linalg.eigh(self.belief.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0))
        states = self.belief.mean + draw.standard_normal((RAYS, size)) @ root.T
        traced = sample_traces(rays, states, self.places[anchor])
        count = len(rays)
        agent = np.broadcast_to(states[:, :2], (count, RAYS, 2))
        corners = np.stack([np.broadcast_to(self.places[anchor], agent.shape), agent, agent, agent], 2).copy()
        first = traced.first_point.reshape(count, RAYS, 2)
        last = traced.last_point.reshape(count, RAYS, 2)
        corners[rays.bounces >= 1, :, 1] = first[rays.bounces >= 1]
        corners[rays.bounces == 2, :, 2] = last[rays.bounces == 2]
        valid = traced.valid.reshape(count, RAYS) & (np.abs(corners) < 1e4).all((2, 3))
        corners = np.where(valid[:, :, None, None], np.nan_to_num(corners), self.places[anchor])
        lines = states[:, AGENT:].reshape(RAYS, -1, 2)
        normals = np.zeros((count, RAYS, 2, 2))
        if lines.shape[1]:
            facing = np.swapaxes(unit(lines[:, :, 0]), 0, 1)
            normals[:, :, 0] = facing[np.maximum(rays.first, 0)]
            normals[:, :, 1] = facing[np.maximum(rays.last, 0)]
        return corners, normals, valid

    # ---- what comes out -------------------------------------------------------------------------

    def _surfaces(self) -> SurfaceEstimate:
        line, covariance = bank_of.canonical_lines(self.belief)
        mean = self.bank.reflection @ REFLECTION_BINS
        variance = self.bank.reflection @ REFLECTION_BINS**2 - mean**2
        flip = self.belief.lines[:, 1] < 0  # the tangent turns with the normal
        extent = np.where(flip[:, None], -self.bank.extent[:, ::-1], self.bank.extent)
        return SurfaceEstimate.from_lines(
            line, covariance, mean, variance, self.bank.existence, extent, self.bank.identity
        )

    def _estimate(self, scan: Scan, heard: list[_Heard], seconds: float) -> Estimate:
        surfaces = self._surfaces()
        detected = surfaces.existence > self.settings.detect_above
        mean = self.belief.mean
        return Estimate(
            scan.step, scan.time_s, mean[:2].copy(), mean[2:4].copy(), float(wrap(mean[4])),
            self.belief.covariance[:AGENT, :AGENT].copy(), surfaces, self._paths(), detected,
            float(self.settings.particles), seconds,
        )  # fmt: skip

    def _paths(self) -> PathEstimate:
        """Paths believed in now, over the surfaces as they stand."""
        tables = []
        for anchor in range(len(self.places)):
            rays = rays_of(self.bank, self.sight, anchor, self.scene.radio.max_bounces)
            memory = np.concatenate(
                [
                    [self.sight[anchor]],
                    self.bank.single[anchor],
                    self.bank.double[anchor, rays.last, rays.first][rays.bounces == 2],
                ]
            )
            chance = memory * rays.surfaces
            rows = np.flatnonzero(chance > 0.5)
            found = predict_paths(rays, rows, self.belief, self.places[anchor], float(self.facings[anchor]))
            rows, good = rows[found.geometry.valid], found.geometry.valid
            mean = np.append(self.bank.reflection @ REFLECTION_BINS, 1.0)
            strength = mean[rays.last[rows]] * np.where(rays.bounces[rows] == 2, mean[rays.first[rows]], 1.0)
            points = np.full((len(rows), 4, 2), np.nan)
            points[:, 0], points[:, 3] = self.places[anchor], self.belief.mean[:2]
            points[:, 1] = found.geometry.first_point[good]
            double = rays.bounces[rows] == 2
            points[double, 2] = found.geometry.last_point[good][double]
            identity = np.append(self.bank.identity, -1)
            value = found.value[good]
            tables.append(
                PathEstimate(
                    np.full(len(rows), anchor),
                    np.stack([identity[rays.last[rows]], identity[rays.first[rows]]], -1),
                    value[:, 0],
                    value[:, 1],
                    value[:, 2],
                    self.signal.amplitude(value[:, 0], strength),
                    chance[rows],
                    points,
                )
            )
        return PathEstimate.stack(tables)

    def map(self) -> Map:
        """The map as it stands: evidence, coefficients, detected surfaces."""
        surfaces = self._surfaces()
        found = surfaces.existence > self.settings.detect_above
        provenance: dict[str, Any] = {
            **self.provenance,
            "agents": [*self.provenance["agents"], self.agent],
            "seeds": [*self.provenance["seeds"], self.seed],
            "steps": [*self.provenance["steps"], self.steps],
        }
        return Map(
            np.asarray(self.cells.origin), self.cells.cell, self.cells.evidence.astype(np.float32),
            self.cells.coefficient.astype(np.float32), self.cells.observed.copy(), float(self.cells.prior),
            surfaces.take(found), self.bank.reflection[found].copy(), provenance,
        )  # fmt: skip

    def _inherit(self, prior: Map) -> None:
        """Start from another agent's map (paper 003, section IV-C)."""
        prior = prior.resample(self.cells.origin, self.cells.cell, self.cells.shape)
        self.cells.evidence = prior.evidence.astype(np.float64)
        self.cells.observed = prior.observed.copy()
        self.cells.coefficient = prior.coefficient.astype(np.float64)
        for key in self.provenance:
            earlier = prior.provenance.get(key)
            self.provenance[key] = list(earlier) if isinstance(earlier, list) else []
        known = prior.surfaces if prior.surfaces is not None else SurfaceEstimate.empty()
        for surface in range(len(known)):
            old = self.belief.covariance
            covariance = np.zeros((len(old) + 2, len(old) + 2))
            covariance[:-2, :-2], covariance[-2:, -2:] = old, known.line_cov[surface]
            self.belief = Belief(np.concatenate([self.belief.mean, known.line[surface]]), covariance)
            weights = prior.surface_reflection
            reflection = (
                np.full(len(REFLECTION_BINS), 0.05) if weights is None else np.asarray(weights[surface])
            )
            foot = np.nan_to_num(known.extent_m[surface].mean())
            self.bank = self.bank.add(
                self.next_identity, float(known.existence[surface]), reflection, float(foot), (0, -1, -1)
            )
            self.bank.extent[-1] = known.extent_m[surface]
            self.bank.seen[-1] = self.bank.age[-1] = 100
            self.next_identity += 1
        self.bank.single[:] = 0.5
