"""Rays: every path that a set of surfaces could make to one anchor, and its existence over time."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import PathGeometry, trace, wrap
from gridslam.inference.belief import Belief, slots
from gridslam.inference.surfaces import Bank

Array = NDArray[np.float64]
P_STAY, P_APPEAR = 0.95, 0.005
"""A ray that exists stays so for a step; one that doesn't appears (model.md, section 2.6 (a))."""


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

    def take(self, rows: NDArray[np.intp]) -> Rays:
        """Some of the rays."""
        return Rays(*(getattr(self, f.name)[rows] for f in fields(self)))


def rays_of(bank: Bank, sight: Array, anchor: int, most_bounces: int, now: bool = False) -> Rays:
    """All paths worth a look from `anchor`; `sight` (J,) is the existence of the line of sight.

    Their existence is predicted one step ahead, unless asked for `now`.
    """
    own = np.flatnonzero((bank.owner == -1) | (bank.owner == anchor))
    strong = np.flatnonzero(bank.existence > 0.3)
    last, first = (a.ravel() for a in np.meshgrid(strong, strong, indexing="ij"))
    other = last != first
    last, first = last[other], first[other]
    if most_bounces < 2:
        last = first = last[:0]
    bounces = np.repeat([0, 1, 2], [1, len(own), len(last)])
    memory = np.concatenate([[sight[anchor]], bank.single[anchor, own], bank.double[anchor, last, first]])
    if not now:
        settled = P_APPEAR / (1 - P_STAY + P_APPEAR)
        memory = settled + (memory - settled) * (P_STAY - P_APPEAR)
    product = np.concatenate([[1.0], bank.existence[own], bank.existence[last] * bank.existence[first]])
    return Rays(
        bounces,
        np.concatenate([[-1], own, last]).astype(np.intp),
        np.concatenate([[-1], own, first]).astype(np.intp),
        memory,
        product,
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


def remember(bank: Bank, sight: Array, rays: Rays, anchor: int, worth: Array, validity: Array) -> None:
    """Update the rays' existence by what their measurements said (model.md, section 2.6 (a)).

    Parameters
    ----------
    sight : (J,)
        Existence of every anchor's line of sight, updated in place like the bank's rays.
    worth : (L,)
        Mean of ``sum_m nu_m g_m + 1 - p_d`` of every path.
    validity : (L,)
        V: a ray that the grid blocks is not judged by its silence.
    """
    chance = rays.surfaces * validity
    ahead = chance * worth + 1 - chance
    after = rays.existence * ahead / (rays.existence * ahead + 1 - rays.existence)
    sight[anchor] = after[0]
    single, double = rays.bounces == 1, rays.bounces == 2
    bank.single[anchor, rays.last[single]] = after[single]
    bank.double[anchor, rays.last[double], rays.first[double]] = after[double]
