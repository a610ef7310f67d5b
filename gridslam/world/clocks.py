"""Clocks of anchors and agents: what a scene says of them, and what a filter may know.

A device whose clock is off by b measures distances that are off by c b. Inside the package all offsets are
in metres: beta of an anchor, b of an agent; a path of theirs is measured as ``distance + beta - b``
[Venus2025network], eqs. (2), (4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.world.names import Label
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.validation import Strict, fault

NS = 1e-9 * SPEED_OF_LIGHT
"""Metres per nanosecond."""
HalfWidth = Annotated[float, Field(ge=0, le=1e6)]
LEAST_WALK_M = 1e-6
"""What a clock is taken to walk at least in a root second, unless it is known."""


class Clock(Strict):
    """One device's clock: the truth, to simulate, and a prior of its own.

    `zigzag_s` is the period of a drift that changes its sign every half of it; `jump_ns` happens at `jump_s`.
    `walk_ns` per root second is a random walk, drawn by the seed of the simulation.
    """

    offset_ns: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0
    drift_ppb: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0
    zigzag_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    jump_s: Annotated[float, Field(ge=0, le=1e9)] | None = None
    jump_ns: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0
    walk_ns: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    prior_ns: HalfWidth | None = None

    def offset_s(self, time_s: Array) -> Array:
        """True offset at given times (N,), s, without its walk."""
        time = np.asarray(time_s, np.float64)
        run = time
        if self.zigzag_s is not None:
            half = 0.5 * self.zigzag_s
            run = half - np.abs(np.mod(time, self.zigzag_s) - half)
        jumped = np.zeros_like(time) if self.jump_s is None else self.jump_ns * (time >= self.jump_s)
        return np.asarray(1e-9 * (self.offset_ns + self.drift_ppb * run + jumped), np.float64)


class Clocks(Strict, table="[clocks]"):
    """What is known of all clocks before the first step; half widths of uniform priors (0: known).

    `reference` names the device whose clock is the time; anchors without a prior may then be off by as much
    as the receive window is wide.
    """

    anchor_prior_ns: HalfWidth | None = None
    agent_prior_ns: HalfWidth = 0.0
    walk_ns: Annotated[float, Field(ge=0, le=1e6)] = 0.1
    drift_prior_ppb: HalfWidth = 0.0
    drift_walk_ppb: HalfWidth = 0.0
    reference: Label | None = None

    @model_validator(mode="after")
    def _tied_down(self) -> Self:
        if self.anchor_prior_ns is None and self.reference is None:
            raise fault(
                "anchor_prior_ns",
                "neither it nor a reference",
                "a half width in ns (0: known), or a reference",
            )
        return self


@dataclass(frozen=True, eq=False)
class ClockModel:
    """What a filter may know of the clocks, in metres; the anchors' first, then the agents'.

    Attributes
    ----------
    anchors, agents : int
        J and I.
    half_width_m : (J + I,)
        Of the uniform priors about 0; 0 stands for a clock that is known.
    walk_m : float
        Standard deviation of an unknown clock's random walk, per root second.
    drift_m, drift_walk_m : float
        Standard deviation of the drifts' prior (m/s) and of their walk (m/s per root second); both 0 for
        clocks of one state.
    """

    anchors: int
    agents: int
    half_width_m: Array
    walk_m: float = 0.1 * NS
    drift_m: float = 0.0
    drift_walk_m: float = 0.0

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whose clocks are known, (J + I,)."""
        return self.half_width_m == 0

    @property
    def variance(self) -> Array:
        """Of the priors, (J + I,) m^2."""
        return self.half_width_m**2 / 3

    @property
    def drifting(self) -> bool:
        """Whether clocks have two states."""
        return self.drift_m > 0 or self.drift_walk_m > 0


@dataclass(frozen=True, eq=False)
class ClockTruth:
    """True offsets of all clocks over time; for scoring alone.

    Attributes
    ----------
    device : tuple of str
    time_s : (N,)
    offset_s : (N, D)
    """

    device: tuple[str, ...]
    time_s: Array
    offset_s: Array

    def __post_init__(self) -> None:
        time, offset = (np.array(part, np.float64) for part in (self.time_s, self.offset_s))
        if offset.shape != (len(time), len(self.device)) or not np.isfinite(offset).all():
            found = f"shape {offset.shape}"
            raise InputError("clocks: offset_s", found, f"finite numbers, ({time.size}, {len(self.device)})")
        for name, values in (("time_s", time), ("offset_s", offset)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def metres(self, devices: tuple[str, ...]) -> Array:
        """Offsets of some devices in metres, (N, D).

        Raises
        ------
        InputError
            One of them isn't there.
        """
        for name in devices:
            if name not in self.device:
                raise InputError("clocks: device", repr(name), ", ".join(self.device) or "none here")
        return SPEED_OF_LIGHT * self.offset_s[:, [self.device.index(name) for name in devices]]
