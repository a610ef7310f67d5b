"""Where an agent may be after a silence: where in the region its motion leads; docs/model.md, (M571).

Between two snapshots the agent has one acceleration. Over a long time that is no motion: it would lead far
out of the region, and tell the speed by the place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.health.monitor import VAGUE_M
from gridslam.inference.messages.features.joint_update import predict
from gridslam.inference.messages.features.regaining import UNSURE_M
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.signal_model import SignalModel

LONGER = 3.0
"""Times as long as usual a silence is at least: where steps are long, motion over one is all there is."""
MOST = 1000
"""Places along either axis of the region at most: in one of over 150 m they are farther apart."""


def carried(belief: JointBelief, seconds: float, model: SignalModel) -> JointBelief:
    """The belief so many seconds later, within the region if it is vague by then."""
    after = replace(
        predict(belief, seconds, model.settings.acceleration_mps2), usual_s=usual(belief.usual_s, seconds)
    )
    wide = lasts(seconds, belief.usual_s, model) or (belief.astray and _beyond(after, model))
    return _within(after, model) if wide else after


def lasts(seconds: float, usual_s: float, model: SignalModel) -> bool:
    """Whether a push of so long alone leaves the agent vague, and steps are mostly far shorter."""
    push = np.sqrt(2) * 0.5 * model.settings.acceleration_mps2 * seconds**2
    return bool(push > VAGUE_M and seconds > LONGER * usual_s > 0)


def usual(usual_s: float, seconds: float) -> float:
    """How long steps mostly are (s) after one more; 0 before the first. A single odd one hardly counts."""
    return max(0.5 * usual_s, min(1.1 * usual_s, seconds)) if usual_s else seconds


def unheard(belief: JointBelief, heard: NDArray[np.bool_]) -> JointBelief:
    """The belief after a step at which nothing was heard: one that is vague then has to be found again."""
    vague = not heard.any() and np.trace(belief.agent_covariance[:2, :2]) > VAGUE_M**2
    return replace(belief, astray=True) if vague and not belief.astray else belief


def region_axes(model: SignalModel) -> list[Array]:
    """Coordinates (m) along x and y over the region, closer than half of what a pulse tells apart."""
    sides = np.array([model.grid.x_m, model.grid.y_m])
    counts = np.clip(np.ceil((sides[:, 1] - sides[:, 0]) / UNSURE_M), 2, MOST).astype(int)
    return [
        low + (high - low) * (np.arange(n) + 0.5) / n for (low, high), n in zip(sides, counts, strict=True)
    ]


def region_places(model: SignalModel) -> Array:
    """Places (Q, 2) m all over the region."""
    grid: Array = np.stack(np.meshgrid(*region_axes(model), indexing="ij"), -1).reshape(-1, 2)
    return grid


def _beyond(belief: JointBelief, model: SignalModel) -> bool:
    """Whether the agent's place is vaguer than if it were anywhere in the region."""
    spread = np.diagonal(belief.agent_covariance)[:2]
    return bool((spread > [along.var() for along in region_axes(model)]).any())


def _within(belief: JointBelief, model: SignalModel) -> JointBelief:
    """The belief with its agent in the region, and no faster than one push gets it that far, (M571)."""
    mean, covariance = belief.mean.copy(), belief.covariance.copy()
    own = np.diagonal(belief.agent_covariance).copy()
    for axis, along in enumerate(region_axes(model)):
        middle = float(np.clip(mean[axis], along[0], along[-1]))
        nats = -0.5 * (along - middle) ** 2 / own[axis]
        share = np.exp(nats - np.logaddexp.reduce(nats))
        mean[axis] = share @ along
        own[axis] = share @ (along - mean[axis]) ** 2
        fastest = 2 * model.settings.acceleration_mps2 * np.sqrt(own[axis])
        own[axis + 2] = min(own[axis + 2], fastest)
    covariance[:MOVING] = 0.0
    covariance[:, :MOVING] = 0.0
    covariance[:MOVING, :MOVING] = np.diag(own)
    return replace(belief, mean=mean, covariance=covariance, astray=True)
