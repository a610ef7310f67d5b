"""Judge direct SLAM in rooms traced by Sionna RT: `python docs/traced_rooms.py FIRST LAST [SNR_DB [NOISE]]`.

Each number draws a room (L, T, U, corridors with a branch, hulls of five and six walls, halls; turned by any
angle, with partitions, a pillar or a box; ITU's materials), two to four anchors, at least one of which is in
sight at first, and a way of 7.5 m, and prints a line as `random_plans.py` does. Walls have no end and devices
one height, so that single and double bounces run in the plane; antennas are single, starts drawn from the
default prior. Needs the extra "sionna", and LLVM 17 or later.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from random_plans import NoPlan, agent, crosses, gap, line

import gridslam as gs

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
SHAPES = ("L", "T", "U", "hull5", "hull6", "hall", "branch")
OUTER = ("concrete", "glass", "plasterboard", "brick")
ITU = {"concrete": 0.55, "glass": 0.5, "metal": 0.97, "plasterboard": 0.35, "wood": 0.3, "brick": 0.4}
BLOCKS = {"box of metal": "metal", "box of wood": "wood", "pillar": "concrete"}
STEPS, STEP_M, TRIES, ROOMS, NEXT = 150, 0.05, 4000, 60, 1000
"""Of a way; tries for a place, and rooms for a number: the first seed and how far the next one is off."""
RADIO = """[radio]
frequencies = 41
frequency_step_hz = 1e7
fading = "steady"
max_bounces = 2
array = { rows = 1, columns = 1 }
"""
Array = Any
Walls = list[tuple[Array, Array, str]]


def outline(draw: np.random.Generator) -> Array:
    """Corners of the outer walls, (N, 2) m."""
    kind = str(draw.choice(SHAPES))

    def of(low: float, high: float) -> float:
        return float(draw.uniform(low, high))

    if kind == "hall":
        w, h = of(9, 17), of(7, 12)
        return np.array([(0, 0), (w, 0), (w, h), (0, h)])
    if kind == "L":
        w, h, a, b = of(9, 15), of(8, 13), of(3.5, 5.5), of(3.5, 5.5)
        return np.array([(0, 0), (w, 0), (w, a), (b, a), (b, h), (0, h)])
    if kind in ("T", "branch"):
        low, high = (2.4, 3.2) if kind == "branch" else (3.5, 5)
        t, s, w, h = of(low, high), of(low, high), of(11, 18), of(8, 13)
        x = of(0.25, 0.6) * w
        stem = [(0, h - t), (x, h - t), (x, 0), (x + s, 0), (x + s, h - t)]
        return np.array([*stem, (w, h - t), (w, h), (0, h)])
    if kind == "U":
        w, h, a, b = of(11, 16), of(8, 12), of(3.2, 4.5), of(3.2, 4.5)
        return np.array([(0, 0), (w, 0), (w, h), (w - a, h), (w - a, b), (a, b), (a, h), (0, h)])
    count = int(kind[-1])
    angle = np.sort((np.arange(count) + draw.uniform(-0.25, 0.25, count)) * 2 * np.pi / count)
    span = draw.uniform(0.8, 1.1, count)
    return np.stack([of(5, 8) * span * np.cos(angle), of(4, 6.5) * span * np.sin(angle)], 1)


def inside(point: Array, corners: Array) -> bool:
    """Whether a point is within an outline."""
    (x, y), within = point, False
    for (a, b), (e, f) in zip(corners, np.roll(corners, -1, 0), strict=True):
        if (b > y) != (f > y) and x < (e - a) * (y - b) / (f - b) + a:
            within = not within
    return within


def turned(angle: float) -> Array:
    """Matrix that turns by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


class Room:
    """A drawn room: walls with what they are, anchors, and waypoints.

    Raises
    ------
    NoPlan
        No place for something.
    """

    def __init__(self, seed: int) -> None:
        self.draw = np.random.default_rng(seed + 990_000)
        corners = outline(self.draw)
        angle = float(self.draw.uniform(0, 2 * np.pi))
        corners = corners @ turned(angle).T
        self.corners = corners - corners.min(0)
        self.size = self.corners.max(0)
        ends = zip(self.corners, np.roll(self.corners, -1, 0), strict=True)
        self.walls: Walls = [(a, b, "outer") for a, b in ends]
        for _ in range(self.draw.integers(0, 3)):
            self.partition(angle)
        if self.draw.integers(0, 2):
            self.block(angle)
        count = int(self.draw.choice([2, 3, 4], p=[0.4, 0.4, 0.2]))
        self.anchors = [self.place(0.4) for _ in range(count)]
        if min(np.hypot(*(a - b)) for k, a in enumerate(self.anchors) for b in self.anchors[:k]) < 1.5:
            raise NoPlan
        self.way = self.walk()
        outer = self.draw.choice(OUTER, size=12)
        self.materials = [
            BLOCKS.get(part) or str(outer[k % 12] if part == "outer" else self.draw.choice(list(ITU)))
            for k, (_, _, part) in enumerate(self.walls)
        ]

    def place(self, margin: float) -> Array:
        """A point so far from all walls (m)."""
        for _ in range(TRIES):
            point = self.draw.uniform(0, 1, 2) * self.size
            clear = inside(point, self.corners)
            if clear and all(gap(tuple(point), tuple(a), tuple(b)) > margin for a, b, _ in self.walls):
                return point
        raise NoPlan

    def partition(self, angle: float) -> None:
        """A wall within, with a door where it is long."""
        middle = self.place(0.9)
        along = turned(angle) @ ([1, 0] if self.draw.random() < 0.5 else [0, 1])
        length = float(self.draw.uniform(1.2, 3.5))
        start, end = middle - along * length / 2, middle + along * length / 2
        if not (inside(start, self.corners) and inside(end, self.corners)):
            return
        door = [(start, middle - along * 0.45), (middle + along * 0.45, end)]
        self.walls += [(a, b, "within") for a, b in (door if length > 2.8 else [(start, end)])]

    def block(self, angle: float) -> None:
        """A pillar or a box."""
        middle, sides = self.place(1.0), self.draw.uniform(0.3, 0.8, 2)
        facing = float(self.draw.uniform(0, np.pi / 2)) if self.draw.random() < 0.4 else angle
        corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * sides / 2 @ turned(facing).T + middle
        what = str(self.draw.choice(list(BLOCKS)))
        self.walls += [(corner[k], corner[(k + 1) % 4], what) for k in range(4)]

    def crosses(self, start: Array, end: Array) -> bool:
        """Whether the way from one point to another leads through a wall."""
        return any(crosses(tuple(start), tuple(end), (tuple(a), tuple(b))) for a, b, _ in self.walls)

    def walk(self) -> list[Array]:
        """Waypoints that keep off walls and anchors, from one that an anchor sees."""
        way, length = [self.place(0.6)], 0.0
        if all(self.crosses(way[0], anchor) for anchor in self.anchors):
            raise NoPlan
        for _ in range(3000):
            to = self.place(0.5)
            leg = to - way[-1]
            far, before = float(np.hypot(*leg)), way[-1] - way[-2] if len(way) > 1 else leg
            back = np.dot(before, leg) < -0.3 * np.hypot(*before) * far
            if far < 1.5 or back or self.crosses(way[-1], to):
                continue
            stretch = tuple(way[-1]), tuple(to)
            ends = min(gap(tuple(end), *stretch) for a, b, _ in self.walls for end in (a, b))
            if ends < 0.35 or min(gap(tuple(anchor), *stretch) for anchor in self.anchors) < 0.3:
                continue
            way.append(to)
            length += far
            if length > STEPS * STEP_M + 4:
                return way
        raise NoPlan


def scene_of(number: int, snr_db: float) -> gs.Scene:
    """The scene of a room's number.

    Raises
    ------
    NoPlan
    """
    for seed in range(number, number + ROOMS * NEXT, NEXT):
        try:
            room = Room(seed)
        except NoPlan:
            continue
        break
    else:
        raise NoPlan
    text = [f'name = "room{number}"\n{RADIO}snr_at_1m_db = {snr_db}\n[grid]\ncell_m = 0.1']
    sizes = np.ceil(room.size).astype(int).tolist()
    text += [f"{axis}_m = [-2.0, {size + 2}.0]" for axis, size in zip("xy", sizes, strict=True)]
    text += ["[materials]", *(f"{name} = {value}" for name, value in ITU.items())]
    for name, (x, y) in zip("ABCD", room.anchors, strict=False):
        text.append(f'[[anchors]]\nname = "{name}"\nposition_m = [{x:.2f}, {y:.2f}]')
    for k, ((a, b, _), material) in enumerate(zip(room.walls, room.materials, strict=True)):
        ends = f"[[{a[0]:.4f}, {a[1]:.4f}], [{b[0]:.4f}, {b[1]:.4f}]]"
        text.append(f'[[walls]]\nname = "w{k}"\nmaterial = "{material}"\npoints_m = {ends}')
    text.append(agent("agent1", [(float(x), float(y)) for x, y in room.way], STEPS))
    return gs.Scene.checked(tomllib.loads("\n".join(text)), f"room{number}")


def main(first: int, last: int, snr_db: float = 40.0, noise: int = 1) -> None:
    """Trace rooms, and print a line for each."""
    import sionna_world

    for number in range(first, last + 1):
        try:
            scene = scene_of(number, snr_db)
        except NoPlan:
            print(f"room{number}: none", flush=True)
            continue
        track, seed = scene.track("agent1"), 1000 * noise + number
        paths = sionna_world.trace(scene, "agent1", 1, sionna_world.BUILDINGS["plane"])
        heard = gs.recording_from_sionna(paths, scene, track.heading_rad, truth=track, seed=seed)
        run = gs.map_scene(scene, heard, method="direct", seed=seed, start="drawn")
        print(line(scene, "agent1", run, False), flush=True)


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4, 5):
        sys.exit(__doc__)
    snr_db = float(sys.argv[3]) if len(sys.argv) > 3 else 40.0
    main(int(sys.argv[1]), int(sys.argv[2]), snr_db, int(sys.argv[4]) if len(sys.argv) > 4 else 1)
