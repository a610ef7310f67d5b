"""Posterior Cramer-Rao bounds: what no filter can beat on average (Tichavsky's recursion)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import mirror
from gridslam.scene import Scene
from gridslam.simulate import TruePaths, true_paths

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bound:
    """Root mean square errors that can't be beaten.

    Attributes
    ----------
    position_m : (N,) m
    heading_rad : (N,) rad
    """

    position_m: Array
    heading_rad: Array


def known_map_bound(scene: Scene, agent: str, paths: TruePaths | None = None) -> Bound:
    """Bound of an agent that knows the walls and which measurement is which path.

    The information of every visible path is weighted by its detection probability. The amplitude's own
    information about the position is left out: it is below a thousandth of that of the distance.
    """
    paths = true_paths(scene, agent) if paths is None else paths
    track, signal, body = scene.track(agent), scene.signal_model(agent), scene.agent(agent)
    information = np.zeros((len(track), 5, 5))
    rows = path_information(scene, agent, paths)
    np.add.at(information, paths.step, rows * signal.detection_probability(paths.amplitude)[:, None, None])

    half = np.array(
        [body.prior.position_m] * 2 + [body.prior.velocity_mps] * 2 + [np.radians(body.prior.heading_deg)]
    )
    variance = np.maximum(half, 1e-4) ** 2 / 3
    variance[2:4] += (
        body.step_m / body.interval_s
    ) ** 2  # the track starts at speed; the prior's centre is rest
    covariance = np.diag(variance)
    position, heading = np.zeros(len(track)), np.zeros(len(track))
    for step in range(len(track)):
        if step:
            dt = track.time_s[step] - track.time_s[step - 1]
            forward, noise = np.eye(5), np.zeros((5, 5))
            forward[0, 2] = forward[1, 3] = dt
            push = np.array([0.5 * dt**2, dt])
            for axis in range(2):
                entry = np.array([axis, axis + 2])
                noise[np.ix_(entry, entry)] = scene.filter.acceleration_mps2**2 * np.outer(push, push)
            noise[4, 4] = np.radians(scene.filter.heading_deg) ** 2
            covariance = forward @ covariance @ forward.T + noise
        covariance = np.linalg.inv(np.linalg.inv(covariance + 1e-12 * np.eye(5)) + information[step])
        position[step] = np.sqrt(covariance[0, 0] + covariance[1, 1])
        heading[step] = np.sqrt(covariance[4, 4])
    return Bound(position, heading)


def path_information(scene: Scene, agent: str, paths: TruePaths) -> Array:
    """Fisher information of each detected path about [x, y, vx, vy, heading], (L, 5, 5)."""
    signal, walls, track = scene.signal_model(agent), scene.segments(), scene.track(agent)
    lines = walls.line if len(walls) else np.zeros((1, 2))
    first, last = paths.segment[:, 0], np.where(paths.bounces == 2, paths.segment[:, 1], paths.segment[:, 0])
    anchor = scene.anchor_positions[paths.anchor]
    image = np.where((paths.bounces == 2)[:, None], mirror(lines[first], anchor), anchor)
    image = np.where((paths.bounces >= 1)[:, None], mirror(lines[last], image), image)
    away = track.position_m[paths.step] - image
    toward = -away / np.linalg.norm(away, axis=1, keepdims=True)
    across = np.stack([-toward[:, 1], toward[:, 0]], -1) / paths.distance_m[:, None]
    jacobian = np.zeros((len(paths), 3, 5))
    jacobian[:, 0, :2] = -toward
    jacobian[:, 1, :2] = np.where((paths.bounces == 1)[:, None], across, -across)
    jacobian[:, 2, :2] = -across
    jacobian[:, 2, 4] = -1
    std = np.stack(
        [
            signal.distance_std(paths.amplitude),
            signal.angle_std(paths.amplitude, paths.aod_rad, signal.anchor_aperture[paths.anchor]),
            signal.angle_std(paths.amplitude, paths.aoa_rad, signal.agent_aperture),
        ],
        -1,
    )
    measured = [quantity in signal.measures for quantity in ("distance", "aod", "aoa")]
    scaled = jacobian / np.where(measured, std, np.inf)[:, :, None]
    return np.einsum("lai,laj->lij", scaled, scaled)
