"""The front door of systems that map by surfaces: scans in, estimates and maps out, around a pure step."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.estimates import AnchorEstimate, Estimate
from gridslam.inference.beliefs.belief import append, lines_covariance, with_lines
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.management.early_arrivals import watched_arrivals
from gridslam.inference.management.features.left_features import left_features
from gridslam.inference.management.features.surface_features import mirror_surfaces
from gridslam.inference.management.free_turn import all_with_turn, put_back
from gridslam.inference.management.hypotheses import advance_population, begun
from gridslam.inference.management.mixture import agent_moments
from gridslam.inference.management.readout import described, estimates, surface_estimate
from gridslam.inference.management.sole_sight import as_far_as_told
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.messages.anchor_frames import as_believed, with_common_turn
from gridslam.inference.messages.level_coefficients import level_means, with_levels
from gridslam.inference.messages.ray_amplitudes import mean_amplitudes
from gridslam.inference.scans.unsure_orientations import as_sure_as_anchors
from gridslam.inference.state.arrangement import unparked
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.state.population import Population
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import FRESH_SINGLE, SETTLED
from gridslam.inference.workspace.workspace import Workspace
from gridslam.maps.frames import stamped
from gridslam.maps.map import Map
from gridslam.systems.far_regions import moved_estimate, moved_map
from gridslam.systems.filter_front import FilterFront, Moment, require_paths
from gridslam.systems.handed_anchors import map_anchors
from gridslam.systems.soundness import require_sound_population
from gridslam.world.filter_model import FilterModel, detected
from gridslam.world.geometry import wrap
from gridslam.world.network_scene import require_known_clocks
from gridslam.world.observation import Observation
from gridslam.world.radio import REFLECTION_BINS
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene
from gridslam.world.start import require_scene

Mapped = TypeVar("Mapped", State, NetworkState)
Observed = TypeVar("Observed", bound=Observation)


class SurfaceFront(FilterFront[Observed, Population[State]]):
    """The front of systems whose state is `State`, on measurements of any kind.

    A system adds its `start` and `advance`, of one state.
    """

    centres = True
    keeps_grid: ClassVar[bool] = False
    """Whether it maps cells."""
    branches: ClassVar[bool] = False
    """Whether it holds several hypotheses where one Gaussian won't do."""

    @property
    def state(self) -> State:
        """What is believed after the latest step; of several hypotheses, the likeliest."""
        return self.population.best

    @property
    def population(self) -> Population[State]:
        """All hypotheses after the latest step."""
        population: Population[State] = self.now.believed
        return population

    def believing(self, state: State) -> Moment:
        """The moment with one hypothesis in place of all."""
        return self.now._replace(believed=Population.of(state))

    def _workspace(self) -> Workspace:
        return Workspace(self.model, self.seed, self.keeps_grid)

    def _begun(self, state: State) -> Population[State]:
        return begun(state, self.model) if self._branches(state) else Population.of(state)

    def _branches(self, state: State) -> bool:
        """Particles hold several modes by themselves."""
        return self.branches and state.samples is None

    @staticmethod
    def moved(state: State, position_m: Array, heading_rad: float) -> State:
        """The state before the first step, with its prior about another start (m, rad)."""
        mean = state.belief.mean.copy()
        mean[[0, 1, 4]] = [*position_m, heading_rad]
        if state.samples is not None:
            samples = state.samples.shifted(mean[[0, 1, 4]])
            return replace(state, samples=samples, belief=samples.moments())
        return replace(state, belief=replace(state.belief, mean=mean))

    @staticmethod
    def require_sound(believed: Population[State], model: FilterModel, where: str) -> None:
        """Refuse hypotheses from a file whose numbers can't be."""
        require_sound_population(believed, model, where)

    def _advanced(self, scan: Observed) -> tuple[Population[State], StepInfo]:
        state, info = self.advance(self.state, scan, self.model, self.work)
        return Population.of(state), info

    def _inherited(self, prior: Map) -> Map | None:
        """Features that surfaces may not stand for, and cells, of systems that don't map any."""
        none: Any = dict.fromkeys(
            ("surfaces", "surface_reflection", "surface_covariance", "stretches", "anchors")
        )
        bare = replace(prior, **none, levels={})
        if self.keeps_grid:
            grid = prior.blank(prior.origin_m, prior.cell_m, prior.shape, prior.prior)
            bare = replace(bare, evidence=grid.evidence, coefficient=grid.coefficient, observed=grid.observed)
        return bare if bare.features is not None or bare.observed.any() else None

    def map(self) -> Map:
        """The map as it stands: detected surfaces, and what was handed down or is left over."""
        # without a ring's depth: it hangs together
        state = with_common_turn(unparked(put_back(self.state, self.model)))
        table = surface_estimate(state, work=self.work)
        found = detected(table.existence, self.model.settings)
        joint = lines_covariance(state.belief, found)
        own_map = bare_map(self, table.take(found), state.surfaces.reflection[found], joint)
        own_map = replace(own_map, anchors=map_anchors(state, found, self.model))
        levels = () if state.levels is None else zip(self.model.level_names, state.levels, strict=True)
        own_map = replace(own_map, levels={name: belief for name, belief in levels if belief.any()})
        earlier = self.inherited
        if earlier is not None:
            own_map = replace(
                own_map, evidence=earlier.evidence, coefficient=earlier.coefficient, observed=earlier.observed
            )
        handed = (None, None) if earlier is None else (earlier.features, earlier.feature_covariance)
        array = self.scene.agent(self.agent).array
        elements = 1 if array is None else len(array.elements)
        features, spread = left_features(
            state.unexplained, *handed, table.line[found], self.model.anchor_positions, elements
        )
        if features is not None:
            own_map = replace(own_map, features=features, feature_covariance=spread)
        return moved_map(own_map, self.model.origin_m)

    def _strength(self, state: State) -> Callable[[Rays, Array], Array] | None:
        """Amplitudes (L,) of rays of given distances (L,); None where they follow from coefficients."""
        if state.amplitudes is None:
            return None
        radio = self.model.radio
        return lambda rays, distance: mean_amplitudes(state, rays, distance, radio)

    def estimate(self, believed: Population[State], scan: Observed, info: StepInfo, began: float) -> Estimate:
        """MMSE estimates of the agent; surfaces and paths of the likeliest hypothesis; all hypotheses."""
        population = all_with_turn(believed, as_believed(self.model, believed.best))
        state = population.best
        model = self.work.calibrated(
            with_levels(self.model, state.levels), info.turned, state.belief.higher, state.aside
        )
        mean, covariance = agent_moments(population)
        at_1m = model.radio.amplitude_at_1m * info.gain
        table, paths = estimates(state, model, at_1m, self._strength(state), work=self.work)
        near = Estimate(
            scan.step, scan.time_s, mean[:2].copy(), mean[2:4].copy(), float(wrap(mean[HEADING])),
            covariance, table, paths,
            detected(table.existence, model.settings), info.health.effective_sample_size,
            time.perf_counter() - began, info.health, described(population), self._heights(state),
            coefficients=self._coefficients(state), anchors=self._anchors(state),
        )  # fmt: skip
        return moved_estimate(near, self.model.origin_m)

    def _coefficients(self, state: State) -> dict[str, tuple[float, float]]:
        """Coefficients of floor and ceiling that the scene gives with deviations, as believed, and theirs."""
        if state.levels is None:
            return {}
        found = zip(self.model.level_names, *level_means(state.levels), strict=True)
        return {name: (float(mean), float(std)) for name, mean, std in found if mean > 0}

    def _anchors(self, state: State) -> dict[str, AnchorEstimate]:
        """How anchors stand that the scene gives deviations of, as believed."""
        if state.mountings is None:
            return {}
        aside, std = state.mountings.aside, state.mountings.in_scene(self.model)
        facing = wrap(self.scene.anchor_orientations + aside[:, 2])
        places = self.scene.anchor_positions + aside[:, :2]
        return {
            name: AnchorEstimate(place, math.hypot(*own[:2]), float(turn), float(own[2]))
            for name, place, turn, own in zip(self.model.anchor_names, places, facing, std, strict=True)
        }

    def _heights(self, state: State) -> dict[str, tuple[float, float]]:
        """Heights that the scene gives with deviations, as believed, and their deviations, m."""
        belief, own = state.belief, state.belief.layout.heights
        if not belief.rises:
            return {}
        return self.scene.found_heights(self.agent, belief.higher, belief.covariance[own, own])


class SurfaceFilter(SurfaceFront[Scan]):
    """The front of systems on path measurements; it holds several states where one Gaussian won't do."""

    branches = True

    def __init__(
        self,
        scene: Scene,
        prior_map: Map | None = None,
        agent: str | None = None,
        seed: int = 0,
        same_frame: bool = False,
    ) -> None:
        require_scene(scene)
        require_known_clocks(scene, agent)
        super().__init__(scene, prior_map, agent, seed, same_frame)

    def _checked(self, scan: Scan, after: float | None) -> Scan:
        require_paths(scan, self)
        return scan.checked(len(self.scene.anchors), after)

    def _advanced(self, scan: Scan) -> tuple[Population[State], StepInfo]:
        believed = self.population
        if len(scan):
            if self.state.mountings is None:
                scan = as_sure_as_anchors(scan, self.model)  # (M568)
            model = as_believed(self.model, self.state)
            believed, scan = as_far_as_told(believed, scan, model, self.work)  # (M514)
        if self._branches(self.state):
            after, info = advance_population(believed, scan, self.model, self.work, self.start, self.advance)
        else:
            state, info = self.advance(believed.best, scan, self.model, self.work)
            after = Population.of(state)
        return watched_arrivals(after, believed.early, info, scan, self.model, self.work)  # (M525)


def bare_map(
    slam: FilterFront[Any, Any], surfaces: SurfaceEstimate, reflection: Array, joint: Array | None = None
) -> Map:
    """A map of surfaces with beliefs about their coefficients (S, BINS), and of cells nobody observed.

    `joint` is the covariance of all lines, (2 S, 2 S), of methods that keep one.
    """
    grid, bins = slam.scene.grid, len(REFLECTION_BINS)
    own_map = Map(
        np.array(grid.origin_m), grid.cell_m, np.zeros(grid.shape, np.float32),
        np.zeros((*grid.shape, bins), np.float32), np.zeros(grid.shape, dtype=bool),
        float(1 - np.exp(-grid.cell_m / slam.scene.filter.mean_free_path_m)), surfaces, reflection.copy(),
        slam.latest(), surface_covariance=joint if len(surfaces) else None,
    )  # fmt: skip
    return stamped(own_map, slam.scene)


def inherit_levels(model: FilterModel, prior: Map | None) -> Array | None:
    """Beliefs (W, 50) about coefficients of floor and ceiling: an earlier agent's, or else the prior.

    The former holds the prior already. A level that the scene says is known stays so.
    """
    if model.level_prior is None or prior is None:
        return model.level_prior
    levels = model.level_prior.copy()
    for row, name in enumerate(model.level_names):
        if levels[row].any():
            levels[row] = prior.levels.get(name, levels[row])
    return levels


def inherit_surfaces(state: Mapped, prior: Map) -> Mapped:
    """The state with the surfaces that another agent left: as correlated as they are in its map, and
    independent of this agent. Of a map that has none, learned features that are mirror images say them."""
    known = prior.surfaces if prior.surfaces is not None else SurfaceEstimate.empty()
    if not len(known) and prior.features is not None:
        known = mirror_surfaces(prior.features)
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
        belief: Any = append(state.belief, known.line[row], known.line_cov[row])
        state = replace(state, belief=belief, surfaces=surfaces, next_identity=state.next_identity + 1)
    if prior.surface_covariance is not None and len(prior.surface_covariance) == 2 * len(known):
        state = replace(state, belief=with_lines(state.belief, prior.surface_covariance))
    fresh = np.full_like(state.surfaces.single, FRESH_SINGLE)
    return replace(state, surfaces=replace(state.surfaces, single=fresh))
