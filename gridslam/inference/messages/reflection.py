"""Reflection coefficients: beliefs about products of them along paths, and what amplitudes say of each; owner
of that kernel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.inference.messages.cells import Cells
from gridslam.inference.messages.likelihood import DetectionTable
from gridslam.inference.state.belief import Belief
from gridslam.inference.state.path_messages import Notes
from gridslam.inference.state.polylines import Polylines
from gridslam.inference.state.surface_bank import Bank
from gridslam.world.radio import REFLECTION_BINS, SignalModel

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
    notes: Notes, bank: Bank, belief: Belief, drawn: Polylines, least: float, cells: Cells,
    table: DetectionTable, signal: SignalModel,
) -> None:  # fmt: skip
    """Learn coefficients of surfaces and cells, in place, from what a step's amplitudes said.

    And remember which surfaces were seen, and where they were hit.

    Parameters
    ----------
    drawn : Polylines
        The paths as cast at sampled states.
    least : float
        Share of the states at which a path must be possible to tell of cells.
    """
    runtime.start()
    from gridslam.kernels.propagation.coefficients import learn as launch

    surfaces = len(bank)
    if notes.among[0] > surfaces or len(belief.lines) != surfaces:
        raise ValueError("notes or belief aren't of these surfaces")
    launch(
        belief.mean, drawn.drawn, drawn.seen, *notes.arrays, table.chance, table.step, signal.radio(0),
        cells.hits(least), runtime.scratch("learn", (surfaces,)), bank.reflection, cells.held,
        runtime.scratch("latest", (surfaces,), np.int32), bank.foot, bank.extent, bank.seen,
    )  # fmt: skip
