"""Loopy belief propagation for data association by [Williams2014bp]; owner of that kernel.

With a column of new features, as in [Meyer2018mtt]; docs/model.md, (M26).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.kernels.primitives import tables

ROUNDS = 100
"""At most."""


@dataclass(frozen=True, eq=False)
class Association:
    """Messages out of a data association that was done elsewhere than in the updates' kernel.

    Attributes
    ----------
    nu, claimed : (L, M), (M,)
        To the L paths, and what all causes send to each measurement; as of `associate`.
    new : (M,)
        xi_m, as it was reckoned with.
    other_beta, other_missed, other_nu : (R, M), (R,), (R, M)
        Messages of and to causes beside the paths.
    """

    nu: Array
    claimed: Array
    new: Array
    other_beta: Array
    other_missed: Array
    other_nu: Array

    @classmethod
    def alone(cls, nu: Array, claimed: Array, new: Array) -> Self:
        """Of paths alone."""
        none = np.zeros((0, len(new)))
        return cls(nu, claimed, new, none, np.zeros(0), none)


def associate(beta: Array, missed: Array, new: Array, rounds: int = ROUNDS) -> tuple[Array, Array]:
    """Messages of the association graph, (M26): [Li2026grid], section III-D.

    The paper names them; they are written out in [Li2025adaptive], supporting document, section II-B 4.

    Parameters
    ----------
    beta : (L, M)
        Message of every path for "caused measurement m".
    missed : (L,) > 0
        Message of every path for "caused none".
    new : (M,) > 0
        xi_m, message of every measurement for "caused by no legacy path" (1 + birth).

    Returns
    -------
    (nu, claimed)
        nu (L, M): message from measurement m to path l, scaled so that "no measurement" is 1;
        claimed (M,): sum of what the paths send to m, with which new existence is (xi - 1) / (xi + claimed).
    """
    runtime.start()
    from gridslam.kernels.messages.association import associate as launch

    paths, count = beta.shape
    odds, message, measured = (
        np.empty((tables.ODDS, paths)),
        np.empty((5, paths, count)),
        np.empty((tables.MEASURED_ROWS, count)),
    )
    odds[tables.MISSED], message[tables.BETA], measured[tables.NEW] = missed, beta, new
    launch(odds, message, measured, rounds)
    return message[tables.NU], message[tables.CLAIM].sum(0)  # a device that bounds loops may not come to sums


def log_normaliser(beta: Array, missed: Array, new: Array, nu: Array, total: Array) -> float:
    """Log of an anchor's normaliser, in ratio to clutter: Bethe's, with paths normalised in sequence.

    The sum over all matchings of the product of their messages is ``sum_l log(missed_l + sum_m beta_lm nu_lm)
    + sum_m log(xi_m + sum_l mu_lm) - sum_lm log(1 + nu_lm mu_lm)`` where the graph is a tree. Instead of the
    first term stands what every path's association came to where the paths before had led the belief: paths
    of one scan share the agent, and a vague belief doesn't gain by measurements that agree with no one pose.

    Parameters
    ----------
    beta, missed, new : (L, M), (L,), (M,)
        The arguments of `associate`.
    nu : (L, M)
        What `associate` returns.
    total : (L,)
        ``missed + sum beta nu`` of every path, or what took its place.
    """
    own = beta * nu
    mu = beta / (missed[:, None] + np.maximum(own.sum(1, keepdims=True) - own, 0.0))
    known = np.log(total).sum() + np.log(new + mu.sum(0)).sum()
    return float(known - np.log1p(nu * mu).sum())
