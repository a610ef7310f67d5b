"""Estimates for users of published methods: means and covariances of particles of virtual anchors."""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import PathEstimate, SurfaceEstimate
from gridslam.inference.management.samples.image_readout import UNKNOWN_REFLECTION
from gridslam.inference.state.published.feature_particles import Features
from gridslam.world.geometry import course, line_between, mirror_derivative, wrap

LEAST_M2 = 1e-9
"""Added to variances, so that particles that are all the same have a covariance."""


def agent_moments(agent: Array) -> tuple[Array, Array]:
    """Mean (5,) and covariance (5, 5) of particles (P, 5) of an agent, whose heading turns."""
    heading = np.angle(np.exp(1j * agent[:, 4]).mean())
    off = np.column_stack([agent[:, :4] - agent[:, :4].mean(0), wrap(agent[:, 4] - heading)])
    mean = np.append(agent[:, :4].mean(0), wrap(heading + off[:, 4].mean()))
    return mean, np.cov(off.T, bias=True) + LEAST_M2 * np.eye(5)


def feature_surfaces(features: Features, anchor_positions: Array) -> SurfaceEstimate:
    """Lines between anchors (J, 2) and their virtual anchors' mean places; each serves its own anchor."""
    found = features.take(~features.fixed)
    place = found.position.mean(1)
    off = found.position - place[:, None]
    spread = np.einsum("fpi,fpj->fij", off, off) / off.shape[1] + LEAST_M2 * np.eye(2)
    anchor = anchor_positions[found.anchor]
    line = line_between(anchor, place)
    back = np.linalg.inv(mirror_derivative(line, anchor) + LEAST_M2 * np.eye(2))
    size, (level, doubt) = len(found), UNKNOWN_REFLECTION
    return SurfaceEstimate.from_lines(
        line, back @ spread @ np.swapaxes(back, 1, 2), np.full(size, level), np.full(size, doubt),
        found.existence.copy(), None, found.identity.copy(), found.anchor.copy(),
    )  # fmt: skip


def feature_paths(features: Features, pose: Array, anchors: Array) -> PathEstimate:
    """Lines of sight and single bounces at the means, of an agent at a pose (5,) and anchors (J, 3)."""
    count, whose = len(features), features.anchor
    place, own = features.position.mean(1), anchors[whose]
    position = np.broadcast_to(pose[:2], (count, 2))
    line = line_between(own[:, :2], place)
    bounces = np.where(features.fixed, 0, 1)
    path = course(position, own[:, :2], line, line, bounces)
    identity = np.where(features.fixed, -1, features.identity)
    points = np.stack([own[:, :2], path.first_point, path.last_point, position], axis=1)
    return PathEstimate(
        whose.copy(), np.column_stack([identity, identity]), path.distance, wrap(path.departure - own[:, 2]),
        wrap(path.arrival - pose[4]), features.intensity.mean(-1), features.existence.copy(), points,
    )  # fmt: skip
