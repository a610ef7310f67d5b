"""What the tables of a scene must agree in: names, clocks, and places that devices may be at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridslam.arrays import Array
from gridslam.world.clocks import Clocks
from gridslam.world.geometry import Segments, crossing, distance_to_segments, wrap
from gridslam.world.names import same_folder
from gridslam.world.scene_derived import track_of
from gridslam.world.scene_parts import Agent, Anchor, GridSpec
from gridslam.world.validation import fault, nearest
from gridslam.world.waypoints import TightCorner

CLEARANCE_M, SCATTERER_M = 0.01, 0.1
"""Distance that devices keep from walls, and from scatterers."""


@dataclass(frozen=True, eq=False)
class Room:
    """Where devices may be: the region to map, pieces of walls, and scatterers (K, 2) m; names of walls."""

    grid: GridSpec
    walls: Segments
    scatterers: Array
    names: Sequence[str | None] = ()

    def wall(self, number: int) -> str:
        """What a wall is called in errors."""
        name = self.names[number] if number < len(self.names) else None
        return f"walls[{number}]" + (f" ({name!r})" if name else "")


def check_names(anchors: Sequence[Anchor], agents: Sequence[Agent]) -> None:
    """Refuse names that are taken, and agents whose folders would be the same."""
    kinds: dict[str, Sequence[Anchor | Agent]] = {"anchors": anchors, "agents": agents}
    for key, devices in kinds.items():
        names = [device.name for device in devices]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise fault(f"{key}[{index}].name", repr(name), "a name that isn't taken")
    folders = [same_folder(agent.name) for agent in agents]
    for index, folder in enumerate(folders):
        if folder in folders[:index]:
            found = f"{agents[index].name!r} beside {agents[folders.index(folder)].name!r}"
            raise fault(f"agents[{index}].name", found, "names that differ by more than case")


def check_clocks(clocks: Clocks | None, anchors: Sequence[Anchor], agents: Sequence[Agent]) -> None:
    """Refuse clocks of devices without a table of clocks, names of two of them, and a reference to none."""
    kinds: dict[str, Sequence[Anchor | Agent]] = {"anchors": anchors, "agents": agents}
    for key, devices in kinds.items():
        for index, device in enumerate(devices):
            if device.clock is not None and clocks is None:
                raise fault(f"{key}[{index}].clock", "a clock", "none, or a table [clocks] too")
    if clocks is None:
        return
    names = [anchor.name for anchor in anchors]
    for index, agent in enumerate(agents):
        if agent.name in names:
            allowed = "a name that no anchor has: clocks go by the names of their devices"
            raise fault(f"agents[{index}].name", repr(agent.name), allowed)
    if clocks.reference is not None:
        names += [agent.name for agent in agents]
        if clocks.reference not in names:
            raise fault("clocks.reference", repr(clocks.reference), nearest(clocks.reference, names))


def check_places(anchors: Sequence[Anchor], agents: Sequence[Agent], room: Room) -> None:
    """Refuse anchors, starts and ways outside the region, or where a wall or a scatterer is."""
    for index, anchor in enumerate(anchors):
        _check_way(np.array([anchor.position_m[:2]]), room, f"anchors[{index}].position_m")
    for index, agent in enumerate(agents):
        _check_way(np.array([agent.start_m]), room, f"agents[{index}].start_m")
        if agent.waypoints_m is not None:
            _check_track(agent, room, f"agents[{index}]")


def _check_track(agent: Agent, room: Room, where: str) -> None:
    try:
        track = track_of(agent)
    except TightCorner as error:
        index = error.index + len(agent.waypoints_m or ()) - len(agent.way) + 1
        x, y = agent.way[error.index + 1]
        found = f"room to turn with a radius of {error.radius:.3g} m at ({x:g}, {y:g})"
        step = math.floor(1e3 * error.step) / 1e3  # 0 of a turn on the spot
        cure = f"longer legs beside it, a blunter corner{f', or a step_m of {step:g} or less' * (step > 0)}"
        allowed = f"{error.smallest:.3g} m or more: {cure}"
        raise fault(f"{where}.waypoints_m[{index}]", found, allowed) from None
    if agent.steps is not None and agent.steps > len(track):
        raise fault(f"{where}.steps", str(agent.steps), f"at most {len(track)}, where the waypoints end")
    off = np.degrees(np.abs(wrap(track.heading_rad[0] - np.radians(agent.start_heading_deg))))
    if off > max(agent.prior.heading_deg, 1e-6):
        facing = float(np.degrees(track.heading_rad[0]))
        allowed = f"{facing:.1f} (the motion's) within prior.heading_deg"
        raise fault(f"{where}.start_heading_deg", str(agent.start_heading_deg), allowed)
    _check_way(track.position_m, room, f"{where}.waypoints_m")


def _check_way(way: Array, room: Room, where: str) -> None:
    """Positions (N, 2) inside the region, clear of walls, and no wall between consecutive ones."""
    walls, outside = room.walls, ~room.grid.holds(way)
    if outside.any():
        x, y = way[outside][0]
        allowed = f"x in {list(room.grid.x_m)}, y in {list(room.grid.y_m)}"
        raise fault(where, f"({x:.4g}, {y:.4g}) outside the grid", allowed)
    for number, (start, end, line) in enumerate(zip(walls.start, walls.end, walls.line, strict=True)):
        near = distance_to_segments(way, start[None], end[None])[:, 0] < CLEARANCE_M
        if len(way) > 1:
            here = crossing(way[:-1], way[1:], line)
            with np.errstate(invalid="ignore"):
                along = (way[:-1] + here[:, None] * (way[1:] - way[:-1]) - start) @ (end - start)
                near[1:] |= (
                    (here >= 0) & (here <= 1) & (along >= 0) & (along <= (end - start) @ (end - start))
                )
        if near.any():
            x, y = way[near][0]
            found = f"({x:.4g}, {y:.4g}) in {room.wall(int(walls.wall[number]))}"
            raise fault(where, found, f"places at least {CLEARANCE_M} m from every wall")
    gap = np.linalg.norm(way[:, None] - room.scatterers, axis=-1)
    if gap.size and gap.min() < SCATTERER_M:
        row, number = np.unravel_index(gap.argmin(), gap.shape)
        x, y = way[row]
        found = f"({x:.4g}, {y:.4g}) at scatterers[{number}]"
        raise fault(where, found, f"places at least {SCATTERER_M} m from every scatterer")
