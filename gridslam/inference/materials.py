"""Reflection coefficients: beliefs about products of them along paths, and what amplitudes say of each; owner
of that kernel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.cells import Cells
from gridslam.inference.likelihood import DetectionTable
from gridslam.inference.polylines import Polylines
from gridslam.inference.surfaces import Bank
from gridslam.inference.told import Told
from gridslam.signal import REFLECTION_BINS, SignalModel

Array = NDArray[np.float64]
BINS = len(REFLECTION_BINS)
PRODUCTS: Array = np.arange(1, 2 * BINS + 1) / (2 * BINS)
"""Nodes for products of coefficients; they hold every bin's centre, and 1 for the line of sight."""


@dataclass(frozen=True)
class Reflected:
    """Amplitudes by reflection: node c of a path of length d stands for ``c u_1m / d``.

    Attributes
    ----------
    probability : (L, K)
        Belief over `PRODUCTS`.
    """

    probability: Array
    signal: SignalModel

    spreading = True

    @property
    def nodes(self) -> Array:
        """Amplitudes of the nodes at 1 m, (K,)."""
        return _nodes(self.signal.amplitude_at_1m)


@lru_cache(16)
def _nodes(amplitude_at_1m: float) -> Array:
    nodes = amplitude_at_1m * PRODUCTS
    nodes.setflags(write=False)
    return nodes


def learn(
    told: Told, bank: Bank, drawn: Polylines, send: NDArray[np.bool_], cells: Cells, table: DetectionTable,
    signal: SignalModel,
) -> None:  # fmt: skip
    """Learn coefficients of surfaces and cells, in place, from what a step's amplitudes said.

    Parameters
    ----------
    drawn : Polylines
        The rays as cast at sampled states.
    send : (L,)
        Which paths tell anything of cells.
    """
    from gridslam.kernels.coefficients import learn as launch

    rays = told.rays
    rays.check(len(bank))
    if len(rays):
        launch(
            drawn.drawn, rays.table, np.array([send, rays.surfaces, told.chance, told.share, told.distance]),
            told.path, told.said, table.chance, table.step, signal.radio(0),
            cells.frame(), runtime.scratch("learn", (len(bank),)), bank.reflection, cells.held,
        )  # fmt: skip
