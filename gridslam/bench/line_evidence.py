"""The kernel that gathers evidence for lines from snapshots, for direct grid SLAM, against its twin."""

from __future__ import annotations

import numpy as np

from gridslam import reference
from gridslam.bench.kernels import KernelSpeed, race
from gridslam.inference.state.leftovers import REFLECTIONS, LineEvidence

NAMES = ("weigh_lines",)
RADIUS_M, SPACING_M = 6.0, 0.125
BEAMS, LENGTHS = 18, 98


def line_evidence_speed(seconds: float) -> KernelSpeed:
    """Time of the kernel for all lines over a room and one snapshot.

    Parameters
    ----------
    seconds : float
        At least so long; the kernel runs three times or more, its twin once.
    """
    from gridslam.kernels.messages.line_evidence import weigh_lines

    draw, by_line = np.random.default_rng(1), LineEvidence.none(1, RADIUS_M, SPACING_M)
    arguments = (
        draw.exponential(size=(BEAMS, BEAMS, LENGTHS)).astype(np.float32), 1.0, 24.0,
        np.array([2.0, 1.0, 0.3, 0.0]),
        np.array([-1.0, 0.5, 0.4, 0.0, 0.0]), by_line.offsets(RADIUS_M), 30.0 * REFLECTIONS,
        np.array([0.9, 0.02]), 0,
    )  # fmt: skip
    ratio = by_line.ratio[0].copy()
    lines = ratio.shape[0] * ratio.shape[1]
    return race(
        "weigh_lines", f"room of {2 * RADIUS_M:.0f} m", "line", lines, seconds, 1.0,
        lambda: weigh_lines(*arguments, ratio),
        lambda: weigh_lines(*arguments, ratio[:, :0]),
        lambda: reference.weigh_lines(*arguments, by_line.ratio[0]),
    )  # fmt: skip
