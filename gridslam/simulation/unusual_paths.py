"""Paths that no filter here models: triple bounces, diffuse points, coefficients that grow when grazing.

They are made for `disturbances`; `image_source` traces the ordinary ones.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.simulation.occlusion import visible
from gridslam.simulation.scattering import path_rows, scattered_paths
from gridslam.simulation.true_paths import TruePaths
from gridslam.world.geometry import Segments, crossing, mirror, unit
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory


def triple_bounces(scene: Scene, agent: str, track: Trajectory) -> TruePaths:
    """Every visible path over three walls, by images (as the simulator's, one bounce further).

    Their `segment` and interaction points are left empty (-1, NaN): the table has room for two.
    """
    walls, tables = scene.segments(), []
    for first, second, third in product(range(len(walls)), repeat=3):
        numbers = (first, second, third)
        if walls.surface[first] == walls.surface[second] or walls.surface[second] == walls.surface[third]:
            continue
        for anchor in range(len(scene.anchors)):
            corners, here = _unfold(scene.anchor_positions[anchor], track.position_m, walls, numbers)
            legs = pairwise(corners)
            here &= np.logical_and.reduce([visible(a, b, walls) for a, b in legs])
            if here.any():
                strength = float(walls.reflection[list(numbers)].prod())
                tables.append(
                    path_rows(scene, agent, track, anchor, [c[here] for c in corners], here, strength)
                )
    return TruePaths.empty().joined(*tables)


def diffuse_points(
    scene: Scene, agent: str, track: Trajectory, count: int, size_m: float, draw: np.random.Generator
) -> TruePaths:
    """Paths by way of small things in the region that scatter to all sides.

    Parameters
    ----------
    count : int
        How many points, uniform over the region where some anchor sees them.
    size_m : float
        Amplitude ``u_1m size / (d_1 d_2)``: sqrt of the radar cross-section over 4 pi.
    """
    walls = scene.segments()
    low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
    places: list[Array] = []
    while len(places) < count:
        place = draw.uniform(low, high)
        starts = scene.anchor_positions
        if visible(starts, np.broadcast_to(place, starts.shape), walls).any():
            places.append(place)
    return scattered_paths(scene, agent, track, np.reshape(places, (-1, 2)), np.full(len(places), size_m))


def grazing(scene: Scene, paths: TruePaths, share: float) -> TruePaths:
    """The paths with coefficients that grow towards grazing incidence, as a dielectric's do.

    A wall's coefficient at normal incidence is `share` of its material's; a Fresnel reflection with the
    permittivity that this implies (transverse electric) gives the others. Concrete at 0.7 and a share of 0.56
    give ITU-R P.2040's 0.39 at normal incidence and 0.93 at 86 degrees.
    """
    walls, factor = scene.segments(), np.ones(len(paths))
    legs = np.diff(_filled(paths.points), axis=1)
    for bounce in range(2):
        rows = np.flatnonzero(paths.segment[:, bounce] >= 0)
        piece = paths.segment[rows, bounce]
        leg = legs[rows, bounce]
        normal = unit(walls.line[piece, 0])
        cosine = np.abs((leg * normal).sum(-1)) / np.maximum(np.linalg.norm(leg, axis=1), 1e-12)
        factor[rows] *= fresnel(share * walls.reflection[piece], cosine) / walls.reflection[piece]
    return replace(paths, amplitude=paths.amplitude * factor)


def fresnel(normal: Array, cosine: Array) -> Array:
    """Coefficient at an angle of incidence, of a material that has `normal` at normal incidence."""
    index = (1 + normal) / (1 - normal)
    inside = np.sqrt(index**2 - 1 + cosine**2)
    return np.asarray((inside - cosine) / (inside + cosine))


def _filled(points: Array) -> Array:
    """Corners (L, 4, 2) with absent interaction points moved onto the next corner."""
    filled = points.copy()
    for corner in (2, 1):
        absent = np.isnan(filled[:, corner, 0])
        filled[absent, corner] = filled[absent, corner + 1]
    return filled


def _unfold(
    source: Array, agents: Array, walls: Segments, numbers: tuple[int, ...]
) -> tuple[list[Array], NDArray[np.bool_]]:
    """Corners of the path over walls `numbers` from source to each agent (N, 2), and where it exists (N,)."""
    images = [source]
    for number in numbers:
        images.append(mirror(walls.line[number], images[-1]))
    corners, here = [agents], np.ones(len(agents), dtype=bool)
    for number, image in zip(reversed(numbers), reversed(images), strict=False):
        start = corners[0]
        fraction = crossing(start, np.broadcast_to(image, start.shape), walls.line[number])
        fraction = np.where(np.isfinite(fraction), fraction, -1.0)
        point = start + fraction[:, None] * (image - start)
        span = walls.end[number] - walls.start[number]
        along = (point - walls.start[number]) @ span / (span @ span)
        here &= (fraction > 1e-9) & (fraction < 1) & (along > 0) & (along < 1)
        corners.insert(0, np.where(here[:, None], point, start))
    corners.insert(0, np.broadcast_to(source, agents.shape))
    return corners, here
