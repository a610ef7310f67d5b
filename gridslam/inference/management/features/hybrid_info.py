"""What happened at a step of hybrid SLAM, returned beside the new state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gridslam.arrays import Array
from gridslam.estimates import Health
from gridslam.inference.health.signal_watch import assess_particles
from gridslam.inference.messages.features.learning import Learned
from gridslam.inference.messages.features.sight import Moments, los_power
from gridslam.inference.state.features.hybrid_state import HybridState
from gridslam.world.signal_model import SignalModel

SIGHTS = 10
"""Steps at which a line of sight has to have been heard, or at half of all, for it to be believed; of two
anchors, if antennas tell no directions, for the turn of agent and map about either to be known."""
LATELY = 20
"""Steps within which they have to have been for that: lengths along a metre of way don't tell where what is
learned from them stands, and the agent turns away with it."""
HANDED_ON = -1_000_000
"""Steps since where an earlier agent left features, which tell the turn."""


@dataclass(frozen=True, eq=False)
class HybridInfo:
    """Messages, timing and health of one step.

    Attributes
    ----------
    agent, agent_covariance : (4,), (4, 4)
        x, y (m), vx, vy (m/s), before any resampling.
    heading_rad, heading_variance : float
        As measured.
    existence, los_power, noise : (J,)
        Lines of sight: probability, power at 1 m in units of the samples squared; noise power.
    log_evidence : float
        Log density of the step's samples given all before.
    learned : Learned
        What the segment taught, at steps that end one.
    health : Health
    seconds : mapping of str to float
    """

    agent: Array
    agent_covariance: Array
    heading_rad: float
    heading_variance: float
    existence: Array
    los_power: Array
    noise: Array
    log_evidence: float
    learned: Learned
    health: Health
    seconds: Mapping[str, float] = field(default_factory=dict)


def conclude(
    state: HybridState, moments: Moments, learned: Learned, heading_rad: float, seconds: Mapping[str, float],
    model: SignalModel,
) -> HybridInfo:  # fmt: skip
    """What a step reports of the state after it.

    Parameters
    ----------
    moments : Moments
        Of the agent after the step, before any resampling.
    heading_rad : float
        As measured.
    seconds : mapping of str to float
        What the step took so far, by stage.
    """
    cloud, joint = state.particles, state.joint
    existence, power, noise = joint.existence, joint.los_power, joint.noise
    if cloud is not None:
        existence, power, noise = cloud.existence, los_power(cloud), cloud.noise.mean(1)
    spread_m = float(np.sqrt(np.trace(moments.covariance[:2, :2])))
    believed = bool(len(joint.features)) or state.sights > 0
    unsighted = believed and state.sights < min(SIGHTS, state.step / 2)
    seen = (state.sighted >= SIGHTS) & (state.unseen <= LATELY)
    alone = len(model.waveform.agent_element_m) == 1 and seen.sum() < 2
    health = assess_particles(
        spread_m, moments.effective, state.silent, state.early, len(existence), cloud is not None,
        unsighted, (state.leap_m, state.since_leap), turnable=bool(alone and len(joint.features)),
        astray=joint.astray,
    )  # fmt: skip
    return HybridInfo(
        moments.mean, moments.covariance, heading_rad, model.waveform.heading_std_rad**2, existence, power,
        noise, moments.log_evidence, learned, health, seconds,
    )  # fmt: skip
