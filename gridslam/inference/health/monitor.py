"""Whether measurements fit the belief, as a filter itself can judge. Nothing here needs the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from gridslam.arrays import LATER, Array, replace
from gridslam.estimates import Health
from gridslam.inference.beliefs.calibration import KEEP, Calibration
from gridslam.inference.health import reasons
from gridslam.inference.health.fresh_look import FreshLook
from gridslam.kernels import LOUD_ONES, SUMS
from gridslam.world.filter_model import FilterModel

SLOW = 0.03
"""Share of news that enters what is usual."""
SILENT, LOST, MISFIT, LOUD_CLUTTER, FEW, VAGUE_M = 5, 0.5, 1.7, 3.0, 3.0, 1.0
"""When something is amiss: steps of silence; share of the usual explained; ratio of innovations to what is
expected; of clutter; effective particles; position's standard deviation."""
FEW_UNEXPLAINED = 0.75
"""Measurements a step that nothing explains, of an anchor (of all where nothing says whose they are), up to
which none are clutter: paths over two walls, walls that are still to be born."""
CALLED = 4.26
"""Deviations beyond which innovations are called too large: 1 step in 100 000 by chance; runs are long."""
UNCHECKED_M = 0.3
"""Standard deviation of the position from which on somebody has to tell whether it is the right place."""
BLIND_M, SEEN = 0.5, 0.9
"""Standard deviation beyond which reflections alone may lead to another place, so far off as counts as wrong;
existence of a line of sight that tells."""
LISTENED = 2.0
"""Steps of listening to an anchor, with forgetting, from which on its clutter is judged."""
MOST_LOUD = 30
"""The loudest of an anchor, which propose poses where the agent is looked for."""
SWAMPED = 150
"""Loud measurements of one anchor beyond which a scan fits nearly any place, so that no place is compared."""
AFRESH, ENOUGH, UNCERTAIN = 5, 4, 20
"""Steps for which a recovery is reported; loud measurements needed to call the agent lost, and, over some ten
steps, to call it found; scans of fewer after which it no longer counts as lost."""
TRUSTED, DISTRUSTED = 20, 100
"""Steps from being well, within which a place counts as where the agent was; and for which another isn't
trusted that no motion led to from there."""
MOUNTED = 3.0
"""Deviations of an anchor's orientation up to which a turn is what was to be expected."""
NO_FIT = np.append(np.zeros(SUMS - 1), np.inf)
"""Sums of an anchor before its measurements were taken in."""


@dataclass(frozen=True)
class HealthMonitor:
    """How well measurements have fitted lately.

    Attributes
    ----------
    misfit, freedom : float
        Normalised innovations squared of sure associations, and their degrees of freedom: numbers measured
        with finite deviations.
    explained, loud : float
        Measurements too loud for clutter that known paths explain, and all such.
    usual, near : float
        Share of them that is explained, and that lies where a line of sight or a single bounce is predicted,
        in the long run.
    silent, since : int
        Steps of silence so far; steps since the agent was found again.
    crowd : int
        Loud measurements of one anchor at this step, if too many for all to propose poses; else 0.
    dropped : int
        Surfaces believed in that are in sight and were set aside (or, of methods that park none, dropped) at
        this step, since one joint belief takes only so many.
    lost : int
        Steps for which the agent counts as lost if too little is heard to tell; 0 while it is followed.
    look : FreshLook
        Of an agent of a network: what lines of sight alone have said of it lately.
    leap_m, since_leap : float, int
        How far from where its motion led a trusted agent was found (m), and steps since; (M512).
    since_well : int
        Steps since health was well.
    blind_m : float
        Largest standard deviation of the position since a line of sight was seen, m; (M533).
    early : float
        Of an agent of a network: share of the latest steps at which a path arrived before any line of sight.
    off : int
        Steps for which nobody has listened, (M580).
    trial : int
        Steps for which this place, put up against one that is called wrong, isn't given up.
    """

    misfit: float = 0.0
    freedom: float = 0.0
    explained: float = 0.0
    loud: float = 0.0
    usual: float = 0.0
    near: float = 0.0
    silent: int = 0
    since: int = 1_000_000
    crowd: int = 0
    dropped: int = 0
    off: int = field(default=0, metadata=LATER)
    lost: int = field(default=0, metadata=LATER)
    look: FreshLook = field(default=FreshLook(), metadata=LATER)
    leap_m: float = field(default=0.0, metadata=LATER)
    since_leap: int = field(default=1_000_000, metadata=LATER)
    since_well: int = field(default=1_000_000, metadata=LATER)
    blind_m: float = field(default=0.0, metadata=LATER)
    early: float = field(default=0.0, metadata=LATER)
    trial: int = field(default=0, metadata=LATER)

    def next_step(self, scan_size: int) -> Self:
        """A new step with `scan_size` measurements."""
        return replace(
            self,
            misfit=KEEP * self.misfit,
            freedom=KEEP * self.freedom,
            explained=KEEP * self.explained,
            loud=KEEP * self.loud,
            silent=0 if scan_size else self.silent + 1,
            off=0 if scan_size else self.off,
            since=self.since + 1,
            since_leap=self.since_leap + 1,
            since_well=self.since_well + 1,
            crowd=0,
            dropped=0,
            trial=max(self.trial - 1, 0),
        )

    def fitted(self, fits: Array) -> Self:
        """Take in how the measurements of all anchors fitted, (J, 9); see `gridslam.kernels.SUMS`."""
        misfit, freedom, _, _, explained, loud = fits[:, : LOUD_ONES + 1].sum(0).tolist()
        return replace(
            self,
            misfit=self.misfit + misfit,
            freedom=self.freedom + freedom,
            explained=self.explained + explained,
            loud=self.loud + loud,
        )

    def is_lost(self, count: int, near: int) -> bool:
        """Whether, of `count` loud measurements, far fewer than usual lie where a path is predicted."""
        return count >= ENOUGH and bool(near < LOST * self.near * count)

    @property
    def astray(self) -> bool:
        """Whether the agent is lost, or was found again so lately that it may be the wrong place."""
        return self.lost > 0 or self.since < AFRESH

    def followed(self, count: int, near: int) -> Self:
        """Take in how many loud measurements lie where a path is predicted, at a step that isn't lost."""
        if count < ENOUGH:  # too few to tell: in the end it counts as followed again
            return replace(self, lost=max(self.lost - 1, 0)) if count else self
        return replace(self, near=self.near + SLOW * (near / count - self.near), lost=0)

    def sighted(self, spread_m: float, sights: Array) -> Self:
        """Take in how well the position is known, and existences of lines of sight (J,), after a step."""
        if self.silent:  # wider by silence, not misled by what is heard
            return self
        blind = 0.0 if (sights > SEEN).any() else max(self.blind_m, spread_m)
        return self if blind == self.blind_m else replace(self, blind_m=blind)

    def found_again(self) -> Self:
        """The agent was found by other means than following it."""
        return replace(self, since=0, lost=0)

    def leapt(self, metres: float) -> Self:
        """The agent is taken to be elsewhere, so far from where its motion led; 0 if it may have led there.

        One that hasn't been well for long was somewhere else all the while; and one that leaps again is still
        where its first leap led.
        """
        surprises = metres > 0 and self.since_well <= TRUSTED and not self.distrusted
        return replace(self, leap_m=metres, since_leap=0) if surprises else self

    def judged(self, well: bool) -> Self:
        """Health was well at this step, or wasn't."""
        return replace(self, since_well=0) if well else self

    @property
    def distrusted(self) -> bool:
        """Whether the place is one that no motion led to: it may be another world, in which all is wrong."""
        return self.since_leap < DISTRUSTED

    def still_lost(self) -> Self:
        """The agent was lost at this step, and not found."""
        return replace(self, lost=UNCERTAIN)

    def assess(
        self, calibration: Calibration, turned: Array, model: FilterModel, spread_m: float, effective: float
    ) -> tuple[Health, Self]:
        """Say how things are.

        Parameters
        ----------
        turned : (J,) rad
            By which the anchors were taken to be turned at this step.
        spread_m : float
            Standard deviation of the position.
        effective : float
            Least effective number of particles behind a sure association.

        Returns
        -------
        (health, monitor)
            With the usual share learned, unless the scan was empty.
        """
        share = (self.explained + 1) / (self.loud + 1)
        ratio = self.misfit / self.freedom if self.freedom > 0 else 1.0
        clutters = [
            calibration.estimate(j, model.radio.false_alarms) for j in range(len(calibration.clutter))
        ]
        found = [
            *self._of_place(spread_m), *self._of_fit(share, ratio),
            *self._of_anchors(calibration, clutters, turned, model), *self._of_limits(effective, model),
        ]  # fmt: skip
        health = Health(
            not found, "; ".join(found), effective, ratio, innovation_band(self.freedom), share,
            np.array(clutters), calibration.gain, calibration.turned.copy(), self.silent,
        )  # fmt: skip
        if self.silent:
            return health, self
        return health, replace(
            self, usual=self.usual + (SLOW if self.usual > 0 else 1.0) * (share - self.usual)
        )

    def _of_place(self, spread_m: float) -> list[str]:
        """What is amiss with where the agent is."""
        found = []
        if self.silent >= SILENT:
            found.append(reasons.silent(self.silent))
        if spread_m > VAGUE_M:
            found.append(reasons.vague(spread_m))
        elif spread_m > UNCHECKED_M and self.loud < ENOUGH:
            found.append(reasons.unchecked(spread_m, self.silent > 0))
        elif self.blind_m > BLIND_M and not self.silent:
            found.append(reasons.blind(self.blind_m))
        found += self.look.reasons()
        if self.since < AFRESH:
            found.append(reasons.found_again(self.since))
        if self.distrusted:
            found.append(reasons.leapt(self.leap_m, self.since_leap))
        return found

    def _of_fit(self, share: float, ratio: float) -> list[str]:
        """What is amiss with how measurements fit: the share that is explained, their mean misfit."""
        found = []
        _, called = innovation_band(self.freedom, CALLED)
        if self.usual > 0 and share < LOST * self.usual:
            found.append(reasons.few_explained(share, self.usual))
        if ratio > max(called, MISFIT):
            found.append(reasons.misfit(ratio))
        return found

    def _of_anchors(
        self, calibration: Calibration, clutters: list[float], turned: Array, model: FilterModel
    ) -> list[str]:
        """What is amiss with anchors: clutter of each (J), and turns (J,), rad, that nobody expects."""
        found, stated = [], model.radio.false_alarms
        # at first, walls that are still to be born pass for clutter
        known = (calibration.listened >= LISTENED).tolist()
        levels = [level for level, has_level in zip(clutters, known, strict=True) if has_level]
        clutter = max(levels, default=0.0)
        if clutter > max(LOUD_CLUTTER * stated, FEW_UNEXPLAINED):
            found.append(reasons.clutter(clutter, stated))
        unlikely = np.where(np.abs(turned) > MOUNTED * model.orientation_std, turned, 0.0)
        if unlikely.any() and not self.distrusted:
            found.append(most_turned(unlikely, model))
        return found

    def _of_limits(self, effective: float, model: FilterModel) -> list[str]:
        """What is amiss with the filter's own means: particles, places compared, surfaces held."""
        found = []
        # a Gaussian asks them for likelihoods alone
        if effective < FEW and model.settings.representation == "particles":
            found.append(reasons.few_particles(effective))
        if self.crowd:
            found.append(reasons.crowded(self.crowd, MOST_LOUD, self.crowd <= SWAMPED))
        if self.dropped:
            found.append(reasons.left_out(self.dropped))
        return found


def most_turned(turned: Array, model: FilterModel) -> str:
    """Which anchor is turned farthest by turns (J,), rad, in words."""
    worst = int(np.abs(turned).argmax())
    return reasons.turned(model.anchor_names[worst], float(np.degrees(turned[worst])))


def innovation_band(freedom: float, deviations: float = 3.09) -> tuple[float, float]:
    """Band of the mean normalised innovation squared, of 0.998 probability by default (Wilson, Hilferty)."""
    part = 2 / (9 * max(freedom, 1.0))
    reach = deviations * math.sqrt(part)
    return max(1 - part - reach, 0.0) ** 3, (1 - part + reach) ** 3
