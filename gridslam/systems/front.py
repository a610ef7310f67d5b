"""The front door of systems that map by surfaces: scans in, estimates and maps out, around a pure step."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.estimates import Estimate, SurfaceEstimate
from gridslam.inference.management.readout import estimates, surface_estimate
from gridslam.inference.state.belief import AGENT, append
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import FRESH_SINGLE, SETTLED
from gridslam.inference.step_info import StepInfo
from gridslam.inference.workspace import Workspace
from gridslam.maps.frames import fitted, stamped
from gridslam.maps.map import Map
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap
from gridslam.world.radio import REFLECTION_BINS
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene

Array = NDArray[np.float64]


class SurfaceFilter:
    """A state, what the filter knows of the scene, and a workspace; a system adds its `start` and `advance`.

    Attributes
    ----------
    state : State
        What is believed after the latest step.
    info : StepInfo or None
        What happened at it.
    model : FilterModel
    agent : str
    """

    method: ClassVar[str]
    """Name by which the system is entered."""
    keeps_grid: ClassVar[bool] = False
    """Whether it maps cells."""

    def __init__(
        self, scene: Scene, prior_map: Map | None = None, agent: str | None = None, seed: int = 0
    ) -> None:
        self.scene, self.seed = scene, seed
        self.model = self._model(FilterModel.of(scene, agent))
        self.agent = self.model.agent
        self.work = Workspace(self.model, seed, self.keeps_grid)
        prior = None if prior_map is None else fitted(prior_map, scene)[0]
        self.provenance = _provenance(prior)
        self.state = self.start(self.model, prior)
        self.info: StepInfo | None = None

    @staticmethod
    def _model(model: FilterModel) -> FilterModel:
        """What the system takes of the model."""
        return model

    @staticmethod
    def start(model: FilterModel, prior: Map | None = None) -> State:
        """The state before the first step."""
        raise NotImplementedError

    @staticmethod
    def advance(state: State, scan: Scan, model: FilterModel, work: Workspace) -> tuple[State, StepInfo]:
        """One step: the state after it, and what happened. The state before stays as it is."""
        raise NotImplementedError

    def step(self, scan: Scan) -> Estimate:
        """Take in what was heard at one step and return what is believed now."""
        began = time.perf_counter()
        state, info = self.advance(self.state, scan, self.model, self.work)
        estimate = self._estimate(state, scan, info, began)
        self.state, self.info = state, info  # last: whatever interrupts a step leaves the one before
        return estimate

    def map(self) -> Map:
        """The map as it stands: detected surfaces, and a grid of which nothing was observed."""
        table, grid = surface_estimate(self.state, work=self.work), self.model.grid
        found, bins = table.existence > self.model.settings.detect_above, len(REFLECTION_BINS)
        latest = {"agents": self.agent, "seeds": self.seed, "steps": self.state.step}
        provenance: dict[str, Any] = {key: [*self.provenance[key], value] for key, value in latest.items()}
        sheet = Map(
            np.array(grid.origin_m), grid.cell_m, np.zeros(grid.shape, np.float32),
            np.zeros((*grid.shape, bins), np.float32), np.zeros(grid.shape, dtype=bool),
            float(1 - np.exp(-grid.cell_m / self.model.settings.mean_free_path_m)), table.take(found),
            self.state.surfaces.reflection[found].copy(), provenance,
        )  # fmt: skip
        return stamped(sheet, self.scene)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, from which `resume` goes on bit for bit.

        Raises
        ------
        InputError
            The file can't be written.
        """
        from gridslam.systems.checkpoint import save

        save(self, path)

    @classmethod
    def resume(cls, path: str | os.PathLike[str]) -> Self:
        """Read a checkpoint of this system.

        Raises
        ------
        InputError
            No such file, or not a checkpoint of this version and system.
        """
        from gridslam.systems.checkpoint import resume

        return resume(cls, path)

    def _strength(self, state: State) -> Callable[[Rays, Array], Array] | None:
        """Amplitudes (L,) of rays of given distances (L,); None where they follow from coefficients."""
        return None

    def _estimate(self, state: State, scan: Scan, info: StepInfo, began: float) -> Estimate:
        """MMSE estimates of agent and surfaces, and the paths believed in."""
        model = self.work.calibrated(self.model, info.turned)
        mean, covariance = state.belief.mean, state.belief.covariance
        at_1m = model.radio.amplitude_at_1m * info.gain
        table, paths = estimates(state, model, at_1m, self._strength(state), work=self.work)
        return Estimate(
            scan.step, scan.time_s, mean[:2].copy(), mean[2:4].copy(), float(wrap(mean[4])),
            covariance[:AGENT, :AGENT].copy(), table, paths,
            table.existence > model.settings.detect_above, info.health.effective_sample_size,
            time.perf_counter() - began, info.health,
        )  # fmt: skip


def inherit_surfaces(state: State, prior: Map) -> State:
    """The state with the surfaces that another agent left, as independent of this agent."""
    known = prior.surfaces if prior.surfaces is not None else SurfaceEstimate.empty()
    uniform = np.full(len(REFLECTION_BINS), 1 / len(REFLECTION_BINS))
    for row in range(len(known)):
        reflection = uniform if prior.surface_reflection is None else prior.surface_reflection[row]
        surfaces = state.surfaces.add(
            state.next_identity,
            float(known.existence[row]),
            np.asarray(reflection, np.float64),
            float(np.nan_to_num(known.extent_m[row].mean())),
            (0, -1, -1),
            age=SETTLED,
            seen=SETTLED,
            extent=known.extent_m[row],
        )
        belief = append(state.belief, known.line[row], known.line_cov[row])
        state = replace(state, belief=belief, surfaces=surfaces, next_identity=state.next_identity + 1)
    fresh = np.full_like(state.surfaces.single, FRESH_SINGLE)
    return replace(state, surfaces=replace(state.surfaces, single=fresh))


def _provenance(prior: Map | None) -> dict[str, list[Any]]:
    """Who made the map that a filter starts from, as parallel lists."""
    earlier = {} if prior is None else prior.provenance
    lists = {key: earlier.get(key) for key in ("agents", "seeds", "steps")}
    return {key: list(value) if isinstance(value, list) else [] for key, value in lists.items()}
