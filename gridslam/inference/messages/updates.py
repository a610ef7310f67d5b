"""Data association of an anchor's measurements, and the updates by it; owner of their kernel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.health.monitor import NO_FIT
from gridslam.inference.messages.association import ROUNDS, Association, associate, log_normaliser
from gridslam.inference.messages.crowds import crowded_as_one, neighbours, of_one_way
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels import GAIN, GAIN_PRECISION, LEAST_PARTICLES, LIKELIER_THAN_NOT
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

    def likely_pairs(self, ratios: LikelihoodRatios) -> NDArray[np.intp]:
        """Numbers of those of the ratios' pairs whose path likelier than not caused the measurement."""
        index = ratios.pairs.index[: len(ratios.pairs)]
        return (self.responsible[index[:, 0], index[:, 1]] > LIKELIER_THAN_NOT).nonzero()[0]

    @property
    def claimed(self) -> Array:
        """What the known paths send to each measurement, (M,)."""
        return self.measured[tables.CLAIMED]

    @property
    def effective_sample_size(self) -> float:
        """Least effective number of particles behind a sure association; all if there is none."""
        return float(min(*self.fit[:, LEAST_PARTICLES].tolist(), self.particles))

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


def in_turn(exchanges: list[Exchange]) -> list[Exchange]:
    """Of the anchors one after the other, in whatever order they were heard."""
    return sorted(exchanges, key=lambda exchange: exchange.anchor)


@timed("updates")
def update_surfaces_and_agent(
    state: State, scan: AnchorScan, paths: PredictedPaths, ratios: LikelihoodRatios, turned: Array,
    model: FilterModel, given: Association | None = None, *, work: Workspace,
) -> tuple[State, Exchange]:  # fmt: skip
    """Associate; correct agent and surfaces, and update what exists: docs/model.md, (M26) to (M31).

    The joint belief is corrected by every path in turn, surest first, moment-matched over its association.
    Each path is linearised where the ones before it have led: the sure ones carry the unsure.

    Parameters
    ----------
    state : State
        As predicted; its belief (N,), (N, N) and the existence of lines of sight, surfaces and rays change.
    scan : AnchorScan
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
    _require_listed_of_this_state(paths.rays, scan, state, turned, model)
    given = _associated_elsewhere(ratios) if given is None else given  # (M26), on a GPU
    ratios = _crowds_as_one(scan, paths.rays, ratios, len(turned), work)  # (M231)
    sent, rounds = _handed_over(ratios, given), ROUNDS if given is None else 0
    state, fits = _correct(state, sent, scan, paths, ratios, turned, rounds, model, work)  # (M26) to (M31)
    own = slice(scan.anchor, scan.anchor + 1) if scan.anchor >= 0 else slice(None)
    exchange = Exchange(
        scan.anchor, _copied_rays(paths.rays), sent.odds, sent.message, sent.measured,
        _with_images(fits, len(turned), model.level_prior is None)[own], paths.recipe.count,
        np.zeros((0, 2)), given,
    )  # fmt: skip
    return state, exchange


def _require_listed_of_this_state(
    rays: Rays, scan: AnchorScan, state: State, turned: Array, model: FilterModel
) -> None:
    """Refuse paths of other surfaces or anchors than the state's, and anchors that aren't there."""
    rays.check(len(state.surfaces), min(len(state.los), len(model.anchors)))
    if not -1 <= scan.anchor < len(turned) or (scan.anchor < 0 and scan.label.max(initial=-1) >= len(turned)):
        raise ValueError("there is no such anchor")


def _associated_elsewhere(ratios: LikelihoodRatios) -> Association | None:
    """Messages of the association on a GPU, whose one thread is too slow for it; else it is the kernel's."""
    if runtime.start() != "gpu":
        return None
    return Association.alone(*associate(ratios.beta, ratios.missed, ratios.new), ratios.new)


def _crowds_as_one(
    scan: AnchorScan, rays: Rays, ratios: LikelihoodRatios, senders: int, work: Workspace
) -> LikelihoodRatios:
    """The ratios, in whose pairs a crowd counts as one measurement of its middle."""
    near = work.once(neighbours, scan.table)
    if not near.any():
        return ratios
    near = of_one_way(near, ratios.beta, rays.anchor // senders)
    return replace(ratios, pairs=crowded_as_one(ratios.pairs, scan, near))


def _copied_rays(rays: Rays) -> Rays:
    """Paths that stay as they are when the workspace lists others."""
    return Rays(rays.table.copy(), rays.existence.copy(), rays.surfaces.copy(), rays.among)


def _handed_over(ratios: LikelihoodRatios, given: Association | None) -> blocks.Ratios:
    """Copies of the ratios' messages, which the correction completes, with the association's if known."""
    odds, message, measured = ratios.odds.copy(), ratios.message.copy(), ratios.measured.copy()
    if given is not None:
        message[tables.NU], measured[tables.CLAIMED] = given.nu, given.claimed
        measured[tables.NEW] = given.new
    return blocks.Ratios(odds, message, measured)


def _correct(
    state: State, sent: blocks.Ratios, scan: AnchorScan, paths: PredictedPaths, ratios: LikelihoodRatios,
    turned: Array, rounds: int, model: FilterModel, work: Workspace,
) -> tuple[State, Array]:  # fmt: skip
    """Complete messages sent; the state as corrected, and how each anchor's paths fitted, (J, 9).

    The kernel corrects copies in the workspace, which last: to hand over new arrays takes longer.
    """
    belief, bank, rays, pairs = state.belief, state.surfaces, paths.rays, ratios.pairs
    anchors, size = len(model.anchors), len(belief.mean)
    known = _updates()
    launch = (
        known.update_with_rises() if belief.rises
        else known.update_with_clocks() if belief.clocks else known.update
    )  # fmt: skip
    share, scratch = work.buffers(_account, scan.anchor, len(pairs.index), size)
    turns = turned if len(turned) == anchors else np.resize(turned, anchors)  # images turn with their anchors
    joint, existence, fits = work.buffers(_copies, 0, size, state.los.shape, bank.single.shape, anchors)
    fits[:] = NO_FIT
    given = belief.mean, belief.covariance, bank.existence, state.los, bank.single, bank.double
    for copy, known in zip((*joint, *existence), given, strict=True):
        copy[...] = known
    work.messages.reserve(len(rays), len(pairs), (len(bank), anchors))
    launch(
        belief.layout.head, rounds, joint, blocks.PathRows(rays.table, paths.prediction.whole),
        pairs.block(ratios.blocks), sent, scan.table, blocks.Anchors(model.places, model.radio.numbers),
        existence, blocks.Account(scratch, share, turns, fits), work.messages.block(),
    )  # fmt: skip
    surface, sight, single, double = (copy.copy() for copy in existence)
    belief = replace(belief, mean=joint.mean.copy(), covariance=joint.covariance.copy())
    bank = replace(bank, existence=surface, single=single, double=double)
    return replace(state, belief=belief, los=sight, surfaces=bank), fits.copy()


def _copies(
    size: int, sights: tuple[int, ...], rays: tuple[int, int], anchors: int
) -> tuple[blocks.Belief, blocks.Existence, Array]:
    """Room for a belief of this size, for what exists, with so many rays over one surface, and for fits."""
    existence = blocks.Existence(
        np.empty(rays[1]), np.empty(sights), np.empty(rays), np.empty((*rays, rays[1]))
    )
    return blocks.Belief(np.empty(size), np.empty((size, size))), existence, np.empty((anchors, len(NO_FIT)))


def _with_images(fits: Array, senders: int, known: bool = True) -> Array:
    """Sums of anchors, those of their images in floor and ceiling among them, (senders, 9).

    Of levels whose coefficient isn't known, amplitudes tell nothing of the radio's gain.
    """
    if len(fits) == senders:
        return fits
    each = fits.reshape(-1, senders, fits.shape[1])
    if not known:
        each[1:, :, GAIN : GAIN_PRECISION + 1] = 0.0
    return np.column_stack([each[..., :LEAST_PARTICLES].sum(0), each[..., LEAST_PARTICLES].min(0)])


def _account(pairs: int, size: int) -> tuple[Array, Array]:
    """Scratch: probability of each association, and of a belief of this size."""
    return np.empty(pairs), np.empty((size, 6))


@runtime.once_started
def _updates() -> Any:
    """The kernels that update: of a state without clocks and rises, with clocks, and with rises."""
    from gridslam.kernels.messages import updates

    return updates
