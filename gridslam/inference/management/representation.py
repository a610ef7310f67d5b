"""How agent and surfaces are held, as an object: those messages of a step that differ by it.

A step asks for the `representation_of` its state and calls these of it; docs/model.md, (M15), (M142).
"""

from __future__ import annotations

from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import separated
from gridslam.inference.management import parking
from gridslam.inference.messages import births as new_surfaces
from gridslam.inference.messages import cells, elevations, motion, path_prediction, updates
from gridslam.inference.messages.births import Births
from gridslam.inference.messages.cells import Visibility
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.published import sample_updates as particles
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.ray_amplitudes import Key
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import RadioModel


class JointGaussian:
    """One Gaussian over agent and surfaces, correlated, (M15): the messages as they stand in their files."""

    def with_surfaces(self, state: State, work: Workspace) -> State:
        """The state, of which surfaces have come, gone or changed places, in its representation."""
        return state

    def predict(
        self, state: State, time_s: float, scan_size: int, model: FilterModel, *, work: Workspace
    ) -> State:
        """See `motion.predict`."""
        return motion.predict(state, time_s, scan_size, model)

    def recall(self, state: State, model: FilterModel, *, work: Workspace) -> State:
        """See `parking.recall`."""
        return self.with_surfaces(parking.recall(state, model), work)

    def predict_paths(
        self, state: State, anchor: int, model: FilterModel, *, work: Workspace
    ) -> PredictedPaths:
        """See `path_prediction.predict_paths`."""
        return path_prediction.predict_paths(state, anchor, model, work=work)

    def cast_paths(
        self, state: State, anchor: int, model: FilterModel, *, work: Workspace
    ) -> tuple[PredictedPaths, Visibility]:
        """See `cells.cast_paths`."""
        return cells.cast_paths(state, anchor, model, work=work)

    def update_surfaces_and_agent(
        self, state: State, scan: AnchorScan, paths: PredictedPaths, ratios: LikelihoodRatios,
        turned: Array, model: FilterModel, *, work: Workspace,
    ) -> tuple[State, Exchange]:  # fmt: skip
        """See `updates.update_surfaces_and_agent`."""
        return updates.update_surfaces_and_agent(state, scan, paths, ratios, turned, model, work=work)

    def correct_by_elevations(
        self, state: State, scan: AnchorScan, exchange: Exchange, radio: RadioModel, model: FilterModel
    ) -> State:
        """See `elevations.correct_by_elevations`."""
        return elevations.correct_by_elevations(state, scan, exchange, radio, model)

    def add_births(
        self, state: State, births: Births, scan: AnchorScan, exchange: Exchange, radio: RadioModel,
        model: FilterModel, *, work: Workspace,
    ) -> tuple[State, Exchange, list[tuple[Key, int]]]:  # fmt: skip
        """See `births.add_births`."""
        state, exchange, born = new_surfaces.add_births(
            state, births, scan, exchange, radio, model, work=work
        )
        return self.with_surfaces(state, work), exchange, born

    def park(self, recalled: State, state: State, model: FilterModel, *, work: Workspace) -> State:
        """See `parking.park`."""
        return self.with_surfaces(parking.park(recalled, state, model), work)


class SeparateGaussians(JointGaussian):
    """One Gaussian of the agent and one of each surface: what they have in common is dropped.

    Within an anchor's messages the joint Gaussian is corrected as it is. It is taken apart where surfaces may
    have joined: by `recall`, `park`, and `add_births`, which a step calls for every anchor, born any or none.
    So no correlation outlasts the anchor that made it.
    """

    def with_surfaces(self, state: State, work: Workspace) -> State:
        """Without the correlations that the latest messages made."""
        return replace(state, belief=separated(state.belief))


class SeparateParticles(JointGaussian):
    """Particles of the agent and of each surface, as published: moved, weighed and resampled, (M142).

    The state's Gaussian has their moments; all that is no matter of agent or surfaces goes by it.
    """

    def with_surfaces(self, state: State, work: Workspace) -> State:
        """With particles of the surfaces there are."""
        return particles.sampled_anew(state, work=work)

    def predict(
        self, state: State, time_s: float, scan_size: int, model: FilterModel, *, work: Workspace
    ) -> State:
        """The particles move as well."""
        after = super().predict(state, time_s, scan_size, model, work=work)
        return particles.move_samples(after, state.time_s, model, work=work)

    def predict_paths(
        self, state: State, anchor: int, model: FilterModel, *, work: Workspace
    ) -> PredictedPaths:
        """Paths that are evaluated at the particles."""
        return particles.at_samples(super().predict_paths(state, anchor, model, work=work), state)

    def cast_paths(
        self, state: State, anchor: int, model: FilterModel, *, work: Workspace
    ) -> tuple[PredictedPaths, Visibility]:
        """Paths that are evaluated at the particles."""
        paths, visible = super().cast_paths(state, anchor, model, work=work)
        return particles.at_samples(paths, state), visible

    def update_surfaces_and_agent(
        self, state: State, scan: AnchorScan, paths: PredictedPaths, ratios: LikelihoodRatios,
        turned: Array, model: FilterModel, *, work: Workspace,
    ) -> tuple[State, Exchange]:  # fmt: skip
        """The particles are weighed and resampled; what exists is the Gaussian's."""
        after, exchange = super().update_surfaces_and_agent(
            state, scan, paths, ratios, turned, model, work=work
        )
        ratios = replace(ratios, odds=exchange.odds, message=exchange.message, measured=exchange.measured)
        return particles.weigh_samples(state, after, paths, scan, ratios, model, work=work), exchange

    def correct_by_elevations(
        self, state: State, scan: AnchorScan, exchange: Exchange, radio: RadioModel, model: FilterModel
    ) -> State:
        """Elevations tell which path is whose, and correct no particles."""
        return state


def representation_of(state: State, model: FilterModel) -> JointGaussian:
    """What a state is held in: particles if it has any, else a Gaussian as the settings have it."""
    if state.samples is not None:
        return SeparateParticles()
    return JointGaussian() if model.settings.correlated else SeparateGaussians()
