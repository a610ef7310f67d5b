"""A line of sight that comes back while nobody knows well where the agent is; docs/model.md, (M377).

Where the agent is only known to more than a pulse's length, its line of sight isn't heard at the predicted
place, and stays unseen or is taken for a feature. So it is looked for wherever the agent may be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.path_products import LEAST_M, paths_at
from gridslam.inference.messages.features.presence import after_a_step, predicted
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
UNSURE_M = 0.15
"""Deviation of the agent's place from which on it is looked for."""
LEAST_NATS = 3.0
"""Nats by which samples have to speak for a sight somewhere."""
REACH, MOST = 3.0, 41
"""Deviations about the prediction that are searched, and places along either axis at most."""


def regained(
    belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float, model: SignalModel
) -> Array:
    """Where to begin to look for the maximum: the joint mean (n,), or that given where a sight is heard.

    Parameters
    ----------
    belief : JointBelief
        As predicted.
    samples : (J, N, M)
    """
    spread = belief.agent_covariance[:2, :2]
    size, axes = np.linalg.eigh(spread)
    before = after_a_step(belief.existence)
    lost = np.flatnonzero(audible & (before < 0.5))
    if not len(lost) or size[-1] < UNSURE_M**2:
        return belief.mean
    steps = np.sqrt(np.maximum(size, 0))
    ways = [np.linspace(-REACH, REACH, _places(one)) for one in steps]
    grid = np.stack(np.meshgrid(*ways, indexing="ij"), -1).reshape(-1, 2)
    shift = (grid * steps) @ axes.T
    weight = -0.5 * (grid**2).sum(1)
    weight -= np.logaddexp.reduce(weight)
    total = weight.copy()
    for j in lost:
        gain = _gains(belief, samples[j], int(j), shift, heading_rad, model)
        total += np.logaddexp(np.log(before[j]) + gain, np.log1p(-before[j]))
    if np.logaddexp.reduce(total) < LEAST_NATS:
        return belief.mean
    best = shift[np.argmax(total)]
    moved: Array = belief.mean + belief.covariance[:, :2] @ np.linalg.solve(spread, best)
    return moved


def _places(deviation_m: float) -> int:
    """How many places along an axis, an odd number: closer than half of what a pulse tells apart."""
    return min(2 * int(np.ceil(REACH * deviation_m / UNSURE_M)) + 1, MOST)


def _gains(
    belief: JointBelief, samples: Complex, anchor: int, shift: Array, heading_rad: float, model: SignalModel
) -> Array:
    """Nats that a line of sight to each of the places (Q, 2) about the predicted one brings, (Q,)."""
    paths = paths_at(belief.mean, belief, anchor, heading_rad, model)
    known = predicted(belief)[paths.rows] > 0.5
    length, angle = paths.numbers.reshape(2, -1)[:, 1:][:, known]
    noise, power = belief.noise[anchor], belief.features.power[paths.rows]
    response = responses(length, angle, model)  # (n, N M)
    root = np.sqrt(power[known])[:, None] * response
    small = noise * np.eye(len(root)) + root.conj() @ root.T
    rest = samples.ravel() - root.T @ np.linalg.solve(small, root.conj() @ samples.ravel())
    way = model.anchors[anchor, :2] - belief.mean[:2] - shift
    far = np.maximum(np.hypot(*way.T), LEAST_M)
    tried = responses(far, np.arctan2(way[:, 1], way[:, 0]) - heading_rad, model)
    level = belief.los_power[anchor]
    match = np.abs(tried.conj() @ rest) ** 2 / noise**2
    over = 1 + level * len(model.waveform.agent_element_m) / far**2 / noise
    gain: Array = level * match / over - np.log(over)
    return gain


def responses(length: Array, angle: Array, model: SignalModel) -> Complex:
    """Responses of paths (n, N M), (M121)."""
    antennas, spectrum = steering(angle, model), spectra(length, model)
    size = antennas.shape[1] * spectrum.shape[1]
    both: Complex = (antennas[:, :, None] * spectrum[:, None, :]).reshape(len(length), size)
    return both


def steering(angle: Array, model: SignalModel) -> Complex:
    """What antennas make of angles (n,): (n, N)."""
    element = 2 * np.pi / model.waveform.wavelength_m * model.waveform.agent_element_m
    found: Complex = np.exp(1j * np.stack([np.cos(angle), np.sin(angle)], -1) @ element.T)
    return found


def spectra(length: Array, model: SignalModel) -> Complex:
    """What is received over lengths (n,) m at each frequency: (n, M)."""
    rate = 2 * np.pi / SPEED_OF_LIGHT * model.waveform.offset_hz
    found: Complex = model.waveform.pulse * np.exp(-1j * np.outer(length, rate)) / length[:, None]
    return found
