"""Part of a segment of one anchor, and what of it features leave unexplained; docs/model.md, (M132)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.feature_likelihood import Front, Tables
from gridslam.inference.messages.features.sight import feature_table
from gridslam.inference.state.features.hybrid_state import JointBelief, Segment
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
LEAST_M = 0.1
"""Shorter ways are taken to be as long as this."""
SURE_SIGHT = 1e3
"""Power of a line of sight, in units of what it is, that takes it out of the samples altogether."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """What one anchor sent during a part of a segment, and where the agent was.

    Attributes
    ----------
    points : (K, 4)
        x, y, heading, noise power of each step.
    samples : (K, N, M) complex128
    anchor_m : (2,)
    unit : float
        Power of the line of sight.
    front : Front
    steps : (K,) int32
        Which table each point takes.
    tables : (K or more, N, T, 4) float32
        Matched outputs of samples.
    """

    points: Array
    samples: Complex
    anchor_m: Array
    unit: float
    front: Front
    steps: NDArray[np.int32]
    tables: Tables

    @property
    def centre(self) -> Array:
        """Where the agent was half-way, (2,) m."""
        middle: Array = self.points[len(self.points) // 2, :2]
        return middle

    def rest(self, table: Array) -> Complex:
        """What line of sight and features (D, 4) leave of the samples, (K, N, M)."""
        wave, points = self.front.waveform, self.points
        place = np.concatenate([[[*self.anchor_m, 0.0, SURE_SIGHT * self.unit]], table])
        way = place[:, :2] - points[:, None, :2]
        far = np.maximum(np.hypot(way[..., 0], way[..., 1]), LEAST_M)
        length = far + place[:, 2]
        angle = np.arctan2(way[..., 1], way[..., 0]) - points[:, 2:3]
        turned = np.stack([np.cos(angle), np.sin(angle)], -1) @ self.front.element.T  # (K, C, N)
        antennas = np.exp(1j * np.moveaxis(turned, -1, 1)) * np.sqrt(place[:, 3])
        spectrum = wave.pulse[:, None] * phasors(-length, wave.offset_hz) / length[:, None]
        upright, across = antennas.conj().swapaxes(1, 2), spectrum.conj().swapaxes(1, 2)
        small = (upright @ antennas) * (across @ spectrum)
        noise = points[:, 3]
        small[:, np.arange(len(place)), np.arange(len(place))] += noise[:, None]
        matched = ((across @ self.samples.swapaxes(1, 2)) * upright).sum(-1)
        amplitude = np.linalg.solve(small, matched[..., None])[..., 0]
        return self.samples - (antennas * amplitude[:, None]) @ spectrum.swapaxes(1, 2)

    def unexplained(self, table: Array) -> Tables:
        """Matched outputs of ``C^-1 P z`` under features (D, 4), (K, T, N, 2)."""
        return self._matched(self.rest(table))

    def quieter(self, table: Array) -> tuple[Stretch, Tables]:
        """The stretch with the noise's power that features (D, 4) leave, and what is unexplained then."""
        rest = self.rest(table)
        free = rest[0].size - 1 - len(table)
        noise = float((np.abs(rest) ** 2).sum() / (len(rest) * free))
        points = self.points.copy()
        points[:, 3] = noise
        quiet = replace(self, points=points)
        return quiet, quiet._matched(rest)

    def _matched(self, rest: Complex) -> Tables:
        """Matched outputs of what is left of the samples, in units of the noise."""
        return self.front.coarse(rest / self.points[:, 3, None, None])


def phasors(length: Array, offset_hz: Array) -> Complex:
    """``exp(j 2 pi f d / c)`` of lengths (K, C) at evenly spaced frequencies, (K, M, C)."""
    rate, many = 2 * np.pi / SPEED_OF_LIGHT * offset_hz, len(offset_hz)
    part = int(np.ceil(np.sqrt(many)))  # of every so many the phase, and that of so many beyond
    coarse = np.exp(1j * length[:, None] * rate[::part, None])
    fine = np.exp(1j * length[:, None] * (rate[:part] - rate[0])[:, None])
    whole = coarse[:, :, None] * fine[:, None]
    return whole.reshape(len(length), -1, length.shape[1])[:, :many]


def stretch_of(
    belief: JointBelief, segment: Segment, anchor: int, judged: int, front: Front, model: SignalModel,
    tables: Tables | None = None,
) -> tuple[Stretch, Tables]:  # fmt: skip
    """A segment of an anchor but for its last steps, with the noise that what a belief holds leaves.

    And what is unexplained then, (K, T, N, 2).

    Parameters
    ----------
    tables : (K, N, T, 4) float32, optional
        Matched outputs of this anchor's samples at all steps, if they are known.
    """
    used = np.flatnonzero(segment.heard[: len(segment) - judged, anchor])
    noise = np.full(len(used), belief.noise[anchor])
    points = np.column_stack([segment.agent[used, :2], segment.heading_rad[used], noise])
    power = float(belief.los_power[anchor])
    samples, anchor_m = segment.samples[used, anchor], model.anchors[anchor, :2].copy()
    steps = used.astype(np.int32)
    if tables is None:
        steps, tables = np.arange(len(used), dtype=np.int32), front.tables(samples)
    raw = Stretch(points, samples, anchor_m, power, front, steps, tables)
    return raw.quieter(feature_table(belief, anchor))
