"""Particles after a silence: the agent is sought as a joint belief's, and they are drawn about where it is.

Docs/model.md, (M571), (M572). Of silences within the first steps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.messages.features import sight
from gridslam.inference.messages.features.found_again import update_anywhere
from gridslam.inference.messages.features.sight import Moments
from gridslam.inference.messages.features.silences import carried, lasts, usual
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, ParticleBelief
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
CARRIED, PLACED = 5, 6
"""Purposes of random numbers, beside those of `sight`."""


def carried_particles(
    state: HybridState, seconds: float, model: SignalModel, seed: int, bounded: bool
) -> HybridState:
    """The state with its particles so many seconds later; after a silence, if bounded, in the region."""
    cloud = state.particles
    assert cloud is not None
    after = sight.predict_particles(cloud, seconds, model.settings.acceleration_mps2, seed, state.step)
    usual_s = state.joint.usual_s
    state = replace(state, joint=replace(state.joint, usual_s=usual(usual_s, seconds)))
    if not (bounded and (state.joint.astray or lasts(seconds, usual_s, model))):
        return replace(state, particles=after)
    belief = carried(replace(_as_joint(state, cloud), usual_s=usual_s), seconds, model)
    after = _drawn(after, belief, [seed, state.step, CARRIED])
    return replace(state, particles=after, joint=replace(state.joint, astray=True))


def follow_astray(
    state: HybridState, samples: Complex, heard: NDArray[np.bool_], heading_rad: float, model: SignalModel,
    seed: int,
) -> tuple[HybridState, Moments]:  # fmt: skip
    """Particles astray after the samples (J, N, M) of one step: about the place that these tell."""
    cloud = state.particles
    assert cloud is not None
    predicted = _as_joint(state, cloud)
    belief, evidence = update_anywhere(predicted, samples, heard, heading_rad, model, state.step)
    moments = Moments(belief.mean[:MOVING], belief.agent_covariance, evidence, float(len(cloud.agent)))
    if belief.astray:
        return state, moments
    cloud = _drawn(replace(cloud, existence=belief.existence), belief, [seed, state.step, PLACED])
    return replace(state, particles=cloud, joint=replace(state.joint, astray=False)), moments


def _as_joint(state: HybridState, cloud: ParticleBelief) -> JointBelief:
    """The joint belief of particles, and of the features that they know, independent of these."""
    mean, covariance = state.before.mean.copy(), state.before.covariance.copy()
    mean[:MOVING] = cloud.agent.mean(0)
    covariance[:MOVING], covariance[:, :MOVING] = 0.0, 0.0
    covariance[:MOVING, :MOVING] = np.cov(cloud.agent.T) + sight.LEAST_VARIANCE * np.eye(MOVING)
    return replace(
        state.before, mean=mean, covariance=covariance, existence=cloud.existence,
        los_power=sight.los_power(cloud), noise=cloud.noise.mean(1), astray=state.joint.astray,
    )  # fmt: skip


def _drawn(cloud: ParticleBelief, belief: JointBelief, seeds: list[int]) -> ParticleBelief:
    """The particles with agents drawn from a joint belief."""
    root, draw = np.linalg.cholesky(belief.agent_covariance), np.random.default_rng(seeds)
    agent = belief.mean[:MOVING] + draw.standard_normal(cloud.agent.shape) @ root.T
    return replace(cloud, agent=agent)
