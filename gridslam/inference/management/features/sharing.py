"""What one anchor's features say of others': mirrors and scatterers serve all; docs/model.md, (M232), (M321).

A feature is one anchor's. But a wall reflects every anchor, and a scatterer is heard from all of them: only
the extra length differs. So the next agent starts from what an earlier one learned for other anchors, too,
be they in its scene or not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from gridslam.arrays import Array
from gridslam.estimate_tables import SCATTERER, FeatureEstimate, SurfaceEstimate
from gridslam.inference.management.features.surface_features import (
    LEAST_STEPS,
    Images,
    image_features,
    mirror_surfaces,
    same_line,
)
from gridslam.maps.feature_rows import (
    TIED_M,
    chosen,
    entries,
    numbered_after,
    own_covariance,
    owners,
    stand_for,
    tied,
)
from gridslam.world.signal_model import SignalModel

ONE_PLACE_M = 1e-3
"""By how much places of one scatterer may differ."""
NEAREST_M = 1.0
"""Scatterers are as loud as if they were no nearer to anchor or agent."""


def handed_over(
    features: FeatureEstimate | None, joint: Array | None, surfaces: SurfaceEstimate | None,
    lines: Array | None, model: SignalModel,
) -> Images:  # fmt: skip
    """All features that a map has for the anchors of a model; images in its surfaces with slopes by these.

    Parameters
    ----------
    features, surfaces : FeatureEstimate, SurfaceEstimate or None
    joint, lines : (3 G, 3 G), (2 S, 2 S) or None
        Covariance of all features' x, y, b, and of all surfaces' lines; default: each one's own.

    These are the anchors' own, scatterers that others heard, and images in surfaces of which an anchor has no
    feature yet. What is left of features of anchors that aren't in the model is this alone.
    """
    table = FeatureEstimate.empty() if features is None else features
    surfaces = SurfaceEstimate.empty() if surfaces is None else surfaces
    joint = own_covariance(table) if joint is None else joint
    whose = owners(table, model.anchors[:, :2])
    own, spread = chosen(table, joint, np.flatnonzero(whose >= 0))
    own = replace(own, anchor=whose[whose >= 0])
    found, spread = with_scatterers(table, joint, own, spread, model)
    every = Images(found, spread, np.zeros((3 * len(found), 2 * len(surfaces))))
    for images in _images(surfaces, lines, table, own, model):
        every = _joined(every, _missing(images, every.table))
    return every._replace(table=replace(every.table, identity=np.arange(len(every.table))))


def with_others(
    table: FeatureEstimate, joint: Array, earlier: FeatureEstimate | None, known: Array | None,
    model: SignalModel,
) -> tuple[FeatureEstimate, Array]:  # fmt: skip
    """Features after a run, and those of an earlier map whose anchors weren't in it: they stay as they were.

    Parameters
    ----------
    joint, known : (3 F, 3 F), (3 G, 3 G) or None
        Covariances of all x, y, b; default: each one's own.
    """
    if earlier is None:
        return table, joint
    left = np.flatnonzero(owners(earlier, model.anchors[:, :2]) < 0)
    others, square = chosen(earlier, own_covariance(earlier) if known is None else known, left)
    return FeatureEstimate.stack([table, numbered_after(others, table)]), block_diag(joint, square)


def with_scatterers(
    table: FeatureEstimate, joint: Array, own: FeatureEstimate, spread: Array, model: SignalModel
) -> tuple[FeatureEstimate, Array]:
    """Own features and those that scatterers of other anchors are, unless they are there already; (M321).

    Parameters
    ----------
    table, joint : FeatureEstimate, (3 F, 3 F)
        Of all anchors.
    own, spread : FeatureEstimate, (3 O, 3 O)
        Of this model's: the rows of the table that are its anchors', in order.
    """
    scatterers = np.flatnonzero((table.kind == SCATTERER) & (table.steps_seen >= LEAST_STEPS))
    whose = owners(table, model.anchors[:, :2])
    features, own_spread = [own], np.square([ONE_PLACE_M, ONE_PLACE_M, TIED_M])
    rows = [np.eye(len(joint))[entries(np.flatnonzero(whose >= 0))]]
    for j, anchor in enumerate(model.anchors[:, :2]):
        for n in scatterers[whose[scatterers] != j]:
            far, by_place = tied(table.position_m[n], anchor)
            one = replace(
                table.take([n]), anchor=np.array([j]), anchor_m=anchor[None], bias_m=np.array([far]),
                variance=table.variance[[n]] * _louder(table, int(n), anchor, model),
            )  # fmt: skip
            slope = np.zeros((3, len(joint)))
            slope[:, 3 * n : 3 * n + 2] = by_place
            square = slope @ joint @ slope.T + np.diag(own_spread)
            covariance = table.covariance[[n]].copy()
            covariance[0, :3, :3], covariance[0, :3, 3], covariance[0, 3, :3] = square, 0.0, 0.0
            one = replace(one, covariance=covariance)
            if not any(_known(other, one) for other in features):
                features.append(one)
                rows.append(slope)
    jacobian = np.concatenate(rows)
    whole = jacobian @ joint @ jacobian.T
    whole[: len(spread), : len(spread)] = spread
    shared = np.arange(len(spread), len(whole))
    whole[shared, shared] += np.tile(own_spread, len(shared) // 3)
    return FeatureEstimate.stack(features), whole


def _louder(table: FeatureEstimate, row: int, anchor_m: Array, model: SignalModel) -> float:
    """By which a scatterer's power at 1 m differs for another anchor, seen from where the agent starts."""
    place, start = table.position_m[row], model.start_mean[:2]
    fro = max(float(np.hypot(*(start - place))), NEAREST_M)
    here, there = (
        max(float(np.hypot(*(place - other))), NEAREST_M) for other in (table.anchor_m[row], anchor_m)
    )
    return ((1 / there + 1 / fro) / (1 / here + 1 / fro)) ** 2


def _images(
    surfaces: SurfaceEstimate,
    known: Array | None,
    table: FeatureEstimate,
    own: FeatureEstimate,
    model: SignalModel,
) -> list[Images]:
    """Images in the map's surfaces; in those that features stand for, only of anchors that have none."""
    mirrors = mirror_surfaces(table)
    other = np.array([not any(same_line(s, m) for m in mirrors.line) for s in surfaces.line], bool)
    keep = np.repeat(other, 2)
    found = image_features(surfaces.take(other), None if known is None else known[np.ix_(keep, keep)], model)
    slopes = np.zeros((len(found.slopes), len(keep)))
    slopes[:, keep] = found.slopes
    images, spread, _ = image_features(mirrors, None, model)
    rows = np.flatnonzero(~np.isin(images.anchor, own.anchor))
    bare = Images(*chosen(images, spread, rows), np.zeros((3 * len(rows), len(keep))))
    return [found._replace(slopes=slopes), bare]


def _missing(images: Images, found: FeatureEstimate) -> Images:
    """Images that no feature stands for, in units of the samples that features were learned from."""
    rows = np.array(
        [n for n in range(len(images.table)) if not _known(found, images.table.take([n]))], np.int64
    )
    some, square = chosen(images.table, images.covariance, rows)
    level = {int(j): found.noise[found.anchor == j][0] for j in np.unique(found.anchor)}
    noise = np.array([level.get(int(j), 1.0) for j in some.anchor])
    covariance = some.covariance.copy()
    covariance[:, 3, 3] *= noise**2
    some = replace(some, variance=some.variance * noise, noise=noise, covariance=covariance)
    return Images(some, square, images.slopes[entries(rows)])


def _known(table: FeatureEstimate, one: FeatureEstimate) -> bool:
    """Whether some feature of the same of the model's anchors can be this one (a table of one row)."""
    return stand_for(table, np.flatnonzero(table.anchor == one.anchor[0]), one)


def _joined(one: Images, other: Images) -> Images:
    return Images(
        FeatureEstimate.stack([one.table, other.table]), block_diag(one.covariance, other.covariance),
        np.concatenate([one.slopes, other.slopes]),
    )  # fmt: skip
