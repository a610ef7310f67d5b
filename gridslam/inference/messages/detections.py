"""Detections of surfaces, and where they were hit; owner of that kernel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.particles import at_mean
from gridslam.inference.state.polylines import draw_paths
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives.blocks import Hits
from gridslam.world.filter_model import FilterModel


@timed("cells")
def mark_detections(state: State, rays: Rays, share: Array, model: FilterModel, *, work: Workspace) -> State:
    """Count an anchor's detections of surfaces, and where its rays hit them at the belief's mean, (M391).

    Parameters
    ----------
    share : (L,)
        Probability that the path caused a measurement, if it is possible; above one half it counts.
    """
    runtime.start()
    from gridslam.kernels.propagation.detections import mark

    bank, belief = state.surfaces, state.belief
    lines = draw_paths(rays, at_mean(belief), model.places)
    rays.check(len(bank))
    if len(belief.lines) != len(bank) or not len(rays) == lines.count == len(share):
        raise ValueError("belief, bank, rays and what was drawn of them don't belong together")
    hits, latest = hits_of(bank), work.buffers(latest_hits, 0, len(bank))
    mark(belief.mean, belief.layout.head, rays.table, lines.seen, share, model.places, latest, hits)
    return replace(state, surfaces=with_hits(bank, hits))


def hits_of(bank: SurfaceBank) -> Hits:
    """Where surfaces were hit, for kernels to go on with."""
    return Hits(bank.foot.copy(), bank.extent.copy(), bank.seen.copy(), bank.outermost.copy())


def with_hits(bank: SurfaceBank, hits: Hits) -> SurfaceBank:
    """The bank with what a kernel made of `hits_of`."""
    foot, extent, seen, outermost = hits
    return replace(bank, foot=foot, extent=extent, seen=seen, outermost=outermost)


def latest_hits(surfaces: int) -> NDArray[np.int32]:
    """Scratch of the kernels that record hits: the anchor that detected each surface last, in one launch."""
    return np.empty(surfaces, np.int32)
