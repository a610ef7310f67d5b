"""Where paths that no surface explains would come from; docs/model.md, (M432)."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array, replace
from gridslam.inference.scans.unexplained import Unexplained
from gridslam.world.geometry import unit

Whole = NDArray[np.int64]
SAME, SAME_M = 3.0, 0.1
"""Deviations, and metres on top, within which paths come from one place."""
LONGER_M = 0.3
"""By which a path has to be longer than the line of sight, or it is as good as that."""
ABOUT_M = 2.0
"""Within which others have to be, or a path is clutter."""


@dataclass(frozen=True, eq=False)
class Places:
    """U places from which paths of one anchor came that weren't any known surface's.

    Attributes
    ----------
    anchor : (U,) int64
    tied : (U,) bool
        Whether it is a scatterer's, from which there is as far to the anchor as the path says; else the path
        ends there, as if it were an image.
    place_m : (U, 2) m
    covariance : (U, 2, 2)
        By the measurements' deviations alone.
    pose : (U, 2, 2)
        Mean covariance by the agent's pose, whose errors last.
    misfit : (U,)
        Sum of squared errors, each in its covariance.
    power : (U,)
        Mean squared amplitude at 1 m.
    agent_m : (U, 2) m
        From where it was heard, in the mean.
    reach_m : (U,)
        How far apart places were from which it was heard, at least.
    steps, last_step : (U,) int64
    """

    anchor: Whole
    tied: NDArray[np.bool_]
    place_m: Array
    covariance: Array
    pose: Array
    misfit: Array
    power: Array
    agent_m: Array
    reach_m: Array
    steps: Whole
    last_step: Whole
    first_m: Array = field(repr=False)

    @classmethod
    def none(cls) -> Self:
        """Before the first step."""
        whole, none, pair = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 2))
        square = np.zeros((0, 2, 2))
        return cls(whole, np.zeros(0, bool), pair, square, square, none, none, pair, none, whole, whole, pair)

    def __len__(self) -> int:
        return len(self.anchor)

    def joined(self, other: Self) -> Self:
        """These and others."""
        return type(self)(
            *(np.concatenate([getattr(one, f.name) for one in (self, other)]) for f in fields(self))
        )


def places_of(known: Unexplained, anchors: Array, least: int) -> Places:
    """All places that paths came from, one path after the other.

    A path is used twice: as one that ends where its length and direction say, and as one by way of a
    scatterer in that direction.

    Parameters
    ----------
    anchors : (J, 2) m
    least : int
        How many paths have to come from about there.
    """
    power = (known.amplitude * known.value[:, 0]) ** 2
    rows = [
        replace(one, anchor=known.anchor[[n]], power=power[[n]])
        for n in range(len(known))
        for one in sighted(known, n, anchors[known.anchor[n]])
    ]
    every = Places.none()
    for one in np.array(rows, object)[_in_company(rows, least)]:
        every = added(every, one)
    return every


def _in_company(rows: list[Places], least: int) -> NDArray[np.bool_]:
    """Which places (of one path each) have so many of their kind about them, themselves included."""
    from scipy.spatial import cKDTree

    if not rows:
        return np.zeros(0, bool)
    place = np.concatenate([one.place_m for one in rows])
    kind = np.concatenate([2 * one.anchor + one.tied for one in rows])
    apart = np.column_stack([place, 2 * ABOUT_M * kind])  # other kinds are too far off
    near = cKDTree(apart).query_ball_point(apart, ABOUT_M, return_length=True)
    return np.asarray(near >= least)


def sighted(known: Unexplained, row: int, anchor_m: Array) -> list[Places]:
    """Where a path comes from: tables of one row."""
    (distance, angle), std = known.value[row], known.std[row]
    pose, spread = known.pose[row], known.covariance[row]
    way, agent = unit(pose[2] + angle), pose[:2]
    across = np.array([-way[1], way[0]])
    found = [(False, distance, 1.0, 0.0, np.zeros(2))]
    sight = anchor_m - agent
    if distance > np.hypot(*sight) + LONGER_M:
        half = distance - way @ sight
        far = 0.5 * (distance**2 - sight @ sight) / half
        by_place = (sight - far * way) / half
        found.append((True, far, (distance - far) / half, far * (across @ sight) / half, by_place))
    rows = []
    for tied, far, by_distance, by_angle, by_place in found:
        turned = by_angle * way + far * across
        slope = np.column_stack([by_distance * way, turned])
        moved = np.column_stack([np.eye(2) + np.outer(way, by_place), turned])
        one, here = np.ones(1, np.int64), agent[None].copy()
        rows.append(Places(
            anchor=0 * one, tied=np.array([tied]), place_m=here + far * way,
            covariance=(slope * std**2 @ slope.T)[None], pose=(moved @ spread @ moved.T)[None],
            misfit=np.zeros(1), power=np.zeros(1), agent_m=here, reach_m=np.zeros(1), steps=one,
            last_step=known.step[[row]], first_m=here,
        ))  # fmt: skip
    return rows


def added(known: Places, one: Places) -> Places:
    """All places with one more path: of the nearest of its kind if it can be from there, else a new one."""
    (alike,) = ((known.anchor == one.anchor) & (known.tied == one.tied)).nonzero()
    gap = one.place_m - known.place_m[alike]
    noise = one.covariance + SAME_M**2 * np.eye(2)
    lasting = known.pose[alike] + one.pose
    square = known.covariance[alike] + noise + lasting
    off = np.einsum("ni,ni->n", gap, np.linalg.solve(square, gap[..., None])[..., 0])
    if not len(alike) or off.min() >= SAME**2:
        return known.joined(one)
    nearest = int(off.argmin())
    n, misfit = alike[nearest], off[nearest]
    count = known.steps[n] + (known.last_step[n] < one.last_step[0])
    gain = known.covariance[n] @ np.linalg.inv(known.covariance[n] + noise[0])
    share = 1 / (known.steps[n] + 1)
    new = {
        "place_m": known.place_m[n] + gain @ gap[nearest],
        "covariance": known.covariance[n] - gain @ known.covariance[n],
        "pose": known.pose[n] + share * (one.pose[0] - known.pose[n]),
        "misfit": known.misfit[n] + misfit,
        "power": known.power[n] + share * (one.power[0] - known.power[n]),
        "agent_m": known.agent_m[n] + share * (one.agent_m[0] - known.agent_m[n]),
        "reach_m": max(known.reach_m[n], float(np.hypot(*(one.agent_m[0] - known.first_m[n])))),
        "steps": count,
        "last_step": one.last_step[0],
    }
    columns: dict[str, NDArray[Any]] = {}
    for name in (f.name for f in fields(known)):
        columns[name] = getattr(known, name)
        if name in new:
            columns[name] = columns[name].copy()
            columns[name][n] = new[name]
    return Places(**columns)
