"""Rays: every path that a set of surfaces could make to one anchor, and what the measurements say of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import PathGeometry, trace, wrap
from gridslam.inference.belief import AGENT, Belief, slots
from gridslam.inference.surfaces import Bank
from gridslam.measurements import Scan
from gridslam.signal import REFLECTION_BINS, SignalModel

Array = NDArray[np.float64]
P_STAY, P_APPEAR = 0.95, 0.005
"""A ray that exists stays so for a step; one that doesn't appears (model.md, section 2.6 (a))."""
OTHER_MATERIAL = 0.05
"""Share of the belief that a wall is of another material where it is hit next."""
GATE = 6.0


@dataclass(frozen=True)
class Rays:
    """Paths of one anchor: line of sight first, then single, then double bounces.

    Attributes
    ----------
    bounces, last, first : (L,) int
        Number of bounces; surfaces hit last and first (-1 for none).
    existence : (L,) float64
        Predicted existence q' of the ray alone.
    surfaces : (L,) float64
        Product of the existences of the surfaces involved.
    """

    bounces: NDArray[np.intp]
    last: NDArray[np.intp]
    first: NDArray[np.intp]
    existence: Array
    surfaces: Array

    def __len__(self) -> int:
        return len(self.bounces)


def rays_of(bank: Bank, sight: Array, anchor: int, most_bounces: int) -> Rays:
    """All paths worth a look from `anchor`; `sight` (J,) is the existence of the line of sight."""
    count = len(bank)
    own = np.arange(count)
    strong = np.flatnonzero(bank.existence > 0.3)
    last, first = (a.ravel() for a in np.meshgrid(strong, strong, indexing="ij"))
    other = last != first
    last, first = last[other], first[other]
    if most_bounces < 2:
        last = first = last[:0]
    bounces = np.repeat([0, 1, 2], [1, count, len(last)])
    memory = np.concatenate([[sight[anchor]], bank.single[anchor], bank.double[anchor, last, first]])
    settled = P_APPEAR / (1 - P_STAY + P_APPEAR)
    memory = settled + (memory - settled) * (P_STAY - P_APPEAR)
    product = np.concatenate([[1.0], bank.existence, bank.existence[last] * bank.existence[first]])
    return Rays(
        bounces,
        np.concatenate([[-1], own, last]).astype(np.intp),
        np.concatenate([[-1], own, first]).astype(np.intp),
        memory,
        product,
    )


def sample_traces(rays: Rays, states: Array, anchor: Array) -> PathGeometry:
    """Trace every ray at every sampled state (R, N); rows run [ray, sample]."""
    samples = len(states)
    lines = states[:, AGENT:].reshape(samples, -1, 2)
    if lines.shape[1] == 0:
        lines = np.zeros((samples, 1, 2))
    last = np.maximum(rays.last, 0)
    first = np.maximum(rays.first, 0)
    count = len(rays)
    return trace(
        np.tile(states[:, :2], (count, 1)),
        np.broadcast_to(anchor, (count * samples, 2)),
        np.swapaxes(lines, 0, 1)[last].reshape(-1, 2),
        np.swapaxes(lines, 0, 1)[first].reshape(-1, 2),
        np.repeat(rays.bounces, samples),
    )


@dataclass(frozen=True)
class Prediction:
    """Predicted parameters of paths at the mean of the belief.

    Attributes
    ----------
    value : (L, 3)
        Distance (m), AoD and AoA relative to anchor and heading (rad).
    jacobian : (L, 3, N)
        Derivative by the joint state.
    spread : (L, 3, 3)
        Covariance from the belief alone.
    geometry : PathGeometry
    """

    value: Array
    jacobian: Array
    spread: Array
    geometry: PathGeometry


def predict_paths(
    rays: Rays, rows: NDArray[np.intp], belief: Belief, anchor: Array, facing: float
) -> Prediction:
    """Predict the paths `rows` of `rays` at the mean of the belief."""
    lines = belief.lines if len(belief.lines) else np.zeros((1, 2))
    last, first, bounces = rays.last[rows], rays.first[rows], rays.bounces[rows]
    geometry = trace(
        np.broadcast_to(belief.mean[:2], (len(rows), 2)),
        np.broadcast_to(anchor, (len(rows), 2)),
        lines[np.maximum(last, 0)],
        lines[np.maximum(first, 0)],
        bounces,
    )
    value = np.stack(
        [geometry.distance, wrap(geometry.departure - facing), wrap(geometry.arrival - belief.mean[4])], -1
    )
    jacobian = np.zeros((len(rows), 3, len(belief.mean)))
    jacobian[:, :, [0, 1, 4]] = geometry.jacobian[:, :, :3]
    for kind, surface, columns in ((bounces > 0, last, slice(3, 5)), (bounces == 2, first, slice(5, 7))):
        chosen = np.flatnonzero(kind)
        place = slots(surface[chosen])
        for side in range(2):
            jacobian[chosen, :, place[:, side]] += geometry.jacobian[chosen, :, columns][:, :, side]
    spread = np.einsum("lan,nm,lbm->lab", jacobian, belief.covariance, jacobian, optimize=True)
    return Prediction(value, jacobian, spread, geometry)


def coefficient_beliefs(rays: Rays, bank: Bank, at_cells: Array) -> list[tuple[Array, Array]]:
    """Belief over the product of reflection coefficients of every ray: (values, probabilities).

    Parameters
    ----------
    at_cells : (L, 2, BINS)
        Log-likelihoods that the hit cells hold, [last, first].
    """

    def one(surface: int, log_cell: Array) -> Array:
        local = bank.reflection[surface] * np.exp(log_cell - log_cell.max())
        flat = np.full(len(local), 1 / len(local))
        local = local / local.sum() if local.sum() > 1e-12 else flat
        return (1 - OTHER_MATERIAL) * local + OTHER_MATERIAL * flat

    beliefs = []
    for ray in range(len(rays)):
        if rays.bounces[ray] == 0:
            beliefs.append((np.ones(1), np.ones(1)))
            continue
        last = one(rays.last[ray], at_cells[ray, 0])
        if rays.bounces[ray] == 1:
            beliefs.append((REFLECTION_BINS, last))
        else:
            first = one(rays.first[ray], at_cells[ray, 1])
            beliefs.append(
                (np.outer(REFLECTION_BINS, REFLECTION_BINS).ravel(), np.outer(last, first).ravel())
            )
    return beliefs


class AmplitudeTable:
    """p_d(u) by interpolation in a table, since it depends on u alone."""

    def __init__(self, signal: SignalModel) -> None:
        self._u = np.linspace(0, 40, 2001)
        self._p = signal.detection_probability(np.maximum(self._u, 1e-6))

    def __call__(self, amplitude: Array) -> Array:
        """Detection probability of any amplitudes."""
        return np.interp(amplitude, self._u, self._p)


def measurement_std(
    scan: Scan, rows: NDArray[np.intp], amplitude: Array, angles: Array, anchor: int, signal: SignalModel
) -> Array:
    """Standard deviations (M, 3) of (distance, AoD, AoA): the table's own, or from Fisher information.

    Infinite where nothing was measured.

    Parameters
    ----------
    amplitude : (M,)
        Believed amplitude of the path behind each measurement.
    angles : (2,) rad
        Predicted AoD and AoA, on which the aperture depends.
    """
    amplitude = np.maximum(amplitude, 0.3)
    std = np.stack(
        [
            signal.distance_std(amplitude),
            signal.angle_std(amplitude, angles[0], signal.anchor_aperture[anchor]),
            signal.angle_std(amplitude, angles[1], signal.agent_aperture),
        ],
        -1,
    )
    for column, (own, value) in enumerate(
        (
            (scan.distance_std_m, scan.distance_m),
            (scan.aod_std_rad, scan.aod_rad),
            (scan.aoa_std_rad, scan.aoa_rad),
        )
    ):
        if own is not None:
            std[:, column] = np.where(np.isnan(own[rows]), std[:, column], own[rows])
        std[:, column] = np.where(np.isnan(value[rows]), np.inf, std[:, column])
    return std


def likelihood(
    scan: Scan,
    rows: NDArray[np.intp],
    value: Array,
    spread: Array,
    belief: tuple[Array, Array],
    anchor: int,
    signal: SignalModel,
) -> tuple[Array, Array, Array]:
    """Density of measurements under one path, over that of clutter (per mean number of clutter).

    Returns
    -------
    (ratio, residual, variance)
        ratio (M,): p_d f(z | path) / (mu_fa f_fa(z)); residual (M, 3), 0 where not measured; variance (M, 3).
    """
    coefficient, probability = belief
    amplitude = signal.amplitude(value[0], coefficient)
    heard = scan.amplitude[rows]
    known = ~np.isnan(heard)
    density = np.exp(signal.log_rician(np.where(known, heard, 1.0)[:, None], amplitude[None]))
    weighted = density * probability
    strength = weighted.sum(1)
    mean = np.where(
        known & (strength > 1e-300),
        weighted @ amplitude / np.maximum(strength, 1e-300),
        probability @ amplitude,
    )
    std = measurement_std(scan, rows, mean, value[1:], anchor, signal)
    measured = np.stack([scan.distance_m[rows], scan.aod_rad[rows], scan.aoa_rad[rows]], -1)
    residual = measured - value
    residual[:, 1:] = wrap(residual[:, 1:])
    missing = ~np.isfinite(std)
    residual = np.where(missing, 0.0, residual)
    variance = np.where(missing, 1e12, std**2)
    total = spread[None] + variance[:, None, :] * np.eye(3)
    solved = np.linalg.solve(total, residual[..., None])[..., 0]
    log = -0.5 * (residual * solved).sum(-1) - 0.5 * np.linalg.slogdet(2 * np.pi * total)[1]
    # a factor that was not measured is left out on both sides: take its clutter density out of the ratio
    flat = np.array([np.log(signal.max_distance_m), np.log(2 * np.pi), np.log(2 * np.pi)])
    log += (missing * (0.5 * np.log(2 * np.pi * 1e12) - flat)).sum(-1)
    log -= np.log(signal.false_alarms) + signal.log_clutter(heard)
    strength = np.where(
        known, strength, probability @ signal.detection_probability(np.maximum(amplitude, 1e-6))
    )
    return np.exp(np.minimum(log, 600)) * strength, residual, variance
