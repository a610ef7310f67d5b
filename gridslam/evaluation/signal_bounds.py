"""Posterior Cramer-Rao bounds of SLAM from sampled signals, in which overlapping paths cost what they cost.

As `gridslam.evaluation.bounds`, [Tichavsky1998pcrb], but the information of a step is that of the whole
snapshot about all distances at once, (M76): a path tells little next to another one within the resolution.
The state is [x, y, vx, vy] and the anchors' images, two entries each; docs/model.md, (M87). Amplitudes fade,
so a bound is the root mean square over several draws of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.evaluation.bounds import Bound, agent_prior, predict_information
from gridslam.inference.messages.samples.signal_likelihood import Band, superpose
from gridslam.simulation.image_source import TruePaths, true_paths
from gridslam.world.geometry import mirror
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

MOVING = 4
"""Entries of the agent's state: single antennas tell no heading."""
DRAWS = 3
"""Of fading amplitudes, over which a scene's bound is averaged."""
FREE_M = 100.0
"""Prior deviation of an image's coordinates where the map is unknown."""


def has_single_antennas(scene: Scene, agent: str) -> bool:
    """Whether a scene's radio samples signals, of one element at either end: they tell no heading."""
    if scene.radio.frequencies is None:
        return False
    _, at_anchor, at_agent, _ = scene.waveform(agent).shape
    return at_anchor * at_agent == 1


def scene_signal_bound(
    scene: Scene,
    agent: str,
    known_map: bool,
    paths: TruePaths | None = None,
    track: Trajectory | None = None,
) -> Bound:
    """Bound of a scene's own radio: `signal_bound` over `DRAWS`; nothing bounds the heading.

    Parameters
    ----------
    scene : Scene
        Samples signals of single antennas, see `has_single_antennas`.
    agent, known_map, paths, track
        As there.
    """
    waveform, fading = scene.waveform(agent), scene.radio.fading == "swerling1"
    band = Band.of(waveform.offset_hz, waveform.pulse)
    position = signal_bound(scene, agent, band, known_map, paths, track, DRAWS, fading=fading)
    return Bound(position, np.full(len(position), np.nan))


def signal_bound(
    scene: Scene,
    agent: str,
    band: Band,
    known_map: bool = False,
    paths: TruePaths | None = None,
    track: Trajectory | None = None,
    draws: int = 1,
    seed: int = 0,
    fading: bool = True,
) -> Array:
    """Root mean square error of the position that no filter on samples beats, (N,) m.

    Parameters
    ----------
    scene : Scene
        Paths of up to one bounce; one element at both ends.
    agent : str
    band : Band
    known_map : bool
        Whether the images are known; else each has a prior of 100 m.
    paths : TruePaths, optional
        What ``true_paths(scene, agent)`` gives, if it is at hand.
    track : Trajectory, optional
        Another way than the scene's, to which `paths` belong.
    draws, seed : int
        How many times amplitudes are drawn, and of which random numbers.
    fading : bool
        Swerling 1; else amplitudes are steady, with random phases.
    """
    track = scene.track(agent) if track is None else track
    paths = true_paths(scene, agent, track) if paths is None else paths
    paths = paths.take(paths.of_walls)
    rng = np.random.default_rng(seed)
    square = np.zeros(len(track))
    for _ in range(draws):
        phase = np.exp(2j * np.pi * rng.random(len(paths)))
        size = np.sqrt(rng.exponential(size=len(paths))) if fading else 1.0
        square += _bound(scene, agent, band, paths, paths.amplitude * phase * size, track, known_map)
    return np.asarray(np.sqrt(square / draws))


def _bound(
    scene: Scene, agent: str, band: Band, paths: TruePaths, amplitude: NDArray[np.complex128],
    track: Trajectory, known_map: bool,
) -> Array:  # fmt: skip
    """Mean square error of the position, (N,) m^2, for given amplitudes (L,)."""
    place, slot, count = _images(scene, paths)
    size = MOVING + (0 if known_map else 2 * count)
    information = np.eye(size) / FREE_M**2
    information[:MOVING, :MOVING] = agent_prior(scene, agent)[:MOVING, :MOVING]
    bounds = np.empty(len(track))
    for step in range(len(track)):
        if step:
            dt = float(track.time_s[step] - track.time_s[step - 1])
            information = predict_information(information, *_motion(scene, dt, size))
        for anchor in range(len(scene.anchors)):
            rows = np.flatnonzero((paths.step == step) & (paths.anchor == anchor))
            if not len(rows):
                continue
            away = track.position_m[step] - place[rows]
            distance = np.linalg.norm(away, axis=-1)
            slope = np.zeros((len(rows), size))
            slope[:, :2] = away / distance[:, None]
            moves = np.flatnonzero((slot[rows] >= 0) & (not known_map))
            for side in range(2):
                slope[moves, MOVING + 2 * slot[rows[moves]] + side] = -slope[moves, side]
            gained = distance_information(band, distance, amplitude[rows], paths.amplitude[rows] ** 2)
            information = information + slope.T @ gained @ slope
        # the block of the position alone
        own = information[:2, :2] - information[:2, 2:] @ np.linalg.solve(
            information[2:, 2:], information[2:, :2]
        )
        bounds[step] = np.trace(np.linalg.inv(own))
    return bounds


def distance_information(
    band: Band, distance: Array, amplitude: NDArray[np.complex128], power: Array, noise: float = 1.0
) -> Array:
    """What a snapshot tells of the distances of N paths of given amplitudes, (N, N) 1/m^2 (M76)."""
    samples = amplitude @ band.response(distance)
    paths = superpose(band, samples, distance, power, noise)
    # `superpose` shrinks the amplitudes towards 0: here they are the true ones
    scale = amplitude / np.where(np.abs(paths.amplitude) > 0, paths.amplitude, 1.0)
    return np.asarray((np.conj(scale)[:, None] * paths.whole_information * scale).real)


def _images(scene: Scene, paths: TruePaths) -> tuple[Array, NDArray[np.intp], int]:
    """Whence each path seems to come (L, 2) m; the number of that image, -1 for anchors (L,); how many."""
    place = scene.anchor_positions[paths.anchor].astype(np.float64)
    slot = np.full(len(paths), -1)
    single = np.flatnonzero(paths.bounces == 1)
    if not len(single):
        return place, slot, 0
    walls = scene.segments()
    piece = paths.segment[single, 0]
    place[single] = mirror(walls.line[piece], place[single])
    key = np.stack([paths.anchor[single], walls.surface[piece]], -1)
    _, number = np.unique(key, axis=0, return_inverse=True)
    slot[single] = number.reshape(-1)
    return place, slot, int(slot.max()) + 1


def _motion(scene: Scene, dt: float, size: int) -> tuple[Array, Array, Array]:
    """Inverse transition, noise inputs and their variances (see `predict_information`)."""
    backward, push = np.eye(size), np.zeros((size, 2))
    backward[0, 2] = backward[1, 3] = -dt
    push[[0, 1], [0, 1]], push[[2, 3], [0, 1]] = 0.5 * dt**2, dt
    return backward, push, np.full(2, scene.filter.acceleration_mps2**2)
