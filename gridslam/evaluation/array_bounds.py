"""Posterior Cramer-Rao bounds of SLAM from samples of antenna arrays, with overlap priced in.

As `gridslam.evaluation.signal_bounds`, but of an agent with a heading, and of lines that all anchors share:
the information of a step is J^T Lambda J, with Lambda that of the whole snapshot about lengths and angles of
all paths; docs/model.md, (M87).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.evaluation.bounds import (
    JITTER_SHARE,
    Bound,
    agent_bound,
    agent_motion,
    agent_prior,
    estimable_covariance,
    predict_information,
)
from gridslam.evaluation.path_slopes import follow_hits, hit_surfaces, path_jacobian, surface_lines
from gridslam.inference.beliefs.layout import AGENT, HEADING
from gridslam.inference.messages.samples.array_likelihood import ArrayBand, composed, superpose_arrays
from gridslam.simulation.image_source import TruePaths, true_paths
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

DRAWS = 3
"""Of fading amplitudes, over which a bound is averaged."""
SURE_RAD = 1e-4
"""Deviation that counts for a heading that is measured exactly."""


def array_bound(
    scene: Scene, agent: str, known_map: bool, paths: TruePaths | None = None,
    track: Trajectory | None = None, draws: int | None = None, seed: int = 0,
) -> Bound:  # fmt: skip
    """Root mean square errors of position and heading that no filter on samples of arrays beats.

    A heading that is measured counts as known to its deviation at each step.

    Parameters
    ----------
    scene : Scene
        Samples signals.
    agent : str
    known_map : bool
        Whether the walls are known; else the surfaces are found on the way, with no prior on them.
    paths : TruePaths, optional
        What ``true_paths(scene, agent)`` gives, if it is at hand.
    track : Trajectory, optional
        Another way than the scene's, to which `paths` belong.
    draws, seed : int
        How many times phases and amplitudes are drawn (default: once; `DRAWS` times where they fade), and of
        which random numbers.
    """
    fades = scene.radio.fading == "swerling1"
    draws = (DRAWS if fades else 1) if draws is None else draws
    track = scene.track(agent) if track is None else track
    paths = true_paths(scene, agent, track) if paths is None else paths
    paths = paths.take(paths.of_walls)
    surface = hit_surfaces(scene, paths)
    jacobian = path_jacobian(scene, agent, paths, surface, track)
    jacobian = jacobian[:, :, :AGENT] if known_map else jacobian
    draw, squares = np.random.default_rng(seed), np.zeros((len(track), 2))
    for _ in range(draws):
        gain = np.exp(2j * np.pi * draw.random(len(paths)))
        if fades:
            gain *= np.sqrt(draw.exponential(size=len(paths)))
        gained = _gained(scene, agent, paths, jacobian, paths.amplitude * gain, len(track))
        squares += np.square(_recursion(scene, agent, paths, surface, gained, track))
    position, heading = np.sqrt(squares / draws).T
    return Bound(position, heading)


def _gained(
    scene: Scene, agent: str, paths: TruePaths, jacobian: Array, amplitude: NDArray[np.complex128], steps: int
) -> Array:
    """Information that each step's snapshots give, (N, state, state)."""
    waveform, size = scene.waveform(agent), jacobian.shape[2]
    gained = np.zeros((steps, size, size))
    if scene.agent(agent).heading_sensor_deg is not None:
        gained[:, HEADING, HEADING] = 1 / max(waveform.heading_std_rad, SURE_RAD) ** 2
    for anchor in range(len(scene.anchors)):
        band = ArrayBand.of(waveform, anchor)
        own = np.flatnonzero(paths.anchor == anchor)
        for step in np.unique(paths.step[own]):
            rows = own[paths.step[own] == step]
            place = np.column_stack([paths.distance_m[rows], paths.aod_rad[rows], paths.aoa_rad[rows]])
            information = snapshot_information(band, place, amplitude[rows], paths.amplitude[rows] ** 2)
            slope = jacobian[rows].reshape(-1, size)
            gained[step] += slope.T @ information @ slope
    return gained


def snapshot_information(
    band: ArrayBand, path: Array, amplitude: NDArray[np.complex128], power: Array
) -> Array:
    """What a snapshot tells of N paths (N, 3) of given amplitudes, over noise of power 1, (3 N, 3 N)."""
    samples = composed(band, path, amplitude)
    return superpose_arrays(band, samples, path, power, 1.0, amplitude).information


def _recursion(
    scene: Scene, agent: str, paths: TruePaths, surface: NDArray[np.intp], gained: Array, track: Trajectory
) -> Array:
    """Errors of position (m) and heading (rad) at each step, (N, 2), by the recursion of (M47)."""
    size = gained.shape[1]
    known_map, line = size == AGENT, surface_lines(scene)[surface]
    information = np.zeros((size, size))
    information[:AGENT, :AGENT] = agent_prior(scene, agent)
    count, jitter = (0, 0.0) if known_map else (len(surface), JITTER_SHARE * scene.filter.surface_m)
    feet, bounds = np.zeros(count), []
    for step in range(len(gained)):
        if step:
            motion = agent_motion(scene, track.time_s, step, count, jitter, feet)
            information = predict_information(information, *motion)
        information = information + gained[step]
        bounds.append(agent_bound(estimable_covariance(information)))
        if not known_map:
            follow_hits(feet, scene, paths.at(step), surface, line)
    return np.array(bounds)
