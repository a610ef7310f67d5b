"""All steps of a run, one after another: watched, kept in checkpoints, stopped when asked to."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Sized
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Generic, Protocol, TypeVar

import psutil

from gridslam.errors import InputError
from gridslam.maps.map import Map
from gridslam.runs.stopping import asked_to_stop, keep_with
from gridslam.runs.unfinished import AgentCheckpoint

MIB = 2**20

Estimated = TypeVar("Estimated")
System = TypeVar("System")
Progress = Callable[[Estimated, int, int], None]
Watch = Callable[[Estimated, Callable[[], Map]], None]


class Scans(Sized, Iterable[Any], Protocol):
    """What was heard, step by step: `Measurements`, `Recording` or `NetworkMeasurements`."""


@dataclass(frozen=True, eq=False)
class Steps(Generic[Estimated]):
    """Steps that were taken.

    Attributes
    ----------
    estimates : list of Estimate or NetworkEstimate
        One for each.
    seconds : list of float
        Wall-clock time of each, s.
    peak_memory_mb : float
        Greatest resident memory after a step, MiB.
    fault : Exception or None
        What the step after them raised.
    """

    estimates: list[Estimated] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    peak_memory_mb: float = 0.0
    fault: Exception | None = None

    @property
    def seconds_per_step(self) -> float:
        """Median wall-clock time of a step: the first ones also compile kernels, once for all runs."""
        return statistics.median(self.seconds)


def resumed_or_started(
    system: type[System], checkpoint: AgentCheckpoint | None, start: Callable[[], System]
) -> tuple[System, Steps[Any]]:
    """A filter and the steps that it took already: of a checkpoint, or none and one that starts.

    Raises
    ------
    InputError
        A file of the checkpoint is damaged, or of another system.
    """
    resumed = checkpoint.resumed(system) if checkpoint is not None else None
    if checkpoint is None or resumed is None:
        return start(), Steps()
    slam, estimates = resumed
    return slam, Steps(estimates, checkpoint.progress.seconds, checkpoint.progress.peak_mb)


def run_steps(
    step: Callable[[Any], Estimated],
    slam: Any,
    scans: Scans,
    before: Steps[Estimated],
    progress: Progress[Estimated] | None,
    watch: Watch[Estimated] | None,
    checkpoint: AgentCheckpoint | None,
    keep: bool = False,
) -> Steps[Estimated]:
    """Take all steps that are left.

    Parameters
    ----------
    step : callable
        One step: what was heard in, an estimate out.
    slam : Slam or NetworkFront
        Whose step it is; its map is shown to `watch`, its state kept by `checkpoint`.
    scans : Measurements, Recording or NetworkMeasurements
        Of all steps.
    before : Steps
        Of `resumed_or_started`: those that needn't be taken again.
    progress, watch, checkpoint
        As those of `gridslam.map_scene`.
    keep : bool
        Whether a step that fails ends the run with those before it, if there are any.

    Returns
    -------
    Steps
        Those before included; fewer than scans if it was interrupted: Ctrl-C lets the step in hand finish.

    Raises
    ------
    InputError
        There is no step, or a step refuses what was heard.
    KeyboardInterrupt
        Asked to stop a second time.
    """
    estimates, seconds, peak = list(before.estimates), list(before.seconds), before.peak_memory_mb
    process = psutil.Process()  # to find out when it began takes longer than to ask for its memory
    with asked_to_stop() as stopped:
        for scan in islice(iter(scans), len(estimates), None):
            began = time.perf_counter()
            try:
                estimates.append(step(scan))
            except Exception as error:
                if keep:
                    keep_with(error, None)  # theirs, at the first step, too
                if not (keep and estimates):
                    raise
                return Steps(estimates, seconds, peak, error)
            seconds.append(time.perf_counter() - began)
            peak = max(peak, process.memory_info().rss / MIB)
            try:
                if progress is not None:
                    progress(estimates[-1], len(estimates), len(scans))
                if watch is not None:
                    watch(estimates[-1], slam.map)
            except KeyboardInterrupt:
                stopped.set()
            if checkpoint is not None:
                checkpoint.keep(slam, estimates, seconds, peak, now=stopped.is_set())
            if stopped.is_set():
                break
    if not estimates:
        raise InputError("measurements", "no step", "at least one step")
    return Steps(estimates, seconds, peak)
