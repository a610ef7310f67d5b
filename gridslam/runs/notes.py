"""What is said of a run by its scores: below the table of `run`, by `check`, and in its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.evaluation.metrics import DIVERGED_M, SETTLED_STEP, diverged, track_errors
from gridslam.maps.map import Map
from gridslam.runs.run_files import RunFiles, read_summary
from gridslam.systems.registry import METHODS
from gridslam.world.trajectory import Trajectory

LAST = 10
"""Steps at the end over which errors tell whether an agent was found again."""
SUSPECT = ": suspect: "
"""Behind an agent's name, before what is suspected of its measurements."""


def lost_note(
    agent: str, track: Trajectory, truth: Trajectory | None, estimates: Sequence[Estimate] = ()
) -> str | None:
    """How far an agent was off, and whether to the end; None where it never was, or nobody knows.

    Parameters
    ----------
    agent : str
    track : Trajectory
        Estimated.
    truth : Trajectory or None
    estimates : sequence of Estimate
        For the numbers of the steps; without, they are counted from 0.
    """
    if truth is None or not len(track):
        return None
    seen = ~truth.in_hole(track.time_s)
    position = track_errors(track, truth)[0][seen]
    estimates = list(compress(estimates, seen)) if len(estimates) == len(seen) else []
    if not diverged(position):
        return None
    error = np.linalg.norm(position, axis=-1)
    worst = SETTLED_STEP + 1 + int(error[SETTLED_STEP + 1 :].argmax())
    step = estimates[worst].step if len(estimates) == len(error) else worst
    peak = f"up to {error[worst]:.2f} m off at step {step}"
    if (error[-LAST:] <= DIVERGED_M).all():
        return f"{agent}: {peak}, found again"
    if error[-1] <= DIVERGED_M:  # too late to tell
        return f"{agent}: {peak}, {error[-1]:.2f} m at the end"
    if worst == len(error) - 1:
        return f"{agent}: lost: {error[-1]:.2f} m off at step {step}, the last"
    return f"{agent}: lost: {peak}, {error[-1]:.2f} m at the end"


def health_notes(agent: str, score: Mapping[str, Any]) -> list[str]:
    """What a filter said was amiss, and at how many steps, most frequent first.

    Parameters
    ----------
    agent : str
    score : mapping
        The agent's part of ``run.json``.
    """
    why, steps = (score.get("health") or {}).get("why") or {}, score.get("steps", "?")
    return [f"{agent}: {reason} (at {number} of {steps} steps)" for reason, number in why.items()]


def silence_note(agent: str, unheard: Sequence[int], steps: int) -> str | None:
    """When nothing was heard for a while; None of a silence shorter than `LAST`.

    Parameters
    ----------
    agent : str
    unheard : sequence of int
        Steps at which nothing was heard.
    steps : int
        How many there are.
    """
    gone = np.asarray(unheard, int)
    longest = max(np.split(gone, np.flatnonzero(np.diff(gone) > 1) + 1), key=len)
    if len(longest) < LAST:
        return None
    where = f"from step {longest[0]} to {longest[-1]}"
    said = f"{agent}: nothing was heard at {len(gone)} of {steps} steps, the longest time {where}"
    if longest[0] > 0:
        return said
    return f"{said}, from the start on; if the start is where the table begins, count its steps from 0"


def unsaid_note(agent: str, score: Mapping[str, Any], method: str) -> str | None:
    """That a filter was wrong by its own measure without a word of it, by the true track.

    Parameters
    ----------
    agent : str
    score : mapping
        The agent's part of ``run.json``.
    method : str
        Its name: some published ones have no health that could say so.
    """
    silent, steps = score.get("silent_steps"), score.get("steps", "?")
    if not silent or score.get("position_nees") is None:  # it claims nothing
        return None
    why = "while its health is well"
    if method in METHODS and not METHODS[method].has_health:
        why = f"and {method}, kept as published, has no health that could say so"
    return f"{agent}: off by over 4 of its own deviations at {silent} of {steps} steps, {why}"


def whole_walls_note(found: Map, method: str) -> str | None:
    """That nothing tells where walls are open; None of a map with cells, or without walls that were hit.

    Parameters
    ----------
    found : Map
    method : str
        The name of the one that made it.
    """
    table = found.surfaces
    if table is None or found.observed.any() or not np.isfinite(table.extent_m).all(axis=1).any():
        return None
    if found.stretches is None:
        return (
            f"{method} maps no cells: each wall is drawn and exported from its first hit to its last, across "
            "doors and gaps, which only methods with a grid find"
        )
    return (
        f"{method} maps no cells: walls are drawn and exported where paths were reflected by them; whether "
        "there is a door or a wall in between, only methods with a grid find"
    )


def planner_note(found: Map, file: Path) -> str | None:
    """That a map without free cells is none for a planner, and what its walls are."""
    if found.free.any():
        return None
    none = "no free cells, as of methods that map none or where too little is measured"
    if found.surfaces is not None and not found.observed.any():
        none += "; walls go " + (
            "from their first hit to their last, across doors"
            if found.stretches is None
            else "as far as paths were reflected by them"
        )
    return f"{file}: {none}: no map for a planner"


def lost_makers(map_file: Path | None) -> list[str]:
    """Who of those that made a map was lost, by the notes of the run's folder that it lies in, if it does.

    Parameters
    ----------
    map_file : Path or None
        In the folder itself or in that of one agent, who alone is asked then.
    """
    if map_file is None:
        return []
    above = map_file.resolve().parent
    for folder, agent in ((above, ""), (above.parent, above.name)):
        if (folder / "run.json").is_file():
            with suppress(InputError):  # a map is read, whatever lies beside it
                notes = [str(note) for note in read_summary(folder).get("notes") or ()]
                whose = f"{agent}: " if agent else ""
                lost = [note for note in notes if ": lost: " in note and note.startswith(whose)]
                return [
                    f"{map_file}: by its run's notes, {note}: map it again, or go on from another"
                    for note in lost
                ]
    return []


def run_notes(run: RunFiles) -> list[str]:
    """All that was said of a run that was written, in the words of `run`."""
    kept = [str(note) for note in run.summary.get("notes") or ()]
    lost = [lost_note(name, own.trajectory, own.truth, own.estimates) for name, own in run.agents.items()]
    health = [note for name in run.agents for note in health_notes(name, run.summary["agents"][name])]
    return [*(note for note in lost if note and note not in kept), *kept, *health]


def grave_notes(run: RunFiles) -> list[str]:
    """Of these, what says that its map may be worth nothing; and who wasn't well at most steps."""
    grave = [note for note in run_notes(run) if ": lost: " in note or SUSPECT in note]
    for name, own in run.agents.items():
        unwell = sum(not one.health.ok for one in own.estimates)
        if 2 * unwell > len(own.estimates):
            grave.append(f"{name}: health complains at {unwell} of {len(own.estimates)} steps")
    return grave
