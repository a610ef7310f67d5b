"""The front door of systems that map by surfaces: scans in, estimates and maps out, around a pure step."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.estimates import Estimate, SurfaceEstimate
from gridslam.inference.management.hypotheses import advance, begun
from gridslam.inference.management.readout import described, estimates, surface_estimate
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.messages.ray_amplitudes import mean_amplitudes
from gridslam.inference.state.belief import append
from gridslam.inference.state.population import Population
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import FRESH_SINGLE, SETTLED
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.frames import fitted, stamped
from gridslam.maps.map import Map
from gridslam.maps.run_identity import Identity
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap
from gridslam.world.radio import REFLECTION_BINS
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene
from gridslam.world.start import require_seed

Array = NDArray[np.float64]


class Moment(NamedTuple):
    """Where a filter has got to: its hypotheses, which measurements led there, and the latest step."""

    population: Population
    identity: Identity
    info: StepInfo | None = None

    @property
    def state(self) -> State:
        """The likeliest hypothesis."""
        return self.population.best

    def believing(self, state: State) -> Moment:
        """The same with one hypothesis in place of all."""
        return self._replace(population=Population.of(state))


class SurfaceFilter(ABC):
    """A state, what the filter knows of the scene, and a workspace; a system adds its `start` and `advance`.

    Attributes
    ----------
    now : Moment
    model : FilterModel
    agent : str
    """

    method: ClassVar[str]
    """Name by which the system is entered."""
    uses_maps: ClassVar[bool] = True
    """Whether what an earlier agent left enters its belief."""
    keeps_grid: ClassVar[bool] = False
    """Whether it maps cells."""
    branches: ClassVar[bool] = True
    """Whether it holds several hypotheses where one Gaussian won't do."""

    def __init__(
        self,
        scene: Scene,
        prior_map: Map | None = None,
        agent: str | None = None,
        seed: int = 0,
        same_frame: bool = False,
    ) -> None:
        require_seed(seed)
        self.scene, self.seed = scene, seed
        self.model = self._model(scene.filter_model(agent))
        self.agent = self.model.agent
        self.work = Workspace(self.model, seed, self.keeps_grid)
        prior = None
        if prior_map is not None:
            prior, _ = fitted(prior_map, scene, same_frame=same_frame)
        self.provenance = _provenance(prior if self.uses_maps else None)
        identity = Identity.of(self.model.anchor_positions)
        self.now = Moment(self._population(self.start(self.model, prior)), identity)

    @property
    def state(self) -> State:
        """What is believed after the latest step; of several hypotheses, the likeliest."""
        return self.now.state

    @property
    def population(self) -> Population:
        """All hypotheses after the latest step."""
        return self.now.population

    @property
    def info(self) -> StepInfo | None:
        """What happened at it; None before the first."""
        return self.now.info

    def start_at(self, position_m: Array, heading_rad: float) -> None:
        """Believe in another start (m, rad) than the scene's, as surely as its prior says.

        Raises
        ------
        InputError
            A step was taken already, or the start isn't finite.
        """
        if self.state.step or self.state.time_s is not None:
            raise InputError("start", f"told after {self.state.step} steps", "before the first")
        pose = np.array([*np.reshape(position_m, 2), heading_rad], dtype=np.float64)
        if not np.isfinite(pose).all():
            raise InputError("start", str(pose.tolist()), "finite numbers")
        mean = self.state.belief.mean.copy()
        mean[[0, 1, 4]] = pose
        state = replace(self.state, belief=replace(self.state.belief, mean=mean))
        self.now = self.now._replace(population=self._population(state))

    def _population(self, state: State) -> Population:
        """The hypotheses before the first step."""
        return begun(state, self.model) if self.branches else Population.of(state)

    @staticmethod
    def _model(model: FilterModel) -> FilterModel:
        """What the system takes of the model."""
        return model

    @staticmethod
    @abstractmethod
    def start(model: FilterModel, prior: Map | None = None) -> State:
        """The state before the first step."""

    @staticmethod
    @abstractmethod
    def advance(state: State, scan: Scan, model: FilterModel, work: Workspace) -> tuple[State, StepInfo]:
        """One step: the state after it, and what happened. The state before stays as it is."""

    def step(self, scan: Scan) -> Estimate:
        """Process the measurements of one step and return the estimates after it.

        Raises
        ------
        InputError
            The scan makes no sense, see `Scan.checked`; the filter stays as it was.
        """
        began = time.perf_counter()
        scan = scan.checked(len(self.model.anchors), self.state.time_s)
        population, info = self._advance(scan)
        estimate = self._estimate(population, scan, info, began)
        # last and at once: whatever interrupts a step leaves the moment before
        self.now = Moment(population, self.now.identity.after(scan), info)
        return estimate

    def _advance(self, scan: Scan) -> tuple[Population, StepInfo]:
        """The hypotheses after a scan, and what happened."""
        if self.branches:
            return advance(self.population, scan, self.model, self.work, self.start, self.advance)
        state, info = self.advance(self.state, scan, self.model, self.work)
        return Population.of(state), info

    def map(self) -> Map:
        """The map as it stands: detected surfaces, and a grid of which nothing was observed."""
        table, grid = surface_estimate(self.state, work=self.work), self.model.grid
        found, bins = table.existence > self.model.settings.detect_above, len(REFLECTION_BINS)
        latest: dict[str, Any] = {"agents": self.agent, "seeds": self.seed, "steps": self.state.step}
        latest["runs"] = self.now.identity.text
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
        from gridslam.systems.checkpoint import Checkpoint, write_checkpoint

        kept = Checkpoint(
            self.method, self.scene, self.agent, self.seed, self.provenance, self.now.identity,
            self.population,
        )  # fmt: skip
        write_checkpoint(kept, path)

    @classmethod
    def resume(cls, path: str | os.PathLike[str]) -> Self:
        """Read a checkpoint of this system.

        Raises
        ------
        InputError
            No such file, or not a checkpoint of this version and system.
        """
        from gridslam.systems.checkpoint import read_checkpoint

        kept = read_checkpoint(path, cls.method, cls.start)
        slam = cls(kept.scene, agent=kept.agent, seed=kept.seed)
        slam.provenance, slam.now = kept.provenance, Moment(kept.population, kept.identity)
        return slam

    def _strength(self, state: State) -> Callable[[Rays, Array], Array] | None:
        """Amplitudes (L,) of rays of given distances (L,); None where they follow from coefficients."""
        if state.amplitudes is None:
            return None
        radio, work = self.model.radio, self.work
        return lambda rays, distance: mean_amplitudes(state, rays, distance, radio, work=work)

    def _estimate(self, population: Population, scan: Scan, info: StepInfo, began: float) -> Estimate:
        """MMSE estimates of the agent; surfaces and paths of the likeliest hypothesis; all hypotheses."""
        state = population.best
        model = self.work.calibrated(self.model, info.turned)
        mean, covariance = population.agent()
        at_1m = model.radio.amplitude_at_1m * info.gain
        table, paths = estimates(state, model, at_1m, self._strength(state), work=self.work)
        return Estimate(
            scan.step, scan.time_s, mean[:2].copy(), mean[2:4].copy(), float(wrap(mean[4])),
            covariance, table, paths,
            table.existence > model.settings.detect_above, info.health.effective_sample_size,
            time.perf_counter() - began, info.health, described(population),
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
    lists = {key: earlier.get(key) for key in ("agents", "seeds", "steps", "runs")}
    known = {key: list(value) if isinstance(value, list) else [] for key, value in lists.items()}
    unknown = len(known["agents"]) - len(known["runs"])  # maps of earlier versions don't name their runs
    return known | {"runs": [""] * unknown + known["runs"]}
