"""Data association of an anchor's measurements, and the updates by it; owner of their kernel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.health.monitor import NO_FIT
from gridslam.inference.messages.association import ROUNDS, Association, associate, log_normaliser
from gridslam.inference.messages.crowds import crowded_as_one, neighbours, of_one_way
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.prediction import PredictedPaths
from gridslam.inference.state.anchor_measurements import AnchorScan
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives import blocks, tables
from gridslam.world.filter_model import FilterModel


@dataclass(frozen=True, eq=False)
class Exchange:
    """Messages between the measurements of an anchor, or of all, and the filter's paths at one step.

    Attributes
    ----------
    anchor : int
        -1 for all of them.
    rays : Rays
        The L paths, with their existence one step ahead.
    odds : (12, L)
        By path, `message` (5, L, M) by path and measurement, `measured` (5, M) by measurement: rows as in
        `gridslam.kernels.primitives.tables`.
    fit : (1 or J, 9)
        How the measurements of each anchor fitted; see `gridslam.kernels.SUMS`.
    particles : int
        How many the paths were evaluated at.
    born : (B, 2)
        Measurement and existence of every new surface.
    given : Association, optional
        If it was done otherwise than by the updates' kernel.
    """

    anchor: int
    rays: Rays
    odds: Array
    message: Array
    measured: Array
    fit: Array
    particles: int
    born: Array
    given: Association | None = None

    @property
    def responsible(self) -> Array:
        """Probability that a path caused a measurement, (L, M)."""
        return self.message[tables.RESPONSIBLE]

    @property
    def claimed(self) -> Array:
        """What the known paths send to each measurement, (M,)."""
        return self.measured[tables.CLAIMED]

    @property
    def effective_sample_size(self) -> float:
        """Least effective number of particles behind a sure association; all if there is none."""
        return float(min(self.fit[:, 8].min(), self.particles))

    @cached_property
    def log_evidence(self) -> float:
        """Log of the anchor's normaliser, in ratio to clutter; see `association.log_normaliser`."""
        beta, missed, nu, total = (
            self.message[tables.BETA], self.odds[tables.MISSED], self.message[tables.NU],
            self.odds[tables.TOTAL],
        )  # fmt: skip
        if self.given is not None:
            others = self.given.other_beta, self.given.other_missed, self.given.other_nu
            beta, missed, nu = (np.concatenate(pair) for pair in zip((beta, missed, nu), others, strict=True))
            total = np.append(total, others[1] + (others[0] * others[2]).sum(1))
        return log_normaliser(beta, missed, self.measured[tables.NEW], nu, total)


@timed("updates")
def update_surfaces_and_agent(
    state: State, heard: AnchorScan, paths: PredictedPaths, ratios: LikelihoodRatios, turned: Array,
    model: FilterModel, given: Association | None = None, *, work: Workspace,
) -> tuple[State, Exchange]:  # fmt: skip
    """Associate; correct agent and surfaces, and update what exists: docs/model.md, (M26) to (M31).

    The joint belief is corrected by every path in turn, surest first, moment-matched over its association.
    Each path is linearised where the ones before it have led: the sure ones carry the unsure.

    Parameters
    ----------
    state : State
        As predicted; its belief (N,), (N, N) and the existence of lines of sight, surfaces and rays change.
    heard : AnchorScan
        M measurements.
    paths : PredictedPaths
        L paths over the surfaces of `state`.
    ratios : LikelihoodRatios
        Of these, with births in row `NEW` of `measured`.
    turned : (senders,) rad
        By which the anchors are taken to be turned.
    given : Association, optional
        Messages of an association that was done elsewhere (with rings, or on a GPU), in place of (M26).

    Returns
    -------
    (state, exchange)
        exchange: with the messages of the ratios, and those of the association.

    Raises
    ------
    ValueError
        Paths, measurements and state don't belong together.

    Notes
    -----
    After [Li2025adaptive], section V-B, 4 to 8; the joint Gaussian in place of particles is ours.
    """
    if runtime.start() == "gpu" and given is None:
        given = Association.alone(*associate(ratios.beta, ratios.missed, ratios.new), ratios.new)
    from gridslam.kernels.messages.updates import update, update_with_clocks, update_with_rises

    rays, bank, anchor, messages = paths.rays, state.surfaces, heard.anchor, work.messages
    surfaces, anchors = len(bank), len(model.anchors)
    rays.check(surfaces, min(len(state.los), anchors))
    if not -1 <= anchor < len(turned) or heard.label.max(initial=-1) >= len(turned):
        raise ValueError("there is no such anchor")
    belief, los, existence = state.belief.copy(), state.los.copy(), bank.existence.copy()
    single, double, pairs, rounds = bank.single.copy(), bank.double.copy(), ratios.pairs, ROUNDS
    share, scratch = work.buffers(_shares, anchor, len(pairs.index)), np.empty((len(belief.mean), 6))
    turns = turned if len(turned) == anchors else np.resize(turned, anchors)  # images turn with their anchors
    fits = np.empty((anchors, len(NO_FIT)))
    fits[:] = NO_FIT
    odds, message, measured = ratios.odds.copy(), ratios.message.copy(), ratios.measured.copy()
    if given is not None:
        message[tables.NU], measured[tables.CLAIMED] = given.nu, given.claimed
        measured[tables.NEW], rounds = given.new, 0
    messages.reserve(len(rays), len(pairs), (surfaces, anchors))
    launch = update_with_rises() if belief.rises else update_with_clocks() if belief.clocks else update
    near = work.once(neighbours, heard.table)
    near = of_one_way(near, ratios.beta, rays.anchor // len(turned))
    pairs = crowded_as_one(pairs, heard, near)
    launch(
        belief.layout.head, rounds, blocks.Belief(belief.mean, belief.covariance),
        blocks.PathRows(rays.table, paths.prediction.whole), pairs.block(ratios.blocks),
        blocks.Ratios(odds, message, measured), heard.table,
        blocks.Anchors(model.places, model.radio.numbers),
        blocks.Existence(existence, los, single, double),
        blocks.Account(scratch, share, turns, fits),
        messages.block(),
    )  # fmt: skip
    bank = replace(bank, existence=existence, single=single, double=double)
    listed = Rays(rays.table.copy(), rays.existence.copy(), rays.surfaces.copy(), rays.among)
    fits = _with_images(fits, len(turned))
    own = slice(anchor, anchor + 1) if anchor >= 0 else slice(None)
    exchange = Exchange(
        anchor, listed, odds, message, measured, fits[own], paths.recipe.count, np.zeros((0, 2)), given,
    )  # fmt: skip
    return replace(state, belief=belief, surfaces=bank, los=los), exchange


def _with_images(fits: Array, senders: int) -> Array:
    """Sums of anchors, those of their images in floor and ceiling among them, (senders, 9)."""
    if len(fits) == senders:
        return fits
    each = fits.reshape(-1, senders, fits.shape[1])
    return np.column_stack([each[..., :-1].sum(0), each[..., -1].min(0)])


def _shares(pairs: int) -> Array:
    """Scratch: probability of each association."""
    return np.empty(pairs)
