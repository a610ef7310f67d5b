"""Whether all hypotheses are wrong, as evidence tells: docs/model.md, (M206), (M253) and (M471).

Innovations can't tell a world that is wrong but fits itself; evidence can, if there is something to set it
against: the best pose by one scan alone, as if nothing had ever been heard.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import LATER
from gridslam.inference.health import reasons

ENOUGH_LOUD, LOW_LEAD = 6.0, 4.0
"""Loud measurements needed to call a map worth nothing, and the lead of each, nats, below which it is."""
ONE_ALONE, ELSEWHERE = 15.0, 5.0
"""Nats by which a scan is explained better elsewhere if one measurement is the line of sight there; and
beyond those, with forgetting, from which on a place is called wrong."""
LOW_EVIDENCE, ONE_UNEXPLAINED = 10.0, 8.0
"""Of each loud measurement, nats, below which a step is hardly explained; what stands for the 15 then."""
ASKED_EVIDENCE = 20.0
"""Evidence of each loud measurement, nats, below which a step is compared at once."""
BY_CHANCE, SURPLUS = 2.0, 15.0
"""Nats by which the best pose of many may explain a scan better by chance; and sum of what is beyond, from
which on a place is called wrong."""
ALIKE = 1.0
"""Nats by which two searches for a best pose may differ."""
KEEP, FADING = 0.5, 0.25
"""Forgetting of leads, and of what fits elsewhere, from one comparison to the next."""
PROOF_LEAD, PROOF_LOUD = 10.0, 20.0
"""Lead of each loud measurement, nats, that bears out a start for which too many places fitted; as many nats
as so many of them have are needed anyway."""
TOLD_BY_SIGHT = 10.0
"""Nats that lines of sight have to be louder by than reflections to bear out such a start."""
DOUBT_STEPS, SPREAD_M = 50, 0.3
"""For how long a doubt keeps the search for challengers going; spread of the position that is one."""
PLACE_COUNTS = 1e-4
"""Weight from which on a place is one that remains: evidence is that of beliefs that were vague, and of maps
that are a little off."""


@dataclass(frozen=True)
class Doubt:
    """What is kept to tell whether all hypotheses are wrong.

    Attributes
    ----------
    lead, loud : float
        Log evidence above that of the best pose without any map, and loud measurements, with forgetting; of
        steps at which that pose is elsewhere.
    doubtful : int
        Steps for which another search by one scan alone is worth while.
    elsewhere : float
        By how much a scan and no map favour another pose than the believed one, nats beyond what one
        measurement can say, with forgetting.
    surplus : float
        By how much poses elsewhere, without a map, explained steps better than the likeliest hypothesis did
        with its map, nats; (M471).
    unproven : bool
        Whether the start was taken from a list that lacks places, and nothing has borne it out since.
    borne, counted : float
        Lead and loud measurements since then, or since all spoke against it.
    sighted : float
        What loudness says since then for lines of sight against reflections, nats.
    turnable : bool
        Whether nothing tells by how much all is turned about the one anchor.
    raised : bool
        Whether the latest step spoke against all hypotheses, and those before didn't.
    """

    lead: float = 0.0
    loud: float = 0.0
    doubtful: int = 0
    elsewhere: float = 0.0
    unproven: bool = field(default=False, metadata=LATER)
    borne: float = field(default=0.0, metadata=LATER)
    counted: float = field(default=0.0, metadata=LATER)
    turnable: bool = field(default=False, metadata=LATER)
    raised: bool = field(default=False, metadata=LATER)
    surplus: float = field(default=0.0, metadata=LATER)
    sighted: float = field(default=0.0, metadata=LATER)

    FORMER_NAMES: ClassVar = ("Watch",)

    def followed(self, variance_m2: float, hypotheses: int) -> Self:
        """A step on, with that variance of the position (both axes), and so many hypotheses."""
        doubtful = max(self.doubtful - 1, 0)
        if variance_m2 > SPREAD_M**2 or hypotheses > 1 or self.unproven:
            doubtful = DOUBT_STEPS
        if doubtful == self.doubtful and not self.raised:
            return self
        return replace(self, doubtful=doubtful, raised=False)

    def is_urgent(self, evidence: float, loud: float) -> bool:
        """Whether a step asks for a comparison at once; with the numbers of `compared`."""
        doubted = self.elsewhere > ELSEWHERE or self.surplus > 0
        return loud > 0 and (doubted or evidence < ASKED_EVIDENCE * loud)

    def compared(
        self, evidence: float, best: float, here: float, mirrored: float, loud: float, due: bool = True
    ) -> Self:
        """Take in a comparison.

        Parameters
        ----------
        evidence : float
            Of the likeliest hypothesis at this step, nats.
        best, here, mirrored : float
            Scores by the scan alone of the best pose, and of the best near the believed one, nats, and what
            one mirror may add to a line of sight's part in the best.
        loud : float
            Loud measurements of the scan.
        due : bool
            Whether it counts for the lead, too, and for another place however well the step is explained:
            urgent ones would count wrong steps alone.
        """
        hardly, elsewhere = evidence < LOW_EVIDENCE * loud, self.elsewhere
        if due or hardly or elsewhere > ELSEWHERE:
            alone = ONE_UNEXPLAINED if hardly else ONE_ALONE
            elsewhere = FADING * elsewhere + max(best - mirrored - here - alone, 0.0)
        rival = best > here + ALIKE  # one that stands where the agent is believed to be bears that out
        gain = best - evidence - BY_CHANCE
        after = replace(
            self,
            elsewhere=elsewhere,
            surplus=max(self.surplus + (gain if rival else min(gain, 0.0)), 0.0),
        )
        if due:
            lead = KEEP * self.lead + rival * (evidence - best)
            after = replace(after, lead=lead, loud=KEEP * self.loud + rival * loud)
        return after._raised_since(self)

    def scored(self, best: float, here: float, mirrored: float) -> Self:
        """Take in scores as of `compared`, where no evidence says more; (M522)."""
        beyond = max(best - mirrored - here - ONE_ALONE, 0.0)
        return replace(self, elsewhere=FADING * self.elsewhere + beyond)._raised_since(self)

    def _raised_since(self, before: Doubt) -> Self:
        """The doubt with a search of other places, if anything speaks against all hypotheses."""
        if not self.against():
            return self
        return replace(self, doubtful=DOUBT_STEPS, raised=not before.against())

    def tried(self, lead: float, loud: float, sighted: float = 0.0) -> Self:
        """Take in by how much the likeliest hypothesis leads a start anew at a step, nats; (M392), (M551).

        Parameters
        ----------
        sighted : float
            What the scan says for its lines of sight against reflections, nats.
        """
        told = replace(self, sighted=max(self.sighted + sighted, 0.0))
        if told.sighted >= TOLD_BY_SIGHT:
            return told.proven()
        if self.borne + lead <= 0:
            return replace(told, borne=0.0, counted=0.0)
        after = replace(told, borne=self.borne + lead, counted=self.counted + loud)
        enough = PROOF_LEAD * max(after.counted, PROOF_LOUD)
        return after.proven() if after.borne >= enough else after

    def proven(self) -> Self:
        """The start is borne out: what is believed is no longer one of many places."""
        return replace(self, unproven=False)

    def reasons(self) -> list[str]:
        """What speaks against all hypotheses, and what their start leaves open."""
        found = self.against()
        if self.unproven:
            found.append(reasons.UNPROVEN)
        if self.turnable:
            found.append(reasons.TURNABLE)
        return found

    def against(self) -> list[str]:
        """What speaks against all hypotheses.

        Any one measurement may be the line of sight of another pose, and one line of sight tells a fresh
        start as much as a right map: what several say together counts.
        """
        found = []
        if self.loud >= ENOUGH_LOUD and self.lead < LOW_LEAD * self.loud:
            found.append(reasons.fresh_start(self.lead / self.loud))
        if self.elsewhere > ELSEWHERE or self.surplus > SURPLUS:
            found.append(reasons.elsewhere(max(self.elsewhere, self.surplus)))
        return found


def places(log_weight: Sequence[float], together: Callable[[Sequence[int]], NDArray[np.bool_]]) -> int:
    """How many places the agent may be at: hypotheses that count, merged by pose alone.

    Parameters
    ----------
    log_weight : (K,)
        Of the hypotheses.
    together : callable
        Which of some hypotheses (N,) are at one place, (N, N).
    """
    rows = [k for k, log in enumerate(log_weight) if log > np.log(PLACE_COUNTS)]
    if len(rows) < 2:
        return 1
    near = together(rows)
    label = np.arange(len(rows))
    for _ in rows:  # each passes its number on to those beside it, the least one stays
        label = np.where(near, label, len(rows)).min(1)
    return len(np.unique(label))
