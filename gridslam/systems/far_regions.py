"""Regions beside the origin: a filter reckons about their middle, and users get their own coordinates back.

A line is believed as an angle and an offset from the origin, docs/model.md, (M556). From far off, offsets
hang on angles by metres, and thresholds and linearised steps of both lose their meaning.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.arrays import Array
from gridslam.estimate_tables import FeatureEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.maps.map import Map
from gridslam.maps.map_cells import joint_of
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import gap_to_origin, moved_lines, wrap
from gridslam.world.scene_parts import GridSpec


def middle_of(grid: GridSpec, anywhere: bool = False) -> Array:
    """About where a filter is to reckon, (2,) whole m: the origin, if the region holds it, or its middle.

    Parameters
    ----------
    anywhere : bool
        The middle wherever the region is.
    """
    sides = np.array([grid.x_m, grid.y_m])
    return np.round(sides.mean(1)) if anywhere or gap_to_origin(*sides.T) else np.zeros(2)


def about(model: FilterModel, middle: Array) -> FilterModel:
    """What a filter knows of a scene, its origin moved to (2,) m; the same object where that stays."""
    if not middle.any():
        return model
    x, y = middle.tolist()
    grid = model.grid.model_copy(update={
        "x_m": (model.grid.x_m[0] - x, model.grid.x_m[1] - x),
        "y_m": (model.grid.y_m[0] - y, model.grid.y_m[1] - y),
    })  # fmt: skip
    anchors, mean = model.anchors.copy(), model.start_mean.copy()
    anchors[:, :2] -= middle
    mean[:2] -= middle
    for values in (anchors, mean):
        values.setflags(write=False)
    return replace(model, anchors=anchors, grid=grid, start_mean=mean, origin_m=model.origin_m + middle)


def moved_surfaces(table: SurfaceEstimate, by: Array) -> tuple[SurfaceEstimate, Array]:
    """Surfaces moved by (2,) m, and the derivatives (S, 2, 2) of their lines by those before.

    Offsets are 0 or more before and after: a line that the origin changes the side of is turned over.
    """
    line, slope = moved_lines(table.line, by)
    along, sense = slope[:, 1, 0].copy(), np.where(line[:, 1] < 0, -1.0, 1.0)
    slope[:, 1] *= sense[:, None]
    line = np.column_stack([np.where(sense < 0, wrap(line[:, 0] + np.pi), line[:, 0]), sense * line[:, 1]])
    stretch = table.extent_m + along[:, None]
    stretch = np.where(sense[:, None] < 0, -stretch[:, ::-1], stretch)
    moved = SurfaceEstimate.from_lines(
        line, slope @ table.line_cov @ slope.transpose(0, 2, 1), table.reflection, table.reflection_var,
        table.existence, stretch, table.identity, table.owner,
    )  # fmt: skip
    return moved, slope


def moved_features(table: FeatureEstimate, by: Array) -> FeatureEstimate:
    """Features moved by (2,) m, with the anchors that they are of."""
    return replace(table, position_m=table.position_m + by, anchor_m=table.anchor_m + by)


def moved_map(known: Map, by: Array) -> Map:
    """A map with its surfaces and features moved by (2,) m; cells stay where they are."""
    if not by.any():
        return known
    changes: dict[str, object] = {}
    whole = np.zeros((0, 0))
    if known.surfaces is not None:
        changes["surfaces"], slope = moved_surfaces(known.surfaces, by)
        whole = joint_of(slope)
        if known.surface_covariance is not None:
            joint = whole @ known.surface_covariance @ whole.T
            changes["surface_covariance"] = 0.5 * (joint + joint.T)
    if known.anchors is not None:
        changes["anchors"] = known.anchors.moved(by, whole)
    if known.features is not None:
        changes["features"] = moved_features(known.features, by)
    return replace(known, **changes)  # type: ignore[arg-type]


def moved_estimate(estimate: Estimate, by: Array) -> Estimate:
    """What users get of a step, moved by (2,) m."""
    if not by.any():
        return estimate
    places = replace(estimate.hypotheses, position_m=estimate.hypotheses.position_m + by)
    surfaces, _ = moved_surfaces(estimate.surfaces, by)
    paths = replace(estimate.paths, points=estimate.paths.points + by)
    return replace(
        estimate, position_m=estimate.position_m + by, surfaces=surfaces, hypotheses=places, paths=paths
    )
