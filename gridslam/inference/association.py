"""Loopy belief propagation for data association (Williams and Lau 2014, with the new-feature column).

Owner of that kernel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime

Array = NDArray[np.float64]


ROUNDS = 100
"""At most."""


def associate(beta: Array, missed: Array, new: Array, rounds: int = ROUNDS) -> tuple[Array, Array]:
    """Messages of the association graph (paper 002, supporting document).

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
        claimed (M,): sum of what the paths send to m, with which new existence is xi / (xi + claimed).
    """
    runtime.start()
    from gridslam.kernels.association import associate as launch

    beta = np.ascontiguousarray(beta)
    message, claimed = np.empty((2, *beta.shape)), np.empty(beta.shape[1])
    launch(beta, missed[None], new, rounds, message, claimed)
    return message[1], message[0].sum(0)  # a device that bounds loops may not come to the sums
