"""What the world is: radio, anchors, the region to map, agents and, where it is known, the true walls."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import tomli_w
from pydantic import Field, model_validator

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.world.clocks import Clocks
from gridslam.world.filter_model import FilterModel, fixed
from gridslam.world.filter_settings import FilterSettings
from gridslam.world.geometry import Segments, wrap
from gridslam.world.levels import Level, Verticals, check_heights, verticals_of
from gridslam.world.names import Label
from gridslam.world.radio import RadioModel
from gridslam.world.scene_checks import Room, check_clocks, check_names, check_places
from gridslam.world.scene_derived import mounting_std_of, segments_of, start_prior, track_of
from gridslam.world.scene_files import scene_tables, scene_text
from gridslam.world.scene_parts import Agent, Anchor, GridSpec, Name, Radio, Scatterer, Share, Wall
from gridslam.world.scene_radio import check_samples, link_of, waveform_of
from gridslam.world.trajectory import Trajectory
from gridslam.world.validation import Strict, fault, nearest
from gridslam.world.waveform import Waveform


class Scene(Strict):
    """A scene file; attributes are named as its keys: see docs/scene-file.md.

    Examples
    --------
    >>> import gridslam as gs
    >>> gs.Scene.load("room").anchor_names
    ('A', 'B')
    """

    name: Label = "scene"
    description: str = ""
    frame: Label | None = None
    radio: Radio = Radio()
    grid: GridSpec
    materials: dict[Name, Share] = Field(default_factory=lambda: {"concrete": 0.7, "glass": 0.3})
    anchors: tuple[Anchor, ...] = Field(min_length=1)
    walls: tuple[Wall, ...] = ()
    floor: Level | None = None
    ceiling: Level | None = None
    scatterers: tuple[Scatterer, ...] = ()
    agents: tuple[Agent, ...] = ()
    clocks: Clocks | None = None
    filter: FilterSettings = FilterSettings()

    def __repr__(self) -> str:
        """One line; `to_toml` has all of it."""
        things = {"anchor": self.anchors, "wall": self.walls, "agent": self.agents}
        counts = ", ".join(f"{len(one)} {name}{'s' * (len(one) != 1)}" for name, one in things.items())
        return f"<Scene {self.name}: {counts}>"

    __str__ = __repr__

    @classmethod
    def load(cls, name_or_path: str | os.PathLike[str]) -> Scene:
        """Read a bundled scene by name or a file by path (with a folder or ``.toml`` in it).

        Raises
        ------
        InputError
            No such scene or file, a TOML error, or any fault in its content.
        """
        return cls.from_toml(*scene_text(name_or_path))

    @classmethod
    def from_toml(cls, text: str, where: str = "scene") -> Scene:
        """Read a scene from TOML text; `where` names it in errors.

        Raises
        ------
        InputError
            A TOML error or any fault in the content.
        """
        return cls.checked(scene_tables(text, where), where)

    def to_toml(self) -> str:
        """Write all settings, defaults included; reads back as an equal scene."""
        return tomli_w.dumps(self.model_dump(exclude_none=True))

    def with_filter(self, **changes: Any) -> Scene:
        """Return the scene with other filter settings.

        Raises
        ------
        InputError
            An unknown setting or a value out of range.
        """
        whole = self.model_dump(exclude_none=True)
        return self.checked({**whole, "filter": {**whole["filter"], **changes}}, self.name)

    def agent(self, name: str) -> Agent:
        """Agent of a name.

        Raises
        ------
        InputError
            There is none.
        """
        for agent in self.agents:
            if agent.name == name:
                return agent
        raise InputError(
            f"{self.name}: agents", repr(name), ", ".join(a.name for a in self.agents) or "none here"
        )

    def starting(self, agent: str | None, position_m: Array, heading_rad: float) -> Scene:
        """The scene with another start of an agent, None for the first; walls aren't minded.

        `position_m` is (2,) m. `InputError`: there is no agent of this name.
        """
        body = self.agent(agent) if agent is not None else self.agents[0]
        x, y = np.asarray(position_m, np.float64).tolist()
        start = {"start_m": (x, y), "start_heading_deg": float(np.degrees(heading_rad))}
        moved = [a.model_copy(update=start) if a is body else a for a in self.agents]
        return self.model_copy(update={"agents": type(self.agents)(moved)})

    @property
    def anchor_names(self) -> tuple[str, ...]:
        """Names of the anchors, in order."""
        return tuple(anchor.name for anchor in self.anchors)

    @property
    def anchor_positions(self) -> Array:
        """Positions of the anchors, (J, 2) m, as seen from above."""
        return np.array([anchor.position_m[:2] for anchor in self.anchors], dtype=np.float64)

    @property
    def anchor_places(self) -> Array:
        """Positions of the anchors with heights, (J, 3) m, where the scene has some; else (J, 2) m."""
        return np.array([anchor.position_m for anchor in self.anchors], dtype=np.float64)

    @property
    def has_heights(self) -> bool:
        """Whether anchors have heights; without, all is planar."""
        return len(self.anchors[0].position_m) > 2

    def require_planar(self) -> None:
        """Refuse heights, for methods that know none: those on sampled signals, and the published ones.

        Raises
        ------
        InputError
            Anchors have heights.
        """
        if self.has_heights:
            where, found = f"{self.name}: anchors[0].position_m", str(list(self.anchors[0].position_m))
            raise InputError(
                where, found, "[x, y] and no height_m: sampled signals, refa and network-paper are planar"
            )

    def require_walls_alone(self, method: str) -> None:
        """Refuse floor and ceiling, for a method whose paths go over walls alone.

        Raises
        ------
        InputError
            One of them reflects.
        """
        for name in self.levels:
            allowed = "none, or grid or adaptive SLAM, whose paths may go over it"
            raise InputError(f"{self.name}: {name}", f"a {name} that reflects, for {method}", allowed)

    def require_known_heights(self, method: str, agent: str | None = None) -> None:
        """Refuse heights with deviations, for a method that takes them as they are.

        Raises
        ------
        InputError
            That of the agent (default: of any), of floor or of ceiling has one.
        """
        for body in self.agents if agent is None else (self.agent(agent),):
            for name, (_, std) in self.uncertain_heights(body.name).items():
                where = f"agents[{self.agents.index(body)}]" if name == "agent" else name
                allowed = "0, or grid or adaptive SLAM by Gaussians, which estimate heights"
                raise InputError(f"{self.name}: {where}.height_std_m", f"{std:g}, for {method}", allowed)

    def uncertain_heights(self, agent: str) -> dict[str, tuple[float, float]]:
        """Heights that aren't known, and their deviations, m: of "agent", "floor", "ceiling"."""
        elements: dict[str, Agent | Level] = {"agent": self.agent(agent), **self.levels}
        both = {name: (float(one.height_m or 0.0), one.height_std_m) for name, one in elements.items()}
        return {name: known for name, known in both.items() if known[1] > 0}

    @property
    def levels(self) -> dict[str, Level]:
        """Floor and ceiling, where they reflect."""
        both = {"floor": self.floor, "ceiling": self.ceiling}
        return {name: level for name, level in both.items() if level is not None}

    def at_coefficients(self, coefficients: Mapping[str, float]) -> Scene:
        """The scene with other reflection coefficients, 0 to 1, of "floor" and "ceiling"."""
        own = {n: self.levels[n].model_copy(update={"coefficient": one}) for n, one in coefficients.items()}
        return self.model_copy(update=own)

    def at_heights(self, agent: str | None, heights_m: Mapping[str, float]) -> Scene:
        """The scene with other heights, m, by the names "agent", "floor" and "ceiling"; others stay.

        The agent is that of the name, None for the first. `InputError`: there is none of this name.
        """
        body = self.agent(agent) if agent is not None else self.agents[0]
        other = ((n, {"height_m": heights_m[n]}) for n in self.levels if n in heights_m)
        changes: dict[str, Any] = {n: self.levels[n].model_copy(update=one) for n, one in other}
        if "agent" in heights_m:
            own = body.model_copy(update={"height_m": heights_m["agent"]})
            changes["agents"] = tuple(own if a is body else a for a in self.agents)
        return self.model_copy(update=changes)

    def found_heights(self, agent: str, higher: Array, covariance: Array) -> dict[str, tuple[float, float]]:
        """Heights that the scene leaves open, by name, each (height, deviation) in m.

        They follow from believed rises `higher`, (G,) m, of `covariance` (G, G), m^2: see `Verticals`.
        """
        stated, ways = self.uncertain_heights(agent), self.verticals(agent)
        errors = ways.errors(higher, covariance)
        return {
            name: (known + errors[over][0], errors[over][1])
            for over, name in enumerate(("agent", "floor", "ceiling"))
            for known, _ in ([stated[name]] if name in stated else [])
        }

    def heights(self, agent: str | None = None) -> Array:
        """How high the anchors stand above an agent, by default the first, (J,) m: 0 in a planar scene.

        Raises
        ------
        InputError
            There is no such agent.
        """
        return np.asarray(self.verticals(agent).height[0])

    def verticals(self, agent: str | None = None) -> Verticals:
        """Heights of anchors above an agent, by default the first, and of their images in floor and ceiling.

        Raises
        ------
        InputError
            There is no such agent.
        """
        if not self.has_heights:
            return verticals_of(np.zeros(len(self.anchors)), 0.0, None, None)
        bodies = self.agents[:1] if agent is None else (self.agent(agent),)
        own = sum(body.height_m or 0.0 for body in bodies)
        above = np.array([anchor.position_m[2] - own for anchor in self.anchors], dtype=np.float64)
        unsure = max((body.height_std_m for body in bodies), default=0.0)
        return verticals_of(above, own, self.floor, self.ceiling, unsure)

    @property
    def scatterer_positions(self) -> Array:
        """Positions of the scatterers, (S, 2) m."""
        return np.reshape([point.position_m for point in self.scatterers], (-1, 2)).astype(np.float64)

    @property
    def anchor_orientations(self) -> Array:
        """Orientations of the anchors, (J,) rad in (-pi, pi]."""
        return wrap(np.radians([anchor.orientation_deg for anchor in self.anchors]))

    def signal_model(self, agent: str | None = None) -> RadioModel:
        """Numbers of the radio link that the likelihoods need, with the arrays of anchors and agent.

        Raises
        ------
        InputError
            There is no agent of this name.
        """
        carried = self.agent(agent).array if agent is not None else None
        return link_of(self.radio, self.anchors, carried or self.radio.array)

    def waveform(self, agent: str | None = None) -> Waveform:
        """Frequencies, pulse and elements of the signals that an agent (default: the first) would sample.

        Raises
        ------
        InputError
            ``radio.frequencies`` isn't given, the anchors' arrays differ in size or have heights, or there is
            no such agent.
        """
        self.require_planar()
        body = self.agent(agent) if agent is not None else self.agents[0]
        return waveform_of(self.radio, self.anchors, body, self.name)

    def filter_model(self, agent: str | None = None) -> FilterModel:
        """What a filter may know: neither walls nor waypoints.

        Parameters
        ----------
        agent : str, optional
            Whose start, prior and array; default: the first.

        Raises
        ------
        InputError
            There is no such agent, or none.
        """
        if agent is None and not self.agents:
            raise InputError(f"{self.name}: agents", "none", "at least one, to say where it starts")
        body = self.agent(agent) if agent else self.agents[0]
        mean, variance = start_prior(body)
        anchors = np.column_stack([self.anchor_positions, self.anchor_orientations])
        ways = self.verticals(body.name)
        return FilterModel(
            self.name, body.name, self.signal_model(body.name).imaged(ways.gain), self.anchor_names,
            fixed(np.tile(anchors, (len(ways.gain), 1))), fixed(ways.height.ravel()), self.radio.max_bounces,
            self.grid, self.filter, fixed(mean), fixed(variance),
            np.repeat(ways.rise, len(self.anchors)), fixed(ways.rise_variance),
            fixed(np.zeros(len(ways.rise_variance))), level_prior=ways.coefficient,
            level_names=tuple(self.levels), mounting_std=fixed(mounting_std_of(self.anchors)),
        )  # fmt: skip

    def segments(self) -> Segments:
        """Straight pieces of all walls; see `scene_derived.segments_of`."""
        return segments_of(self.walls, self.materials)

    def track(self, agent: str) -> Trajectory:
        """Smooth way of an agent through its waypoints, one state per step.

        Raises
        ------
        InputError
            No such agent, or one without waypoints.
        """
        body = self.agent(agent)
        if body.waypoints_m is None:
            where = f"{self.name}: agents[{self.agents.index(body)}].waypoints_m"
            raise InputError(where, "none", "waypoints, to simulate this agent")
        return track_of(body)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_names(self.anchors, self.agents)
        check_heights(self.anchors, self.agents, self.floor, self.ceiling)
        check_clocks(self.clocks, self.anchors, self.agents)
        for index, wall in enumerate(self.walls):
            if wall.material is not None and wall.material not in self.materials:
                allowed = f"a name of [materials]: {nearest(wall.material, self.materials)}"
                raise fault(f"walls[{index}].material", repr(wall.material), allowed)
        check_samples(self.radio, self.anchors, self.agents)
        called = [wall.name for wall in self.walls]
        room = Room(self.grid, self.segments(), self.scatterer_positions, called)
        check_places(self.anchors, self.agents, room)
        return self
