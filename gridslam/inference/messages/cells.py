"""Occupancy of the grid: visibility of paths and messages to cells; owner of their kernels.

Equations without a key are those of [Li2026grid]; docs/model.md, (M35)-(M40).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.particles import Sampling, draft_of
from gridslam.inference.messages.path_prediction import (
    AS_THEY_ARE,
    ListArguments,
    PathQuery,
    PredictedPaths,
    listing,
    query_buffers,
    query_of,
)
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.polylines import Polylines
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels import ALREADY_LISTED
from gridslam.kernels.primitives import blocks
from gridslam.kernels.primitives.blocks import Casting, Cells, Links, Listed
from gridslam.kernels.primitives.tables import MEAN_VALIDITY, PREDICTED, SHARE_POSSIBLE
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import BINS

RAYS = 48
"""Sampled rays per path, from which validity and cell messages are averaged."""
NO_LINKS = Links(np.empty(0), np.empty(0, np.int64), np.empty(0), np.empty((0, 0)), np.empty((0, 0, 0)))
NO_PATHS = np.empty(0), np.empty(0), np.empty((0, PREDICTED))
NO_PRODUCTS = np.empty((0, 2 * BINS))
"""Empty placeholders for a kernel's arguments where paths are listed already."""


@dataclass(frozen=True, eq=False)
class Visibility:
    """Visibility of an anchor's paths, and beliefs about their coefficients, by rays cast through the grid.

    Attributes
    ----------
    validity : (L,)
        V of every path, eq. (14): probability that it is open.
    possible : (L,)
        Share of the rays of each that are possible.
    products : (L, 2 BINS)
        Belief over the product of the coefficients along every path, eq. (2), by nodes
        ``(n + 1) / (2 BINS)``. A hit's own combines the beliefs of surface and cells there, and a share for
        another material.
    """

    validity: Array
    possible: Array
    products: Array


def casting_of(paths: int, rays: int, beliefs: int) -> Casting:
    """Reusable buffers for so many paths and rays each, and beliefs about the coefficients of so many."""
    drawn = runtime.room((paths * rays, 14), np.float64)
    return Casting(np.zeros((paths, 2)), drawn, np.empty((paths, 6)), np.empty((beliefs, 2 * BINS)))


@timed("evaluation")
def cast_paths(
    state: State, anchor: int, model: FilterModel, *, work: Workspace
) -> tuple[PredictedPaths, Visibility]:
    """List and predict an anchor's paths, and cast them at sampled states: V, eq. (14), and coefficients.

    The arrays are reused when the same anchor's paths are cast again.
    """
    query = PathQuery.of(state, anchor, model, RAYS, _number(state, anchor, model), work)
    most = len(query.buffers.path)
    cast = work.buffers(casting_of, anchor, most, RAYS, most)
    _cast(query.attempts(), state.require_grid(), cast, state.surfaces.reflection, work)
    paths = query.paths(work)
    seen = cast.seen[: len(paths)]
    products = work.first_rows(cast.products, len(paths))
    return paths, Visibility(seen[:, MEAN_VALIDITY], seen[:, SHARE_POSSIBLE], products)


@timed("cells")
def cast_messages(state: State, model: FilterModel, *, work: Workspace) -> Polylines:
    """Cast a step's likely paths, and add their messages to the cells', eqs. (43)-(45), in the workspace.

    Those that are too unlikely to send count as impossible. The next call reuses the arrays.
    """
    messages, anchors = work.messages, len(model.anchors)
    if messages.among[0] > len(state.surfaces) or messages.among[1] > anchors:
        raise ValueError("messages are of surfaces or anchors that don't exist")
    draft = work.buffers(draft_of, anchors, state.belief.layout, RAYS)
    samples = work.particles.samples(state.belief, _number(state, anchors, model), draft)
    cast = work.buffers(casting_of, anchors, len(messages.path), RAYS, 0)
    cast_at(samples, state.require_grid(), cast, model.places, work)
    return Polylines(int(messages.count[0]), cast.drawn, cast.seen)


def cast_at(samples: Sampling, grid: Grid, cast: Casting, anchors: Array, work: Workspace) -> None:
    """Cast the paths of the workspace's messages at sampled states, and add their messages to the cells'."""
    messages, belief = work.messages, blocks.Belief(samples.belief.mean, samples.belief.covariance)
    query = query_of(work.buffers(query_buffers, len(anchors)), ALREADY_LISTED, 0, samples, AS_THEY_ARE, 1.0)
    listed = Listed(messages.path, *NO_PATHS, messages.count)
    asked = PathQuery(query, belief, anchors, NO_LINKS, samples, listed, messages.among, None)
    work.require_cells().unsettled = True
    casting = cast._replace(factor=messages.factor, products=NO_PRODUCTS)
    _cast(asked.attempts(), grid, casting, NO_PRODUCTS, work, sends=True, given=samples.given)


@timed("cells")
def update_cells(state: State, *, work: Workspace) -> State:
    """Fold the messages of all paths and anchors into the beliefs of the cells, eq. (46)."""
    grid = state.require_grid()
    evidence, observed = work.require_cells().fold(grid)
    return replace(state, grid=replace(grid, evidence=evidence, observed=observed))


def _number(state: State, anchor: int, model: FilterModel) -> int:
    """Which points states are sampled by: others for every step and anchor."""
    return state.step * (len(model.anchors) + 1) + anchor


def _cast(
    attempts: Iterable[ListArguments], grid: Grid, casting: Casting, surface: Array, work: Workspace,
    sends: bool = False, given: bool = False,
) -> None:  # fmt: skip
    """Cast rays.

    Parameters
    ----------
    casting : Casting
        `factor` is given.
    surface : (S, BINS)
        Beliefs about the surfaces' coefficients.
    sends : bool
        Whether messages are sent at all.
    given : bool
        Whether paths and samples are there already.
    """
    device, cells, launch = runtime.start(), work.require_cells(), _casting()
    frame = cells.frame_of_messages if sends else cells.frame
    for arguments in attempts:
        if device == "gpu" and not given:
            listing()(*arguments)
        known = Cells(cells.occupancy(grid), frame, grid.row, grid.hit, surface)
        launch(*arguments, known, casting, cells.scratch)


@runtime.once_started
def _casting() -> Any:
    """The kernel that casts rays."""
    from gridslam.kernels.propagation.cells import cast

    return cast
