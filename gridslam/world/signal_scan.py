"""What is received at one step, sampled over frequency and antennas."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.world.given import require_radians, time_of, unmasked
from gridslam.world.scan import require_time


@dataclass(frozen=True, eq=False)
class SignalScan:
    """What was received at one step.

    Attributes
    ----------
    step : int
    time_s : float
    samples : (J, A, B, M) complex128
        By anchor, element of the anchor, element of the agent and frequency; any scale.
    heard : (J,) bool
        Whether there is a snapshot of the anchor; the samples of others mean nothing.
    heading_rad : float or None
        As measured by an IMU.
    """

    step: int
    time_s: float
    samples: NDArray[np.complex128]
    heard: NDArray[np.bool_]
    heading_rad: float | None = None

    def __len__(self) -> int:
        """How many anchors were heard."""
        return int(np.count_nonzero(self.heard))

    def content(self) -> Iterator[NDArray[Any] | None]:
        """Which anchors were heard, the samples of these, and the heading."""
        yield self.heard
        yield self.samples[self.heard].view(np.float64)
        yield None if self.heading_rad is None else np.array([self.heading_rad])

    def checked(
        self, anchors: int, after: float | None = None, shape: tuple[int, ...] | None = None
    ) -> SignalScan:
        """The scan as arrays, if a filter can make sense of it; samples that weren't heard are 0.

        Parameters
        ----------
        anchors : int
            How many there are.
        after : float, optional
            Time of the scan before, s.
        shape : tuple of int, optional
            What the samples' shape has to be, `Waveform.shape`.

        Raises
        ------
        InputError
            Other shapes, samples of a heard anchor that are NaN, infinite or all 0, a heading that isn't
            finite, or a time that is NaN or isn't later than that of the scan before.
        """
        time = time_of(self.time_s, "signal")
        try:
            samples = np.array(unmasked(self.samples), np.complex128)
            heard = np.array(self.heard)
            heading = None if self.heading_rad is None else float(self.heading_rad)
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError("signal", str(error), "arrays of numbers") from None
        wanted = shape if shape is not None else (anchors, *samples.shape[1:])
        if samples.ndim != 4 or samples.shape != tuple(wanted):
            allowed = f"shape {tuple(wanted)}" if shape is not None else f"shape ({anchors}, A, B, M)"
            raise InputError("signal: samples", f"shape {samples.shape}", allowed)
        if heard.shape != (anchors,) or heard.dtype.kind not in "bui":
            raise InputError(
                "signal: heard", f"shape {heard.shape} of {heard.dtype}", f"({anchors},) truth values"
            )
        heard = heard.astype(bool)
        if not np.isfinite(samples[heard]).all():
            raise InputError("signal: samples", "NaN or infinity in a heard snapshot", "finite numbers")
        if not samples[heard].any(axis=(1, 2, 3)).all():
            raise InputError(
                "signal: samples", "zeros alone in a heard snapshot", "what was received, or heard = false"
            )
        require_time("signal", time, after)
        if heading is not None and not np.isfinite(heading):
            raise InputError("signal: heading_rad", str(heading), "a finite number, or None")
        require_radians(heading or 0.0, "signal")
        samples[~heard] = 0
        return replace(self, time_s=time, samples=samples, heard=heard, heading_rad=heading)
