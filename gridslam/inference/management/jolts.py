"""Steps at which the agent moves more sharply than its motion model says, taken again: docs/model.md,
(M483), (M484).

Most devices go straight for long and then turn at once: a walk that is wide enough for their bends is wider
than needed all the way between them, and one that isn't loses them there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array
from gridslam.inference.beliefs.layout import AGENT, HEADING
from gridslam.inference.health.monitor import SWAMPED
from gridslam.inference.management.challenge import HANDICAP
from gridslam.inference.management.poses.pose_recovery import crowd
from gridslam.inference.management.step_info import StepInfo, comparable
from gridslam.inference.messages.motion import predict_agent
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel, fixed
from gridslam.world.geometry import wrap
from gridslam.world.scan import Scan

Step = Callable[[State, Scan, FilterModel, Workspace], tuple[State, StepInfo]]
FACTORS = fixed(np.sqrt(2.0) ** np.arange(9))
"""Times the scene's standard deviations that are tried: 1 to 16."""
MORE = fixed(FACTORS[:, None] ** 2 - 1)
"""By how much the variances are larger then, as multiples of the scene's."""
LIKELIER, UNUSUAL = 3.0, 3.0
"""Nats by which another factor must explain a step's correction better than 1 to be tried, and then the
step: a jolt is rare."""
SLACK, SINGULAR = 1e-3, 1e-6
"""Nats that rounding doesn't reach; share of two variances' product below which a determinant is taken for 0.
"""


class Jolt(NamedTuple):
    """Times the scene's acceleration, and walk of the heading, that a step allows."""

    acceleration: float = 1.0
    heading: float = 1.0

    def allowed(self, model: FilterModel) -> FilterModel:
        """The model of such a step."""
        settings = model.settings
        return replace(
            model, settings=settings.model_copy(update={
                "acceleration_mps2": self.acceleration * settings.acceleration_mps2,
                "heading_deg": self.heading * settings.heading_deg,
            }),
        )  # fmt: skip


NONE = Jolt()
ANY = Jolt(float(FACTORS[5]), float(FACTORS[4]))
"""Where the step itself says nothing, since the agent was lost in it."""


def stepped(
    before: State, scan: Scan, model: FilterModel, work: Workspace, step: Step
) -> tuple[State, StepInfo]:
    """A step; taken again with room for a jolt where it looks like one, if that explains more, (M484)."""
    state, info = step(before, scan, model, work)
    jolt = ANY if info.found_again else likeliest(before, state, model)
    if jolt == NONE or crowd(split_by_anchor(scan, model)) > SWAMPED:  # by chance, any motion fits some
        return state, info
    recovers, work.recovers = work.recovers, False
    again, other = step(before, scan, jolt.allowed(model), work)
    work.recovers = recovers
    gain = comparable(other, again, model) - comparable(info, state, model)
    if gain < (-HANDICAP if info.found_again else UNUSUAL):
        return state, info
    return again, replace(other, health=replace(other.health, jolt=(jolt.acceleration, jolt.heading)))


def likeliest(before: State, state: State, model: FilterModel) -> Jolt:
    """The jolt that explains best by how much a step has corrected the agent's prediction, (M483)."""
    if before.time_s is None or state.time_s is None:
        return NONE
    elapsed_s, settings = state.time_s - before.time_s, model.settings
    predicted = predict_agent(before.belief, elapsed_s, settings)
    change = state.belief.mean[:AGENT] - predicted.mean
    change[HEADING] = wrap(change[HEADING])
    place, speed = 0.5 * elapsed_s**2, elapsed_s
    noise = np.array([[place, 0, 0], [0, place, 0], [speed, 0, 0], [0, speed, 0], [0, 0, 1.0]])
    back = np.linalg.solve(predicted.covariance, noise)
    score = back.T @ change
    information = back.T @ (predicted.covariance - state.belief.covariance[:AGENT, :AGENT]) @ back
    return Jolt(
        _factor(score[:2], information[:2, :2], settings.acceleration_mps2),
        _factor(score[2:], information[2:, 2:], np.radians(settings.heading_deg)),
    )


def _factor(score: Array, information: Array, told: float) -> float:
    """Which of `FACTORS` times what is told explains a step best; 1 unless another does so clearly."""
    if explained_at_most(score, information) < LIKELIER - SLACK:  # as at most steps
        return 1.0
    log = evidence(score, information, told)
    best = int(log.argmax())
    return float(FACTORS[best]) if log[best] > LIKELIER else 1.0


def explained_at_most(score: Array, information: Array) -> float:
    """Nats by which no jolt, however likely, explains a step better than none: half of the squared score in
    its own deviations. Infinite where the covariance of the score (D, D), of one or two, is about singular.

    It takes a tenth of the time of `evidence`, and is enough to say no at most steps.
    """
    if len(score) == 1:
        (x,), ((xx,),) = score.tolist(), information.tolist()
        return float(0.5 * x * x / xx) if xx > 0 else np.inf
    (x, y), ((xx, _), (xy, yy)) = score.tolist(), information.tolist()
    determinant = xx * yy - xy * xy
    square = yy * x * x - 2 * xy * x * y + xx * y * y
    return float(0.5 * square / determinant) if xx > 0 and determinant > SINGULAR * xx * yy else np.inf


def evidence(score: Array, information: Array, told: float) -> Array:
    """Log likelihood (9,) of a step for each of `FACTORS` times what is told, above that for once; (M483).

    Parameters
    ----------
    score : (D,)
        Derivative of the step's log likelihood by the jolt, at none.
    information : (D, D)
        Covariance of the score.
    told : float
        Standard deviation of the jolt as told.
    """
    if len(information) == 1:  # its own eigenvalue
        values = information[0]
    else:
        values, vectors = np.linalg.eigh(information)
        score = vectors.T @ score
    more = told**2 * MORE
    wider = 1 + more * np.maximum(values, 0.0)
    log: Array = 0.5 * (more * score**2 / wider - np.log(wider)).sum(1)
    return log
