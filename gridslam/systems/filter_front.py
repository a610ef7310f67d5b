"""The front door of all filters: observations in, estimates and maps out, around a pure step.

Nothing here knows what a state holds or what an observation measures. `gridslam.systems.front` is the door of
systems on path measurements that map by surfaces, `gridslam.systems.signal_front` that of systems on samples.
"""

from __future__ import annotations

import copy
import os
import time
from abc import ABC, abstractmethod
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.maps.frames import fitted
from gridslam.maps.map import Map
from gridslam.maps.run_identity import Identity, makers_of, refuse_heard
from gridslam.systems.far_regions import about, middle_of, moved_map
from gridslam.wording import counted
from gridslam.world.filter_model import FilterModel
from gridslam.world.given import finite, require_radians
from gridslam.world.network_scene import require_in_reach
from gridslam.world.observation import Kind, Observation
from gridslam.world.scan import Scan, require_step
from gridslam.world.scene import Scene
from gridslam.world.scene_derived import require_known_places
from gridslam.world.signal_scan import SignalScan
from gridslam.world.start import require_scene, require_seed

Observed = TypeVar("Observed", bound=Observation)
Believed = TypeVar("Believed")


class Moment(NamedTuple):
    """Where a filter has got to: what it believes, which measurements led there, and the latest step.

    `number` is that of the latest scan; None before the first.
    """

    believed: Any
    identity: Identity
    info: Any = None
    number: int | None = None


class FilterFront(ABC, Generic[Observed, Believed]):
    """A state, what the filter knows of the scene, and a workspace.

    A system adds `start`, `advance`, `estimate` and `map`, and `moved` if it can be told another start. Its
    state is a frozen dataclass with `step` and `time_s`; `gridslam.systems.values` says what may stand in it,
    so that checkpoints hold it.

    Attributes
    ----------
    now : Moment
    model : FilterModel
    agent : str
    inherited : Map or None
        What of an earlier agent's map no state holds, but goes into the map that is made.
    """

    method: ClassVar[str]
    """Name by which the system is entered."""
    takes: ClassVar[Kind] = "paths"
    """What it is handed: path measurements, or sampled signals."""
    uses_maps: ClassVar[bool] = True
    """Whether what an earlier agent left enters its belief."""
    centres: ClassVar[bool] = False
    """Whether it reckons about the middle of a far region, see `gridslam.systems.far_regions`."""
    by_particles: ClassVar[bool] = False
    """Whether ``filter.representation = "particles"`` says something that it does."""
    over_levels: ClassVar[bool] = False
    """Whether paths over floor and ceiling have a place in it."""
    finds_heights: ClassVar[bool] = False
    """Whether it estimates heights that a scene gives with deviations: of agent, floor and ceiling."""
    finds_places: ClassVar[bool] = False
    """Whether it estimates places of anchors that a scene gives with deviations. Scenes with deviations that
    a system doesn't estimate (nor by particles) are refused."""
    truth_given: ClassVar[str] = ""
    """What of the truth a reference is told; its map says so, and maps that go on from it."""

    def __init__(
        self,
        scene: Scene,
        prior_map: Map | None = None,
        agent: str | None = None,
        seed: int = 0,
        same_frame: bool = False,
    ) -> None:
        require_scene(scene)
        require_seed(seed)
        asked = scene.filter.representation
        if asked == "particles" and not self.by_particles:
            allowed = "'gaussian': grid and adaptive SLAM, and the published methods, take particles"
            raise InputError(f"{scene.name}: filter.representation", f"{asked!r} for {self.method}", allowed)
        if not self.over_levels:
            scene.require_walls_alone(self.method)
        if not self.finds_heights or asked == "particles":
            scene.require_known_heights(f"{self.method} by particles" if self.finds_heights else self.method)
        if not self.finds_places or asked == "particles" or not scene.filter.correlated:
            apart = f"{self.method} by particles, or by Gaussians apart" if self.finds_places else self.method
            require_known_places(scene.name, scene.anchors, apart)
        self.scene, self.seed = scene, seed
        self.model = self._model(self._prepared(scene.filter_model(agent)))
        self.agent = self.model.agent
        self.work, self.turns = self._workspace(), runtime.Turns()
        prior = None
        if prior_map is not None:
            prior, _ = fitted(prior_map, scene, same_frame=same_frame)
        if prior is not None and (prior.lost or not self.uses_maps):
            prior = None
        self.provenance = makers_of(prior)
        prior = None if prior is None else moved_map(prior, -self.model.origin_m)
        self.inherited = None if prior is None else self._inherited(prior)
        begun = self._begun(self.start(self.model, prior))
        self.now = Moment(begun, Identity.of(scene.anchor_positions))

    def __repr__(self) -> str:
        """One line."""
        steps = counted(self.now.identity.scans, "step")
        return f"<{type(self).__name__} of {self.agent} in {self.scene.name}: {steps}>"

    def __copy__(self) -> Self:
        """Another filter at the same moment, on the same workspace."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Another filter at the same moment, which goes on as this one does."""
        other = object.__new__(type(self))
        memo[id(self)] = other
        other.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return other

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Refuse to be pickled (`InputError`): a workspace holds what belongs to its process."""
        name = type(self).__name__
        allowed = f"a checkpoint: save(path), then {name}.resume(path)"
        raise InputError(name, "a filter to be pickled", allowed)

    @property
    def state(self) -> Any:
        """What is believed after the latest step."""
        return self.now.believed

    def _begun(self, state: Any) -> Believed:
        """What is believed before the first step, of the state that the system begins with."""
        believed: Believed = state
        return believed

    def _inherited(self, prior: Map) -> Map | None:
        """What of an earlier agent's map no state holds, but goes into the map that is made."""
        return None

    def _prepared(self, model: FilterModel) -> FilterModel:
        """The model with the filter's seed, in the coordinates that the system reckons in.

        Where anchors may be turned, walls' offsets from a far origin have long levers: about the middle then.
        """
        turning = self.finds_places and bool(model.unsure.any())
        model = replace(model, seed=self.seed)
        return about(model, middle_of(model.grid, turning)) if self.centres else model

    def _model(self, model: FilterModel) -> Any:
        """What the system takes of the model."""
        return model

    def _workspace(self) -> Any:
        """What a step writes to and may forget."""
        return None

    @staticmethod
    @abstractmethod
    def start(model: Any, prior: Map | None = None) -> Any:
        """The state before the first step.

        Parameters
        ----------
        model : FilterModel, or what the front makes of it (a `SignalModel`, a `NetworkModel`)
        prior : Map, optional
            An earlier agent's, about the model's origin; None always where not `uses_maps`.
        """

    @staticmethod
    @abstractmethod
    def advance(state: Any, scan: Any, model: Any, work: Any) -> tuple[Any, Any]:
        """One step: the state after it, and what happened. The state before stays as it is.

        Parameters
        ----------
        state, model : as of `start`
        scan : Scan, SignalScan or NetworkScan; as `checked`
        work : of the front's `_workspace`; a step may write to it
        """

    @abstractmethod
    def estimate(self, believed: Believed, scan: Observed, info: Any, began: float) -> Estimate:
        """What users get of what is believed after a step; the step began at `began`, `time.perf_counter`."""

    @abstractmethod
    def map(self) -> Map:
        """The map as it stands."""

    @staticmethod
    def moved(state: Any, position_m: Array, heading_rad: float) -> Any:
        """The state before the first step, with its prior about another start (m, rad)."""
        raise InputError("start", "another than the scene's", "the scene's: this method can't be told")

    @staticmethod
    def require_sound(believed: Any, model: Any, where: str) -> None:
        """Refuse what a file holds if its numbers can't be, by an `InputError` that names the part.

        `gridslam.systems.checkpoint` checks types.
        """

    @property
    def info(self) -> Any:
        """What happened at the latest step; None before the first."""
        return self.now.info

    def start_at(self, position_m: Array, heading_rad: float) -> None:
        """Believe in another start, (2,) m and rad, than the scene's, as surely as its prior says.

        Raises
        ------
        InputError
            A step was taken already, or the start isn't finite.
        """
        state = self.state
        if state.step or state.time_s is not None:
            raise InputError("start", f"told after {self.now.identity.scans} steps", "before the first")
        position, heading = finite(position_m, "start: position_m"), finite(heading_rad, "start: heading_rad")
        if (position.size, heading.shape) != (2, ()):
            raise InputError(
                "start", f"shapes {position.shape} and {heading.shape}", "(2,) m, and one number"
            )
        require_radians(heading, "start")
        moved = self._begun(self.moved(state, position.reshape(2) - self.model.origin_m, float(heading)))
        self.now = self.now._replace(believed=moved)

    def step(self, scan: Observed) -> Estimate:
        """Process what was heard at one step and return the estimates after it; threads take turns.

        Raises
        ------
        InputError
            It makes no sense, see `Scan.checked` and `SignalScan.checked`, its step is no whole number or
            below that of the scan before, or the map that the filter began with was made of it, or no
            distance of the first is one that the radio measures; the filter stays as it was.
        """
        began = time.perf_counter()
        runtime.require_not_forked()
        with self.turns.lock, runtime.one_blas_thread():
            scan = self._checked(scan, self.state.time_s)
            require_step(scan.step, self.now.number)
            identity = self.now.identity.after(scan)
            if identity.scans == 1:
                refuse_heard(self.provenance, identity)
                require_in_reach(scan, self.scene)
            believed, info = self._advanced(scan)
            estimate = self.estimate(believed, scan, info, began)
            # last and at once: whatever interrupts a step leaves the moment before
            self.now = Moment(believed, identity, info, scan.step)
        return estimate

    def _checked(self, scan: Observed, after: float | None) -> Observed:
        """What was heard, if it is of the kind that the system takes and makes sense."""
        return scan.checked(len(self.scene.anchors), after)

    def _advanced(self, scan: Observed) -> tuple[Believed, Any]:
        """What is believed after a scan, and what happened."""
        return self.advance(self.state, scan, self.model, self.work)

    @property
    def lost(self) -> bool:
        """Whether the filter notices that the agent is lost, so that nobody is to go on from its map."""
        return False

    def latest(self) -> dict[str, Any]:
        """Provenance of the map as it stands: that of the map it began with, and this run; see `Map`.

        `lost` is not handed down: nobody goes on from a map whose maker is lost.
        """
        own = {
            "agents": self.agent,
            "seeds": self.seed,
            "steps": self.now.identity.scans,
            "runs": self.now.identity.text,
            "kinds": self.takes,
        }
        names = [*self.provenance.get("told", ()), *([self.truth_given] if self.truth_given else ())]
        lists = {key: [*self.provenance[key], value] for key, value in own.items()}
        lost = {"lost": [self.agent]} if self.lost else {}
        return lists | ({"told": names} if names else {}) | lost

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, from which `resume` goes on bit for bit.

        Raises
        ------
        InputError
            The file can't be written.
        """
        from gridslam.systems.checkpoint import write_checkpoint

        write_checkpoint(self, path)

    @classmethod
    def resume(cls, path: str | os.PathLike[str]) -> Self:
        """Read a checkpoint of this system.

        Raises
        ------
        InputError
            No such file, or not a checkpoint of this version and system.
        """
        from gridslam.systems.checkpoint import read_checkpoint

        slam: Self = read_checkpoint(path, cls)
        return slam


def require_paths(scan: object, system: object) -> None:
    """Refuse what is no scan of path measurements.

    Raises
    ------
    InputError
    """
    if isinstance(scan, Scan):
        return
    sampled = isinstance(scan, SignalScan)
    found = "sampled signals" if sampled else type(scan).__name__
    more = ": gridslam extract makes them of signals" if sampled else ""
    raise InputError(f"{type(system).__name__}.step", found, f"path measurements, a Scan{more}")
