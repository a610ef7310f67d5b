"""Whether all hypotheses are wrong, as evidence tells: docs/model.md, (M206) and (M253).

Innovations can't tell a world that is wrong but fits itself; evidence can, if there is something to set it
against: the best pose by one scan alone, as if nothing had ever been heard.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

from gridslam.inference.health import reasons

ENOUGH_LOUD, LOW_LEAD = 6.0, 4.0
"""Loud measurements needed to call a map worth nothing, and the lead of each, nats, below which it is."""
ONE_ALONE, ELSEWHERE = 15.0, 5.0
"""Nats by which a scan is explained better elsewhere if one measurement is the line of sight there; and
beyond those, with forgetting, from which on a place is called wrong."""
KEEP, FADING = 0.5, 0.25
"""Forgetting of leads, and of what fits elsewhere, from one comparison to the next."""


@dataclass(frozen=True)
class Doubt:
    """What is kept to tell whether all hypotheses are wrong.

    Attributes
    ----------
    lead, loud : float
        Log evidence above that of the best pose without any map, and loud measurements, with forgetting.
    doubtful : int
        Steps for which another search by one scan alone is worth while.
    elsewhere : float
        By how much a scan and no map favour another pose than the believed one, nats beyond what one
        measurement can say, with forgetting.
    """

    lead: float = 0.0
    loud: float = 0.0
    doubtful: int = 0
    elsewhere: float = 0.0

    FORMER_NAMES: ClassVar = ("Watch",)

    def compared(self, evidence: float, best: float, here: float, loud: int) -> Self:
        """Take in a comparison.

        Parameters
        ----------
        evidence : float
            Of the likeliest hypothesis at this step, nats.
        best, here : float
            Scores by the scan alone of the best pose, and of the best near the believed one, nats.
        loud : int
            Loud measurements of the scan.
        """
        return replace(
            self, lead=KEEP * self.lead + evidence - best, loud=KEEP * self.loud + loud,
            elsewhere=FADING * self.elsewhere + max(best - here - ONE_ALONE, 0.0),
        )  # fmt: skip

    def reasons(self) -> list[str]:
        """What speaks against all hypotheses.

        Any one measurement may be the line of sight of another pose, and one line of sight tells a fresh
        start as much as a right map: what several say together counts.
        """
        found = []
        if self.loud >= ENOUGH_LOUD and self.lead < LOW_LEAD * self.loud:
            found.append(reasons.fresh_start(self.lead / self.loud))
        if self.elsewhere > ELSEWHERE:
            found.append(reasons.elsewhere(self.elsewhere))
        return found
