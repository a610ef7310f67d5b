"""What is said of a run by its scores: below the table of `run`, by `check`, and in its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gridslam.estimates import Estimate
from gridslam.evaluation.metrics import DIVERGED_M, SETTLED_STEP, diverged, track_errors
from gridslam.world.trajectory import Trajectory

LAST = 10
"""Steps at the end over which errors tell whether an agent was found again."""


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
    position, _ = track_errors(track, truth)
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
