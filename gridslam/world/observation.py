"""What all kinds of observations have in common: paths that were measured, and signals that were sampled."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, Protocol, Self, runtime_checkable

from numpy.typing import NDArray

Kind = Literal["paths", "signal"]
"""What a method takes: path measurements, or sampled signals."""


@runtime_checkable
class Observation(Protocol):
    """What was heard at one step.

    `Scan` holds measured paths, `SignalScan` samples. The front of a filter needs no more of either;
    likelihoods, births and updates know which of them they take.
    """

    @property
    def step(self) -> int:
        """Number of the step."""
        ...

    @property
    def time_s(self) -> float:
        """When it was."""
        ...

    def __len__(self) -> int:
        """How much was heard; 0 if nothing."""
        ...

    def checked(self, anchors: int, after: float | None = None) -> Self:
        """The observation as arrays, if a filter can make sense of it.

        Raises
        ------
        InputError
            It can't.
        """
        ...

    def content(self) -> Iterator[NDArray[Any] | None]:
        """All that was heard, in a fixed order: what the identity of a run is made of. None: not measured."""
        ...
