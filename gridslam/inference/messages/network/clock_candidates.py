"""An agent's paths, each of which may have caused any of its measurements; docs/model.md, (M103)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.network.clock_amplitudes import amplitude_ratio
from gridslam.inference.messages.path_prediction import predict_every_path
from gridslam.inference.scans.anchor_measurements import AnchorScan, whole_scan
from gridslam.inference.scans.deviations import deviations
from gridslam.inference.state.network.clock_search import CELL_M
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import lean, wrap
from gridslam.world.radio import REFLECTION_BINS, RadioModel
from gridslam.world.scan import Scan

TURN_DENSITY = 1 / (2 * np.pi)
ANY_DIRECTION = 2 * np.pi
"""Variance of an angle of residual 0 whose normal density is that of any angle at all."""
SURE_SURFACE = 0.9
"""Existence from which on a surface's single bounces tell of clocks, too."""


@dataclass(frozen=True)
class Candidates:
    """An agent's L paths, each of which may have caused any of its M measurements.

    Attributes
    ----------
    rays : Rays
    predicted, spread : (L, 3), (L, 3, 3)
        Distance (m), AoD and AoA (rad) of paths and their covariance, without the clocks that are sought.
    amplitude, steep : (L,)
        As expected; cosine of a path's elevation.
    chance : (L,)
        ``e p_d`` of (M103): that it is there and detected.
    ratio : (L, M)
        ``r`` of (M103), see `amplitude_ratio`.
    scan : AnchorScan
    radio : RadioModel
    """

    rays: Rays
    predicted: Array
    spread: Array
    amplitude: Array
    steep: Array
    chance: Array
    ratio: Array
    scan: AnchorScan
    radio: RadioModel

    @classmethod
    def of(cls, bare: State, scan: Scan, model: FilterModel, work: Workspace) -> Self:
        """All paths of an agent's view without the clocks that are sought, and what the agent measured."""
        radio, measured = model.radio, work.once(whole_scan, scan, model)
        paths = predict_every_path(bare, model, work=work)
        rays, prediction = paths.rays, paths.prediction
        strength = np.append(bare.surfaces.reflection @ REFLECTION_BINS, 1.0)[rays.last]
        amplitude = radio.amplitude(prediction.length, strength)
        chance = rays.existence * rays.surfaces * radio.detection_probability(amplitude)
        steep = lean(prediction.length, np.asarray(model.anchor_heights)[rays.anchor])
        ratio = amplitude_ratio(measured.amplitude, amplitude, radio)
        return cls(
            rays, prediction.value, prediction.spread, amplitude, steep, chance, ratio, measured, radio
        )

    def telling(self, witnessed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which paths, (L,), tell of their clocks: lines of sight, and single bounces over sure surfaces."""
        rays = self.rays
        over_sure = (rays.surfaces > SURE_SURFACE) & np.append(witnessed, True)[rays.last]
        return (rays.bounces == 0) | ((rays.bounces == 1) & over_sure)

    def able(self, chosen: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Whether measurements may be of the anchors of chosen paths, (K, M)."""
        return may_be_of(self.scan.label, self.rays.anchor[chosen])

    def std(self, chosen: NDArray[np.intp]) -> Array:
        """Deviations of measurements, were they of chosen paths, (K, M, 3)."""
        angles = self.predicted[chosen, 1:]
        return all_deviations(self.scan, self.amplitude[chosen], angles, self.steep[chosen], self.radio)

    def shares(self, chosen: NDArray[np.intp], density: Array) -> Array:
        """``e p_d r`` times a density of measurements by chosen paths; 0 if not of their anchor, (K, M)."""
        return np.where(self.able(chosen), self.chance[chosen, None] * self.ratio[chosen] * density, 0.0)


def one_per_anchor(rays: Rays, anchors: int) -> NDArray[np.intp] | None:
    """Each anchor's line of sight among the paths, (J,); None if one isn't listed."""
    direct = np.flatnonzero(rays.bounces == 0)
    return direct[np.argsort(rays.anchor[direct])] if len(direct) == anchors else None


def may_be_of(label: NDArray[np.integer[Any]], sender: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
    """Whether measurements of these labels, -1 if not known, may be of each sender, (K, M)."""
    return np.asarray((label < 0) | (label == sender[:, None]))


def joint_density(predicted: Array, spread: Array, measured: Array, std: Array) -> Array:
    """Density of measurements (M, 3) over distance and both angles, had one of L paths caused them, (L, M).

    Parameters
    ----------
    predicted, spread, measured, std
        As of `clock_evidence`; 0 where no distance was measured.
    """
    known = np.isfinite(measured[:, 0])
    density = np.zeros((len(predicted), len(measured)))
    shift, variance, weight = given_angles(predicted, spread, measured[known], std[:, known])
    density[:, known] = weight * np.exp(-0.5 * shift**2 / variance) / np.sqrt(2 * np.pi * variance)
    return density


def density_over_offsets(given: tuple[Array, Array, Array], mass: Array, centre: Array) -> Array:
    """Density of measurements by paths whose clock's offset has a mass (L, C) over cells, (L, M)."""
    shift, variance, weight = given
    normal = np.exp(-0.5 * (centre - shift[..., None]) ** 2 / variance[..., None])
    return np.asarray(
        weight * (normal * mass[:, None]).sum(-1) / np.sqrt(2 * np.pi * (variance + CELL_M**2 / 12))
    )


def given_angles(value: Array, own: Array, measured: Array, deviation: Array) -> tuple[Array, Array, Array]:
    """Distance left over given the angles, its variance, and the angles' density, (L, M) each."""
    residual = measured - value[:, None]
    residual[..., 1:] = wrap(residual[..., 1:])
    missing = ~(np.isfinite(measured[:, 1:]) & np.isfinite(deviation[..., 1:]))
    turn, twist = np.where(missing, 0.0, residual[..., 1:]).transpose(2, 0, 1)
    noise = np.square(deviation)
    # joint covariance of the distance, one angle and the other; an angle without measurement has its own
    one = np.where(missing[..., 0], ANY_DIRECTION, own[:, 1, 1, None] + noise[..., 1])
    other = np.where(missing[..., 1], ANY_DIRECTION, own[:, 2, 2, None] + noise[..., 2])
    both = np.where(missing.any(-1), 0.0, own[:, 1, 2, None])
    near = np.where(missing[..., 0], 0.0, own[:, 0, 1, None])
    far = np.where(missing[..., 1], 0.0, own[:, 0, 2, None])
    size = one * other - both**2
    first, last = (near * other - far * both) / size, (far * one - near * both) / size
    shift = first * turn + last * twist
    variance = own[:, 0, 0, None] + noise[..., 0] - first * near - last * far
    exponent = (turn**2 * other - 2 * turn * twist * both + twist**2 * one) / size
    weight = TURN_DENSITY * np.exp(-0.5 * exponent) / np.sqrt(size)
    return residual[..., 0] - shift, variance, weight


def by_anchor(value: Array, sender: NDArray[np.integer[Any]], anchors: int) -> Array:
    """Sums (J, ...) of the rows of each anchor's paths."""
    return np.array([value[sender == anchor].sum(0) for anchor in range(anchors)])


def all_deviations(
    scan: AnchorScan, amplitude: Array, angles: Array, steep: Array, radio: RadioModel
) -> Array:
    """Deviations (L, M, 3) of all measurements, if paths of these amplitudes and angles caused them."""
    paths, count = len(amplitude), len(scan)
    every, each = np.tile(np.arange(count), paths), np.repeat(np.arange(paths), count)
    return deviations(scan, every, amplitude[each], angles[each], radio, steep[each]).reshape(paths, count, 3)
