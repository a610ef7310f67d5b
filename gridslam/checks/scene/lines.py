"""What a scene holds, in lines: sizes, and where on their ways agents see anchors."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.simulation.image_source import visible
from gridslam.wording import counted
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene
from gridslam.world.scene_derived import repeats_note
from gridslam.world.scene_parts import Agent, Anchor

LEAST_CARRIER_HZ, LEAST_BANDWIDTH_HZ = 1e6, 1e5
"""Below these a radio can't be meant: at 100 kHz two paths must differ by 3 km to be told apart."""

MUCH = 10.0
"""Times the region's greater side by which no wall reaches out of it."""
UNITS = {"centimetres": 1e-2, "millimetres": 1e-3}
"""In which walls may be drawn, m."""
WALKS, TINY_NS = 4.0, 1e-6
"""Deviations of the walk that a clock is told to make, within which a drift passes for one; and rounding."""
MOST_NAMED = 12
"""Anchors up to which each is said of how often it is in sight."""


def scene_lines(scene: Scene) -> list[str]:
    """Say what a scene holds, and of each agent with a way how much of it an anchor is in sight.

    Where none is, only reflections tell where the agent is, and where nothing reflects either, nothing does.
    """
    size = " x ".join(str(n) for n in reversed(scene.grid.shape))
    pieces = len(scene.segments())
    walls = counted(len(scene.walls), "wall")
    if pieces > len(scene.walls):
        walls += f" of {counted(pieces, 'piece')}"
    counts = f"{counted(len(scene.anchors), 'anchor')}, {walls}, {counted(len(scene.agents), 'agent')}"
    lines = [f"scene {scene.name}: {counts}, {size} cells of {scene.grid.cell_m:g} m"]
    lines += [f"suspect: {found}" for found in implausible_radio(scene)]
    lines += _beyond(scene)
    notes = [repeats_note(scene.walls), hidden_note(scene), clock_note(scene)]
    lines += [f"note: {found}" for found in notes if found]
    for agent in scene.agents:
        if scene.walls and agent.waypoints_m:
            lines.append(f"  {agent.name}: {_in_sight(scene, scene.track(agent.name).position_m)}")
    return lines


def hidden_note(scene: Scene) -> str | None:
    """Which anchors no line of sight leads to from any step of any agent's way; None if none is hidden."""
    ways = [scene.track(agent.name).position_m for agent in scene.agents if agent.waypoints_m is not None]
    if not (scene.walls and ways):
        return None
    walls, way = scene.segments(), np.concatenate(ways)
    hidden = [
        f"{name} at ({x:g}, {y:g})"
        for name, (x, y) in zip(scene.anchor_names, scene.anchor_positions.tolist(), strict=True)
        if not visible(np.broadcast_to([x, y], way.shape), way, walls).any()
    ]
    if not hidden:
        return None
    named = ", ".join(hidden[:MOST_NAMED])
    rest = f" and {len(hidden) - MOST_NAMED} more" * (len(hidden) > MOST_NAMED)
    return (
        f"anchor{'s' * (len(hidden) > 1)} {named}{rest}: hidden by walls from all steps of all agents' ways. "
        "If that isn't meant, see positions, walls and waypoints_m: gridslam scene draw"
    )


def clock_note(scene: Scene) -> str | None:
    """Whose true offset or drift leaves what ``[clocks]`` allows for on the agents' ways; None if none does.

    A filter is told no more than that: it follows such a clock into wrong places, mostly without a word.
    Walks are learned, and clocks that jump are found again.
    """
    told, beyond = scene.clocks, list[str]()
    ways = [scene.track(agent.name).time_s for agent in scene.agents if agent.waypoints_m is not None]
    if told is None or not ways:
        return None
    time = np.sort(np.concatenate(ways))
    late = float(np.ptp(time))
    walked = WALKS * np.sqrt(late) * np.array([told.walk_ns, told.drift_walk_ppb])
    devices: list[tuple[Anchor | Agent, float | None]] = [
        *((anchor, told.anchor_prior_ns) for anchor in scene.anchors),
        *((agent, told.agent_prior_ns) for agent in scene.agents),
    ]
    for device, shared in devices:
        if device.clock is None:
            continue
        prior = shared if device.clock.prior_ns is None else device.clock.prior_ns
        prior = 0.0 if device.name == told.reference else prior  # one that is known has no drift either
        offset = 1e9 * device.clock.model_copy(update={"jump_s": None}).offset_s(time)
        drift = 0.0 if prior == 0 else told.drift_prior_ppb + walked[1]
        if prior is not None and abs(offset[0]) > prior + TINY_NS:
            beyond.append(f"{device.name} begins at {offset[0]:g} ns, where {prior:g} are allowed for")
        if np.ptp(offset) > walked[0] + drift * late + TINY_NS:
            allowed = f"where {drift:.3g} ppb are allowed for"
            beyond.append(f"{device.name} drifts by {np.ptp(offset):.3g} ns in {late:g} s, {allowed}")
    return f"true clocks leave what [clocks] allows for: {'; '.join(beyond)}" if beyond else None


def implausible_radio(scene: Scene) -> list[str]:
    """Fields of a scene's radio, with their values, that can hardly be meant: other units, mostly."""
    radio, found = scene.radio, list[str]()
    if radio.carrier_hz < LEAST_CARRIER_HZ:
        found.append(
            f"radio.carrier_hz: {radio.carrier_hz:g} Hz is no carrier of a radio: MHz or GHz for Hz?"
        )
    if radio.bandwidth_hz < LEAST_BANDWIDTH_HZ:
        cell = SPEED_OF_LIGHT / radio.bandwidth_hz
        found.append(
            f"radio.bandwidth_hz: {radio.bandwidth_hz:g} Hz tells paths apart by {cell:.2g} m: MHz for Hz?"
        )
    elif radio.bandwidth_hz > radio.carrier_hz:
        found.append(
            f"radio.bandwidth_hz: {radio.bandwidth_hz:g} Hz is more than carrier_hz, {radio.carrier_hz:g} Hz"
        )
    return found


def _beyond(scene: Scene) -> list[str]:
    """A line on walls that reach out of the region, and one on those that can hardly be in metres."""
    low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
    out, lines = [], list[str]()
    for number, wall in enumerate(scene.walls):
        far = float(np.maximum(low - wall.corners, wall.corners - high).max())
        name = wall.name or f"walls[{number}]"
        if far > MUCH * (high - low).max():
            units = (
                unit for unit, size in UNITS.items() if (np.abs(size * wall.corners) <= high - low).all()
            )
            guess = next(units, "millimetres")
            lines.append(
                f"suspect: {name} reaches {far:.4g} m out of a region of {high[0] - low[0]:g} x "
                f"{high[1] - low[1]:g} m: {guess} for metres in its points_m?"
            )
        elif far > scene.grid.cell_m:
            out.append(f"{name} by {far:.2g} m")
    named = ", ".join(out[:3]) + (f" and {len(out) - 3} more" if len(out) > 3 else "")
    beyond = "out of the region (grid.x_m, grid.y_m), beyond which nothing is mapped"
    return [*lines, *[f"note: walls reach {beyond}: {named}"] * bool(out)]


def _in_sight(scene: Scene, way: Array) -> str:
    """Share of positions (N, 2) at which an anchor is in sight, and the longest stretch without."""
    places = (np.broadcast_to(place, way.shape) for place in scene.anchor_positions)
    each = np.array([visible(place, way, scene.segments()) for place in places])
    seen = each.any(0)
    shares = zip(scene.anchor_names, each.mean(1), strict=True)
    named = ", ".join(f"{name} {share:.0%}" for name, share in shares) if 1 < len(each) <= MOST_NAMED else ""
    line = f"{counted(len(way), 'step')}, an anchor in sight at {seen.mean():.0%} of them"
    line += f" ({named})" * bool(named)
    if seen.all():
        return line
    edges = np.flatnonzero(np.diff(np.concatenate([[True], seen, [True]]).astype(int)))
    first, last = edges[0::2], edges[1::2] - 1
    longest = int((last - first).argmax())
    return f"{line}, at none from step {first[longest]} to {last[longest]}"
