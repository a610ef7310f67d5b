"""The state of a filter: all that a step needs of the steps before, and all that a checkpoint holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from scipy.linalg import block_diag

from gridslam.arrays import LATER, Array, replace
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.calibration import Calibration
from gridslam.inference.beliefs.element_gains import ElementGains
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.health.monitor import HealthMonitor
from gridslam.inference.scans.leftovers import Leftovers, LineEvidence
from gridslam.inference.scans.unexplained import Unexplained
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.mountings import Mountings
from gridslam.inference.state.parked import Parked
from gridslam.inference.state.presence import FRESH_SIGHT, Presence
from gridslam.inference.state.published.state_samples import StateSamples
from gridslam.inference.state.ray_amplitudes import RayAmplitudes
from gridslam.inference.state.rings import Rings
from gridslam.inference.state.surface_bank import SurfaceBank
from gridslam.world.filter_model import FilterModel

FRESH_OVER = 0.3
"""The same over floor or ceiling, less than `FRESH_SIGHT`: an agent is placed by what is surer."""


def _no_corners() -> Array:
    """Of a state that knows none."""
    return np.zeros((0, 3))


def prior_belief(model: FilterModel) -> Belief:
    """The agent's prior, and that of heights which aren't known, as if they were as told."""
    rises = len(model.rise_variance)
    mean = np.append(model.start_mean, np.zeros(rises))
    return Belief(mean, block_diag(np.diag(model.start_variance), model.rise_variance), rises=rises)


@dataclass(frozen=True, eq=False)
class State:
    """What is believed after a step. A value: nothing of it is changed once a step has returned it.

    Attributes
    ----------
    belief : Belief
        Joint Gaussian of agent and surfaces.
    surfaces : SurfaceBank
        Existence, coefficients and rays of the surfaces, in the order of the belief.
    los : (J,) float64
        Existence of every anchor's line of sight, and of those of images in floor and ceiling.
    calibration : Calibration
        Learned clutter levels, gain and turns of anchors.
    monitor : HealthMonitor
        How well measurements fitted.
    step, next_identity : int
        Steps taken; number of the next new surface.
    time_s : float or None
        Of the latest step; None before the first.
    grid : Grid, optional
        Occupancy and coefficients of cells (grid SLAM).
    amplitudes : RayAmplitudes, optional
        Amplitude of every ray (adaptive SLAM).
    rings : Rings, optional
        Tentative virtual anchors (SLAM by virtual anchors).
    samples : StateSamples, optional
        Particles of agent and surfaces (``filter.representation = "particles"``); `belief` has their moments.
    parked : Parked, optional
        Surfaces out of sight, where there are too many for one joint belief.
    leftovers : Leftovers, optional
        What no known path explained lately (systems that bear walls of it).
    by_line : LineEvidence, optional
        The same of samples (direct grid SLAM).
    presence : Presence, optional
        Of single bounces, by coefficient (direct grid SLAM).
    levels : (W, 50), optional
        Beliefs about coefficients of floor and ceiling, 0 for known ones; see `level_coefficients`.
    unexplained : Unexplained, optional
        Measurements of the run that no surface explains (grid and adaptive SLAM).
    turn_variance : float, optional
        Of the turn of all about the only anchor, or the only one in sight (rad^2), held out of the belief
        while nothing tells it.
    turn_anchor : int
        About which.
    sight_nats : (J,), optional
        While it is held out for want of another anchor's line of sight: how much speaks for one by now.
    corners : (K, 3)
        Anchors, and from where (m) what they send over corners arrives as if off one wall that isn't there.
    noise : (J,), optional
        Power of the noise in each sample, 0 where it isn't known yet (systems on sampled signals).
    mountings : Mountings, optional
        How anchors stand otherwise than is told, where that isn't known; of systems that learn it.
    elements : ElementGains, optional
        Factors of the antennas' elements (direct grid SLAM).
    """

    belief: Belief
    surfaces: SurfaceBank
    los: Array
    calibration: Calibration
    monitor: HealthMonitor
    step: int = 0
    next_identity: int = 0
    time_s: float | None = None
    grid: Grid | None = None
    amplitudes: RayAmplitudes | None = None
    rings: Rings | None = None
    samples: StateSamples | None = None
    noise: Array | None = None
    parked: Parked | None = None
    leftovers: Leftovers | None = None
    by_line: LineEvidence | None = None
    presence: Presence | None = None
    levels: Array | None = field(default=None, metadata=LATER)
    unexplained: Unexplained | None = field(default=None, metadata=LATER)
    turn_variance: float | None = field(default=None, metadata=LATER)
    turn_anchor: int = field(default=0, metadata=LATER)
    sight_nats: Array | None = field(default=None, metadata=LATER)
    elements: ElementGains | None = field(default=None, metadata=LATER)
    corners: Array = field(default_factory=_no_corners, metadata=LATER)
    mountings: Mountings | None = field(default=None, metadata=LATER)

    @classmethod
    def start(cls, model: FilterModel) -> Self:
        """Before the first step: the agent's prior, and no surfaces."""
        anchors, by_samples = len(model.anchors), model.settings.representation == "particles"
        samples = StateSamples.start(model) if by_samples else None
        gaussian = prior_belief(model)
        return cls(
            gaussian if samples is None else samples.moments(), SurfaceBank.empty(anchors),
            np.where(np.arange(anchors) < model.senders, FRESH_SIGHT, FRESH_OVER),
            Calibration.start(model.senders), HealthMonitor(), samples=samples,
        )  # fmt: skip

    def believing(self, belief: Belief, before: Belief | None = None) -> Self:
        """This state with another belief about the same, which all beside it follows by its correlation.

        Parameters
        ----------
        before : Belief, optional
            What was changed into it, where that isn't the state's own.
        """
        parked, mountings, before = self.parked, self.mountings, before or self.belief
        if parked is not None:
            parked = parked.following(before, belief)
        if mountings is not None:
            mountings = mountings.following(before, belief)
        return replace(self, belief=belief, parked=parked, mountings=mountings)

    def placed(self, belief: Belief) -> Self:
        """This state with a belief about an agent that was put elsewhere, which nothing is linked with."""
        parked, mountings = self.parked, self.mountings
        if mountings is not None:  # found by anchors, it is off by as much as they are
            belief, mountings = mountings.shared(belief, np.arange(AGENT))
        return replace(
            self, belief=belief, parked=None if parked is None else parked.unlinked(), mountings=mountings
        )

    @property
    def aside(self) -> Array | None:
        """How anchors are believed to stand otherwise than is told, (senders, 3); None: as is told."""
        return None if self.mountings is None else self.mountings.aside

    @property
    def factors(self) -> ElementGains | None:
        """Factors of antenna elements, (M565); None unless samples tell beyond doubt that some are off."""
        return self.elements if self.elements is not None and self.elements.size else None

    @property
    def every_line(self) -> Array:
        """Mean lines of all surfaces, (S + P, 2): those in the belief, then those that are parked."""
        own = self.belief.lines
        return own if self.parked is None else np.concatenate([own, self.parked.lines])

    @property
    def every_existence(self) -> Array:
        """Existence of all surfaces, (S + P,)."""
        own = self.surfaces.existence
        return own if self.parked is None else np.concatenate([own, self.parked.surfaces.existence])

    def require_grid(self) -> Grid:
        """The grid, of a system that keeps one.

        Raises
        ------
        ValueError
            This system keeps none.
        """
        if self.grid is None:
            raise ValueError("this state has no grid")
        return self.grid

    def require_samples(self) -> StateSamples:
        """The particles, of a state that is held in them.

        Raises
        ------
        ValueError
            This one isn't.
        """
        if self.samples is None:
            raise ValueError("this state has no particles")
        return self.samples
