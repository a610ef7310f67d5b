"""What an agent would receive, as samples: a sum of exact paths, and noise.

docs/model.md, section 11. Every path's amplitude is that of path measurements: the square root of its SNR
over all samples of its anchor. Noise has unit variance per sample; no filter is told so.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.measurements.recording import Recording
from gridslam.measurements.simulated import Simulated
from gridslam.simulation.image_source import TruePaths, true_paths
from gridslam.simulation.scattering import dense_tail
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene
from gridslam.world.start import require_seed
from gridslam.world.trajectory import Trajectory
from gridslam.world.waveform import Waveform

STREAM = 0x53
MOST_SAMPLES = 2**27
"""Of a recording, 1 GiB in single precision."""


def simulate_samples(scene: Scene, agent: str, seed: int = 0) -> Recording:
    """Samples that an agent would receive on its track, of the signals that `Radio.frequencies` says.

    Raises
    ------
    InputError
        The scene says no frequencies, there is no such agent, or more samples than fit into memory.
    """
    return received_along(scene, agent, scene.track(agent), true_paths(scene, agent), seed)


def received_along(scene: Scene, agent: str, track: Trajectory, paths: TruePaths, seed: int = 0) -> Recording:
    """As `simulate_samples`, of any track and of paths that were traced (or made up) before."""
    require_seed(seed)
    waveform, body = scene.waveform(agent), scene.agent(agent)
    if len(track) * np.prod(waveform.shape) > MOST_SAMPLES:
        found = f"{len(track) * np.prod(waveform.shape):.3g} samples"
        raise InputError(f"{scene.name}: radio.frequencies", found, f"at most {MOST_SAMPLES:.3g} in all")
    draw = np.random.default_rng([seed, scene.agents.index(body), STREAM])
    # a path's phase turns many times between two steps, so it is drawn anew at each
    gain = np.exp(2j * np.pi * draw.uniform(size=len(paths)))
    if scene.radio.fading == "swerling1":
        gain *= np.sqrt(draw.exponential(size=len(paths)))
    samples = np.empty((len(track), *waveform.shape), np.complex64)
    for step in range(len(track)):
        noise = draw.standard_normal((2, *waveform.shape)) * np.sqrt(0.5)
        samples[step] = noise[0] + 1j * noise[1] + superposed(paths, paths.step == step, gain, waveform)
        samples[step] += dense_tail(scene, agent, track.position_m[step], waveform, draw)
    heading = None
    if body.heading_sensor_deg is not None:
        error = waveform.heading_std_rad * draw.standard_normal(len(track))
        heading = wrap(track.heading_rad + error)
    return Recording(
        samples=samples, time_s=track.time_s, heard=np.ones((len(track), len(scene.anchors)), bool),
        waveform=waveform, anchors=scene.anchor_names, heading_rad=heading,
        anchor_position_m=scene.anchor_positions, anchor_orientation_rad=scene.anchor_orientations,
        truth=track, simulated=Simulated(scene.name, (agent,), seed),
    )  # fmt: skip


def superposed(
    paths: TruePaths, rows: NDArray[np.bool_], gain: NDArray[np.complex128], waveform: Waveform
) -> NDArray[np.complex128]:
    """Sum of the responses of the paths in `rows` (L,) times amplitude and gain (L,), (J, A, B, M); (M51)."""
    total = np.zeros(waveform.shape, np.complex128)
    for anchor in np.unique(paths.anchor[rows]):
        here = rows & (paths.anchor == anchor)
        delay = waveform.delay_response(paths.distance_m[here])
        delay = (gain[here] * paths.amplitude[here])[:, None] * delay
        leaving = waveform.anchor_response(anchor, paths.aod_rad[here])
        arriving = waveform.agent_response(paths.aoa_rad[here])
        total[anchor] = np.einsum("la,lb,lm->abm", leaving, arriving, delay, optimize=True)
    return total
