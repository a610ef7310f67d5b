"""An agent that is looked for after a silence, wherever in the region it may be; docs/model.md, (M572).

One snapshot tells where it was taken if nowhere else explains it as well. Else it tells nothing: a vague
belief that follows what is likeliest near by is soon sure of a wrong place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.inference.health.monitor import VAGUE_M
from gridslam.inference.messages.features.arrivals import COST, Arrivals
from gridslam.inference.messages.features.feature_likelihood import Front, Tables
from gridslam.inference.messages.features.presence import after_a_step
from gridslam.inference.messages.features.readings import update_by_readings
from gridslam.inference.messages.features.regaining import UNSURE_M
from gridslam.inference.messages.features.sight import feature_table
from gridslam.inference.messages.features.silences import region_places, unheard
from gridslam.inference.messages.features.strangers import beside_strangers
from gridslam.inference.state.features.features import MOVING
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.world.signal_model import SignalModel

Complex = NDArray[np.complex128]
LEAP_M, LEAP = 0.5, 5.0
"""How far, in m and in deviations, a place has to be from another to be elsewhere."""
FOLLOWED, ZOOMS, FINER = 16, 3, 4.0
"""Places, the likeliest, that are looked for on finer grids; on how many, and how much finer each is."""
FAR = 4.0
"""Deviations of the agent's place within which it is looked for."""


def update_anywhere(
    belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float, model: SignalModel,
    step: int,
) -> tuple[JointBelief, float]:  # fmt: skip
    """As `update_by_readings`; of an agent astray only if the samples tell one place from all others, (M572).

    Else the belief stays as it is, and lines of sight are less sure. Of a step without samples a vague agent
    comes out astray.
    """
    if not (belief.astray and audible.any()):
        after, evidence = update_by_readings(belief, samples, audible, heading_rad, model, step)
        return unheard(after, audible), evidence
    sought = Sought.of(belief, samples, audible, heading_rad, model)
    places = region_places(model)
    prior = sought.prior(places)
    near = prior > min(-0.5 * FAR**2, prior.max() - 1)
    nats = prior[near] + sought.explained(places[near])
    best, *others = sought.nearer(likeliest(places[near], nats))
    start = np.append(best.place, belief.mean[2:MOVING])
    after, evidence, _ = beside_strangers(belief, samples, audible, heading_rad, model, step, start)
    own = np.linalg.eigvalsh(after.agent_covariance[:2, :2])
    reach = max(LEAP_M, LEAP * np.sqrt(own[-1]))  # along a circle about an anchor, which bends
    rivals = [one.nats for one in others if one.off(after.mean[:2]) > reach]
    alone = best.nats - max(rivals, default=-np.inf) > COST and best.off(after.mean[:2]) < reach
    if alone and own.sum() < VAGUE_M**2:
        return replace(after, astray=False), evidence
    belief = replace(belief, existence=after_a_step(belief.existence))
    return belief, float(np.logaddexp.reduce(nats) - np.logaddexp.reduce(prior[near]))


class Candidate(NamedTuple):
    """A place (2,) m, and how likely it is, nats."""

    place: Array
    nats: float

    def off(self, place: Array) -> float:
        """How far (m) it is from another."""
        return float(np.hypot(*(self.place - place)))


@dataclass(frozen=True, eq=False)
class Sought:
    """A step's samples, and what is believed of their agent.

    Attributes
    ----------
    belief : JointBelief
        As predicted.
    samples : (J, N, M) complex128
    tables, arrivals : mapping of int
        Of each anchor that was heard: matched outputs (1, N, T, 4), and what arrives by lengths.
    heading_rad : float
    front : Front
    model : SignalModel
    """

    belief: JointBelief
    samples: Complex
    tables: dict[int, Tables]
    arrivals: dict[int, Arrivals]
    heading_rad: float
    front: Front
    model: SignalModel

    @classmethod
    def of(
        cls, belief: JointBelief, samples: Complex, audible: NDArray[np.bool_], heading_rad: float,
        model: SignalModel,
    ) -> Self:  # fmt: skip
        """That of samples (J, N, M), of the anchors that were heard (J,)."""
        front, heard = Front(model.waveform), [int(j) for j in np.flatnonzero(audible)]
        tables = {j: front.tables(samples[j][None]) for j in heard}
        arrivals = {j: Arrivals.of(samples[j], front) for j in heard}
        return cls(belief, samples, tables, arrivals, heading_rad, front, model)

    def prior(self, places: Array) -> Array:
        """Nats of places (Q, 2) before the samples, up to a constant."""
        off = places - self.belief.mean[:2]
        nats: Array = -0.5 * (off @ np.linalg.inv(self.belief.agent_covariance[:2, :2]) * off).sum(1)
        return nats

    def explained(self, places: Array) -> Array:
        """Log density of the samples at places (Q, 2), with or without lines of sight; (M122), (M451)."""
        there, nats = after_a_step(self.belief.existence), np.zeros(len(places))
        for j, table in self.tables.items():
            noise, power, z = self.belief.noise[j], self.belief.los_power[j], self.samples[j]
            points = np.column_stack([places, np.tile([self.heading_rad, noise], (len(places), 1))])
            anchor_m = self.model.anchors[j, :2]
            known = feature_table(self.belief, j)
            ratio, square, energy = self.front.ratios(points, known, anchor_m, table).T
            over = 1 + power * energy / noise
            gain = square * power / noise**2 / over - np.log(over)
            nats += ratio - np.vdot(z, z).real / noise - z.size * np.log(np.pi * noise)
            nats += np.logaddexp(np.log(there[j]) + gain, np.log1p(-there[j]))
            nats -= self.arrivals[j].against(np.hypot(*(anchor_m - places).T))
        return nats

    def nearer(self, places: Array) -> list[Candidate]:
        """The likeliest about each of several places (K, 2), the likeliest of all first."""
        side = np.linspace(-1, 1, 5)
        about, step_m = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2), 0.5 * UNSURE_M
        nats = np.zeros(len(places))
        for _ in range(ZOOMS):
            tried = places[:, None] + step_m * about
            flat = tried.reshape(-1, 2)
            each = (self.prior(flat) + self.explained(flat)).reshape(len(places), -1)
            best = each.argmax(1)[:, None]
            nats = np.take_along_axis(each, best, 1)[:, 0]
            places = np.take_along_axis(tried, best[..., None], 1)[:, 0]
            step_m /= FINER
        found = [Candidate(place, float(its)) for place, its in zip(places, nats, strict=True)]
        return sorted(found, key=lambda one: -one.nats)


def likeliest(places: Array, nats: Array) -> Array:
    """The likeliest of places (Q, 2), each apart from all that are likelier, (K, 2)."""
    chosen, left = list[Array](), nats.copy()
    while len(chosen) < FOLLOWED and np.isfinite(left.max()):
        chosen.append(places[left.argmax()])
        left[np.hypot(*(places - chosen[-1]).T) < LEAP_M] = -np.inf
    return np.array(chosen)
