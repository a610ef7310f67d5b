"""REFA: SLAM by virtual anchors as published, the reference that [Li2025adaptive], section VI, compares with.

[Leitinger2019bp] with angles and amplitudes: particles of the agent and of every anchor's virtual anchors,
each apart. Kept to compare with; `gridslam.systems.virtual_anchor` is the product's own.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from gridslam.arrays import Array
from gridslam.estimates import Estimate
from gridslam.inference.management.published.particle_readout import (
    agent_moments,
    feature_paths,
    feature_surfaces,
)
from gridslam.inference.messages.published.image_particles import (
    agent_logs,
    associate_images,
    born_images,
    evaluate_images,
    move,
    propose_images,
    pruned,
    resample_agent,
    updated_images,
)
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.state.presence import FRESH_SIGHT
from gridslam.inference.state.published.feature_particles import Features, ImageState
from gridslam.maps.map import Map
from gridslam.systems.filter_front import FilterFront, require_paths
from gridslam.systems.front import bare_map
from gridslam.systems.published.soundness import require_sound_particles
from gridslam.world.filter_model import FilterModel, detected
from gridslam.world.network_scene import require_known_clocks
from gridslam.world.radio import BINS
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene
from gridslam.world.start import require_scene


def start(model: FilterModel, prior: Map | None = None) -> ImageState:
    """The state before the first step: particles of the agent's prior, and lines of sight in free space."""
    count, anchors = model.settings.particles, len(model.anchors)
    draw = np.random.default_rng([count, anchors, model.seed])
    half = np.sqrt(3 * model.start_variance)
    agent = model.start_mean + half * draw.uniform(-1, 1, (count, 5))
    place = np.repeat(model.anchor_positions[:, None], count, axis=1)
    amplitude = model.radio.amplitude(np.linalg.norm(place - agent[:, :2], axis=-1))
    features = Features(
        np.arange(anchors), np.arange(anchors), np.ones(anchors, bool), np.full(anchors, FRESH_SIGHT), place,
        amplitude,
    )  # fmt: skip
    return ImageState(agent, features, 0, anchors)


def step(state: ImageState, scan: Scan, model: FilterModel, work: int) -> tuple[ImageState, None]:
    """One step, as the list of its messages.

    Parameters
    ----------
    work : int
        The seed.
    """
    draw = np.random.default_rng([work, state.step])
    state = move(state, scan.time_s, model, draw)
    parts, logs = list[Features](), np.zeros(len(state.agent))
    for anchor_scan in split_by_anchor(scan, model):
        seen = evaluate_images(state, anchor_scan, model.radio, model.anchors[anchor_scan.anchor])
        new = propose_images(state, anchor_scan, model.radio, model, draw)
        found = associate_images(state, seen, new)
        logs = logs + agent_logs(state, seen, found)
        born = born_images(state, anchor_scan, new, found, model, draw)
        parts += [updated_images(state, seen, found, draw), born]
        state = replace(state, next_identity=state.next_identity + len(born))
    features = pruned(Features.of(parts), model.settings.prune_below)
    state = resample_agent(replace(state, features=features), logs, draw)
    return replace(state, step=state.step + 1), None


class PublishedVirtualAnchorSlam(FilterFront[Scan, ImageState]):
    """SLAM by virtual anchors as published, one step at a time: a reference.

    Parameters
    ----------
    scene : Scene
        Radio, anchors, region and filter settings (``filter.particles``); its walls are never read.
    prior_map, agent, seed, same_frame
        As of `gridslam.systems.virtual_anchor.VirtualAnchorSlam`.

    Raises
    ------
    InputError
        As there.
    """

    method = "refa"
    uses_maps = False
    by_particles = True
    start = staticmethod(start)
    advance = staticmethod(step)
    require_sound = staticmethod(require_sound_particles)

    def __init__(
        self,
        scene: Scene,
        prior_map: Map | None = None,
        agent: str | None = None,
        seed: int = 0,
        same_frame: bool = False,
    ) -> None:
        require_scene(scene)
        require_known_clocks(scene, agent)
        scene.require_planar()
        super().__init__(scene, prior_map, agent, seed, same_frame)

    def _workspace(self) -> int:
        return self.seed

    def _checked(self, scan: Scan, after: float | None) -> Scan:
        require_paths(scan, self)
        return scan.checked(len(self.model.anchors), after)

    @staticmethod
    def moved(state: ImageState, position_m: Array, heading_rad: float) -> ImageState:
        """The state before the first step, with its prior about another start (m, rad)."""
        mean, _ = agent_moments(state.agent)
        off = np.array([*(np.asarray(position_m) - mean[:2]), 0.0, 0.0, heading_rad - mean[4]])
        return replace(state, agent=state.agent + off)

    def estimate(self, state: ImageState, scan: Scan, info: None, began: float) -> Estimate:
        """Means and covariances over particles."""
        mean, covariance = agent_moments(state.agent)
        table = feature_surfaces(state.features, self.model.anchor_positions)
        paths = feature_paths(state.features, mean, self.model.anchors)
        return Estimate(
            scan.step, scan.time_s, mean[:2], mean[2:4], float(mean[4]), covariance, table, paths,
            detected(table.existence, self.model.settings), float(len(state.agent)),
            time.perf_counter() - began,
        )  # fmt: skip

    def map(self) -> Map:
        """The map as it stands: surfaces of detected virtual anchors, and an unobserved grid."""
        table = feature_surfaces(self.state.features, self.model.anchor_positions)
        found = table.take(detected(table.existence, self.model.settings))
        return bare_map(self, found, np.full((len(found), BINS), 1 / BINS))
