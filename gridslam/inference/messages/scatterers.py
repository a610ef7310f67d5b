"""Whether a surface is a wall or a point that scatters; docs/model.md, (M559) to (M561). Ours.

What a post, a lamp or a cupboard's edge scatters is heard as if off a wall through it that turns as the agent
goes by, and a surface is born there that walks along with it. A wall stays, and so does the point: both are
fitted beside each other to all that is heard of a surface, and how well either predicts it tells which it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import OF_POSE, POSE
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.kernels import DECIDED
from gridslam.kernels.primitives.tables import DENSITY, DISTANCE, PATH_ROW, VARIANCE
from gridslam.world.filter_model import FilterModel

ODDS = 10
"""Column of `SurfaceBank.forms` with the log odds; before it of either form, wall and point, mean (2,) and
covariance (xx, xy, yy)."""
WALLS, BESIDE = 5.0, -1.0
"""Log odds of a wall beforehand, and of what may be heard of a point that is known."""
KNOWN, SHARP_M, SAME_M = -10.0, 0.1, 0.3
"""Log odds of a point that is known; deviations of its place, and how far what else is heard of it may be."""


def weigh_forms(
    state: State, paths: PredictedPaths, ratios: LikelihoodRatios, exchange: Exchange, model: FilterModel
) -> State:
    """The state with both forms of its surfaces fitted to what single bounces caused, and their odds.

    Not of images that one anchor alone has, nor where heights lengthen paths.

    Parameters
    ----------
    paths : PredictedPaths
        L paths over the surfaces of `state`.
    ratios : LikelihoodRatios
        Of these, with the pairs that may belong together.
    exchange : Exchange
        Which of them did.
    """
    bank = state.surfaces
    if state.monitor.astray or not len(bank) or model.places[:, 3].any():
        return state
    pair, sure = ratios.pairs.pair, exchange.likely_pairs(ratios)
    bounces, surface, _, anchor = paths.rays.table[ratios.pairs.index[sure, PATH_ROW]].T
    open_ = (bounces == 1) & undecided(bank)[surface]
    heard = on_time(pair[sure[open_], :DENSITY], state.belief, anchor[open_])
    return weigh_heard(state, surface[open_], anchor[open_], heard, model)


def on_time(heard: Array, belief: Belief, anchor: NDArray[np.intp]) -> Array:
    """Measurements (D, 6) of anchors (D,) as if clocks were known: their means taken off, variances added."""
    if not belief.clocks:
        return heard
    clock, after = belief.layout.anchor_clocks.start + anchor, heard.copy()
    after[:, DISTANCE] -= belief.mean[clock]
    after[:, VARIANCE + DISTANCE] += belief.covariance[clock, clock]
    return after


def undecided(bank: SurfaceBank) -> NDArray[np.bool_]:
    """Surfaces (S,) of which what is heard still tells whether they are walls."""
    return np.asarray((bank.owner < 0) & (bank.forms[:, ODDS] < DECIDED))


def weigh_heard(
    state: State, surface: NDArray[np.intp], anchor: NDArray[np.intp], heard: Array, model: FilterModel
) -> State:
    """The state with both forms fitted to D measurements of its surfaces, one of each; see `fitted`."""
    if not len(surface):
        return state
    bank, belief = state.surfaces, state.belief
    entry = belief.layout.head + 2 * surface
    spread = [belief.covariance[entry + i, entry + j] for i, j in ((0, 0), (0, 1), (1, 1))]
    lines = np.column_stack([belief.lines[surface], *spread])
    forms = bank.forms.copy()
    forms[surface] = fitted(
        forms[surface], heard, model.places[anchor, :3], belief.mean[POSE], belief.covariance[OF_POSE], lines
    )  # fmt: skip
    return replace(state, surfaces=replace(bank, forms=forms))


def wall_chances(bank: SurfaceBank) -> Array:
    """Chances that surfaces are walls, (S,); 1 of those of which nothing was weighed; (M561)."""
    point, spread, odds = bank.forms[:, 5:7], bank.forms[:, 7] + bank.forms[:, 9], bank.forms[:, ODDS]
    known = point[(odds < KNOWN) & (spread < SHARP_M**2)]
    apart = np.hypot(*(point[:, None] - known).transpose(2, 0, 1)).min(1, initial=np.inf)
    beside = (apart < SAME_M) & (spread < SAME_M**2) & (spread > 0)
    return np.where(spread > 0, expit(odds + np.where(beside, BESIDE, WALLS)), 1.0)


def fitted(forms: Array, heard: Array, places: Array, pose: Array, known: Array, lines: Array) -> Array:
    """Forms (D, 11) of D surfaces after a measurement of each.

    Parameters
    ----------
    heard : (D, 6)
        Distance (m), AoD and AoA (rad), and their own variances; `UNMEASURED` for none.
    places : (D, 3)
        Of the anchors: x, y (m), orientation (rad).
    pose, known : (3,), (3, 3)
        The agent's x, y (m), heading (rad), and their covariance.
    lines : (D, 5)
        The surfaces as they are believed, angle (rad), offset (m) and covariance: what the first measurement
        begins with.
    """
    after = forms.copy()
    _fitting()(pose, known, heard, places, lines, after)
    return after


@runtime.once_started
def _fitting() -> Any:
    """The kernel that fits both forms."""
    from gridslam.kernels.messages.scatterers import fit_forms

    return fit_forms
