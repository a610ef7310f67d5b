"""Speed and memory on this machine: kernels against their twins, whole steps, growth, start-up."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from gridslam import runtime
from gridslam.bench.course import PeakMemory, first_scans, run
from gridslam.bench.features import feature_speeds
from gridslam.bench.growth import Growth, fitted, growth, with_hypotheses
from gridslam.bench.heard_paths import heard_path_speeds
from gridslam.bench.kernels import IdleLaunches, KernelSpeed, compete, largest_launches
from gridslam.bench.plan import Plan
from gridslam.bench.single_kernels import (
    line_evidence_speed,
    pose_speed,
    sight_filter_speed,
    state_path_speed,
)
from gridslam.bench.stages import KERNEL, Stopwatch
from gridslam.bench.start import Machine, StartUp, machine, start_up
from gridslam.bench.superposition import superposition_speeds
from gridslam.estimates import Estimate
from gridslam.inference.workspace.workspace import OTHER
from gridslam.systems.front import SurfaceFilter
from gridslam.systems.registry import method_class, method_name, taken_by
from gridslam.systems.slam import Slam, built, stepped
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene

Tell = Callable[[str, int, int], None]
Kind = tuple[str | type[Slam], str, int, int]
"""Method, scene, particles, steps before any is timed."""
VERSION = 4
SAMPLED, ARRAYS = "overlap", "chamber"
"""Scenes on which methods that take sampled signals are timed, and those of arrays that map cells."""


@dataclass(frozen=True)
class StepSpeed:
    """Whole steps of one method.

    Attributes
    ----------
    method : str
        Whose steps.
    scene : str
        On which scene.
    particles : int
        Those of the scene's filter settings, whether a method uses them or not.
    first : int
        Number of the first step that was timed.
    step_ms : float
        Median time of a step.
    steps_per_s : float
        ``1000 / step_ms``.
    cpu_ms : float
        Median of what all threads together computed: above `step_ms` where they share the work (or wait
        busily), below it where other programs held the cores.
    peak_memory_mb : float
        Memory of the process, while these steps ran.
    stages_ms : dict
        Time per step by stage; the last steps of the run, which are watched. Of a method that isn't
        built of our stages, one stage holds all.
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
    """All that was measured, by what plan and in how many seconds.

    Where chosen methods alone were measured, `kernels` and `growth` are empty and `start_up` is None.
    """

    plan: Plan
    machine: Machine
    kernels: tuple[KernelSpeed, ...]
    steps: tuple[StepSpeed, ...]
    growth: tuple[Growth, ...]
    start_up: StartUp | None
    seconds: float

    def to_json(self) -> str:
        """Everything as JSON, keys as the attributes."""
        whole = {"format": "gridslam-bench", "version": VERSION, **asdict(self)}
        return json.dumps(whole, indent=2, allow_nan=False) + "\n"


def measure(
    plan: Plan | None = None,
    device: str = "auto",
    threads: int | None = None,
    tell: Tell | None = None,
    methods: Sequence[str | type[Slam]] = (),
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
    methods : sequence of str or class, optional
        Measure whole steps of these methods alone, as `gridslam.map_scene` takes them, on `alcove`; of those
        on sampled signals, on `overlap`.

    Returns
    -------
    Speed

    Raises
    ------
    InputError
        The device can't be had, or there is no such method.
    """
    plan, began = plan or Plan(), time.perf_counter()
    if methods:
        return _chosen(plan, device, threads, tell, methods)
    here = machine(runtime.start(device, threads))
    kinds: list[Kind] = [("grid", "alcove", n, plan.before) for n in plan.particles]
    kinds += [("grid", "canyon", plan.canyon, before) for before in (plan.before, plan.later)]
    kinds += [("adaptive", "alcove", n, plan.before) for n in plan.particles]
    next_part = _parts(["start-up", "kernels", *map(_title, kinds), "growth"], tell)
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
    kernels.append(pose_speed(plan.kernel_particles, plan.kernel_s))
    kernels.append(state_path_speed(plan.kernel_s))
    kernels.append(line_evidence_speed(plan.kernel_s))
    kernels.append(sight_filter_speed(plan.kernel_s))
    kernels += superposition_speeds(plan.paths, plan.kernel_s)
    kernels += feature_speeds(plan.features, plan.feature_particles, plan.kernel_s)
    kernels += heard_path_speeds(plan.features, plan.kernel_s)
    steps = []
    for kind in kinds:
        next_part()
        steps.append(_steps(kind, plan, idle))
    next_part()
    on_alcove = [s for s in steps if (s.method, s.scene) == ("grid", "alcove")]
    by_particles = fitted(
        "particles",
        plan.particles,
        [1e-3 * s.step_ms for s in on_alcove],
        [1e-3 * s.cpu_ms for s in on_alcove],
        [s.peak_memory_mb for s in on_alcove],
    )
    by_hypotheses = with_hypotheses(alcove.with_filter(particles=plan.kernel_particles), plan)
    grown = by_particles, by_hypotheses, *growth(alcove.with_filter(particles=plan.growth_particles), plan)
    return Speed(plan, here, tuple(kernels), tuple(steps), grown, started, time.perf_counter() - began)


def _chosen(
    plan: Plan, device: str, threads: int | None, tell: Tell | None, methods: Sequence[str | type[Slam]]
) -> Speed:
    """Whole steps of some methods, and nothing else."""
    began = time.perf_counter()
    classes = [method_class(method, "--method") for method in methods]
    here = machine(runtime.start(device, threads))
    idle = None
    if any(issubclass(found, SurfaceFilter) for found in classes):
        alcove = Scene.load("alcove").with_filter(particles=plan.kernel_particles)
        idle = IdleLaunches(largest_launches(alcove, plan.kernel_before))
    sampled = {found: ARRAYS if getattr(found, "keeps_grid", False) else SAMPLED for found in classes}
    on = {found: sampled[found] if taken_by(found) == "signal" else "alcove" for found in classes}
    kinds: list[Kind] = [
        (method, on[found], n, plan.before)
        for method, found in zip(methods, classes, strict=True)
        for n in plan.particles
    ]
    next_part, steps = _parts([*map(_title, kinds)], tell), []
    for kind in kinds:
        next_part()
        steps.append(_steps(kind, plan, idle))
    return Speed(plan, here, (), tuple(steps), (), None, time.perf_counter() - began)


def _title(kind: Kind) -> str:
    method, scene, particles, _ = kind
    return f"{method_name(method)}, {scene}, {particles} particles"


def _parts(names: Sequence[str], tell: Tell | None) -> Callable[[], None]:
    """What is to be called before each part, to say which one comes."""
    todo = iter(enumerate(names))

    def next_part() -> None:
        number, name = next(todo)
        if tell is not None:
            tell(name, number, len(names))

    return next_part


def _steps(kind: Kind, plan: Plan, idle: IdleLaunches | None) -> StepSpeed:
    """Run a method from the start, time the steps after so many, and split some more by stage."""
    method, name, particles, before = kind
    scene, found = Scene.load(name).with_filter(particles=particles), method_class(method)
    takes = taken_by(found)
    scans = first_scans(scene, before + plan.timed + plan.watched, takes)
    waveform = scene.waveform() if takes == "signal" else None
    memory, slam = PeakMemory(), built(found, scene, seed=1, waveform=waveform)
    course = run(partial(stepped, slam), scans[: -plan.watched], memory)
    if isinstance(slam, SurfaceFilter) and idle is not None:
        stages = _stages(slam, scans[-plan.watched :], memory, idle)
    else:
        stages = {OTHER: float(np.mean(run(partial(stepped, slam), scans[-plan.watched :], memory).took))}
    in_kernels = sum(seconds for name, seconds in stages.items() if name.startswith(KERNEL))
    median = float(np.median(course.took[before:]))
    return StepSpeed(
        method=method_name(method),
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


def _stages(
    slam: SurfaceFilter, scans: Sequence[Scan], memory: PeakMemory, idle: IdleLaunches
) -> dict[str, float]:
    """Seconds per step by stage, of a method that is built of ours."""
    launch = [idle.seconds()]  # of this very minute: before, and after
    with Stopwatch(slam.work).watching() as watch:

        def step(scan: Scan) -> Estimate:
            estimate = slam.step(scan)
            watch.count(slam.info.seconds if slam.info else {})
            return estimate

        whole = sum(run(step, scans, memory).took)
    launch.append(idle.seconds())
    usual = {name: 0.5 * (launch[0][name] + launch[1][name]) for name in launch[0]}
    return watch.of_step(whole, len(scans), usual)
