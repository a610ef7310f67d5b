"""Each kernel against its NumPy twin, on what it was given in a running filter."""

from __future__ import annotations

import inspect
import itertools
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, get_type_hints

import numpy as np

from gridslam import runtime
from gridslam.bench.contests import CONTESTS, PARTS, Array, Case
from gridslam.bench.stages import Function, Kernel, kernels
from gridslam.kernels.primitives.watching import watched
from gridslam.measurements.table import Scan
from gridslam.simulation.image_source import simulate
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.systems.front import SurfaceFilter
from gridslam.systems.grid import GridSlam
from gridslam.world.radio import BINS
from gridslam.world.scene import Scene


@dataclass(frozen=True)
class KernelSpeed:
    """One kernel and its twin on the same case.

    Attributes
    ----------
    name : str
        What the kernel is called here.
    scene : str
        In which the case was taken.
    unit : str
        What is counted: "path-particle", "cell visit", "path-ray", "path", "pair", "sample", "measurement",
        "cell", "entry".
    units : int
        How many of them the case has.
    kernel_s : float
        Median time of the kernel.
    twin_s : float
        Median time of its twin.
    kernel_best_s : float
        Shortest of the kernel's repeats.
    ratio : float
        ``twin_s / kernel_s``.
    ns_per_unit : float
        Time of the kernel, launch included.
    launch_us : float
        Time of a launch with nothing to do.
    """

    name: str
    scene: str
    unit: str
    units: int
    kernel_s: float
    kernel_best_s: float
    twin_s: float
    ratio: float
    ns_per_unit: float
    launch_us: float


def largest_launches(scene: Scene, steps: int, watched: int = 5) -> dict[str, Case]:
    """Run grid SLAM for some steps, then keep each kernel's largest launch of the next few.

    Of a kernel that grid SLAM doesn't launch, that of adaptive SLAM is kept; of those that neither does, a
    case is made of another kernel's: see `contests.PARTS`.

    Parameters
    ----------
    scene : Scene
    steps : int
        Before any launch is looked at.
    watched : int
        Steps that are; from the third on, which arrays last is looked at, too.
    """
    runtime.start()
    scans = list(simulate(scene, scene.agents[0].name, seed=1))[: steps + watched]
    found = _launches(AdaptiveSlam, scene, scans, steps) | _launches(GridSlam, scene, scans, steps)
    parts = {name: _part(name, found[whole]) for name, whole in PARTS.items()}
    return found | parts


def _part(name: str, whole: Case) -> Case:
    """A case of a kernel by the arguments of another; likelihood ratios of coefficients favour the middle."""
    known = {key: _copy(value) for key, value in whole.items()}
    if name == "learn_ratios":
        middle = -0.1 * np.square(np.arange(BINS) - BINS // 2)
        known["ratio"] = np.tile(middle, (len(runtime.on_host(whole["noted"])), 2, 1))
    return Case((key, known[key]) for key in kernels()[name].names)


def _launches(
    method: type[SurfaceFilter], scene: Scene, scans: Sequence[Scan], steps: int
) -> dict[str, Case]:
    slam = method(scene, seed=1)
    for scan in scans[:steps]:
        slam.step(scan)
    best: dict[str, tuple[int, Case]] = {}
    before: defaultdict[tuple[str, str], list[Any]] = defaultdict(list)
    number: Counter[str] = Counter()
    moved: Counter[tuple[str, str]] = Counter()
    names = {name: kernel.names for name, kernel in kernels().items()}

    def record(name: str, launch: Function, arguments: tuple[Any, ...]) -> Any:
        case = Case(zip(names[name], flattened(arguments), strict=True))
        contest = CONTESTS[name]
        size = (contest.size or contest.units)(case)
        fresh = {k for k, v in case.items() if not any(v is one for one in before[name, k])}
        number[name] += 1
        for key in fresh:
            before[name, key].append(case[key])
            moved[name, key] += 1
        if name not in best or size > best[name][0]:
            best[name] = size, Case({k: _copy(v) for k, v in case.items()})
        return launch(*arguments)

    with watched(record):
        for done, scan in enumerate(scans[steps:]):
            slam.step(scan)
            if done < 2:  # what lasts was handed over once by then
                number.clear()
                moved.clear()
    for name, (_, case) in best.items():  # of a kernel that wasn't launched since, nothing is known to last
        case.lasting = frozenset(key for key in case if 2 * moved[name, key] < number[name])
    return {name: case for name, (_, case) in best.items()}


def compete(name: str, scene: str, case: Case, seconds: float) -> KernelSpeed:
    """Time a kernel and its twin on one case.

    Parameters
    ----------
    name, scene : str
        Of the kernel, and where its case was taken.
    seconds : float
        At least so long for the kernel, and for the twin; each runs three times or more, the twin once.
    """
    import taichi as ti

    kernel, contest = kernels()[name], CONTESTS[name]

    held = {key: runtime.on_host(value) for key, value in case.items() if hasattr(value, "shape")}
    used, idle = Case(case | {key: _copy(case[key]) for key in contest.changes}), IdleLaunches({name: case})

    def launch(arguments: Case) -> None:
        kernel.named(**arguments)
        ti.sync()

    def restore() -> None:
        for key in contest.changes:
            if isinstance(used[key], np.ndarray):
                used[key][...] = held[key]
            else:
                used[key].from_numpy(held[key])

    launch(used)  # compiled, and in the cache; what counts its units is there
    case = Case(case | {key: runtime.on_host(case[key]) for key in held})
    units = contest.units(case)
    known = {**case, **contest.given(case)}
    wanted = twin_arguments(contest.twin, known)
    took = repeated(lambda: launch(used), seconds, before=restore)
    nothing = idle.seconds(0.1 * seconds)[name]
    twin = float(np.median(repeated(lambda: contest.twin(**wanted), seconds, 1)))
    median = float(np.median(took))
    return KernelSpeed(
        name, scene, contest.unit, units, median, min(took), twin, twin / median,
        1e9 * median / max(units, 1), 1e6 * nothing,
    )  # fmt: skip


def flattened(arguments: Sequence[Any]) -> list[Any]:
    """Numbers and arrays of a launch in the order of a kernel's `names`: members of blocks come last."""
    alone = [argument for argument in arguments if not isinstance(argument, tuple)]
    return alone + [array for block in arguments if isinstance(block, tuple) for array in block]


def twin_arguments(twin: Function, known: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a twin, blocks and all, from numbers and arrays by name."""
    hints = get_type_hints(twin)
    names = inspect.signature(twin).parameters
    blocks = {name: hints[name] for name in names if hasattr(hints.get(name), "_fields")}
    return {
        name: blocks[name](*(known[field] for field in blocks[name]._fields))
        if name in blocks
        else known[name]
        for name in names
    }


class IdleLaunches:
    """Launches of kernels that have nothing to do.

    Parameters
    ----------
    cases : dict
        One of every kernel, by its name.
    """

    def __init__(self, cases: dict[str, Case]) -> None:
        from gridslam.kernels.primitives.launching import MOST_LAUNCHES

        self._cases: dict[str, list[Case]] = {}
        for name, case in cases.items():
            idle = Case(case | {key: _none(key, runtime.on_host(case[key])) for key in CONTESTS[name].rows})
            # arrays are others than the time before, if they are in a filter
            self._cases[name] = [
                Case((key, value if key in case.lasting else _copy(value)) for key, value in idle.items())
                for _ in range(MOST_LAUNCHES + 1)
            ]

    def seconds(self, each: float = 0.01) -> dict[str, float]:
        """Median of the launches of each kernel, which are repeated for so many seconds."""
        import taichi as ti

        from gridslam.kernels.primitives.device import ON_CPU

        taken = {}
        for name, cases in self._cases.items():
            kernel, turn = kernels()[name], itertools.cycle(cases)

            def launch(kernel: Kernel = kernel, turn: Iterator[Case] = turn) -> None:
                kernel.named(**next(turn))
                if not ON_CPU:
                    ti.sync()

            launch()
            taken[name] = float(np.median(repeated(launch, each)))
        return taken


def repeated(
    action: Callable[[], object],
    seconds: float,
    at_least: int = 3,
    before: Callable[[], object] = lambda: None,
) -> list[float]:
    """Seconds that each of many calls took, without what is done `before` each."""
    took: list[float] = []
    until = time.perf_counter() + seconds
    while len(took) < at_least or time.perf_counter() < until:
        before()
        began = time.perf_counter()
        action()
        took.append(time.perf_counter() - began)
    return took


def race(
    name: str, where: str, unit: str, units: int, seconds: float, share: float,
    launch: Callable[[], object], idle: Callable[[], object], twin: Callable[[], object],
) -> KernelSpeed:  # fmt: skip
    """Time a kernel, its launch with one row, and its twin, whose time counts `share` times.

    Parameters
    ----------
    unit, units : str, int
        What a launch works on, and how many of these.
    seconds : float
        How long the kernel is launched again and again.
    """
    launch()  # compiled
    took = repeated(launch, seconds)
    nothing = float(np.median(repeated(idle, 0.1 * seconds)))
    slow = share * float(np.median(repeated(twin, 0.0, 1)))
    median = float(np.median(took))
    return KernelSpeed(
        name, where, unit, units, median, min(took), slow, slow / median, 1e9 * median / units, 1e6 * nothing
    )


def _none(name: str, array: Array) -> Array:
    """No rows of an array; of those that have paths or measurements in columns, none of these either."""
    if name in ("born", "found"):
        return np.zeros_like(array[:1])
    if name == "count":
        return np.zeros_like(array)
    if name == "message":
        return np.ascontiguousarray(array[:, :0, :0])
    return np.ascontiguousarray(array[:, :0]) if name in ("blocks", "odds", "measured", "news") else array[:0]


def _copy(value: Any) -> Any:
    """A copy of an array, where it is."""
    if isinstance(value, np.ndarray):
        return value.copy()
    return runtime.resident(value.to_numpy()) if hasattr(value, "to_numpy") else value
