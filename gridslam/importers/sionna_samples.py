"""Samples of what Sionna RT traced: all paths, with their phases, at every antenna and frequency.

Unlike path measurements nothing is left out that a map of walls can't explain: scattered paths, of which a
tracer gives thousands, count by the power of their sum, and paths of any slope by how they are heard. What a
tracer lists twice counts once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.importers.raytracers import headings
from gridslam.importers.repeated_paths import repeated
from gridslam.importers.sionna import ANGLES, coefficients, numbers_of, require_seconds, require_whole
from gridslam.measurements.recording import Recording
from gridslam.world.geometry import wrap
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene
from gridslam.world.start import require_scene, require_seed
from gridslam.world.trajectory import Trajectory
from gridslam.world.waveform import Waveform

Complex = NDArray[np.complex128]
STREAM = 0x54
CHUNK = 2048
"""Paths whose responses are summed together."""


def recording_from_sionna(
    paths: Any,
    scene: Scene,
    heading_rad: ArrayLike,
    *,
    agent: str | None = None,
    seed: int = 0,
    truth: Trajectory | None = None,
) -> Recording:
    """Samples of the signals that the scene's radio would receive of what was traced, with its noise.

    Parameters
    ----------
    paths : sionna.rt.Paths, or a sequence of them
        Traced with one antenna at either end, isotropic and vertically polarised; its transmitters are the
        scene's anchors, in order, its receivers the agent, step by step.
    scene : Scene
        For frequencies, pulse, antenna elements and the SNR at 1 m; anchors' orientations.
    heading_rad : float or (N,) float, rad
        The agent's heading, which turns its elements.
    agent : str, optional
        Default: the first.
    seed : int
        Of the noise, and of the error of the measured heading, if the scene has a sensor.
    truth : Trajectory, optional
        For scoring, and for its times; default: the agent's interval from step to step.

    Returns
    -------
    Recording
        Noise has unit variance per sample, as of `gridslam simulate --signal`.

    Raises
    ------
    InputError
        Not such an object, no scene, several antennas at an end, numbers of devices that don't match, delays
        that can't be in seconds, a heading that is no number, or a truth that is no track of as many steps.

    Notes
    -----
    Phases are the tracer's, with those of the carrier over each length, so that steps hang together as they
    do in the world. Elements in a plane hear a path of elevation e as one of that azimuth, cos e times as
    far apart.
    """
    require_seed(seed)
    require_scene(scene)
    if not scene.agents:
        raise InputError(f"{scene.name}: agents", "none", "the agent whose elements and radio these are")
    body = scene.agents[0] if agent is None else scene.agent(agent)
    waveform = scene.waveform(body.name)
    several = list(paths) if isinstance(paths, Sequence) else [paths]
    if not several:
        raise InputError("paths", "none", "one Paths object or more")
    parts = [_Part(item, scene) for item in several]
    steps = sum(part.steps for part in parts)
    heading = headings(heading_rad, steps)
    if not isinstance(truth, Trajectory | None):
        raise InputError("truth", type(truth).__name__, "a Trajectory")
    if truth is not None and len(truth) != steps:
        raise InputError("truth", f"{len(truth)} steps", f"{steps}, as there are receivers")
    draw = np.random.default_rng([seed, scene.agents.index(body), STREAM])
    level = scene.signal_model().amplitude_at_1m * 4 * np.pi / waveform.wavelength_m
    samples, step = np.empty((steps, *waveform.shape), np.complex64), 0
    for part in parts:
        for row in range(part.steps):
            noise = draw.standard_normal((2, *waveform.shape)) * np.sqrt(0.5)
            total = noise[0] + 1j * noise[1]
            for anchor, turn in enumerate(scene.anchor_orientations):
                found = part.of(row, anchor, float(turn), float(heading[step]))
                total[anchor] += level * _sum(found, anchor, waveform)
            samples[step] = total
            step += 1
    measured = None
    if body.heading_sensor_deg is not None:
        measured = wrap(heading + waveform.heading_std_rad * draw.standard_normal(steps))
    time_s = np.arange(steps, dtype=np.float64) * body.interval_s
    if truth is not None:
        time_s = truth.time_s
    return Recording(
        samples=samples, time_s=time_s, heard=np.ones((steps, len(scene.anchors)), bool), waveform=waveform,
        anchors=scene.anchor_names, heading_rad=measured, anchor_position_m=scene.anchor_positions,
        anchor_orientation_rad=scene.anchor_orientations, truth=truth,
    )  # fmt: skip


class _Part:
    """One object of the tracer: coefficients and directions of all paths, (steps, anchors, paths)."""

    def __init__(self, paths: Any, scene: Scene) -> None:
        gain, anchors = coefficients(paths), len(scene.anchors)
        if gain.shape[1] != 1 or gain.shape[3] != 1:
            found = f"{gain.shape[1]} at receivers, {gain.shape[3]} at transmitters"
            raise InputError("paths: antennas", found, "one at either end; the scene's arrays do the rest")
        if gain.shape[2] != anchors:
            found = f"{gain.shape[2]}"
            raise InputError("paths: transmitters", found, f"{anchors}, as the scene has anchors")
        self.gain: Complex = gain[:, 0, :, 0]
        self.steps = len(self.gain)
        columns = {name: numbers_of(paths, name) for name in ("tau", "valid", *ANGLES)}
        for name, values in columns.items():
            one = values[:, 0, :, 0] if values.ndim == 5 else values
            if one.shape != self.gain.shape:
                raise InputError(f"paths: {name}", f"shape {values.shape}", f"{self.gain.shape}, as a")
            columns[name] = one
        valid = columns["valid"].astype(bool)
        require_seconds(columns["tau"][valid], scene)
        require_whole(columns | {"a": self.gain}, valid)
        delay_s = np.where(valid & (columns["tau"] > 0), columns["tau"], np.nan)
        again = repeated(delay_s, [columns[name] for name in ANGLES], np.abs(self.gain))
        self.there = np.isfinite(delay_s) & ~again
        self.columns = columns

    def of(self, step: int, anchor: int, turn: float, heading: float) -> tuple[Complex, Array, Array, Array]:
        """Coefficients and lengths (L,); elevated directions [angle, cosine] (L, 2) at anchor and agent."""
        rows = {name: values[step, anchor] for name, values in self.columns.items()}
        good = self.there[step, anchor]
        ends = [
            np.stack([rows[f"phi_{end}"] - own, np.sin(rows[f"theta_{end}"])], 1)[good]
            for end, own in (("t", turn), ("r", heading))
        ]
        return self.gain[step, anchor, good], SPEED_OF_LIGHT * rows["tau"][good], ends[0], ends[1]


def _sum(found: tuple[Complex, Array, Array, Array], anchor: int, waveform: Waveform) -> Complex:
    """Sum of the responses of paths, (A, B, M)."""
    gain, length, leaving, arriving = found
    total = np.zeros(waveform.shape[1:], np.complex128)
    for first in range(0, len(gain), CHUNK):
        rows = slice(first, first + CHUNK)
        carried = gain[rows] * np.exp(-2j * np.pi / waveform.wavelength_m * length[rows])
        ends = [
            _array_response(elements, way[rows], waveform.wavelength_m)
            for elements, way in (
                (waveform.anchor_element_m[anchor], leaving), (waveform.agent_element_m, arriving)
            )
        ]  # fmt: skip
        both = ends[0][:, :, None] * ends[1][:, None, :] * carried[:, None, None]
        spectra = waveform.delay_response(length[rows])
        total += (both.reshape(len(carried), -1).T @ spectra).reshape(total.shape)
    return total


def _array_response(elements: Array, way: Array, wavelength_m: float) -> Complex:
    """Response of elements (A, 2) to directions [angle, cosine of the elevation] (L, 2): (L, A), norm 1."""
    along = np.stack([np.cos(way[:, 0]), np.sin(way[:, 0])], 1) * way[:, 1:]
    response: Complex = np.exp(2j * np.pi / wavelength_m * along @ elements.T) / np.sqrt(len(elements))
    return response
