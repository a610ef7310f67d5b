"""A run in the Rerun viewer while it goes on: the world, what the filter believes, how well it does."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import Array
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.estimates import Estimate, Health
from gridslam.inference.management.network.readout import NetworkEstimate
from gridslam.maps.map import Map
from gridslam.runs.run_files import RunFiles
from gridslam.viewers import rerun_target
from gridslam.world.geometry import unit, wrap
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

BLUE, GREEN, GREY = (0, 114, 178), (0, 158, 115), (170, 170, 170)
BLACK, WHITE = (0, 0, 0), (255, 255, 255)
SIGMAS, CIRCLE = 3.0, 48
MAP_EVERY = 10
"""Steps between two pictures of the grid, each as large as all else of a hundred steps."""
WEAK_DB, STRONG_DB = 6.0, 40.0
"""Paths are coloured by SNR between these."""
LAYER = 0.001
"""Height of one layer over the one below, of the larger side of the grid: all is drawn in the plane."""
GRID, WALLS, SURFACES, PATHS, TRACK, AGENT = range(6)


@contextmanager
def open_view(
    scene: Scene,
    agents: Sequence[str],
    where: str | None = None,
    overwrite: bool = False,
    health: bool = True,
) -> Iterator[RunView]:
    """Open a view of a run; see `rerun_target.open_stream` for `where`, `overwrite` and errors."""
    with rerun_target.open_stream(where, overwrite) as stream:
        yield RunView(stream, scene, agents, health)


def replay(run: RunFiles, where: str | None = None, overwrite: bool = False) -> None:
    """Show a finished run, of which neither health nor the grid of earlier steps is kept."""
    with open_view(run.scene, list(run.agents), where, overwrite, health=False) as view:
        for name, found in run.agents.items():
            view.follow(name, found.truth)
            for estimate in found.estimates:
                view.show(estimate)
            view.show_map(found.map)


class RunView:
    """What is logged, on the timeline ``step``, which runs on from one agent to the next.

    ``world/`` holds what has a place: ``anchors``, ``walls`` (the truth), ``map``, ``surfaces`` and
    ``candidates`` (not sure to exist), ``paths`` of the step, and for each agent ``NAME/track``,
    ``NAME/true_track``, ``NAME/now/...``; ``error/`` and ``health/`` hold curves.

    Parameters
    ----------
    stream : rerun.RecordingStream
    scene : Scene
    agents : sequence of str
        All that will be followed.
    health : bool
        Whether the estimates come with their health.
    """

    def __init__(self, stream: Any, scene: Scene, agents: Sequence[str], health: bool = True) -> None:
        self.rr, self.stream, self.scene = rerun_target.package(), stream, scene
        self.size = max(b - a for a, b in (scene.grid.x_m, scene.grid.y_m))
        self.health = health
        self.agent = ""
        self.truth: Trajectory | None = None
        self.first = self.step = 0
        """Steps before this agent's, and the one shown last, on the timeline."""
        self.last: dict[tuple[str, str], Array] = {}
        self.seen_s: dict[str, float] = {}
        self.why: dict[str, str] = {}
        self.paths = "world/paths"
        stream.send_blueprint(self._layout(agents))
        self._world()

    def follow(
        self, agent: str, truth: Trajectory | None = None
    ) -> Callable[[Estimate, Callable[[], Map]], None]:
        """Begin with an agent; the one before leaves its track.

        Returns
        -------
        callable
            What `gridslam.map_scene` takes as `watch`: shows each step, and now and then the map.
        """
        if self.agent:
            self.first = self.step + 1
            self.stream.set_time("step", sequence=self.first)
            self.stream.log(f"world/{self.agent}/now", self.rr.Clear(recursive=True))
        self.agent, self.truth, self.last, self.why = agent, truth, {}, {}
        self.seen_s = {}
        return self._watch

    def follow_all(
        self, truths: Mapping[str, Trajectory]
    ) -> Callable[[NetworkEstimate, Callable[[], Map]], None]:
        """Show several agents at once; paths are ``world/NAME/now/paths``.

        Parameters
        ----------
        truths : mapping of str to Trajectory
            True tracks of agents of which they are known.

        Returns
        -------
        callable
            What `gridslam.map_network` takes as `watch`.
        """

        def watch(now: NetworkEstimate, grid: Callable[[], Map]) -> None:
            for name, own in now.agents.items():
                if own is not None:
                    self.agent, self.truth, self.paths = name, truths.get(name), f"world/{name}/now/paths"
                    self.show(own)
            if now.step % MAP_EVERY == 0:
                self.show_map(grid())

        return watch

    def show(self, now: Estimate) -> None:
        """Show one step."""
        self.step = self.first + now.step
        self.stream.set_time("step", sequence=self.step)
        self._agent(now)
        self._surfaces(now.surfaces, np.asarray(now.detected, bool))
        level = 20 * np.log10(np.maximum(now.paths.amplitude, 1e-6))
        share = np.clip((level - WEAK_DB) / (STRONG_DB - WEAK_DB), 0, 1)
        ways = [row[~np.isnan(row[:, 0])] for row in now.paths.points]
        self._lines(self.paths, ways, PATHS, 0.6, colormaps["plasma_r"](0.1 + 0.9 * share, bytes=True))
        self._errors(now)
        if self.health:
            self._health(now.health)

    def show_map(self, grid: Map) -> None:
        """Show the occupancy of the cells at the step shown last: white free, black occupied."""
        rr, shade = self.rr, np.full(grid.shape, 255, np.uint8)  # as in ROS: 255 unknown, else per cent
        shade[grid.observed] = np.round(100 * grid.occupancy[grid.observed]).astype(np.uint8)
        height, width = grid.shape
        form = rr.components.ImageFormat(
            width=width, height=height, color_model="L", channel_datatype=rr.ChannelDatatype.U8
        )
        picture = rr.GridMap(
            data=shade[::-1].tobytes(),  # first row at the top
            format=form,
            cell_size=grid.cell_m,
            translation=[*grid.origin_m, self._height(GRID)],
            colormap=rr.components.Colormap.RvizMap,
        )
        self.stream.log("world/map", picture)

    def _watch(self, estimate: Estimate, grid: Callable[[], Map]) -> None:
        self.show(estimate)
        if estimate.step % MAP_EVERY == 0:
            self.show_map(grid())

    def _world(self) -> None:
        """What doesn't change: anchors, and the walls where they are known."""
        rr, anchors = self.rr, self.scene.anchor_positions
        self.stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._points("world/anchors", anchors, 5, BLACK, static=True)
        self._labels("world/anchors", anchors, list(self.scene.anchor_names), static=True)
        self._arrows("world/anchors/facing", anchors, self.scene.anchor_orientations, BLACK, static=True)
        walls = self.scene.segments()
        if len(walls):
            self._lines("world/walls", np.stack([walls.start, walls.end], 1), WALLS, 1.0, GREEN, static=True)

    def _agent(self, now: Estimate) -> None:
        here = f"world/{self.agent}/now"
        self._points(f"{here}/place", [now.position_m], 5, BLUE)
        self._labels(f"{here}/place", [now.position_m], [self.agent])
        self._arrows(f"{here}/heading", [now.position_m], np.array([now.heading_rad]), BLUE)
        around = ellipse(now.position_m, now.covariance[:2, :2])
        self._lines(f"{here}/ellipse", [around], AGENT, 1.0, BLUE)
        self._walk("track", now.position_m, 1.5, BLUE)

    def _walk(self, name: str, place: Array, width: float, color: ArrayLike) -> None:
        """One more piece of a track: each is logged once, and the view shows all up to the step."""
        key = self.agent, name
        self._lines(f"world/{self.agent}/{name}", [[self.last.get(key, place), place]], TRACK, width, color)
        self.last[key] = place

    def _surfaces(self, surfaces: SurfaceEstimate, detected: NDArray[np.bool_]) -> None:
        """Stretches that were hit: coloured by coefficient and labelled, or thin and grey."""
        hit = np.isfinite(surfaces.extent_m).all(1)
        found, other = surfaces.take(hit & detected), surfaces.take(hit & ~detected)
        spread = np.sqrt(np.maximum(found.reflection_var, 0))
        known = found.reflection_learned
        moments = zip(found.reflection, spread, known, strict=True)
        words = [f"R {value:.2f} ± {std:.2f}" if told else "R not measured" for value, std, told in moments]
        rows = zip(found.identity, words, found.existence, strict=True)
        labels = [f"{who}: {word}, exists {sure:.3f}" for who, word, sure in rows]
        color = colormaps["viridis"](np.clip(found.reflection, 0, 1), bytes=True)
        color[~known] = GREY
        self._lines("world/surfaces", found.ends_m, SURFACES, 2.5, color)
        self._labels("world/surfaces", found.ends_m.mean(1), labels)
        self._lines("world/candidates", other.ends_m, SURFACES, 0.8, GREY)

    def _errors(self, now: Estimate) -> None:
        self._curve("error/position_std_cm", 100 * np.sqrt(np.trace(now.covariance[:2, :2])))
        self._curve("error/heading_std_deg", np.degrees(np.sqrt(now.covariance[4, 4])))
        truth = self.truth
        if truth is None or not truth.time_s[0] <= now.time_s <= truth.time_s[-1]:
            return
        first, last = truth.holes().T
        before = self.seen_s.get(self.agent, now.time_s)
        if ((first < now.time_s) & (last > before)).any():  # no line across
            self.last.pop((self.agent, "true_track"), None)
        if truth.in_hole(np.array([now.time_s]))[0]:
            return
        self.seen_s[self.agent] = now.time_s
        there = np.array([np.interp(now.time_s, truth.time_s, axis) for axis in truth.position_m.T])
        facing = np.interp(now.time_s, truth.time_s, np.unwrap(truth.heading_rad))
        self._walk("true_track", there, 0.8, BLACK)
        self._curve("error/position_cm", 100 * np.linalg.norm(now.position_m - there))
        self._curve("error/heading_deg", abs(np.degrees(wrap(now.heading_rad - facing))))

    def _health(self, health: Health) -> None:
        self._curve("health/innovation", health.innovation)
        self._curve("health/innovation_bound", health.innovation_band[1])
        self._curve("health/explained", health.explained)
        self._curve("health/amplitude", health.amplitude)
        self._curve("health/particles", health.effective_sample_size)
        for name, clutter in zip(self.scene.anchor_names, health.clutter, strict=False):
            self._curve(f"health/clutter/{name}", clutter)
        if health.why != self.why.get(self.agent, ""):
            level = self.rr.TextLogLevel.INFO if health.ok else self.rr.TextLogLevel.WARN
            self.stream.log(
                f"health/{self.agent}/why", self.rr.TextLog(health.why or "all fits again", level=level)
            )
            self.why[self.agent] = health.why

    def _curve(self, name: str, value: Any) -> None:
        group, _, rest = name.partition("/")
        self.stream.log(f"{group}/{self.agent}/{rest}", self.rr.Scalars(float(value)))

    def _points(
        self, name: str, points: ArrayLike, size: float, color: ArrayLike, static: bool = False
    ) -> None:
        radius = self.rr.Radius.ui_points(size)
        shown = self.rr.Points3D(self._lifted(points, AGENT), radii=radius, colors=color)
        self.stream.log(name, shown, static=static)

    def _labels(self, name: str, points: ArrayLike, labels: list[str], static: bool = False) -> None:
        """Words at points of no size: a viewer writes in the colour of what is labelled, on dark grey."""
        place = self._lifted(points, AGENT)
        shown = self.rr.Points3D(place, radii=0.0, colors=WHITE, labels=labels)
        self.stream.log(f"{name}/label", shown, static=static)

    def _arrows(
        self, name: str, points: ArrayLike, facing: Array, color: ArrayLike, static: bool = False
    ) -> None:
        way = np.pad(0.04 * self.size * unit(facing), ((0, 0), (0, 1)))
        radius = self.rr.Radius.ui_points(2)
        start = self._lifted(points, AGENT)
        shown = self.rr.Arrows3D(vectors=way, origins=start, radii=radius, colors=color)
        self.stream.log(name, shown, static=static)

    def _lines(
        self, name: str, strips: Any, layer: int, width: float, color: ArrayLike, static: bool = False
    ) -> None:
        """Polylines; none at all wipes out those of the step before."""
        lifted = [self._lifted(strip, layer) for strip in strips]
        radius = self.rr.Radius.ui_points(width)
        self.stream.log(name, self.rr.LineStrips3D(lifted, radii=radius, colors=color), static=static)

    def _lifted(self, points: ArrayLike, layer: int) -> Array:
        plane = np.asarray(points, float).reshape(-1, 2)
        return np.column_stack([plane, np.full(len(plane), self._height(layer))])

    def _height(self, layer: int) -> float:
        return layer * LAYER * self.size

    def _layout(self, agents: Sequence[str]) -> Any:
        """The plan seen from above, with y up, beside the curves."""
        rrb = self.rr.blueprint
        middle = [sum(self.scene.grid.x_m) / 2, sum(self.scene.grid.y_m) / 2]
        so_far = rrb.VisibleTimeRanges(
            timeline="step",
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
        tracks = {f"world/{name}/{kind}": [so_far] for name in agents for kind in ("track", "true_track")}
        plan = rrb.Spatial3DView(
            origin="world",
            name=self.scene.name,
            background=(255, 255, 255),
            line_grid=False,
            eye_controls=rrb.EyeControls3D(
                position=[*middle, 1.1 * self.size], look_target=[*middle, 0.0], eye_up=[0.0, 1.0, 0.0]
            ),
            overrides=tracks,
        )

        def curves(name: str, *parts: str) -> Any:
            return rrb.TimeSeriesView(origin="/", name=name, contents=[f"+ /{part}" for part in parts])

        def own(group: str, *kinds: str) -> list[str]:
            return [f"{group}/{name}/{kind}" for name in agents for kind in kinds]

        side = [
            curves("position, cm", *own("error", "position_cm", "position_std_cm")),
            curves("heading, deg", *own("error", "heading_deg", "heading_std_deg")),
        ]
        if self.health:
            ratios = own("health", "innovation", "innovation_bound", "explained", "amplitude")
            more = [curves(kind, *own("health", f"{kind}/**")) for kind in ("clutter", "particles")]
            side += [
                curves("health", *ratios),
                rrb.Tabs(rrb.TextLogView(origin="health", name="amiss"), *more),
            ]
        return rrb.Blueprint(
            rrb.Horizontal(plan, rrb.Vertical(*side), column_shares=[2, 1]),
            rrb.TimePanel(timeline="step", state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            rrb.BlueprintPanel(state="collapsed"),
        )


def ellipse(place: Array, covariance: Array) -> Array:
    """Closed polyline, (CIRCLE + 1, 2), m, of the points `SIGMAS` standard deviations from a place."""
    variance, axes = np.linalg.eigh(covariance)
    circle = unit(np.linspace(0, 2 * np.pi, CIRCLE + 1))
    return place + SIGMAS * (circle * np.sqrt(np.maximum(variance, 0))) @ axes.T
