"""Running a filter for some steps, and what each of them took."""

from __future__ import annotations

import gc
import time
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import tomli_w

from gridslam.simulation.simulate import observations_of
from gridslam.world.observation import Kind
from gridslam.world.scene import Scene


class PeakMemory:
    """Largest resident memory of this process since this object was made, MB."""

    def __init__(self) -> None:
        gc.collect()
        self._seen = 0.0
        try:  # Linux keeps the peak itself, and lets it be reset
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
            self._by_system = True
        except OSError:
            self._by_system = False

    def look(self) -> float:
        """The peak; elsewhere than on Linux, the largest of all looks."""
        memory = psutil.Process().memory_info().rss / 2**20
        if self._by_system:
            status = Path("/proc/self/status").read_text(encoding="utf-8")
            memory = int(status.partition("VmHWM:")[2].split()[0]) / 2**10
        self._seen = max(self._seen, memory)
        return self._seen


def changed(scene: Scene, **sections: dict[str, Any]) -> Scene:
    """Return the scene with other values in some sections of its text; "agents" is for all agents."""
    data = tomllib.loads(scene.to_toml())
    for section, values in sections.items():
        for table in data[section] if isinstance(data[section], list) else [data[section]]:
            table.update(values)
    return Scene.from_toml(tomli_w.dumps(data), scene.name)


def first_scans(scene: Scene, steps: int, takes: Kind = "paths") -> list[Any]:
    """What the scene's first agent hears in its first steps, of the kind that a method takes."""
    name = scene.agents[0].name
    return list(observations_of(changed(scene, agents={"steps": steps}), name, 1, takes))


@dataclass(frozen=True)
class Course:
    """What each of some steps took.

    Attributes
    ----------
    took, cpu : list of float
        Wall time, and what all threads together computed, s.
    surfaces : list of int
        In the belief.
    peak : list of float
        Memory so far, MB.
    """

    took: list[float]
    cpu: list[float]
    surfaces: list[int]
    peak: list[float]


def run(step: Callable[[Any], Any], scans: Iterable[Any], memory: PeakMemory) -> Course:
    """Take in all scans, and measure each step."""
    course = Course([], [], [], [])
    for scan in scans:
        began, busy = time.perf_counter(), time.process_time()
        estimate = step(scan)
        course.took.append(time.perf_counter() - began)
        course.cpu.append(time.process_time() - busy)
        course.surfaces.append(len(estimate.surfaces))
        course.peak.append(memory.look())
    return course
