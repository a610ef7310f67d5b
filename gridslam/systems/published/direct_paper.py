"""Direct SLAM as published: particles of agent, features and noise, moment-matched messages.

Kept to compare with `gridslam.systems.direct`. Where [LiangDirect] is silent or can't be meant as printed, it
does what docs/differences.md says of both.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import PathEstimate
from gridslam.estimates import Estimate
from gridslam.inference.management.published.particle_readout import feature_surfaces
from gridslam.inference.messages.published.direct_particles import (
    LEAST_EXISTENCE,
    agent_message,
    expect,
    feature_messages,
    new_features,
    noise_message,
    predict_particles,
    start_particles,
)
from gridslam.inference.messages.published.sampling import resampled
from gridslam.inference.messages.samples.signal_likelihood import band_of
from gridslam.inference.state.presence import FRESH_SIGHT
from gridslam.inference.state.published.feature_particles import Features, ParticleState
from gridslam.maps.map import Map
from gridslam.systems.direct import require_single_antennas
from gridslam.systems.signal_front import SignalFilter
from gridslam.world.filter_model import detected
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan


def start(model: SignalModel, prior: Map | None = None) -> ParticleState:
    """The state before the first step: particles of the agent's prior, and the anchors as features."""
    count, anchors = model.settings.particles, len(model.anchors)
    draw = np.random.default_rng([count, anchors, model.seed])
    agent = model.start_mean[:4] + np.sqrt(model.start_variance[:4]) * draw.standard_normal((count, 4))
    place = np.broadcast_to(model.anchor_positions[:, None], (anchors, count, 2)).copy()
    features = Features(
        np.arange(anchors), np.arange(anchors), np.ones(anchors, bool), np.full(anchors, FRESH_SIGHT), place,
        np.zeros((anchors, count)),
    )  # fmt: skip
    return ParticleState(agent, np.zeros((anchors, count)), features, 0, anchors)


def step(state: ParticleState, scan: SignalScan, model: SignalModel, work: int) -> tuple[ParticleState, None]:
    """One step, as the list of its messages ([LiangDirect], section III).

    Parameters
    ----------
    work : int
        The seed.
    """
    band = band_of(model.waveform)
    draw = np.random.default_rng([work, state.step])
    state = predict_particles(state, scan.time_s, model, draw)
    fresh, logs = list[Features](), np.zeros(len(state.agent))
    for anchor in np.flatnonzero(scan.heard).tolist():
        samples = scan.samples[anchor, 0, 0]
        state = start_particles(state, anchor, band, samples)
        expected = expect(state, anchor, band)
        logs = logs + agent_message(state, expected, band, samples)  # eq. (5)
        noise = state.noise.copy()
        noise[anchor] = noise[anchor][resampled(noise_message(state, anchor, expected, samples), draw)]
        updated = feature_messages(state, expected, band, samples, draw)  # eq. (7)
        new = new_features(
            state, anchor, expected, band, samples, model.anchor_positions[anchor], draw
        )  # [LiangDirect], section II-B
        fresh.append(new)
        known = state.features.put(expected.rows, updated)
        number = state.next_identity + len(new)
        state = replace(state, features=known, noise=noise, next_identity=number)
    features = state.features
    for new in fresh:
        features = features.joined(new)
    features = features.take(features.fixed | (features.existence > LEAST_EXISTENCE))
    agent = state.agent[resampled(logs, draw)]  # eq. (8), the agent last
    return replace(state, agent=agent, features=features, step=state.step + 1), None


class PublishedDirectSlam(SignalFilter[ParticleState]):
    """Direct SLAM as published, one step at a time. Slow, and often lost at the start: a reference.

    Parameters
    ----------
    scene : Scene
        Anchors, region and filter settings (``filter.particles``); its walls are never read.
    prior_map, agent, seed, same_frame, waveform
        As of `gridslam.systems.direct.DirectSlam`.

    Raises
    ------
    InputError
        As there.
    """

    method = "direct-paper"
    uses_maps = False
    by_particles = True
    start = staticmethod(start)
    advance = staticmethod(step)

    def __init__(self, scene: Any, *args: Any, **more: Any) -> None:
        super().__init__(scene, *args, **more)
        require_single_antennas(self.waveform)

    def _workspace(self) -> int:
        return self.seed

    @staticmethod
    def moved(state: ParticleState, position_m: Array, heading_rad: float) -> ParticleState:
        """The state before the first step, with its prior about another start (m)."""
        agent = state.agent.copy()
        agent[:, :2] += np.asarray(position_m) - agent[:, :2].mean(0)
        return replace(state, agent=agent)

    def estimate(self, state: ParticleState, scan: SignalScan, info: None, began: float) -> Estimate:
        """Means over particles; the heading is that of the motion."""
        mean, covariance = state.agent.mean(0), np.cov(state.agent.T)
        whole = np.zeros((5, 5))
        whole[:4, :4], whole[4, 4] = covariance, np.pi**2 / 3
        table = feature_surfaces(state.features, self.model.anchor_positions)
        return Estimate(
            scan.step, scan.time_s, mean[:2], mean[2:], float(np.arctan2(mean[3], mean[2])), whole, table,
            PathEstimate.empty(), detected(table.existence, self.model.settings), np.nan,
            time.perf_counter() - began,
        )  # fmt: skip

    def map(self) -> Map:
        """A blank map: features that aren't at one place yet would be no walls."""
        return replace(Map.of_scene(self.scene), provenance=self.latest())
