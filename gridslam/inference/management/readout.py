"""Estimates for users: tables of surfaces and paths of a belief; owner of their kernel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.estimate_tables import HypothesisEstimate, PathEstimate, SurfaceEstimate
from gridslam.inference.management.mixture import poses
from gridslam.inference.messages.mirrors import mirror_chances, mirror_odds
from gridslam.inference.messages.path_prediction import links_of
from gridslam.inference.messages.scatterers import wall_chances
from gridslam.inference.state.arrangement import unparked
from gridslam.inference.state.population import Population
from gridslam.inference.state.rays import Rays, listed_at_most
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import blocks
from gridslam.kernels.primitives.tables import (
    AOA,
    AOD,
    BY_COEFFICIENTS,
    COEFFICIENT_VARIANCE,
    CORNERS,
    DISTANCE,
    EXISTS,
    FROM_ANCHOR,
    LINE,
    LINE_COVARIANCE,
    MEAN_COEFFICIENT,
    OVER_LAST,
    SFV,
    SFV_COVARIANCE,
    STRETCH,
)
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import wrap

Whole = NDArray[np.int32]
Long = NDArray[np.int64]


def surface_estimate(state: State, *, work: Workspace) -> SurfaceEstimate:
    """Table of all potential surfaces, parked ones among them."""
    none = np.zeros(0), np.zeros((0, 3)), 0, 0.0
    return _described(unparked(state), *none, None, work)[0]


def estimates(
    state: State, model: FilterModel, at_1m: float,
    strength: Callable[[Rays, Array], Array] | None = None, *, work: Workspace,
) -> tuple[SurfaceEstimate, PathEstimate]:  # fmt: skip
    """Tables of all potential surfaces, and of the paths believed in over them as they stand.

    [Li2026grid], section III-F, and the "soft" ray tracing of section IV-C.

    Parameters
    ----------
    at_1m : float
        Amplitude of a line of sight 1 m long: others follow from coefficients, [Li2026grid], eq. (2).
    strength : callable, optional
        Amplitudes (L,) of rays of given lengths (L,), if they are known otherwise.

    Notes
    -----
    Paths over floor or ceiling are those of their anchors, and of the walls that they go over, too.
    """
    table, paths = _described(state, state.los, model.places, model.max_bounces, at_1m, strength, work)
    table = table if state.parked is None else surface_estimate(state, work=work)
    if model.senders == len(model.anchors):
        return table, paths
    amplitude = paths.amplitude
    if strength is None:
        amplitude = amplitude * np.array(model.radio.image_gains)[paths.anchor // model.senders]
    return table, replace(paths, anchor=paths.anchor % model.senders, amplitude=amplitude)


def described(population: Population[State]) -> HypothesisEstimate:
    """Table of all hypotheses."""
    beliefs, pose = [state.belief for state in population.states], poses(population)
    return HypothesisEstimate(
        population.weights, pose[:, :2], wrap(pose[:, 2]),
        np.array([belief.covariance[:2, :2] for belief in beliefs]),
        np.array([len(state.every_existence) for state in population.states], np.int64),
    )  # fmt: skip


def _described(
    state: State, los: Array, anchors: Array, max_bounces: int, at_1m: float,
    strength: Callable[[Rays, Array], Array] | None, work: Workspace,
) -> tuple[SurfaceEstimate, PathEstimate]:  # fmt: skip
    """Tables of surfaces, and of the paths from some anchors."""
    belief, bank = state.belief, state.surfaces
    count, places = len(bank), len(anchors)
    bank.check(belief, places, len(los))
    most = 1 + places * listed_at_most(count, max_bounces)
    scratch = work.buffers(_buffers, places, most, count)
    _describing()(
        belief.layout.head, max_bounces, at_1m, blocks.Belief(belief.mean, belief.covariance), anchors,
        links_of(bank, los), blocks.SurfaceRows(bank.extent, bank.reflection, bank.identity), scratch,
    )  # fmt: skip
    table = scratch.table.copy()
    path, number, quantity, found = scratch.path, scratch.number, scratch.quantity, scratch.found
    several = int(found[0])
    surfaces = SurfaceEstimate(
        bank.identity.copy(), table[:, SFV:SFV_COVARIANCE],
        table[:, SFV_COVARIANCE:MEAN_COEFFICIENT].reshape(-1, 2, 2), table[:, LINE:LINE_COVARIANCE],
        table[:, LINE_COVARIANCE:SFV].reshape(-1, 2, 2),
        table[:, MEAN_COEFFICIENT], table[:, COEFFICIENT_VARIANCE],
        bank.existence * mirror_chances(bank, work.once(mirror_odds, bank)) * wall_chances(bank),
        table[:, STRETCH:],
        bank.owner.copy(),
    )  # fmt: skip
    number, quantity = number[:several].copy(), quantity[:several].copy()
    amplitude = quantity[:, BY_COEFFICIENTS]
    if strength is not None:
        rays = Rays(path[:several], quantity[:, EXISTS].copy(), np.ones(several), (count, places))
        amplitude = strength(rays, quantity[:, DISTANCE] - belief.late(number[:, FROM_ANCHOR]))
    return surfaces, PathEstimate(
        number[:, FROM_ANCHOR], number[:, OVER_LAST:], quantity[:, DISTANCE], quantity[:, AOD],
        quantity[:, AOA], amplitude, quantity[:, EXISTS], quantity[:, CORNERS:].reshape(-1, 4, 2),
    )  # fmt: skip


def _buffers(most: int, surfaces: int) -> blocks.Description:
    """Scratch and outputs of `describe` for so many paths, and their number."""
    return blocks.Description(
        np.empty((3 + 3 * surfaces, 1)), np.empty((surfaces, 16)), np.empty((most, 4), np.int32),
        np.empty((most, 13)), np.empty((most, 3), np.int64), np.empty((most, 13)), np.empty(1, np.int32),
    )  # fmt: skip


@runtime.once_started
def _describing() -> Any:
    """The kernel that describes surfaces and paths."""
    from gridslam.kernels.management.readout import describe

    return describe
