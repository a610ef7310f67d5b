"""What several agents hear at one step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.world.given import time_of
from gridslam.world.scan import Scan, require_time


@dataclass(frozen=True, eq=False)
class NetworkScan:
    """What all agents heard at one step.

    Attributes
    ----------
    step : int
    time_s : float
    scans : tuple of Scan or None
        One for each agent, empty where it heard nothing; None where it isn't there.
    """

    step: int
    time_s: float
    scans: tuple[Scan | None, ...]

    def __len__(self) -> int:
        """Rows of all agents."""
        return sum(len(scan) for scan in self.scans if scan is not None)

    def content(self) -> Iterator[NDArray[Any] | None]:
        """All columns of all agents in a fixed order; None for an agent that isn't there."""
        for scan in self.scans:
            if scan is None:
                yield None
            else:
                yield from scan.content()

    def checked(
        self, anchors: int, after: float | None = None, agents: int | None = None, pseudo: bool = False
    ) -> NetworkScan:
        """The scan as arrays, if a filter can make sense of it.

        Parameters
        ----------
        anchors, agents : int
            How many there are.
        after : float, optional
            Time of the scan before, s.
        pseudo : bool
            Whether distances hold offsets of clocks, and may be negative.

        Raises
        ------
        InputError
            Another number of agents, rows at another time, a time that is NaN or not later than that
            of the scan before, or any fault of a row; see `Scan.checked`.
        """
        if isinstance(self.scans, Mapping) or not all(isinstance(s, Scan | None) for s in self.scans):
            raise InputError(
                "scan: scans", type(self.scans).__name__, "a Scan for each agent, in order, or None"
            )
        time = time_of(self.time_s, "scan")
        require_time("scan", time, after)
        if agents is not None and len(self.scans) != agents:
            raise InputError(
                "scan: scans",
                f"{len(self.scans)} agents",
                f"{agents}, None for an absent one"
                + (" (agents=[...] follows several)" if agents == 1 else ""),
            )
        whole = []
        for scan in self.scans:
            if scan is not None and (scan.step, scan.time_s) != (self.step, self.time_s):
                found = f"step {scan.step} at {scan.time_s} s"
                raise InputError("scan: scans", found, f"step {self.step} at {self.time_s} s for all agents")
            whole.append(None if scan is None else scan.checked(anchors, after, True, pseudo))
        return replace(self, time_s=time, scans=tuple(whole))
