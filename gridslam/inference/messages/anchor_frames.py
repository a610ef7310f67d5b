"""Each anchor's messages in the frame in which it stands as it is taken to; docs/model.md, (M569)."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.beliefs.turn import direction
from gridslam.inference.state.arrangement import mountings_followed
from gridslam.inference.state.mountings import Learned, Mountings
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel

Model = TypeVar("Model", bound=FilterModel)


def with_mountings(
    state: State, model: FilterModel, heard: bool = False, learned: Learned | None = None
) -> State:
    """A state before the first step with the prior of how anchors stand, if it holds one joint Gaussian.

    Parameters
    ----------
    heard : bool
        Whether its walls were found by such anchors: then they are off by what these have in common.
    learned : Learned, optional
        How anchors stand, as it was learned together with these walls.
    """
    if state.samples is not None or not model.settings.correlated:
        return state
    if learned is not None:
        belief, handed = Mountings.handed(model, state.belief, learned)
        return replace(state, belief=belief, mountings=handed)
    mountings = Mountings.start(model, len(state.belief.mean))
    if mountings is None:
        return state
    state = replace(state, mountings=mountings)
    if heard:
        layout = state.belief.layout
        belief, mountings = mountings.shared(state.belief, np.arange(layout.head, layout.size))
        state = replace(state, belief=belief, mountings=mountings)
    # of an only anchor that turn is most of what isn't known, and a start so wide would be searched for
    return with_common_turn(state) if model.senders > 1 else state


def with_common_turn(state: State) -> State:
    """The state with what isn't known of how all is turned together with the anchors."""
    if state.mountings is None or not state.mountings.turn_variance:
        return state
    way = direction(state.belief, state.mountings.pivot)
    covariance = state.belief.covariance + state.mountings.turn_variance * np.outer(way, way)
    return replace(state, belief=replace(state.belief, covariance=covariance))


def as_believed(model: Model, state: State) -> Model:
    """The model with its anchors where a state believes that they stand."""
    if state.aside is None:
        return model
    return model.calibrated(np.zeros(model.senders), model.higher, state.aside)


def seen_from(state: State, anchor: int, model: FilterModel) -> State:
    """The state in the frame of an anchor; as it is where anchors stand as is told."""
    if state.mountings is None:
        return state
    belief, mountings = state.mountings.framed(state.belief, anchor, model)
    return replace(state, belief=belief, mountings=mountings)


def back_in_scene(framed: State, state: State, anchor: int, model: FilterModel) -> State:
    """The state in the scene's frame again, with what the anchor's messages said of how it stands.

    Parameters
    ----------
    framed : State
        In the anchor's frame, before its messages.
    """
    state = mountings_followed(framed, state)
    if state.mountings is None:
        return state
    belief, mountings = state.mountings.unframed(state.belief, anchor, model)
    return replace(state, belief=belief, mountings=mountings)
