"""Runs of a study, gathered by method, scene and setting, beside the truth and bounds that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.evaluation.array_bounds import array_bound
from gridslam.evaluation.bounds import Bound, MapBound, known_map_bound, unknown_map_bound
from gridslam.evaluation.consistency import Steps, nees_band, true_rays
from gridslam.evaluation.ground_truth import tells_heading, walls_tell_all
from gridslam.evaluation.metrics import OSPA_CUTOFF_M
from gridslam.evaluation.network_bounds import network_bound
from gridslam.evaluation.signal_bounds import has_single_antennas, scene_signal_bound
from gridslam.evaluation.surface_truth import AudibleSurfaces
from gridslam.simulation.image_source import Truth, ground_truth
from gridslam.simulation.network import simulate_network
from gridslam.studies.jobs import takes_several
from gridslam.studies.study import Outcome, Variant
from gridslam.systems.registry import kind_of
from gridslam.world.observation import Kind
from gridslam.world.scene import Scene

QUANTILES = (0.1, 0.9)
"""Ends of the 80 % sample-quantile interval of [Li2025adaptive]."""
HEADINGS = "heading_error_rad", "heading_nees"
"""Fields of `Steps` that say nothing where nothing tells of the heading."""


@dataclass(frozen=True, eq=False)
class Benchmark:
    """What a variant of a scene holds for an agent: the truth and the bounds.

    Attributes
    ----------
    known : Bound
        Of an agent that knows the walls; NaN where scatterers tell more.
    unknown : MapBound
        Of one that finds them, or starts from what the agents before it could know.
    rays, likely_rays : (J, N) int
        Visible paths of each anchor, and those that are likelier detected than missed.
    surface_since : (S,) int
        First step at which each surface of `unknown` is there to be found.
    curve : (S,) int
        Curved wall of which it is a facet; -1 for a straight one.
    anchors : tuple of str
        Their J names.
    sight : (J, N) bool
        Whether each anchor's line of sight is there.
    heading_told : bool
        Whether anything tells which way the agent faces; if not, errors of that are left out.
    """

    known: Bound
    unknown: MapBound
    rays: NDArray[np.intp]
    likely_rays: NDArray[np.intp]
    surface_since: NDArray[np.intp]
    curve: NDArray[np.intp]
    anchors: tuple[str, ...]
    sight: NDArray[np.bool_]
    heading_told: bool = True

    @property
    def hidden(self) -> NDArray[np.bool_]:
        """At which steps no line of sight is there, (N,)."""
        return np.asarray(~self.sight.any(0))

    @property
    def surfaces(self) -> NDArray[np.intp]:
        """How many surfaces are there to be found at each step, a curved wall being one, (N,)."""
        return np.isfinite(self._best).sum(1)

    @property
    def mospa_at_bounds_m(self) -> Array:
        """Mapping error bounds averaged over the surfaces there, (N,) m: no bound on the MOSPA.

        As in [Li2025adaptive], Fig. 6a. It is a root mean square and the MOSPA a mean, so that for Gaussian
        errors the latter may lie up to a fifth below, and more since the bounds let walls walk that stand
        still; unknowable surfaces count as the cutoff, 5 m. A curved wall counts once, by its best facet.
        """
        best, there = self._best, np.isfinite(self._best)
        return np.asarray(np.where(there, best, 0.0).sum(1) / np.maximum(there.sum(1), 1))

    @property
    def _best(self) -> Array:
        """Bound of each straight surface and each curved wall's best facet, (N, .); inf before it's there."""
        steps, number = np.arange(self.rays.shape[1]), np.arange(len(self.curve))
        there = self.surface_since <= steps[:, None]
        capped = np.where(there, np.minimum(self.unknown.surface_m, OSPA_CUTOFF_M), np.inf)
        group = np.where(self.curve < 0, number, len(number) + self.curve)
        first = np.unique(group, return_index=True)[1]
        return np.stack([capped[:, group == group[n]].min(1) for n in first], -1) if len(first) else capped


@dataclass(frozen=True, eq=False)
class Batch:
    """All runs of one method on one variant of a scene, for one agent.

    Attributes
    ----------
    variant : Variant
    method, agent : str
    records : list of dict
        R runs.
    steps : dict of (R, ..., N) float64
        The fields of `gridslam.evaluation.consistency.Steps`, run by run.
    benchmark : Benchmark
    """

    variant: Variant
    method: str
    agent: str
    records: list[dict[str, Any]]
    steps: dict[str, Array]
    benchmark: Benchmark

    @property
    def runs(self) -> int:
        """R."""
        return len(self.records)

    @property
    def diverged(self) -> int:
        """How many runs were more than 0.5 m off at some step after step 10."""
        return sum(bool(record["agents"][self.agent]["scores"]["diverged"]) for record in self.records)

    @property
    def silent_steps(self) -> float:
        """At how many steps, of all runs, it was wrong and didn't say so; NaN where a run wasn't counted."""
        counts = [record["agents"][self.agent]["scores"].get("silent_steps") for record in self.records]
        return float("nan") if None in counts else float(sum(counts))

    @property
    def tells_paths(self) -> bool:
        """Whether any run ever believes in a path: a method that tells none has 0 at all steps."""
        return bool(self.steps["rays"].any())

    def mapped(self, values: Array) -> Array:
        """Scores of surfaces (..., N): as they are, or NaN of a method that maps none, or none at its steps.

        From features surfaces follow at the end.
        """
        maps = any(one is not None for one in self._found)
        return values if maps and not self._maps_late else np.full_like(values, np.nan)

    @property
    def _found(self) -> list[int | None]:
        """Surfaces at the end of each run."""
        return [record["agents"][self.agent]["scores"].get("surfaces_detected", 0) for record in self.records]

    @property
    def _maps_late(self) -> bool:
        return any(self._found) and not bool((self.steps["surfaces"] > 0).any())

    @property
    def surface_ospa_m(self) -> float:
        """OSPA distance of surfaces at the end, mean over the runs, m; NaN of a method that maps none."""
        told = self.mapped(self.mean("surface_ospa_m"))[-1]
        scores = [record["agents"][self.agent]["scores"].get("surface_ospa_m") for record in self.records]
        own = [one for one in scores if one is not None]
        return float(np.mean(own)) if own and self._maps_late else float(told)

    @property
    def surface_gospa_m(self) -> float:
        """GOSPA distance of surfaces at the end, mean over the runs, m; NaN if one wasn't counted."""
        scores = [record["agents"][self.agent]["scores"] for record in self.records]
        own = [one["surface_gospa_m"] for one in scores if one.get("surface_gospa_m") is not None]
        counted = all("surface_gospa_m" in one for one in scores)
        return float(np.mean(own)) if own and counted else float("nan")

    @property
    def band(self) -> tuple[float, float]:
        """95 % band of the mean position NEES of consistent runs."""
        return nees_band(self.runs, 2)

    def rmse(self, name: str) -> Array:
        """Root mean square over the runs of a field of `steps`, (..., N); NaN where no run has one."""
        values = self.steps[name]
        count = np.isfinite(values).sum(0)
        square = np.where(np.isfinite(values), values, 0.0) ** 2
        return np.asarray(
            np.sqrt(np.divide(square.sum(0), count, out=np.full(count.shape, np.nan), where=count > 0))
        )

    def quantiles(self, name: str) -> Array:
        """10 % and 90 % quantiles over the runs of a field's absolute values, (2, ..., N)."""
        return np.asarray(np.quantile(np.abs(self.steps[name]), QUANTILES, axis=0))

    def mean(self, name: str) -> Array:
        """Mean over the runs of a field of `steps`, (..., N)."""
        return np.asarray(self.steps[name].mean(0))


def batches(outcome: Outcome) -> list[Batch]:
    """Sort the finished runs of a study by variant, agent and method; those without a run are left out.

    Runs that earlier commands left in the study's folder are among them, as `Outcome.finished` has them.

    Raises
    ------
    InputError
        A run's record is damaged.
    """
    sorted_: dict[tuple[Variant, str, str], list[dict[str, Any]]] = {}
    agents: dict[Variant, tuple[str, ...]] = {}
    for job, record in outcome.finished:
        agents[job.variant] = job.agents
        for agent in job.agents:
            sorted_.setdefault((job.variant, agent, job.method), []).append(record)
    marks: dict[tuple[Variant, Kind, bool], dict[str, Benchmark]] = {}
    found = []
    for (variant, agent, method), records in sorted_.items():
        which = variant, kind_of(method), takes_several(method)
        if which not in marks:
            marks[which] = _benchmarks(variant, which[1], agents[variant], which[2])
        mark = marks[which][agent]
        runs = [_arrays(record, agent, mark) for record in records]
        steps = {name: np.stack([run[name] for run in runs]) for name in runs[0]}
        if not mark.heading_told:
            steps |= {name: np.full_like(steps[name], np.nan) for name in HEADINGS}
        found.append(Batch(variant, method, agent, records, steps, mark))
    return found


def _arrays(record: Mapping[str, Any], agent: str, mark: Benchmark) -> dict[str, Array]:
    """Fields of a run's steps, (..., N); each is checked, since a file may have been changed."""
    anchors, size = mark.rays.shape
    rows = {"rays": anchors, "ray_belief": anchors, "surface_error_m": len(mark.surface_since)}
    try:
        own = record["agents"][agent]
        _, _, _ = own["scores"]["diverged"], own["scores"]["map"].items(), own["cost"]["seconds_per_step"] + 0
        return {
            f.name: np.array(own["steps"][f.name], float).reshape(
                (rows[f.name], size) if f.name in rows else size
            )
            for f in fields(Steps)
        }
    except (KeyError, TypeError, ValueError, AttributeError):
        who = f"seed {record['key'].get('seed')} of {agent}"
        raise InputError("study: results", f"a damaged run ({who})", "what the study wrote") from None


def _benchmarks(
    variant: Variant, takes: Kind, agents: Sequence[str], at_once: bool = False
) -> dict[str, Benchmark]:
    """Of every agent; of those that are run at once, with the bound of all together."""
    scene = Scene.from_toml(variant.scene, variant.name)
    whole = simulate_network(scene, agents)[1] if at_once else None
    joint = None if whole is None else network_bound(scene, whole)
    found: dict[str, Benchmark] = {}
    earlier: list[Truth] = []
    before: MapBound | None = None
    for name in agents:
        truth = ground_truth(scene, name)
        known = known_map_bound(scene, name, truth.paths)
        before = unknown_map_bound(scene, name, truth.paths, before=before)
        audible = AudibleSurfaces.of(truth, earlier)
        rays, likely = true_rays(scene, name, truth), true_rays(scene, name, truth, 0.5)
        unknown = before
        if not walls_tell_all(scene, takes):
            nothing = np.full_like(known.position_m, np.nan)
            known = replace(known, position_m=nothing, heading_rad=nothing)
            unknown = replace(before, position_m=nothing, heading_rad=nothing)
        elif takes == "signal":
            bound = scene_signal_bound if has_single_antennas(scene, name) else array_bound
            known, apart = (bound(scene, name, k, truth.paths) for k in (True, False))
            unknown = replace(before, position_m=apart.position_m, heading_rad=apart.heading_rad)
        if joint is not None and whole is not None:
            there = slice(whole.first[name], whole.first[name] + len(truth.trajectory))
            place, facing = (own[there, agents.index(name)] for own in (joint.position_m, joint.heading_rad))
            unknown = replace(before, position_m=place, heading_rad=facing)
        headed = tells_heading(scene, name, takes)
        if not headed:
            nothing = np.full_like(known.heading_rad, np.nan)
            known, unknown = replace(known, heading_rad=nothing), replace(unknown, heading_rad=nothing)
        anchors, sight = tuple(scene.anchor_names), np.zeros(rays.shape, bool)
        direct = truth.paths.bounces == 0
        sight[truth.paths.anchor[direct], truth.paths.step[direct]] = True
        found[name] = Benchmark(
            known, unknown, rays, likely, audible.first, audible.curve, anchors, sight, headed
        )
        earlier.append(truth)
    return found
