"""Speed and memory on this machine: kernels against their twins, whole steps, growth, start-up."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from gridslam import runtime
from gridslam.bench.course import PeakMemory, heard, run
from gridslam.bench.growth import Growth, fitted, growth
from gridslam.bench.kernels import IdleLaunches, KernelSpeed, compete, largest_launches
from gridslam.bench.plan import Plan
from gridslam.bench.stages import KERNEL, Stopwatch
from gridslam.bench.start import Machine, StartUp, machine, start_up
from gridslam.estimates import Estimate
from gridslam.runs.map_scene import METHODS
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene

Tell = Callable[[str, int, int], None]
VERSION = 3


@dataclass(frozen=True)
class StepSpeed:
    """Whole steps of one method.

    Attributes
    ----------
    method, scene : str
    particles : int
    first : int
        Number of the first step that was timed.
    step_ms : float
        Median.
    steps_per_s : float
        ``1000 / step_ms``.
    cpu_ms : float
        Median of what all threads together computed: above `step_ms` where they share the work (or wait
        busily), below it where other programs held the cores.
    peak_memory_mb : float
        Of the process, while these steps ran.
    stages_ms : dict
        Milliseconds per step by stage; the last steps of the run, which are watched.
    not_kernel_share : float
        Share of those steps that isn't a kernel; launches aren't.
    """

    method: str
    scene: str
    particles: int
    first: int
    step_ms: float
    steps_per_s: float
    cpu_ms: float
    peak_memory_mb: float
    stages_ms: dict[str, float]
    not_kernel_share: float


@dataclass(frozen=True)
class Speed:
    """All that was measured, by what plan and in how many seconds."""

    plan: Plan
    machine: Machine
    kernels: tuple[KernelSpeed, ...]
    steps: tuple[StepSpeed, ...]
    growth: tuple[Growth, ...]
    start_up: StartUp
    seconds: float

    def to_json(self) -> str:
        """Everything as JSON, keys as the attributes."""
        whole = {"format": "gridslam-bench", "version": VERSION, **asdict(self)}
        return json.dumps(whole, indent=2, allow_nan=False) + "\n"


def measure(
    plan: Plan | None = None, device: str = "auto", threads: int | None = None, tell: Tell | None = None
) -> Speed:
    """Measure speed and memory on this machine, in this process and, for the start-up, in others.

    Parameters
    ----------
    plan : Plan, optional
        How much (default: `Plan()`, a few minutes).
    device : str
        auto, cpu or gpu.
    threads : int, optional
        Of the kernels (default: one more than cores; see `runtime`).
    tell : callable, optional
        Gets (what comes next, parts done, parts in all).

    Returns
    -------
    Speed

    Raises
    ------
    InputError
        The device can't be had.
    """
    plan, began = plan or Plan(), time.perf_counter()
    here = machine(runtime.start(device, threads))
    kinds = [("grid", "alcove", n, plan.before) for n in plan.particles]
    kinds += [("grid", "canyon", plan.canyon, before) for before in (plan.before, plan.later)]
    kinds += [("adaptive", "alcove", n, plan.before) for n in plan.particles]
    parts = ["start-up", "kernels", *(f"{method}, {name}, {n} particles" for method, name, n, _ in kinds)]
    parts += ["growth"]
    todo = iter(range(len(parts)))

    def next_part() -> None:
        if tell is not None:
            number = next(todo)
            tell(parts[number], number, len(parts))

    next_part()
    started = start_up(plan.repeats, device)
    next_part()
    alcove = Scene.load("alcove")
    cases = largest_launches(alcove.with_filter(particles=plan.kernel_particles), plan.kernel_before)
    kernels = [compete(name, "alcove", case, plan.kernel_s) for name, case in sorted(cases.items())]
    idle = IdleLaunches(cases)
    canyon = Scene.load("canyon").with_filter(particles=plan.kernel_particles)
    large = largest_launches(canyon, plan.kernel_before)["cast"]
    kernels.append(compete("cast", "canyon", large, plan.kernel_s))
    steps = []
    for method, name, particles, before in kinds:
        next_part()
        scene = Scene.load(name).with_filter(particles=particles)
        steps.append(_steps(scene, method, plan, before, idle))
    next_part()
    on_alcove = [s for s in steps if (s.method, s.scene) == ("grid", "alcove")]
    by_particles = fitted(
        "particles",
        plan.particles,
        [1e-3 * s.step_ms for s in on_alcove],
        [1e-3 * s.cpu_ms for s in on_alcove],
        [s.peak_memory_mb for s in on_alcove],
    )
    grown = by_particles, *growth(alcove.with_filter(particles=plan.growth_particles), plan)
    return Speed(plan, here, tuple(kernels), tuple(steps), grown, started, time.perf_counter() - began)


def _steps(scene: Scene, method: str, plan: Plan, before: int, idle: IdleLaunches) -> StepSpeed:
    """Run a method from the start, time the steps after `before`, and split some more by stage."""
    scans = heard(scene, before + plan.timed + plan.watched)
    memory, slam = PeakMemory(), METHODS[method](scene, seed=1)
    course = run(slam.step, scans[: -plan.watched], memory)
    launch = [idle.seconds()]  # of this very minute: before, and after
    with Stopwatch(slam.work).watching() as watch:

        def step(scan: Scan) -> Estimate:
            estimate = slam.step(scan)
            watch.count(slam.info.seconds if slam.info else {})
            return estimate

        whole = sum(run(step, scans[-plan.watched :], memory).took)
    launch.append(idle.seconds())
    usual = {name: 0.5 * (launch[0][name] + launch[1][name]) for name in launch[0]}
    stages = watch.of_step(whole, plan.watched, usual)
    in_kernels = sum(seconds for name, seconds in stages.items() if name.startswith(KERNEL))
    median = float(np.median(course.took[before:]))
    return StepSpeed(
        method=method,
        scene=scene.name,
        particles=scene.filter.particles,
        first=before + 1,
        step_ms=1e3 * median,
        steps_per_s=1 / median,
        cpu_ms=1e3 * float(np.median(course.cpu[before:])),
        peak_memory_mb=memory.look(),
        stages_ms={name: 1e3 * seconds for name, seconds in stages.items()},
        not_kernel_share=1 - in_kernels / sum(stages.values()),
    )
