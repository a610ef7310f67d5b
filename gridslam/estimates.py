"""What users get of a step: the estimate, and how well the measurements fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from gridslam.errors import InputError
from gridslam.estimate_tables import HypothesisEstimate, PathEstimate, RingEstimate, SurfaceEstimate
from gridslam.wording import counted
from gridslam.world.geometry import wrap
from gridslam.world.given import MOST_RAD, numbers
from gridslam.world.observation import Observation

ANY_SPEED_MPS = 10.0
"""Standard deviation of a velocity of which nothing is known."""
SYMMETRIC = 1e-2
"""By how much a covariance may differ from its mirror image, as correlations do in single precision."""
ROUNDING = 1e-9
"""Share of the largest by which rounding may put an eigenvalue of a covariance below 0."""


@dataclass(frozen=True, eq=False)
class Health:
    """Whether what is heard fits what is believed: a filter's own word, without the truth. Never NaN.

    Attributes
    ----------
    ok : bool
    why : str
        What is amiss, in words; empty if nothing is.
    effective_sample_size : float
        Least effective number of particles behind a sure association of this step; all if there is none.
    innovation : float
        Normalised innovation squared per degree of freedom of sure associations, over some ten steps; 1 is
        what a consistent filter has.
    innovation_band : (float, float)
        Where it lies in 998 of 1000 cases, if associations are independent (chi-square).
    explained : float
        Share of the measurements too loud for clutter that known paths explain, over some ten steps.
    clutter : (J,)
        Clutter heard per anchor and step, as estimated; where no measurement says whose it is, the last
        number is that of all anchors together.
    amplitude : float
        Ratio of the lines of sight's amplitude to what the scene's SNR implies, as estimated.
    turned_rad : (J,) rad
        How far each anchor is turned from the orientation in the scene, as estimated; 0 unless beyond doubt.
    silent_steps : int
        For how long nothing has been heard.
    jolt : (float, float)
        Times the scene's ``filter.acceleration_mps2`` and ``filter.heading_deg`` that this step allowed:
        more than 1 where the agent moved too sharply for them.
    elements : float
        How far antenna elements' factors are from 1, root mean square, as estimated and taken out (direct
        grid SLAM); 0 unless beyond doubt.
    """

    ok: bool = True
    why: str = ""
    effective_sample_size: float = 0.0
    innovation: float = 1.0
    innovation_band: tuple[float, float] = (0.0, 2.0)
    explained: float = 1.0
    clutter: np.ndarray = field(default_factory=lambda: np.zeros(0))
    amplitude: float = 1.0
    turned_rad: np.ndarray = field(default_factory=lambda: np.zeros(0))
    silent_steps: int = 0
    jolt: tuple[float, float] = (1.0, 1.0)
    elements: float = 0.0


class AnchorEstimate(NamedTuple):
    """How an anchor is believed to stand.

    Attributes
    ----------
    position_m : (2,) float64
    position_std_m : float
        Deviation of the place, sqrt(var x + var y).
    orientation_rad, orientation_std_rad : float
    """

    position_m: np.ndarray
    position_std_m: float
    orientation_rad: float
    orientation_std_rad: float


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a filter believes after one step. `of_pose` makes one of the few things that it has to hold.

    Attributes
    ----------
    step : int
        Step number.
    time_s : float, s
        Time of the step.
    position_m, velocity_mps : (2,) float64; m, m/s
        Agent: the mean over all hypotheses.
    heading_rad : float, rad
        Agent's heading, wrapped to (-pi, pi].
    covariance : (5, 5) float64
        Of [x, y, vx, vy, heading], over all hypotheses.
    surfaces : SurfaceEstimate
        All potential surfaces (default: none).
    paths : PathEstimate
        The paths over them (default: none).
    detected : (S,) bool
        Surfaces that count as found.
    effective_sample_size : float
        Particles that carry the agent's weight (NaN for a filter without).
    seconds : float, s
        Time that the step took (NaN where it wasn't kept).
    health : Health
        Whether the filter trusts itself (its defaults where it wasn't kept).
    hypotheses : HypothesisEstimate
        Where the agent may be, the likeliest first (no rows where it wasn't kept). Surfaces and paths are
        those of the first.
    heights : dict
        Height and its deviation, m, of "agent", "floor" and "ceiling", where the scene gives deviations.
    coefficients : dict
        Coefficient and its deviation of "floor" and "ceiling", where the scene gives deviations.
    anchors : dict
        How each anchor stands, an `AnchorEstimate` by name, where the scene gives deviations of places.
    rings : RingEstimate
        Images whose place isn't known yet, of the first hypothesis (direct SLAM; else no rows).
    """

    step: int
    time_s: float
    position_m: np.ndarray
    velocity_mps: np.ndarray
    heading_rad: float
    covariance: np.ndarray
    surfaces: SurfaceEstimate = field(default_factory=SurfaceEstimate.empty)
    paths: PathEstimate = field(default_factory=PathEstimate.empty)
    detected: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    effective_sample_size: float = math.nan
    seconds: float = math.nan
    health: Health = field(default_factory=Health)
    hypotheses: HypothesisEstimate = field(default_factory=HypothesisEstimate.empty)
    heights: dict[str, tuple[float, float]] = field(default_factory=dict)
    rings: RingEstimate = field(default_factory=RingEstimate.empty)
    coefficients: dict[str, tuple[float, float]] = field(default_factory=dict)
    anchors: dict[str, AnchorEstimate] = field(default_factory=dict)

    def __repr__(self) -> str:
        """One line."""
        (x, y), own = self.position_m, math.sqrt(max(float(np.trace(self.covariance[:2, :2])), 0.0))
        doubt = "" if self.health.ok else f", {self.health.why}"
        return (
            f"<Estimate at step {self.step}: {x:.2f}, {y:.2f} m (+-{own:.2g} m), heading "
            f"{self.heading_rad:.2f} rad, {counted(int(np.sum(self.detected)), 'surface')}{doubt}>"
        )

    @classmethod
    def of_pose(
        cls,
        scan: Observation,
        position_m: ArrayLike,
        heading_rad: float,
        covariance: ArrayLike,
        velocity_mps: ArrayLike = (0.0, 0.0),
        surfaces: SurfaceEstimate | None = None,
        paths: PathEstimate | None = None,
    ) -> Self:
        """Make an estimate by hand: the pose, and what else a method knows.

        Parameters
        ----------
        scan : Scan or SignalScan
            Gives step and time.
        position_m, velocity_mps : (2,); m, m/s
        heading_rad : float, rad
            Is wrapped. Beyond four turns it is refused, as degrees are: whoever sums up turns wraps the sum.
        covariance : (5, 5) or (3, 3)
            Of [x, y, vx, vy, heading]; or of [x, y, heading] where nothing is known of the velocity, which
            then gets a standard deviation of 10 m/s.
        surfaces : SurfaceEstimate, optional
            Surfaces found, e.g. by `SurfaceEstimate.from_lines`; all count as detected.
        paths : PathEstimate, optional

        Raises
        ------
        InputError
            Arrays of other shapes, numbers that aren't finite, a heading in degrees, or a covariance
            of negative variances, or that isn't symmetric.
        """
        position = numbers(position_m, "estimate: position_m")
        velocity = numbers(velocity_mps, "estimate: velocity_mps")
        square, turn = (
            numbers(covariance, "estimate: covariance"),
            numbers(heading_rad, "estimate: heading_rad"),
        )
        if turn.size != 1:
            raise InputError("estimate: heading_rad", f"shape {turn.shape}", "one number")
        heading = float(turn.item())
        if square.shape == (3, 3):
            whole = np.diag([0.0, 0.0, ANY_SPEED_MPS**2, ANY_SPEED_MPS**2, 0.0])
            whole[np.ix_([0, 1, 4], [0, 1, 4])] = square
            square = whole
        shapes = {
            "position_m": (position, (2,)),
            "velocity_mps": (velocity, (2,)),
            "covariance": (square, (5, 5)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                allowed = "(5, 5) or (3, 3)" if name == "covariance" else str(shape)
                raise InputError(f"estimate: {name}", f"shape {array.shape}", allowed)
        for name, array in (*((n, a) for n, (a, _) in shapes.items()), ("heading_rad", np.array(heading))):
            if not np.isfinite(array).all():
                raise InputError(f"estimate: {name}", "NaN or infinity", "finite numbers")
        if abs(heading) > MOST_RAD:
            allowed = "radians, four turns at most (of a sum: np.arctan2(np.sin(sum), np.cos(sum)))"
            raise InputError("estimate: heading_rad", f"{heading:g}", allowed)
        values = np.linalg.eigvalsh(0.5 * (square + square.T))
        std = np.sqrt(np.maximum(square.diagonal(), 0.0))
        if (np.abs(square - square.T) > SYMMETRIC * np.outer(std, std)).any():
            raise InputError("estimate: covariance", "a matrix that isn't symmetric", "a symmetric one")
        if values[0] < -ROUNDING * max(values[-1], -values[0]):
            raise InputError(
                "estimate: covariance", f"an eigenvalue of {values[0]:.3g}", "none below 0: of variances"
            )
        table = SurfaceEstimate.empty() if surfaces is None else surfaces
        return cls(
            scan.step, scan.time_s, position, velocity, float(wrap(heading)), square, table,
            PathEstimate.empty() if paths is None else paths, np.ones(len(table), bool),
        )  # fmt: skip
