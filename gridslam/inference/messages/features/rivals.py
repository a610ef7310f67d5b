"""Rival sets of new features for one segment, each with the way that it leads: evidence chooses.

What is proposed depends on where the agent is believed to have been, and leads it elsewhere in turn. So
features are proposed again along the way that came of them, for as long as that explains the segment better.
If one stands beside an anchor, all may be beside where it belongs: that is tried, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.messages.features.arrivals import COST, Arrivals, arrivals_of, contradictions
from gridslam.inference.messages.features.feature_likelihood import Front, Tables
from gridslam.inference.messages.features.following import START_STEPS
from gridslam.inference.messages.features.found_again import update_anywhere
from gridslam.inference.messages.features.proposals import surveys, with_proposals
from gridslam.inference.messages.features.seeding import LEAST_GAIN
from gridslam.inference.messages.features.silences import carried
from gridslam.inference.messages.features.strangers import update_beside_strangers
from gridslam.inference.messages.features.ways import apart, drifted, moved_starts, spread_m
from gridslam.inference.state.features.features import ENTRIES, MOVING
from gridslam.inference.state.features.hybrid_state import HybridState, JointBelief, Segment
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
CLEAR = 10.0
"""Nats by which one set has to explain a segment better than another to be preferred for it."""
SEEN = 200.0
"""Nats that it is worth in a new crowd that a set sees a line of sight where it should be: scores of sets
along ways that differ by decimetres scatter by as much."""
SHIFTED = 300.0
"""Nats by which a crowd that is shifted as a whole has to be better, unless it sees a line of sight then."""
HOPELESS = 60.0
"""Nats by which one has to be behind another at some step for the rest of the segment not to matter."""
ROUNDS, LATER_ROUNDS = 3, 1
"""Times, at most, that features are proposed along the way that the ones before led: of the first steps, when
the agent may be anywhere about its start, and of whole segments."""
MOVED_M = 0.1
"""Ways that are nowhere farther apart lead to the same features."""
SHIFTS, ASTRAY, STRONG = 2, 3.0, 0.2
"""Times that all is shifted. Deviations of the start within which a feature may be a line of sight seen from
a wrong place; its least power in that of the line of sight."""
REACH, LOUD = 2.0, 0.7
"""Deviations of the agent's unheard drift within which no feature may be so loud, in the power of a line of
sight, if that is to say where the agent is."""
FOLLOWED = 2
"""Of these, the best, that are followed up."""


class Rival(NamedTuple):
    """A set of features, and what the segment says of it.

    Attributes
    ----------
    score : float
        Log of the segment's evidence, less what so many features and contradictions cost, nats.
    joint : JointBelief
        At the segment's end.
    track : (K, 4)
    evidence : (K,)
        Log of each step's.
    start : JointBelief
        With the set at the segment's beginning.
    placed : bool
        Whether a line of sight is seen that says where the agent is, see `Lesson.placed`.
    known : bool
        Whether it goes on from features that say so, too.
    """

    score: float
    joint: JointBelief
    track: Array
    evidence: Array
    start: JointBelief
    placed: bool
    known: bool

    @property
    def owed(self) -> float:
        """Nats that what it costs takes from its evidence."""
        return float(self.evidence.sum()) - self.score if np.isfinite(self.score) else 0.0

    @property
    def adrift(self) -> bool:
        """Whether nothing says where all of a crowd is, so that its score may be so high by chance."""
        return self.joint.extent > 0 and not self.placed and not self.known

    def beats(self, other: Rival, by: float = 0.0) -> bool:
        """Whether this set is better by so many nats."""
        return best_of([other._replace(score=other.score + by), self]) is self


def best_of(rivals: list[Rival]) -> Rival:
    """The set that explains the segment best.

    In new crowds, one that sees its line of sight is preferred; features that are known place the agent.
    """
    crowd = any(one.joint.extent > 0 for one in rivals) and not any(one.known for one in rivals)
    return max(rivals, key=lambda one: one.score + SEEN * (crowd and one.placed))


@dataclass(frozen=True, eq=False)
class Lesson:
    """What rival sets of features have in common.

    Attributes
    ----------
    before : JointBelief
        At the beginning of the segment.
    before_s : float or None
        Time of the step before it.
    first, identity : int
        Number of its first step; of the next feature.
    judged : int
        Its last steps, of which no feature is made.
    drift_m : float
        Deviation of where the agent is half-way through it, before it is heard.
    samples : (K, J, N, M) complex128
        Of all its steps.
    tables : list of (K, N, T, 4) float32
        Matched outputs of every anchor: they are the same along any way.
    arrivals : list of list of Arrivals, (K, J)
        Of the first steps; of later segments none.
    front : Front
    model : SignalModel
    """

    before: JointBelief
    before_s: float | None
    first: int
    identity: int
    judged: int
    drift_m: float
    samples: Complex
    tables: list[Tables]
    arrivals: list[list[Arrivals | None]]
    front: Front
    model: SignalModel

    @classmethod
    def of(
        cls, state: HybridState, segment: Segment, judged: int, front: Front, model: SignalModel
    ) -> Lesson:
        """That of a state's segment, of the last `judged` steps of which no feature is made."""
        before, samples = state.before, segment.samples
        looks = segment if len(segment) <= START_STEPS else segment.first(0)
        return cls(
            before, state.before_s, state.step - len(segment), state.next_identity, judged,
            drifted(before, segment, state.before_s, model), samples,
            [front.tables(samples[:, j]) for j in range(len(model.anchors))],
            arrivals_of(looks.samples, looks.heard, front), front, model,
        )  # fmt: skip

    def rivals(
        self, segment: Segment, after: JointBelief, prices: Array, taught: Segment | None = None,
        other: Rival | None = None,
    ) -> list[Rival]:  # fmt: skip
        """What is proposed along the way of the agent in a segment, one set for each row of prices.

        Parameters
        ----------
        after : JointBelief
            At the end of the segment, as far as known.
        taught : Segment, optional
            The part of the segment of which features are made, instead of all but what is judged.
        other : Rival, optional
            One that all have to keep up with, see `judge`; else the first of them.
        """
        part = segment if taught is None else taught
        looks = surveys(self.before, after, part, self.judged, self.front, self.model, self.tables)
        found: list[Rival] = []
        for price in prices:
            wider = with_proposals(
                self.before, part, looks, price, self.first, self.identity, self._beside_way(part), self.model
            )
            rival = self.judge(wider, segment, found[0] if found else other)
            doubtful = self.sights(rival.joint)
            if doubtful.any():
                without = self.judge(wider.keep(~doubtful), segment, rival)
                rival = best_of([rival, without])
            found.append(rival)
        return found

    def judge(self, belief: JointBelief, segment: Segment, other: Rival | None = None) -> Rival:
        """What comes of a belief at the segment's beginning.

        Parameters
        ----------
        other : Rival, optional
            One that is preferred in doubt: who falls `HOPELESS` behind it isn't followed to the end, and
            scores nothing. What more features cost counts in the end alone: by then they may have earned it.
        """
        cost, lead = self._cost(belief), None
        if other is not None:
            slack = HOPELESS + SEEN * other.adrift + max(other.owed - self._cost(other.start), 0.0)
            saved = max(self._cost(other.start) - cost, 0.0)
            lead = np.cumsum(other.evidence) - saved - slack
        joint, evidence, track = replay(belief, segment, self.before_s, self.first, self.model, least=lead)
        known = len(self.before.features) > 0
        way, spread = track[:, None, :2] - self.model.anchors[:, :2], joint.agent_covariance[:2, :2]
        cost += COST * contradictions(self.arrivals, way, spread)  # (M536)
        return Rival(float(evidence.sum()) - cost, joint, track, evidence, belief, self.placed(joint), known)

    def _beside_way(self, way: Segment) -> Array:
        """From a way's first place to where the agent is predicted to be then, (2,) m."""
        begun = self.before
        if self.before_s is not None:
            begun = carried(begun, way.time_s[0] - self.before_s, self.model)
        gap: Array = begun.mean[:2] - way.agent[0, :2]
        return gap

    def _cost(self, belief: JointBelief) -> float:
        """Nats that a belief's new features cost."""
        return LEAST_GAIN * (len(belief.features) - len(self.before.features))

    def climb(self, rival: Rival, segment: Segment, price: Array) -> Rival:
        """The best of a set of features and those that are proposed along the way that it leads.

        The segment has the way along which the set itself was proposed.
        """
        for _ in range(ROUNDS if len(self.samples) <= START_STEPS else LATER_ROUNDS):
            if apart(rival.track, segment.agent) < MOVED_M:
                return rival
            segment = replace(segment, agent=rival.track)
            (following,) = self.rivals(segment, rival.joint, price[None], other=rival)
            if not following.beats(rival, CLEAR):
                return best_of([rival, following])
            rival = following
        return rival

    def best(self, rivals: list[Rival], ways: list[Segment], price: Array) -> Rival:
        """The best of several sets, after each has climbed, and of what a shift of the best makes of it.

        Before any feature is known, nothing but the start and the lines of sight says where all of it is.

        Parameters
        ----------
        ways : list of Segment
            With the way along which each set was proposed.
        """
        climbed: list[Rival] = []
        for rival, segment in zip(rivals, ways, strict=True):
            known = any(apart(rival.track, one.track) < MOVED_M for one in climbed)
            climbed.append(rival if known else self.climb(rival, segment, price))
        found = best_of(climbed)
        if len(self.before.features):
            return found
        for _ in range(SHIFTS):
            shift = self.shift(found)
            if shift is None:
                return found
            along = replace(ways[0], agent=found.track + np.append(shift, np.zeros(2)))
            (rival,) = self.rivals(along, found.joint, price[None])
            rival = self.climb(rival, along, price)
            by_sight = rival.placed and not found.placed
            if not rival.beats(found, SHIFTED if rival.joint.extent > 0 and not by_sight else 0.0):
                return found
            found = rival
        return found

    def elsewhere(self, rival: Rival, segment: Segment, price: Array) -> tuple[list[Rival], list[Segment]]:
        """The best of a set and of those along its way from other starts, each with its way.

        A crowd fits as well a metre beside its place as where it is; evidence of a whole segment tells.
        """
        found = [(rival, segment)]
        for way in moved_starts(replace(segment, agent=rival.track), self.before):
            lead = best_of([one for one, _ in found])
            if lead.placed:
                break
            (other,) = self.rivals(way, rival.joint, price[None], other=lead)
            found.append((other, way))
        found = sorted(found, key=lambda one: one[0].score + SEEN * one[0].placed, reverse=True)[:FOLLOWED]
        return [one for one, _ in found], [way for _, way in found]

    def sights(self, joint: JointBelief) -> NDArray[np.bool_]:
        """Which new features may be a line of sight that is seen from a wrong place, (F,)."""
        bank, gap = joint.features, np.hypot(*self._beside(joint).T)
        strong = bank.power > STRONG * joint.los_power[bank.anchor]
        near: NDArray[np.bool_] = (gap < ASTRAY * spread_m(self.before)) & strong
        near[: len(self.before.features)] = False
        return near

    def placed(self, joint: JointBelief) -> bool:
        """Whether a line of sight is seen, and not a feature instead, which short tracks don't tell."""
        seen = joint.existence > 0.5
        if len(self.samples) > START_STEPS:
            seen[joint.features.anchor[self.sights(joint) | self.loud(joint)]] = False
        return bool(seen.any())

    def loud(self, joint: JointBelief) -> NDArray[np.bool_]:
        """Features (F,) of a crowd about as loud as a line of sight, and within an agent's drift off it."""
        bank, gap = joint.features, np.hypot(*self._beside(joint).T)
        near: NDArray[np.bool_] = (gap < REACH * self.drift_m) & (joint.extent > 0)
        return near & (bank.power > LOUD * joint.los_power[bank.anchor])

    def shift(self, rival: Rival) -> Array | None:
        """How far (2,) m all has to move for the strongest feature of `sights` or `loud` to be an anchor."""
        near, bank = self.sights(rival.joint) | self.loud(rival.joint), rival.joint.features
        if not near.any():
            return None
        top = int(np.argmax(np.where(near, bank.power, 0.0)))
        shift: Array = self._beside(rival.joint)[top]
        return shift

    def _beside(self, joint: JointBelief) -> Array:
        """From where features would be without extra length to their anchors, (F, 2) m."""
        bank = joint.features
        length, direction, _ = joint.mean[MOVING:].reshape(-1, ENTRIES).T
        way = length[:, None] * np.stack([np.cos(direction), np.sin(direction)], 1)
        gap: Array = self.model.anchors[bank.anchor, :2] - bank.origin_m - way
        return gap


def replay(
    belief: JointBelief, segment: Segment, before_s: float | None, first_step: int, model: SignalModel,
    led: bool = True, least: Array | None = None,
) -> tuple[JointBelief, Array, Array]:  # fmt: skip
    """Go through a segment from its beginning: belief at its end, evidences (K,), track (K, 4).

    Parameters
    ----------
    led : bool
        Whether each maximum is looked for from where the agent was believed to be then, else from where
        it is predicted.
    least : (K,), optional
        Sums of the evidence up to each step, below which it is given up: that step's is -inf, the rest 0.
    """
    evidence, earlier, track = np.zeros(len(segment)), before_s, np.zeros((len(segment), MOVING))
    for k in range(len(segment)):
        if earlier is not None:
            belief = carried(belief, segment.time_s[k] - earlier, model)
        got = segment.samples[k], segment.heard[k], segment.heading_rad[k], model, first_step + k
        if led and segment.heard[k].any():
            belief = replace(belief, astray=False)  # the way leads where it was found
            belief, evidence[k] = update_beside_strangers(belief, *got, segment.agent[k])
        else:
            belief, evidence[k] = update_anywhere(belief, *got)
        earlier, track[k] = float(segment.time_s[k]), belief.mean[:MOVING]
        if least is not None and evidence[: k + 1].sum() < least[k]:
            evidence[k] = -np.inf
            break
    return belief, evidence, track
