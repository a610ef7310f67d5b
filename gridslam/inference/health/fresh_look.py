"""What lines of sight alone have said of an agent of a network lately; docs/model.md, (M492)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

from gridslam.inference.health import reasons

BEYOND_ONE = 35.0
"""Nats by which lines of sight have to tell another place: more than any one measurement can say."""
ANOTHER = 10.0
"""Nats that have to remain without the anchors that one mirror may show there."""
AGREED, TOGETHER_M = 3, 1.0
"""Looks in a row that have to put the agent at one other place; how far apart they may do so."""


@dataclass(frozen=True)
class FreshLook:
    """Whether lines of sight alone have put an agent elsewhere than it is believed to be.

    Attributes
    ----------
    nats : float
        By which the latest look favours another place.
    agreed : int
        Looks in a row, up to the latest, that put it at that place.
    x_m, y_m : float
        Where that is.
    """

    nats: float = 0.0
    agreed: int = 0
    x_m: float = 0.0
    y_m: float = 0.0

    @property
    def called(self) -> bool:
        """Whether the agent is believed to be at a wrong place."""
        return self.agreed >= AGREED

    def elsewhere(self, nats: float, x_m: float, y_m: float) -> Self:
        """A look that puts the agent elsewhere, `nats` better than where it is believed to be."""
        again = self.agreed and math.hypot(x_m - self.x_m, y_m - self.y_m) < TOGETHER_M
        return replace(self, nats=nats, agreed=self.agreed + 1 if again else 1, x_m=x_m, y_m=y_m)

    def here(self) -> Self:
        """A look that finds no better place."""
        return replace(self, nats=0.0, agreed=0) if self.agreed else self

    def reasons(self) -> list[str]:
        """What speaks against the believed place."""
        return [reasons.elsewhere(self.nats)] if self.called else []
