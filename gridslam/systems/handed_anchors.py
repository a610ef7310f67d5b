"""Where anchors stand: from what an agent learned into its map, and from a map to the next agent.

docs/model.md, (M569).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.beliefs.belief import lines_as_written
from gridslam.inference.state.mountings import PER_ANCHOR, Learned
from gridslam.inference.state.state import State
from gridslam.maps.map import Map
from gridslam.maps.map_anchors import MapAnchors
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap


def map_anchors(state: State, found: NDArray[np.bool_], model: FilterModel) -> MapAnchors | None:
    """Where anchors stand, beside those surfaces of a state that `found` (S,) says; None if that is known."""
    if state.mountings is None:
        return None
    covariance, cross = state.mountings.jointly(state.belief, model)
    lines, sign = lines_as_written(state.belief, found)
    stand = model.anchors[: model.senders] + state.mountings.aside
    return MapAnchors(model.anchor_names, stand[:, :2], wrap(stand[:, 2]), covariance, cross[:, lines] * sign)


def learned_anchors(prior: Map, model: FilterModel) -> Learned | None:
    """How the model's anchors stand, as an earlier agent's map has it; None unless it knows all of them.

    One that its maker didn't hear may have told its walls before, by an agent before that one.
    """
    told = prior.anchors
    if told is None or prior.surfaces is None or not set(model.anchor_names) <= set(told.names):
        return None
    own = [told.names.index(name) for name in model.anchor_names]
    entries = np.add.outer(PER_ANCHOR * np.array(own), np.arange(PER_ANCHOR)).ravel()
    aside = np.column_stack([told.position_m, told.orientation_rad])[own] - model.anchors[: model.senders]
    aside[:, 2] = wrap(aside[:, 2])
    return Learned(aside, told.covariance[np.ix_(entries, entries)], told.cross[entries])
