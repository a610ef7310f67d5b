"""Where the line of sight of sampled signals should be: along a true track, or near the scene's start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.scene.allowed_for import farthest_aside_m
from gridslam.checks.scene.views import in_view
from gridslam.world.geometry import direction
from gridslam.world.scene import Scene

Complex = NDArray[np.complex128]
MOST_PLACES, START_STEPS = 60, 3
"""Steps that are looked at: of a known track, and from a known start on."""


@dataclass(frozen=True, eq=False)
class Places:
    """What is known of the line of sight: one row per snapshot, N of them.

    Attributes
    ----------
    step, anchor : (N,) int
    distance_m, aod_rad, bearing_rad : (N,)
        Length, departure from the anchor's orientation, direction from the agent in the scene's frame.
    heading_rad : (N,)
        Known without the file's own measurement.
    slack_m : float
        How far off lengths may be.
    """

    step: NDArray[np.intp]
    anchor: NDArray[np.intp]
    distance_m: Array
    aod_rad: Array
    bearing_rad: Array
    heading_rad: Array
    slack_m: float


def places_of(
    raw: dict[str, Any],
    usable: NDArray[np.bool_],
    scene: Scene | None,
    agent: str | None,
    order: Sequence[int] | None = None,
) -> Places | None:
    """Snapshots at which the line of sight is known; None where no place is.

    Along a true track those that the scene's walls hide are left out.

    Parameters
    ----------
    raw : dict
        What the file holds.
    usable : (K, J) bool
        Snapshots that can be looked at.
    order : sequence of int, optional
        Whose place each of the file's anchors has; default: its own.
    """
    anchors, facing = raw.get("anchor_position_m"), raw.get("anchor_orientation_rad")
    rise, aside = np.zeros(len(raw["anchors"])), 0.0
    if scene is not None and tuple(raw["anchors"]) == scene.anchor_names:
        anchors, facing = scene.anchor_positions, scene.anchor_orientations
        rise = _rises(scene, agent)
        aside = farthest_aside_m(scene)
    truth, steps = raw.get("truth"), len(usable)
    if anchors is None:
        return None
    facing = np.zeros(len(anchors)) if facing is None else facing
    if order is not None:
        anchors, facing = np.asarray(anchors)[list(order)], np.asarray(facing)[list(order)]
        rise = rise[list(order)]
    if truth is not None and len(truth) == steps:
        chosen = np.unique(np.linspace(0, steps - 1, min(steps, MOST_PLACES)).astype(int))
        position, heading, slack = truth.position_m[chosen], truth.heading_rad[chosen], 0.1
    elif scene is not None:
        body = scene.agent(agent) if agent is not None else scene.agents[0] if scene.agents else None
        if body is None:
            return None
        chosen = np.arange(min(steps, START_STEPS))
        position = np.broadcast_to(np.array(body.start_m), (len(chosen), 2))
        heading = np.full(len(chosen), np.radians(body.start_heading_deg))
        slack = body.prior.position_m + START_STEPS * body.step_m
    else:
        return None
    row, anchor = np.nonzero(usable[chosen])
    if scene is not None and truth is not None and len(anchors) == len(scene.anchors):
        seen = in_view(position[row], np.asarray(anchors)[anchor], scene.segments())
        row, anchor = (row[seen], anchor[seen]) if seen.any() else (row, anchor)
    if not len(row):
        return None
    way = np.column_stack([position[row] - np.asarray(anchors)[anchor], rise[anchor]])
    leaving = direction(np.asarray(anchors)[anchor], position[row])
    return Places(
        chosen[row], anchor, np.linalg.norm(way, axis=1), leaving - np.asarray(facing)[anchor],
        leaving + np.pi, heading[row], slack + aside,
    )  # fmt: skip


def _rises(scene: Scene, agent: str | None) -> Array:
    """How far the scene's anchors (J,) are above the agent, m."""
    body = scene.agent(agent) if agent is not None else scene.agents[0] if scene.agents else None
    if not scene.has_heights or body is None:
        return np.zeros(len(scene.anchors))
    return np.asarray(scene.anchor_places[:, 2] - (body.height_m or 0.0))


def exchanged(
    raw: dict[str, Any], usable: NDArray[np.bool_], scene: Scene | None, agent: str | None
) -> dict[str, Places]:
    """The places with two anchors exchanged, by what that says.

    Parameters
    ----------
    usable : (K, J) bool
        Which snapshots hold anything, as of `places_of`.
    """
    names, found = tuple(raw["anchors"]), dict[str, Places]()
    for one, other in combinations(range(len(names)), 2):
        order = list(range(len(names)))
        order[one], order[other] = other, one
        places = places_of(raw, usable, scene, agent, order)
        if places is not None:
            found[f"{names[one]} and {names[other]} are exchanged, with all their samples"] = places
    return found
