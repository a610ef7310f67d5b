"""How far a run is: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from gridslam.estimates import Estimate
from gridslam.wording import counted
from gridslam.world.trajectory import Trajectory

if TYPE_CHECKING:
    from gridslam.inference.management.network.readout import NetworkEstimate

Tell = Callable[[Estimate, int, int], None]
LINES, LEAST_STEPS = 10, 100
"""Lines that a run writes where there is no terminal, and steps below which it writes none."""


@contextmanager
def network_progress_bar(
    tracks: Mapping[str, Trajectory], console: Console | None = None
) -> Iterator[Callable[[NetworkEstimate, int, int], None]]:
    """A progress bar of several agents at once, told of the first that is there at a step."""
    with progress_bar(" ".join(tracks) or "agents", None, console) as tell:

        def step_done(estimate: NetworkEstimate, done: int, total: int) -> None:
            there = [own for own in estimate.agents.values() if own is not None]
            if there:
                tell(there[0], done, total)

        yield step_done


@contextmanager
def progress_bar(
    name: str, truth: Trajectory | None = None, console: Console | None = None
) -> Iterator[Tell]:
    """Show steps per second, surfaces found and, where the truth is known, the position RMSE so far.

    Parameters
    ----------
    name : str
        Who is on the way.
    truth : Trajectory, optional
    console : rich.console.Console, optional
        Default: stderr.

    Yields
    ------
    callable
        To be called after each step with (estimate, steps done, steps in all).
    """
    console = Console(stderr=True) if console is None else console
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeRemainingColumn(compact=True),
        TextColumn("{task.fields[state]}"),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(name, total=None, state="loading kernels (compiling them, the first time)")
        began, earlier, square, count = 0.0, 0, 0.0, 0

        def tell(estimate: Estimate, done: int, total: int) -> None:
            nonlocal began, earlier, square, count
            if not began:  # kernels were loaded before
                began, earlier = bar.get_time(), done
            rate = (done - earlier) / max(bar.get_time() - began, 1e-9)
            state = f"{rate:.1f} steps/s" if done > earlier else "first step"
            if len(estimate.surfaces):  # hybrid SLAM, and many a method of one's own, have none
                state += f", {counted(int(estimate.detected.sum()), 'surface')}"
            if truth is not None and truth.time_s[0] <= estimate.time_s <= truth.time_s[-1]:
                there = [np.interp(estimate.time_s, truth.time_s, axis) for axis in truth.position_m.T]
                square, count = square + float(((estimate.position_m - there) ** 2).sum()), count + 1
            if count:
                since = (
                    "" if count == done else f" of the last {counted(count, 'step')}"
                )  # since a run was resumed
                state += f", error{since} {100 * (square / count) ** 0.5:.1f} cm"
            bar.update(task, completed=done, total=total, state=state)
            due = total >= LEAST_STEPS and done * LINES // total > (done - 1) * LINES // total
            if due and not console.is_terminal:
                line = f"{name}: step {done} of {total}, {state}"
                console.print(line, highlight=False, markup=False, soft_wrap=True)

        yield tell
