"""Clocks that aren't set yet: a histogram over each anchor's offset; docs/model.md, (M101), (M496).

Where agents' own clocks are wide, too, an anchor's offset is searched for in each *frame* of its own: the
common time, and every such agent's clock, until an anchor that is set in both ties two frames together.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import LATER, Array
from gridslam.world.clocks import ClockModel

CELL_M = 0.1
NARROW_M = 1.0
"""Half width of a prior up to which a clock counts as set; distance from the peak that counts as decided."""
LOBE_M, LOBE_VARIANCE = 2.5, 0.5
"""The same of a single mode as wide as poses are uncertain at first, and its largest variance (m^2)."""
SURE = 0.999
"""Share of the mass that lies there once a clock is set: at 0.99, clutter alone sets one in a hundred."""
FIRST_STEPS = 3
"""Steps of a search in which poses wait for it: a mode that is likely, but not sure, becomes a hypothesis."""
UNTIED_STEPS = 10
"""The same of agents whose clocks nothing ties to the others' yet, where measurements have no labels."""
MODE_COUNTS = 1e-5
"""Share of the mass from which on a rival mode is kept, where they are: steps share the pose's error."""
FORGETTING, CHALLENGED = 0.7, 14.0
"""Share of older evidence about a set clock that counts, and nats for another offset that open it again."""
SET_VARIANCE = 1.0
"""Variance (m^2) of an offset that a histogram has set: it has chosen the mode, no more."""
SHARED = 4.0
"""By how much larger the variance of a mode is than it seems, where agents' clocks are wide."""
NEVER = -1e9
"""Log of no mass."""
ELSEWHERE = 1e-13
"""Share of the mass outside of a mode that a hypothesis of it keeps."""


def none_moved() -> Array:
    """Nothing was said yet about agents' clocks."""
    return np.zeros((0, 0))


def one_frame() -> NDArray[np.intp]:
    """Frames of agents where none's clock is wide: that of the common time alone."""
    return np.zeros(0, np.intp)


@dataclass(frozen=True, eq=False)
class ClockSearch:
    """Which anchors' clocks are open, and what is known of their offsets.

    There are R = J rows, or R = (1 + I) J where an agent's clock is wide: those of the common time's frame,
    then of the frames of the agents' clocks, each of all anchors.

    Attributes
    ----------
    unset : (R,) bool
    log : (R, C)
        Log mass of every cell, 0 at the peak; of a set clock, evidence since it was set.
    centre : (C,) m
        Offsets in a frame: an anchor's clock less that of the agent whose frame it is.
    since : (R,) int
        Steps searched since the clock was opened.
    doubt : (R,) nats
        Of a set clock: how surely all paths of its anchor fell silent at once, while others were heard.
    frame : (I,) int
        Each agent's frame: 0 for the common time, ``1 + i`` for agent i's clock. Empty where no agent's clock
        is wide: then all are in frame 0.
    moved : (I, C) nats
        By which lines of sight have lately stood for another clock of each agent, so much earlier; or empty.
    """

    unset: NDArray[np.bool_]
    log: Array
    centre: Array
    since: NDArray[np.intp]
    doubt: Array
    frame: NDArray[np.intp] = field(default_factory=one_frame, metadata=LATER)
    moved: Array = field(default_factory=none_moved, metadata=LATER)

    @classmethod
    def start(cls, clocks: ClockModel) -> ClockSearch:
        """Uniform over each anchor's prior; narrow priors are no search."""
        anchors, own = np.split(clocks.half_width_m, [clocks.anchors])
        wide = own > NARROW_M
        half = anchors if not wide.any() else np.concatenate([anchors, np.add.outer(own, anchors).ravel()])
        reach = int(np.ceil(half.max(initial=0.0) / CELL_M)) if (half > NARROW_M).any() else 0
        centre = np.asarray(CELL_M * np.arange(-reach, reach + 1), np.float64)
        log = np.where(np.abs(centre) <= half[:, None], 0.0, NEVER)
        none = np.zeros(len(half))
        unset, frame = half > NARROW_M, one_frame()
        if wide.any():
            unset[clocks.anchors :] = np.repeat(wide, clocks.anchors)
            frame = np.where(wide, 1 + np.arange(len(own)), 0)
        return cls(unset, log, centre, none.astype(np.intp), none, frame)

    @property
    def half_widths(self) -> Array:
        """Of what is possible, about 0 (R,), m."""
        return np.asarray(np.where(self.log > NEVER, np.abs(self.centre), 0.0).max(1))

    @property
    def framed(self) -> bool:
        """Whether agents' clocks are wide, so that frames are told apart."""
        return len(self.frame) > 0

    @property
    def anchors(self) -> int:
        """J."""
        return len(self.unset) // (1 + len(self.frame))

    def frame_of(self, agent: int) -> int:
        """The frame that an agent's clock is tied to."""
        return int(self.frame[agent]) if self.framed else 0

    def rows(self, frame: int) -> slice:
        """Rows of a frame, one for each anchor."""
        return slice(frame * self.anchors, (frame + 1) * self.anchors)

    def open_to(self, agent: int) -> NDArray[np.bool_]:
        """Anchors (J,) whose distances tell an agent nothing yet."""
        return self.unset[self.rows(self.frame_of(agent))]

    def adrift(self, agent: int) -> bool:
        """Whether no anchor's clock tells an agent anything, since its own is wide."""
        return self.framed and bool(self.frame_of(agent) > 0 and self.open_to(agent).all())

    def contested(self, agent: int) -> bool:
        """Whether lines of sight stand for another clock of an agent, if not enough to set it there yet."""
        return len(self.moved) > 0 and bool(self.moved[agent].max(initial=0.0) > CHALLENGED)

    def bearing(self, agent: int, labelled: bool) -> NDArray[np.bool_]:
        """Anchors (J,) whose paths to an agent may bear surfaces.

        Where nothing says whose a path is, and agents' clocks are wide, the few anchors that are set at first
        would bear everybody's paths: none does until the others have had time to be set, too.
        """
        own = ~self.open_to(agent)
        if labelled or not self.framed or own.all():
            return own
        tied = self.frame_of(agent) == self.main_frame
        age = self.since[self.rows(self.frame_of(agent))][~own].max()
        return own & (age > (FIRST_STEPS if tied else UNTIED_STEPS))

    @property
    def main_frame(self) -> int:
        """The common time's frame, if anything is in it, else the one in which most agents are."""
        count = np.bincount(self.frame, minlength=1 + len(self.frame))
        common = not self.framed or count[0] > 0 or not self.unset[self.rows(0)].all()
        return 0 if common else int(count.argmax())

    @property
    def unset_anchors(self) -> NDArray[np.bool_]:
        """Anchors (J,) whose clocks are searched for in the main frame."""
        return self.unset[self.rows(self.main_frame)]

    @property
    def searched(self) -> NDArray[np.bool_]:
        """Rows (R,) that are unset, of frames in which agents are."""
        return np.asarray(self.unset & self.taken)

    @property
    def taken(self) -> NDArray[np.bool_]:
        """Rows (R,) of frames in which agents are."""
        if not self.framed:
            return np.ones(len(self.unset), bool)
        return np.repeat(np.bincount(self.frame, minlength=1 + len(self.frame)) > 0, self.anchors)

    @property
    def mass(self) -> Array:
        """Probability of every cell, (R, C)."""
        share = np.exp(self.log)
        return np.asarray(share / share.sum(1, keepdims=True))

    def walked(self, variance: float) -> ClockSearch:
        """A step later: every offset has walked by this variance, m^2."""
        if not self.unset.any() or not variance:
            return self
        with np.errstate(divide="ignore"):
            log = np.maximum(np.log(diffused(self.mass, variance)), NEVER)
        return replace(self, log=np.where(self.log > NEVER, log - log.max(1, keepdims=True), NEVER))

    def within(self, anchor: int, cells: NDArray[np.bool_], variance: float = 0.0) -> ClockSearch:
        """With a clock's offset taken to be in some cells (C,), once it has walked by a variance, m^2.

        A share of `ELSEWHERE` stays in all others: what makes a mode seem right or wrong may be clutter.
        """
        reach = np.maximum(diffused(cells[None].astype(np.float64), variance)[0], ELSEWHERE)
        log, allowed = self.log.copy(), self.log[anchor] > NEVER
        own = log[anchor] + np.log(reach)
        log[anchor] = np.where(allowed, own - own.max(), NEVER)
        return replace(self, log=log)

    def updated(self, evidence: Array) -> ClockSearch:
        """With the log evidence (R, C) of a step taken in."""
        log = self.log + np.where(self.unset[:, None], evidence, 0.0)
        log = np.maximum(log - log.max(1, keepdims=True), NEVER)
        return replace(self, log=log, since=np.where(self.unset, self.since + 1, 0))

    def challenged(
        self, closed: NDArray[np.bool_], evidence: Array, mean: Array, deviation: Array
    ) -> ClockSearch:
        """With set clocks opened again for which what was heard stands for another offset.

        Parameters
        ----------
        closed : (R,) bool
            The set clocks that are looked at.
        evidence : (R, C)
            Log evidence as if they were unknown. Older evidence is forgotten by and by.
        mean, deviation : (R, ...) m
            Of their offsets, as believed.
        """
        log, unset = self.log.copy(), self.unset.copy()
        for anchor in np.flatnonzero(closed):
            allowed = log[anchor] > NEVER
            log[anchor, allowed] = FORGETTING * log[anchor, allowed] + evidence[anchor, allowed]
            own = np.abs(self.centre - mean[anchor]) <= max(NARROW_M, 4 * deviation[anchor])
            if (allowed & own).any():  # else it has left its prior, and isn't looked for there
                rival = np.max(log[anchor, allowed & ~own], initial=NEVER)
                unset[anchor] = rival - log[anchor, allowed & own].max() > CHALLENGED
            log[anchor, allowed] -= log[anchor, allowed].max()
        doubt = np.where(unset, 0.0, self.doubt)
        return replace(self, log=log, unset=unset, doubt=doubt)

    def decided(self, rivals: bool = False) -> list[tuple[int, float]]:
        """Open clocks whose mass lies about one peak, and its mean there (m).

        Parameters
        ----------
        rivals : bool
            Whether other modes are kept as hypotheses: then none that counts may be left.
        """
        found, mass = [], self.mass
        for anchor in np.flatnonzero(self.searched & (self.since > 0)):
            far = np.abs(self.centre - self.centre[mass[anchor].argmax()])
            sure = 1 - MODE_COUNTS if rivals else SURE
            for reach, widest in ((NARROW_M, np.inf), (LOBE_M, LOBE_VARIANCE)):
                near = far <= reach
                share = mass[anchor, near].sum()
                mean = mass[anchor, near] @ self.centre[near] / share
                variance = mass[anchor, near] @ (self.centre[near] - mean) ** 2 / share
                if share >= sure and variance <= widest:
                    found.append((int(anchor), float(mean)))
                    break
        return found

    def surest(self, found: list[tuple[int, float]]) -> list[tuple[int, float]]:
        """Of the clocks that could be set, the one of each frame that most was heard of.

        The others wait: with its angles, poses are known far better, by which the others are told apart.
        """
        flat = np.median(self.log, axis=1)
        best: dict[int, tuple[int, float]] = {}
        for row, offset in sorted(found, key=lambda one: flat[one[0]]):
            best.setdefault(row // self.anchors, (row, offset))
        return list(best.values())

    def mode_variance(self, row: int, mean: float) -> float:
        """Variance of an offset about the mode that it is set to, with errors that steps share, m^2."""
        near = np.abs(self.centre - mean) <= LOBE_M
        mass = self.mass[row, near]
        spread = float(mass @ (self.centre[near] - mean) ** 2 / mass.sum())
        return min(max(SHARED * spread, CELL_M**2), SET_VARIANCE)

    def begun_anew(self, frame: int) -> ClockSearch:
        """With what was heard of a frame's open clocks forgotten, as poses were known too little for it."""
        log, own = self.log.copy(), self.rows(frame)
        log[own] = np.where((log[own] > NEVER) & self.unset[own, None], 0.0, log[own])
        return replace(self, log=log)

    def forgotten(self, frame: int) -> ClockSearch:
        """With nothing heard of a frame's set clocks since they were set, as an agent's clock was another."""
        log, own = self.log.copy(), self.rows(frame)
        log[own] = np.where((log[own] > NEVER) & ~self.unset[own, None], 0.0, log[own])
        return replace(self, log=log)

    def moments(self, anchor: int) -> tuple[float, float]:
        """Mean (m) and variance (m^2) of an offset over all of its modes."""
        mass = self.mass[anchor]
        mean = float(mass @ self.centre)
        return mean, float(mass @ (self.centre - mean) ** 2)

    def closed(self, anchor: int) -> ClockSearch:
        """With a clock set."""
        unset, doubt, log = self.unset.copy(), self.doubt.copy(), self.log.copy()
        unset[anchor], doubt[anchor] = False, 0.0
        log[anchor] = np.where(log[anchor] > NEVER, 0.0, NEVER)
        return replace(self, unset=unset, doubt=doubt, log=log)

    def opened(self, anchor: int, clocks: ClockModel) -> ClockSearch:
        """With a clock open again, about which nothing is known but its prior."""
        fresh = ClockSearch.start(clocks)
        unset, log, since, doubt = self.unset.copy(), self.log.copy(), self.since.copy(), self.doubt.copy()
        unset[anchor], log[anchor], since[anchor], doubt[anchor] = True, fresh.log[anchor], 0, 0.0
        return replace(self, unset=unset, log=log, since=since, doubt=doubt)


def diffused(mass: Array, variance: float) -> Array:
    """Mass of cells (R, C) after a walk of this variance, m^2; nothing leaves at the ends."""
    share = 0.5 * variance / CELL_M**2
    if share < 0.5:  # less than a cell: a step of diffusion
        ends = np.pad(mass, ((0, 0), (1, 1)), mode="edge")
        return np.asarray(mass + share * (ends[:, 2:] - 2 * mass + ends[:, :-2]))
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(mass, np.sqrt(variance) / CELL_M, axis=1, mode="nearest"))
