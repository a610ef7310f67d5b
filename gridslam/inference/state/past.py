"""What a filter on samples received since its start, kept so that it can be looked at again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, Self, TypeVar

from gridslam.world.signal_scan import SignalScan

S = TypeVar("S")
"""The kind of state."""


@dataclass(frozen=True, eq=False)
class Past(Generic[S]):
    """The scans of all steps since the start.

    Attributes
    ----------
    start : S
        The state before the first step.
    scans : tuple of SignalScan
        One for each step; none any more once it is too late to look again.
    log_evidence : float
        Log density of the samples received, in the mixture of all hypotheses.
    """

    start: S
    scans: tuple[SignalScan, ...] = ()
    log_evidence: float = 0.0

    def with_scan(self, scan: SignalScan, log_evidence: float) -> Self:
        """One step more, and how likely it was given those before."""
        return replace(self, scans=(*self.scans, scan), log_evidence=self.log_evidence + log_evidence)

    def forgotten(self) -> Self:
        """Without the scans: they won't be looked at again."""
        return replace(self, scans=()) if self.scans else self
