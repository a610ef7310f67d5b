"""How time grows with what there is to do."""

from __future__ import annotations

import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import tomli_w

from gridslam.bench.course import PeakMemory, changed, first_scans, run
from gridslam.bench.plan import Plan
from gridslam.inference.management.hypotheses import each_stepped
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.systems.grid import GridSlam
from gridslam.world.scene import Scene


@dataclass(frozen=True)
class Growth:
    """How time grows with one thing.

    Attributes
    ----------
    of : str
        What grows, as "particles" or "steps".
    size : tuple of float
        How much of it there was, on average.
    seconds : tuple of float
        Time of a step (median); of the whole run where `of` is "steps".
    cpu_s : tuple of float
        The same of what all threads together computed: other programs disturb it less.
    peak_memory_mb : tuple of float
        Memory of the process, while that ran.
    exponent : float or None
        Slope of a straight line through the logarithms of `seconds`; None for less than two sizes, or where
        the clock ticks too slowly to tell.
    cpu_exponent : float or None
        The same of `cpu_s`.
    """

    of: str
    size: tuple[float, ...]
    seconds: tuple[float, ...]
    cpu_s: tuple[float, ...]
    peak_memory_mb: tuple[float, ...]
    exponent: float | None
    cpu_exponent: float | None


def fitted(
    of: str, size: Sequence[float], seconds: Sequence[float], cpu: Sequence[float], memory: Sequence[float]
) -> Growth:
    """Fit the exponents of time against size."""

    def exponent(times: Sequence[float]) -> float | None:
        measurable = len(set(size)) > 1 and min(times) > 0
        return float(np.polyfit(np.log(size), np.log(times), 1)[0]) if measurable else None

    sizes = tuple(float(n) for n in size)
    return Growth(of, sizes, tuple(seconds), tuple(cpu), tuple(memory), exponent(seconds), exponent(cpu))


def polygon(sides: int, particles: int) -> Scene:
    """Closed room of `sides` equal walls, 3.5 m from its middle."""
    data = tomllib.loads(Scene.load("room").to_toml())
    turn = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    corner = 3.5 / np.cos(np.pi / sides) * np.stack([np.cos(turn), np.sin(turn)], -1)
    side = float(np.abs(corner).max()) + 0.5
    data["grid"] = {"x_m": [-side, side], "y_m": [-side, side], "cell_m": 0.1}
    data["walls"] = [{"material": "concrete", "points_m": corner.tolist(), "closed": True}]
    for anchor, place in zip(data["anchors"], ([-1.5, 0.8], [1.2, -1.3]), strict=True):
        anchor["position_m"] = place
    agent = {"start_m": [-1.0, -0.6], "waypoints_m": [[0.5, -0.4], [1.0, 0.6], [-0.4, 1.2], [-1.4, 0.2]]}
    data["agents"] = [{**data["agents"][0], **agent, "start_heading_deg": 8.0}]
    del data["agents"][0]["steps"]
    return Scene.from_toml(tomli_w.dumps(data), "polygon").with_filter(particles=particles)


def growth(alcove: Scene, plan: Plan) -> list[Growth]:
    """Growth of grid SLAM's time in all but particles.

    Surfaces are those of polygons, and rays grow with their square; the rest is varied on `alcove`: clutter,
    size of the cells, and length of the run.
    """
    particles = alcove.filter.particles
    variants: dict[str, list[Scene]] = {
        "surfaces": [polygon(sides, particles) for sides in plan.surfaces],
        "measurements": [changed(alcove, radio={"false_alarms": mean}) for mean in plan.false_alarms],
        "grid cells": [changed(alcove, grid={"cell_m": side}) for side in plan.cell_m],
    }
    found = []
    for of, scenes in variants.items():
        sizes, seconds, cpu, peaks = [], [], [], []
        for scene in scenes:
            scans, memory = first_scans(scene, plan.before + plan.timed), PeakMemory()
            course = run(GridSlam(scene, seed=1).step, scans, memory)
            counts = [len(scan) for scan in scans[plan.before :]]
            size = {"surfaces": np.mean(course.surfaces[plan.before :]), "measurements": np.mean(counts)}
            sizes.append(float(size.get(of, np.prod(scene.grid.shape))))
            seconds.append(float(np.median(course.took[plan.before :])))
            cpu.append(float(np.median(course.cpu[plan.before :])))
            peaks.append(course.peak[-1])
        found.append(fitted(of, sizes, seconds, cpu, peaks))
    scans, memory = first_scans(alcove, max(plan.steps)), PeakMemory()
    course = run(GridSlam(alcove, seed=1).step, scans, memory)
    ends = [steps - 1 for steps in plan.steps]
    total, computed = (np.cumsum(times)[ends].tolist() for times in (course.took, course.cpu))
    return [*found, fitted("steps", plan.steps, total, computed, [course.peak[end] for end in ends])]


def with_hypotheses(scene: Scene, plan: Plan) -> Growth:
    """Growth of a step's time with hypotheses, which are kept: each has a grid of its own, none is pruned."""
    scans, memory = first_scans(scene, plan.before + plan.timed), PeakMemory()
    slam, seconds, cpu, peaks = GridSlam(scene, seed=1), list[float](), list[float](), list[float]()
    run(slam.step, scans[: plan.before], memory)
    for count in plan.hypotheses:
        among, took, busy = drawn(slam.state, count), list[float](), list[float]()
        for scan in scans[plan.before :]:
            began, computed = time.perf_counter(), time.process_time()
            states, _ = each_stepped(among, scan, slam.model, slam.work, slam.advance)
            took.append(time.perf_counter() - began)
            busy.append(time.process_time() - computed)
            among = replace(among, states=tuple(states))
        seconds.append(float(np.median(took)))
        cpu.append(float(np.median(busy)))
        peaks.append(memory.look())
    return fitted("hypotheses", plan.hypotheses, seconds, cpu, peaks)


def drawn(state: State, count: int) -> Population[State]:
    """A state, and others that differ from it by what its belief leaves open."""
    draw, belief = np.random.default_rng(1), state.belief
    gaps = draw.standard_normal((count, len(belief.mean))) @ belief.root.T
    gaps[0] = 0
    states = [replace(state, belief=replace(belief, mean=belief.mean + gap)) for gap in gaps]
    return Population(tuple(states), (-float(np.log(count)),) * count)
