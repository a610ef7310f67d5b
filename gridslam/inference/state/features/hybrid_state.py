"""The state of hybrid SLAM: particles for the start, the joint belief with the features, and a segment."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import LATER, Array
from gridslam.inference.state.features.features import ENTRIES, MOVING, FeatureBank
from gridslam.inference.state.features.networks import FeatureNetworks
from gridslam.inference.state.features.sightings import Sightings


@dataclass(frozen=True, eq=False)
class ParticleBelief:
    """Particles of agent and noise, and the lines of sight, [HybridSlam], section III.

    Attributes
    ----------
    agent : (P, 4) float64
        x, y (m), vx, vy (m/s), of equal weight.
    noise : (J, P) float64
        Noise power of every anchor's samples.
    existence : (J,) float64
        Probability that the line of sight is there.
    node, weight : (J, G) float64
        Grid of its power at 1 m, and the probabilities of its nodes.
    """

    agent: Array
    noise: Array
    existence: Array
    node: Array
    weight: Array


@dataclass(frozen=True, eq=False)
class JointBelief:
    """Agent and features in one Gaussian, with the powers that belong to them.

    Attributes
    ----------
    mean, covariance : (4 + 3 F,), (4 + 3 F, 4 + 3 F) float64
        x, y, vx, vy of the agent; length (m), direction (rad) and extra length (m) of each feature.
    features : FeatureBank
    existence, los_power, noise : (J,) float64
        Of the lines of sight: probability, power at 1 m; noise power of the samples.
    extent : float
        Deviation by which what is heard of a feature stands beside its place, at each step anew, m; see
        `joint_update.TURNS_RAD`.
    sightings : Sightings
        From where features and lines of sight were heard.
    astray : bool
        Whether the agent became vague in a silence, and hasn't been found since; see
        `messages.features.silences`.
    usual_s : float
        How long steps mostly are, s; 0 before the first.
    """

    mean: Array
    covariance: Array
    features: FeatureBank
    existence: Array
    los_power: Array
    noise: Array
    extent: float = field(default=0.0, metadata=LATER)
    sightings: Sightings = field(default_factory=Sightings.none, metadata=LATER)
    astray: bool = field(default=False, metadata=LATER)
    usual_s: float = field(default=0.0, metadata=LATER)

    @property
    def agent_covariance(self) -> Array:
        """Of x, y, vx, vy, (4, 4)."""
        return self.covariance[:MOVING, :MOVING]

    def with_feature(
        self,
        anchor: int,
        entry: Array,
        spread: Array,
        origin_m: Array,
        power: float,
        identity: int,
        step: int,
        slopes: Array | None = None,
    ) -> Self:
        """One more feature: entries (3,) and their covariance (3, 3), where the agent is as believed.

        Parameters
        ----------
        slopes : (3, 2), optional
            Of the entries by the agent's place. Default: it is independent of all else.
        """
        size = len(self.mean)
        covariance = np.zeros((size + ENTRIES, size + ENTRIES))
        covariance[:size, :size], covariance[size:, size:] = self.covariance, spread
        if slopes is not None:
            shared = slopes @ self.covariance[:2]
            covariance[size:, :size], covariance[:size, size:] = shared, shared.T
            covariance[size:, size:] += shared[:, :2] @ slopes.T
        return replace(
            self,
            mean=np.concatenate([self.mean, entry]),
            covariance=covariance,
            features=self.features.add(identity, anchor, origin_m, power, step),
        )

    def keep(self, mask: NDArray[np.bool_]) -> Self:
        """Only these of the features."""
        rows = np.concatenate([np.ones(MOVING, bool), np.repeat(mask, ENTRIES)])
        return replace(
            self,
            mean=self.mean[rows],
            covariance=self.covariance[np.ix_(rows, rows)],
            features=self.features.take(mask),
            sightings=self.sightings.keep(self.features.identity[mask]),
        )


@dataclass(frozen=True, eq=False)
class Segment:
    """What was received since features were last learned, and where the agent was believed to be then.

    Attributes
    ----------
    time_s, heading_rad : (K,) float64
    heard : (K, J) bool
    samples : (K, J, N, M) complex128
    agent : (K, 4) float64
        Means of x, y, vx, vy when a step was processed.
    evidence : (K,) float64
        Log of each step's evidence then.
    """

    time_s: Array
    heading_rad: Array
    heard: NDArray[np.bool_]
    samples: NDArray[np.complex128]
    agent: Array
    evidence: Array

    @classmethod
    def empty(cls, anchors: int, elements: int, frequencies: int) -> Self:
        """Nothing yet."""
        return cls(
            np.zeros(0), np.zeros(0), np.zeros((0, anchors), bool),
            np.zeros((0, anchors, elements, frequencies), np.complex128), np.zeros((0, MOVING)),
            np.zeros(0),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.time_s)

    def first(self, steps: int) -> Self:
        """Its first steps alone."""
        return type(self)(*(getattr(self, f.name)[:steps] for f in fields(self)))

    def last(self, steps: int) -> Self:
        """Its last steps alone."""
        return type(self)(*(getattr(self, f.name)[len(self) - steps :] for f in fields(self)))

    def latest(self) -> list[NDArray[np.complex128] | None]:
        """Samples (N, M) of its last step, None of anchors that weren't heard; nothing before the first."""
        last = zip(self.samples[-1], self.heard[-1], strict=True) if len(self) else ()
        return [samples if heard else None for samples, heard in last]

    def joined(self, later: Self) -> Self:
        """These steps and later ones."""
        return type(self)(
            *(np.concatenate([getattr(one, f.name) for one in (self, later)]) for f in fields(self))
        )

    def add(
        self, time_s: float, heading_rad: float, audible: NDArray[np.bool_], samples: NDArray[np.complex128],
        agent: Array, evidence: float,
    ) -> Self:  # fmt: skip
        """One more step.

        Parameters
        ----------
        audible : (J,) bool
            Anchors that were heard.
        samples : (J, N, M) complex128
        agent : (4,)
            Mean of x, y (m), vx, vy (m/s).
        evidence : float
            Log of the step's evidence.
        """
        return type(self)(
            np.append(self.time_s, time_s), np.append(self.heading_rad, heading_rad),
            np.concatenate([self.heard, audible[None]]), np.concatenate([self.samples, samples[None]]),
            np.concatenate([self.agent, agent[None]]), np.append(self.evidence, evidence),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class HybridState:
    """What is believed after a step. A value: nothing of it is changed once a step has returned it.

    Attributes
    ----------
    joint : JointBelief
        While particles are in use, the belief before the first step.
    before : JointBelief
        The joint belief at the beginning of the segment.
    segment : Segment
    particles : ParticleBelief or None
        For the start, and of methods that have nothing else.
    step, next_identity, silent : int
        Steps taken; number of the next feature; for how many steps nothing was heard.
    time_s, before_s : float or None
        Of the latest step, and of the one before the segment; None before the first.
    lesson : HybridState or None
        The state at the end of the segment that is being learned from, see `messages.lessons`.
    networks : FeatureNetworks or None
        Where features are, of the published way to learn.
    early : float
        Share of the latest steps with a sight at which something arrived before it; see
        `following.count_step`.
    sights : int
        Steps at which a line of sight was heard; enough from the start where an earlier agent left features.
    sighted : (J,) int64
        The same of each anchor; empty before the first.
    unseen : (J,) int64
        Steps since then, or below 0 where an earlier agent left features; empty before the first.
    leap_m, since_leap : float, int
        By how far the agent was moved last where its motion doesn't lead, and how many steps ago.
    """

    joint: JointBelief
    before: JointBelief
    segment: Segment
    particles: ParticleBelief | None = None
    step: int = 0
    next_identity: int = 0
    silent: int = 0
    time_s: float | None = None
    before_s: float | None = None
    lesson: HybridState | None = None
    networks: FeatureNetworks | None = field(default=None, metadata=LATER)
    early: float = field(default=0.0, metadata=LATER)
    sights: int = field(default=0, metadata=LATER)
    sighted: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64), metadata=LATER)
    unseen: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64), metadata=LATER)
    leap_m: float = field(default=0.0, metadata=LATER)
    since_leap: int = field(default=1_000_000, metadata=LATER)
