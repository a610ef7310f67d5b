"""Offsets of all clocks over a run, as they were estimated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.inference.management.network.readout import NetworkEstimate
from gridslam.world.clocks import ClockTruth


@dataclass(frozen=True, eq=False)
class ClockTrack:
    """Estimated offsets of all clocks over time.

    Attributes
    ----------
    device : tuple of str, D = J + I names
        Anchors, then agents.
    anchors : int
        J.
    step : (N,) int
    time_s : (N,)
    offset_s : (N, D)
        What all have in common can't be observed.
    covariance_s2 : (N, D, D)
    unset : (N, J) bool
        Anchors whose clocks were still searched for.
    """

    device: tuple[str, ...]
    anchors: int
    step: NDArray[np.intp]
    time_s: Array
    offset_s: Array
    covariance_s2: Array
    unset: NDArray[np.bool_]

    @classmethod
    def of(cls, estimates: list[NetworkEstimate], anchors: int) -> ClockTrack:
        """Of all steps of a run."""
        return cls(
            estimates[0].device,
            anchors,
            np.array([e.step for e in estimates]),
            np.array([e.time_s for e in estimates]),
            np.array([e.offset_s for e in estimates]),
            np.array([e.offset_covariance_s2 for e in estimates]),
            np.array([e.unset for e in estimates]),
        )

    @property
    def deviation_s(self) -> Array:
        """Standard deviations of the offsets, (N, D) s."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.covariance_s2, axis1=1, axis2=2), 0)))

    def errors(self, truth: ClockTruth) -> Array:
        """Estimated minus true offsets, (N, D) s.

        Raises
        ------
        InputError
            A device of which the truth isn't known.
        """
        for name in self.device:
            if name not in truth.device:
                raise InputError("clocks: device", repr(name), ", ".join(truth.device))
        own = [truth.device.index(name) for name in self.device]
        there = [np.interp(self.time_s, truth.time_s, truth.offset_s[:, column]) for column in own]
        return self.offset_s - np.stack(there, -1)
