"""Judge methods on floor plans that nobody drew: `python docs/random_plans.py METHOD FIRST LAST [SNR_DB]`.

Each seed draws a plan (7 to 18 m, slanted or missing outer walls, partitions, a pillar; four materials), one
to three anchors and a way through it, and prints one line: errors, the bound of a filter that doesn't know
the walls, squared errors over claimed variances (2 is right), steps at which health complains, and steps that
are wrong in silence. Methods: grid and adaptive on paths, direct_grid on samples of 3 x 3 arrays, hybrid on
those of 2 x 2 at the agent alone, hybrid-single on those of one antenna, and network_grid with two agents,
three anchors whose clocks nobody set, and no labels.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import gridslam as gs
from gridslam.evaluation.bounds import unknown_map_bound

MATERIALS = {"concrete": 0.71, "glass": 0.35, "metal": 0.95, "plaster": 0.5}
STEP_M, SETTLED = 0.05, 20
"""Way of a step, and steps that aren't counted."""
SILENT_M, SILENT_SQUARED = 0.5, 16.0
"""Errors and squared errors over variances from which on a step is wrong; in silence if health is well."""
TRIES = 4000
ARRAYS = """
frequencies = 49
frequency_step_hz = 12.5e6
fading = "steady"
array = { rows = 3, columns = 3, spacing_wavelengths = 0.4 }"""
AGENT_ARRAY = """
frequencies = 81
frequency_step_hz = 1e7
fading = "steady"
array = { rows = 1, columns = 1 }
false_alarms = 0.1"""
OF_AGENT = "array = { rows = 2, columns = 2, spacing_wavelengths = 0.5 }\nheading_sensor_deg = 1.0\n"
SIGNAL = {"direct_grid": ARRAYS, "hybrid": AGENT_ARRAY, "hybrid-single": AGENT_ARRAY}
CLOCKS = "[clocks]\nanchor_prior_ns = 100.0\nagent_prior_ns = 1.75\nwalk_ns = 0.05\n"
WINDOW = "\nwindow_m = [-45.0, 95.0]\nmax_distance_m = 95.0"

Point = tuple[float, float]
Wall = tuple[Point, Point]


class NoPlan(Exception):
    """A seed whose rooms leave no way."""


def turn(a: Point, b: Point, c: Point) -> float:
    """Twice the area of a triangle, positive if it turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def crosses(a: Point, b: Point, wall: Wall) -> bool:
    """Whether the way from a to b leads through a wall."""
    c, d = wall
    return turn(a, b, c) * turn(a, b, d) < 0 and turn(c, d, a) * turn(c, d, b) < 0


def gap(point: Point, a: Point, b: Point) -> float:
    """Distance of a point from a stretch, m."""
    p, start, along = np.array(point), np.array(a), np.subtract(b, a)
    share = np.clip(np.dot(p - start, along) / np.dot(along, along), 0, 1)
    return float(np.hypot(*(p - start - share * along)))


@dataclass
class Plan:
    """A drawn floor plan: sides (m), walls, anchors, and a way of so many steps."""

    side: tuple[float, float]
    walls: list[Wall]
    anchors: list[Point]
    way: list[Point]


def outline(draw: np.random.Generator) -> tuple[tuple[float, float], list[Wall]]:
    """Outer walls, partitions and a pillar."""
    w, h = (float(side) for side in draw.uniform(7, 18, 2))
    s = draw.uniform(0, 1.2, 4) * (draw.random(4) < 0.4)
    corner = [(s[0], 0.0), (w, s[1]), (w - s[2], h), (0.0, h - s[3])]
    walls = [(corner[k], corner[(k + 1) % 4]) for k in range(4)]
    if draw.random() < 0.3:
        walls.pop(draw.integers(4))
    for _ in range(draw.integers(0, 4)):
        x, y = draw.uniform(0.25, 0.75) * w, draw.uniform(0.25, 0.75) * h
        length = draw.uniform(1.2, 0.35 * min(w, h) + 1.2)
        angle = draw.choice([0, np.pi / 2, draw.uniform(0, np.pi)], p=[0.4, 0.4, 0.2])
        dx, dy = length / 2 * np.cos(angle), length / 2 * np.sin(angle)
        walls.append(((x - dx, y - dy), (x + dx, y + dy)))
    if draw.random() < 0.4:
        x, y, q = draw.uniform(0.25, 0.75) * w, draw.uniform(0.25, 0.75) * h, draw.uniform(0.3, 0.7)
        pillar = [(x, y), (x + q, y), (x + q, y + q), (x, y + q)]
        walls += [(pillar[k], pillar[(k + 1) % 4]) for k in range(4)]
    return (w, h), [tuple((round(float(x), 2), round(float(y), 2)) for x, y in wall) for wall in walls]  # type: ignore[misc]


def drawn(draw: np.random.Generator, steps: int, anchors: int | None) -> Plan:
    """A plan with anchors and a way that keeps off walls and anchors and turns by less than 107 degrees.

    Raises
    ------
    NoPlan
    """
    (w, h), walls = outline(draw)

    def place(margin: float) -> Point:
        for _ in range(TRIES):
            x, y = draw.uniform(0, w), draw.uniform(0, h)
            inside = 1.3 < x < w - 1.3 and 1.3 < y < h - 1.3
            if inside and all(gap((x, y), *wall) > margin for wall in walls):
                return float(x), float(y)
        raise NoPlan

    stands = [place(0.4) for _ in range(anchors or draw.integers(1, 4))]
    way, length, wanted = [place(0.5)], 0.0, steps * STEP_M + 4
    for _ in range(TRIES):
        to = place(0.45)
        if any(crosses(way[-1], to, wall) for wall in walls):
            continue
        leg = np.subtract(to, way[-1])
        before = np.subtract(way[-1], way[-2]) if len(way) > 1 else leg
        far = np.hypot(*leg)
        ends = (end for wall in walls for end in wall)
        if (
            far < 1.5
            or np.dot(before, leg) < -0.3 * np.hypot(*before) * far
            or min(gap(end, way[-1], to) for end in ends) < 0.3
            or min(gap(anchor, way[-1], to) for anchor in stands) < 0.25
        ):
            continue
        length += float(far)
        way.append(to)
        if length > wanted:
            return Plan((w, h), walls, stands, way)
    raise NoPlan


def agent(name: str, way: list[Point], steps: int) -> str:
    """The part of a scene file on an agent."""
    heading = np.degrees(np.arctan2(*np.subtract(way[1], way[0])[::-1]))
    points = ", ".join(f"[{x:.2f}, {y:.2f}]" for x, y in way[1:])
    return (
        f'[[agents]]\nname = "{name}"\nstart_m = [{way[0][0]:.2f}, {way[0][1]:.2f}]\n'
        f"start_heading_deg = {heading:.1f}\nwaypoints_m = [{points}]\nstep_m = {STEP_M}\nsteps = {steps}\n"
    )


def scene_of(seed: int, snr_db: float, method: str) -> gs.Scene:
    """The scene of a seed.

    Raises
    ------
    NoPlan
    """
    network = method.startswith("network")
    steps = 120 if method in SIGNAL else 150 if network else 250
    draw, clock = np.random.default_rng(seed + 77000), np.random.default_rng(seed + 5)
    plan = drawn(draw, steps, 3 if network else None)
    extra = WINDOW if network else SIGNAL.get(method, "")
    text = [
        f'name = "plan{seed}"\n[radio]{extra}\nsnr_at_1m_db = {snr_db}\n[grid]\ncell_m = 0.1',
        *(f"{axis}_m = [-2.0, {round(side + 2)}.0]" for axis, side in zip("xy", plan.side, strict=True)),
        CLOCKS if network else "",
        "[materials]",
        *(f"{name} = {value}" for name, value in MATERIALS.items()),
    ]
    for name, (x, y) in zip("ABC", plan.anchors, strict=False):
        text.append(f'[[anchors]]\nname = "{name}"\nposition_m = [{x:.2f}, {y:.2f}]')
        text.append(f"orientation_deg = {draw.uniform(-180, 180):.1f}")
        text.append(f"clock = {{ offset_ns = {clock.uniform(-90, 90):.1f} }}" if network else "")
    for number, ((ax, ay), (bx, by)) in enumerate(plan.walls):
        text.append(f'[[walls]]\nname = "w{number}"\nmaterial = "{list(MATERIALS)[draw.integers(4)]}"')
        text.append(f"points_m = [[{ax}, {ay}], [{bx}, {by}]]")
    text.append(agent("agent1", plan.way, steps) + (OF_AGENT if method == "hybrid" else ""))
    text.append(agent("agent2", plan.way[::-1], steps) if network else "")
    text.append("[filter]\nparticles = 2000")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plan.toml"
        file.write_text("\n".join(text), encoding="utf-8")
        return gs.Scene.load(file)


def runs(scene: gs.Scene, seed: int, method: str) -> dict[str, Any]:
    """A run for each agent, by name."""
    names = [one.name for one in scene.agents]
    if len(names) > 1:
        heard = gs.simulate(scene, names, seed, unlabelled=True)
        return dict(gs.map_network(scene, heard, method=method, seed=seed, starts="exact").runs)
    what = {"what": "signal"} if method in SIGNAL else {}
    heard = gs.simulate(scene, names[0], seed, **what)
    method = method.removesuffix("-single")
    return {names[0]: gs.map_scene(scene, heard, method=method, seed=seed, start="exact")}


def line(scene: gs.Scene, name: str, run: Any, bounded: bool) -> str:
    """What is said of a run."""
    error = run.trajectory.position_m[:, :2] - scene.track(name).position_m[:, :2]
    off = np.hypot(*error.T)
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(run.covariance[:, :2, :2]), error)
    well = np.array([estimate.health.ok for estimate in run.estimates])
    wrong = (squared > SILENT_SQUARED) & (off > SILENT_M)
    rmse = np.sqrt(np.mean(off[SETTLED:] ** 2))
    bound = ""
    if bounded:
        least = np.sqrt(np.mean(unknown_map_bound(scene, name).position_m[SETTLED:] ** 2))
        bound = f", {rmse / least:.2f} times the bound"
    world = f"{scene.name} {name}, {len(scene.anchors)} anchors, {len(scene.walls)} walls"
    health = f"unwell at {(~well).sum()}, silent at {(wrong & well).sum()}"
    return f"{world}: {100 * rmse:.2f} cm{bound}, squared error {squared[SETTLED:].mean():.2f}, {health}"


def main(method: str, first: int, last: int, snr_db: float) -> None:
    """Print a line for each plan and agent."""
    for seed in range(first, last + 1):
        try:
            scene = scene_of(seed, snr_db, method)
        except (NoPlan, gs.errors.InputError):
            print(f"plan{seed}: no way through it", flush=True)
            continue
        for name, run in runs(scene, seed, method).items():
            print(line(scene, name, run, method in ("grid", "adaptive")), flush=True)


if __name__ == "__main__":
    if len(sys.argv) not in (4, 5):
        sys.exit(__doc__)
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]) if len(sys.argv) == 5 else 36.0)
