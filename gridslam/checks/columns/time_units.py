"""Whether the times of a table of measurements are seconds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.checks.sights.handovers import LEAST_SIGHTS, Ties
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.checks.sights.particles import PAUSE, PAUSE_S
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.world.columns import Columns

LATEST_S = 1e11
"""Seconds since 1970 stay below this for 1200 years; milliseconds have been above since 1973."""
UNITS = {"nanoseconds": (1e17, 1e-9), "microseconds": (1e14, 1e-6), "milliseconds": (LATEST_S, 1e-3)}
ABOUT = 0.1
"""By how much of it an interval in another unit may differ from the scene's."""
DAY_S, YEAR_2200_S = 86_400.0, 7.26e9
"""Median interval from which on times are no seconds, as nobody maps with a step a day; and the year 2200 in
seconds since 1970. Seconds that count from the year 0 or 1601 are beyond it: intervals must be long, too."""
FINEST_S, COARSEST_S = 1e-3, 10.0
"""Intervals between steps as most are."""
LARGE_S = 1e5
"""Times from which on six digits don't tell the first from the last."""
LONG_S, LEAST_MPS, LEAST_WAY_M = 10.0, 0.01, 1.0
"""Interval and speed that make one doubt of seconds, and how far the agent must get to tell a speed."""
AS_TOLD, LEAST_TOLD_M = 0.5, 0.3
"""Share of the way by the scene's `step_m` that is enough for it, too, and how far that must be: of an agent
that is to go a centimetre a step a hundred steps are hardly a metre."""
MOST_MPS = 30.0
"""Speed from which on one doubts of seconds, too."""
LEAST_STEPS = 10
"""Steps from which on their numbers are asked what they count."""
SET_S = 1e8
"""Three years."""
LEGS, FEW = 8, 3
"""Legs of the way by which a speed is told, at most, and positions in the middle of which each ends."""


def span(columns: Columns) -> str:
    """From when to when a table is; of times since 1970, say, how long it is and when it begins.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    """
    first, last = columns["time_s"].min(), columns["time_s"].max()
    if not LARGE_S <= abs(first) < np.inf:
        return f"{first:g} to {last:g} s"
    return f"{last - first:.6g} s from {first:.13g} s on"


def intervals(columns: Columns) -> list[str]:
    """The median interval between steps, as a line; nothing of a single step.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    """
    gap = _interval_s(columns)
    lines = [f"  time_s: median interval between steps {gap:.4g} s"] if gap > 0 else []
    before, after, longest = _longest_pause(columns)
    if gap > 0 and longest > max(PAUSE * gap, PAUSE_S):
        lines.append(f"  time_s: {longest:.4g} s from step {before} to step {after}, with nothing between")
    return lines


def strides_line(step: NDArray[np.integer]) -> str | None:
    """What to say of a table whose numbers of steps count something else; None of others.

    Parameters
    ----------
    step : (K,) int
    """
    numbers = np.unique(step)
    stride = int(np.gcd.reduce(np.diff(numbers))) if len(numbers) >= LEAST_STEPS else 1
    if stride < 2:
        return None
    steps = int(numbers[-1] - numbers[0]) + 1
    return (
        f"step: numbers rise by {stride}, or multiples of it, from one to the next: "
        f"{steps - len(numbers)} of {steps} steps are silent; number steps 0, 1, 2, ..., or leave the column "
        "out: every time is a step then"
    )


def absurd_times(columns: Columns) -> list[Suspicion]:
    """Times that can't be seconds: since 1970, or with steps a day or more apart.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    """
    latest, gap, first = _latest_s(columns), _interval_s(columns), _earliest_s(columns)
    for unit, (least, factor) in UNITS.items():
        if latest > least and factor * gap <= DAY_S:
            return [Suspicion("time_s", unit, _words(unit), True, f"up to {latest:.4g}")]
    if gap > DAY_S:
        reason = f"{gap:.4g} s between steps, in the middle: {gap / DAY_S:.3g} days"
        units = [unit for unit, (_, factor) in UNITS.items() if FINEST_S <= factor * gap <= COARSEST_S]
        kind = units[-1] if units else "nanoseconds"
        words = " or ".join(units) + ", where seconds belong" if len(units) > 1 else _words(kind)
        return [Suspicion("time_s", kind, words, True, reason)]
    if gap >= 10 * LONG_S and first > YEAR_2200_S:
        reason = f"from {first:.4g} s on, {gap:.4g} s between steps"
        return [Suspicion("time_s", "milliseconds", _words("milliseconds"), False, reason)]
    return []


def slow_steps(columns: Columns, interval_s: float, step_m: float) -> list[Suspicion]:
    """Times whose steps are as far apart as the scene's are in another unit, so that the agent would crawl.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of the steps, as their file has them.
    interval_s, step_m : float
        By the scene: between steps, and how far the agent goes meanwhile.
    """
    gap = _interval_s(columns)
    if gap < LONG_S or step_m / gap > LEAST_MPS:
        return []
    for unit, (_, factor) in UNITS.items():
        if abs(factor * gap / interval_s - 1) < ABOUT:
            reason = f"{gap:.4g} s between steps, where the scene's interval_s is {interval_s:g}"
            return [Suspicion("time_s", unit, _words(unit), False, reason)]
    return []


def set_clocks(columns: Columns) -> list[Suspicion]:
    """A clock that counted from when it was switched on, and was set on the way.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Of a table of measurements, as its file has them.
    """
    before, after, longest = _longest_pause(columns)
    if longest < SET_S:
        return []
    words = f"a clock that was set on the way, {longest:.4g} s from step {before} to step {after}"
    return [Suspicion("time_s", "leap", words, True, "nobody measures for years")]


def slow_times(
    columns: Columns, sight: Sight, ties: Ties | None = None, step_m: float = np.inf
) -> list[Suspicion]:
    """Times that would make the agent crawl, by where lines of sight put it.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        Its lines of sight.
    ties : Ties, optional
        Where anchors put it by themselves, in a longer table: nobody may be in sight at first.
    step_m : float
        The way of a step by the scene, if it is to count.
    """
    gap = _interval_s(columns)
    if gap < LONG_S or absurd_times(columns) or len(sight.position_m) < 5:
        return []
    span = float(np.ptp(columns["step"][sight.row]))
    way = float(np.linalg.norm(np.ptp(sight.position_m, axis=0)))
    enough = min(LEAST_WAY_M, max(LEAST_TOLD_M, AS_TOLD * step_m * span))
    if way < enough and ties is not None and sum(map(len, ties.seen.sights)) >= LEAST_SIGHTS:
        rows = np.concatenate(ties.seen.sights)
        span = float(np.ptp(ties.seen.step[rows]))
        way = float(np.linalg.norm(np.diff(np.quantile(ties.seen.place[rows], (0.1, 0.9), axis=0), axis=0)))
    speed = way / (gap * max(span, 1))
    if way < enough or speed > LEAST_MPS:
        return []
    reason = f"{gap:.4g} s between steps, so that the agent would move at {1000 * speed:.2g} mm/s"
    return [Suspicion("time_s", "milliseconds", _words("milliseconds"), False, reason)]


def fast_times(columns: Columns, sight: Sight) -> list[Suspicion]:
    """Times that would make the agent race, by the way that lines of sight put it on.

    Parameters
    ----------
    columns : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    sight : Sight
        Its lines of sight.
    """
    gap = _interval_s(columns)
    if gap <= 0 or len(sight.position_m) < FEW * (LEGS + 1):
        return []
    parts = np.array_split(sight.position_m, LEGS + 1)
    way = float(np.linalg.norm(np.diff([np.median(part, axis=0) for part in parts], axis=0), axis=1).sum())
    span = float(np.ptp(columns["step"][sight.row])) * LEGS / (LEGS + 1)
    speed = way / (gap * max(span, 1.0))
    if way < LEAST_WAY_M or speed < MOST_MPS:
        return []
    reason = f"{gap:.4g} s between steps, so that the agent would move at {speed:.0f} m/s"
    return [Suspicion("time_s", "fast", "too small for seconds", False, reason)]


def _words(unit: str) -> str:
    return f"{unit}, where seconds belong (times {UNITS[unit][1]:g})"


def _latest_s(columns: Columns) -> float:
    """The largest of the finite times, 0 without any."""
    time = columns["time_s"]
    return float(np.abs(time[np.isfinite(time)]).max(initial=0.0))


def _earliest_s(columns: Columns) -> float:
    """The smallest of the finite times, 0 without any."""
    time = columns["time_s"][np.isfinite(columns["time_s"])]
    return float(time.min()) if len(time) else 0.0


def _steps(columns: Columns) -> tuple[NDArray[np.integer], NDArray[np.float64]]:
    """Steps and their times; times that aren't finite are somebody else's to refuse."""
    step, first = np.unique(columns["step"], return_index=True)
    time = columns["time_s"][first]
    return step[np.isfinite(time)], time[np.isfinite(time)]


def _longest_pause(columns: Columns) -> tuple[int, int, float]:
    """The two steps between which the longest time passes, and that, s; 0 without two."""
    step, time = _steps(columns)
    if len(step) < 2:
        return 0, 0, 0.0
    with np.errstate(over="ignore"):
        way = np.diff(time)
    row = int(np.argmax(way))
    return int(step[row]), int(step[row + 1]), float(way[row])


def _interval_s(columns: Columns) -> float:
    """Median time per step, 0 of a single one."""
    step, time = _steps(columns)
    if len(step) < 2:
        return 0.0
    with np.errstate(over="ignore"):
        return float(np.median(np.diff(time) / np.diff(step)))
