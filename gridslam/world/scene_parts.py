"""The parts of a scene file, each checked on its own; `Scene` checks that they fit together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gridslam.arrays import Array
from gridslam.world.clocks import Clock
from gridslam.world.grid_memory import CELL_BYTES, MOST_BYTES, WAY_OUT, in_gb
from gridslam.world.names import FolderName, Label
from gridslam.world.radio import SPEED_OF_LIGHT, aperture
from gridslam.world.validation import Strict, fault

SAME_PLACE_M = 1e-6
"""Points closer than this are one."""
MOST_STEPS = 1_000_000

Positive = Annotated[float, Field(gt=0, le=1e12)]
NotNegative = Annotated[float, Field(ge=0, le=1e12)]
Share = Annotated[float, Field(gt=0, le=1)]
Probability = Annotated[float, Field(gt=0, lt=1)]
Decibel = Annotated[float, Field(ge=-200, le=200)]
Metre = Annotated[float, Field(ge=-1e7, le=1e7)]  # northings reach 10 000 km
HeightStd = Annotated[float, Field(ge=0, le=1)]
CoefficientStd = Annotated[float, Field(ge=0, le=0.5)]
Degree = Annotated[float, Field(ge=-720, le=720)]
Point = tuple[Metre, Metre]
Place = Annotated[tuple[Metre, ...], Field(min_length=2, max_length=3)]
Name = Annotated[str, Field(min_length=1, max_length=100)]
Quantity = Literal["distance", "aod", "aoa", "amplitude"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)


class ArraySpec(Strict):
    """Uniform rectangular antenna array; with layers above each other, it sees elevations, too."""

    rows: int = Field(5, ge=1, le=1000)
    columns: int = Field(5, ge=1, le=1000)
    layers: int = Field(1, ge=1, le=1000)
    spacing_wavelengths: Positive = 0.25

    @property
    def aperture(self) -> Array:
        """Mean square extents along its own x and y axis, (2,), wavelengths^2."""
        return aperture(self.rows, self.columns, self.spacing_wavelengths)

    @property
    def upright(self) -> float:
        """Mean square extent upwards, wavelengths^2."""
        return float(aperture(1, self.layers, self.spacing_wavelengths)[0])

    @property
    def elements(self) -> Array:
        """Where its elements are, row by row, (rows * columns, 2) in wavelengths about the middle."""
        row, column = np.divmod(np.arange(self.rows * self.columns), self.columns)
        middle = 0.5 * np.array([self.columns - 1, self.rows - 1])
        return self.spacing_wavelengths * (np.column_stack([column, row]) - middle)


class Pulse(Strict):
    """Spectrum of the pulse that is sampled: root-raised-cosine."""

    kind: Literal["rrc"] = "rrc"
    rolloff: float = Field(0.6, ge=0, le=1)
    width_hz: Positive

    def spectrum(self, offset_hz: Array) -> Array:
        """Amplitude (M,) about the carrier: 1 in the middle, half the power at +- width_hz / 2."""
        beyond = np.abs(offset_hz) - 0.5 * (1 - self.rolloff) * self.width_hz
        share = beyond / max(self.rolloff * self.width_hz, 1e-9 * self.width_hz)
        return np.sqrt(0.5 * (1 + np.cos(np.pi * np.clip(share, 0, 1))))


class DenseTail(Strict):
    """What is too weak to be told apart: complex Gaussian, decaying from the line of sight's length on."""

    power_db: Decibel
    decay_m: Positive


class Radio(Strict, table="[radio]"):
    """The radio link; defaults as in [Li2025adaptive] and [Li2026grid].

    `detection_probability` and `distance_std_m`, where given, replace what would follow from the amplitude.
    `window_m` is what measured distances may be, where clocks are off; `reports_std` has simulated
    measurements come with deviations, by their own amplitude. Where measurements don't say whose they are,
    `false_alarms` counts those of all anchors together.
    `frequencies`, `frequency_step_hz`, `fading`, `pulse` and `dense` are those of sampled signals. Where
    they are given, `bandwidth_hz` and `max_distance_m` follow: the width from the first to the last frequency
    (with a pulse, the pulse's), and the length at which paths fold back.
    """

    carrier_hz: Positive = 6.0e9
    bandwidth_hz: Positive = 1.0e9
    snr_at_1m_db: Decibel = 30.0
    detection_threshold_db: Decibel = 6.0
    false_alarms: Positive = 2.0
    max_distance_m: Positive = 60.0
    samples: int | None = Field(None, ge=1)
    max_bounces: int = Field(2, ge=0, le=2)
    measures: tuple[Quantity, ...] = QUANTITIES
    detection_probability: Probability | None = None
    distance_std_m: Positive | None = None
    window_m: tuple[Metre, Metre] | None = None
    reports_std: bool = False
    array: ArraySpec = ArraySpec()
    frequencies: int | None = Field(None, ge=8, le=100_000)
    frequency_step_hz: Positive | None = None
    fading: Literal["steady", "swerling1"] = "steady"
    pulse: Pulse | None = None
    dense: DenseTail | None = None

    @model_validator(mode="before")
    @classmethod
    def _follow(cls, data: Any) -> Any:
        """What follows from the frequencies, where it isn't given."""
        if not isinstance(data, Mapping):
            return data
        count, step, pulse = (data.get(key) for key in ("frequencies", "frequency_step_hz", "pulse"))
        if not (isinstance(count, int) and isinstance(step, float | int) and step > 0):
            return data
        width = pulse.get("width_hz") if isinstance(pulse, Mapping) else getattr(pulse, "width_hz", None)
        follows = {"bandwidth_hz": width or (count - 1) * step, "max_distance_m": SPEED_OF_LIGHT / step}
        return {**follows, **data}

    @model_validator(mode="after")
    def _samples_fit(self) -> Self:
        count, step = self.frequencies, self.frequency_step_hz
        if (count is None) != (step is None):
            missing = "frequencies" if count is None else "frequency_step_hz"
            raise fault(missing, "none", "both of frequencies and frequency_step_hz, or neither")
        if count is None or step is None:
            if self.pulse is not None:
                raise fault("pulse", "a pulse without frequencies", "frequencies and frequency_step_hz, too")
            if self.dense is not None:
                raise fault("dense", "a tail without frequencies", "frequencies and frequency_step_hz, too")
            return self
        band = (count - 1) * step
        if band >= 2 * self.carrier_hz:
            raise fault("frequencies", f"{band:g} Hz in all", "less than twice carrier_hz")
        if self.pulse is not None and self.pulse.width_hz > band:
            raise fault("pulse.width_hz", f"{self.pulse.width_hz:g}", f"at most the band's {band:g}")
        width = band if self.pulse is None else self.pulse.width_hz
        for key, follows in (("bandwidth_hz", width), ("max_distance_m", SPEED_OF_LIGHT / step)):
            given = getattr(self, key)
            if abs(given - follows) > 1e-3 * follows:
                raise fault(key, f"{given:g}", f"{follows:.6g}, as frequencies say (or left out)")
        return self

    @property
    def offset_hz(self) -> Array:
        """Frequencies of sampled signals about the carrier, (M,) Hz; none where there are no samples."""
        count = self.frequencies or 0
        step = self.frequency_step_hz or 0.0
        return np.asarray((np.arange(count) - 0.5 * (count - 1)) * step, np.float64)

    @model_validator(mode="after")
    def _measures_what_it_can(self) -> Self:
        if self.window_m is not None and not self.window_m[0] < self.window_m[1]:
            raise fault("window_m", str(list(self.window_m)), "[first, last], rising")
        given = list(self.measures)
        if "distance" not in given or len(set(given)) < len(given):
            raise fault("measures", repr(given), f"distance and any others of {', '.join(QUANTITIES)}, once")
        if self.detection_probability is not None and "amplitude" in given:
            # a measured amplitude is cut at the threshold, which is a detection probability of its own
            allowed = "none, or measures without amplitude"
            raise fault("detection_probability", str(self.detection_probability), allowed)
        return self


class GridSpec(Strict, table="[grid]"):
    """Region to map and the side of its square cells."""

    x_m: Point
    y_m: Point
    cell_m: Positive = 0.1

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for key, (low, high) in (("x_m", self.x_m), ("y_m", self.y_m)):
            if high - low < self.cell_m:
                raise fault(
                    key, f"[{low}, {high}]", f"[low, high], at least one cell of {self.cell_m} m apart"
                )
        cells = (self.x_m[1] - self.x_m[0]) / self.cell_m * ((self.y_m[1] - self.y_m[0]) / self.cell_m)
        if cells * CELL_BYTES > MOST_BYTES:
            need = in_gb(cells * CELL_BYTES)
            found = f"{self.cell_m} ({cells:.3g} cells, which need {need})"
            raise fault("cell_m", found, f"at most {in_gb(MOST_BYTES)}: {WAY_OUT}")
        return self

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells (ny, nx); the last ones may reach beyond the region."""
        ny, nx = (int(np.ceil((high - low) / self.cell_m - 1e-9)) for low, high in (self.y_m, self.x_m))
        return ny, nx

    @property
    def origin_m(self) -> Point:
        """Lower-left corner of the lower-left cell, m."""
        return self.x_m[0], self.y_m[0]

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (..., 2) in m lie in the region, (...)."""
        x, y = points[..., 0], points[..., 1]
        return (self.x_m[0] <= x) & (x <= self.x_m[1]) & (self.y_m[0] <= y) & (y <= self.y_m[1])


class Anchor(Strict, table="[[anchors]]"):
    """A radio at a known place."""

    name: Label
    position_m: Place
    orientation_deg: Degree = 0.0
    orientation_std_deg: float = Field(0.0, ge=0, le=30)
    position_std_m: float = Field(0.0, ge=0, le=2)
    array: ArraySpec | None = None
    clock: Clock | None = None


class Arc(Strict):
    """Part of a circle, drawn as flat facets."""

    centre_m: Point
    radius_m: Positive
    from_deg: Degree
    to_deg: Degree
    facets: int = Field(32, ge=1, le=1000)


class Wall(Strict, table="[[walls]]"):
    """A true wall: a polyline or an arc of one material.

    One that doesn't reflect blocks paths alone; with ``blocks = "sight"`` lines of sight, and no other path.
    """

    name: str | None = None
    material: str | None = None
    reflects: bool = True
    blocks: Literal["all", "sight"] = "all"
    points_m: tuple[Point, ...] | None = None
    arc: Arc | None = None
    closed: bool = False

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if self.reflects and self.material is None:
            raise fault("material", "nothing", "a value, this key has no default (or reflects = false)")
        if (self.points_m is None) == (self.arc is None):
            found = "neither points_m nor arc" if self.arc is None else "points_m and arc"
            raise fault("", found, "exactly one of points_m and arc")
        if len(self.corners) < 2:
            raise fault("points_m", f"{len(self.corners)} point", "at least 2 points")
        short = np.linalg.norm(np.diff(self.corners, axis=0), axis=1) < SAME_PLACE_M
        if short.any():
            where = "arc" if self.arc else f"points_m[{np.flatnonzero(short)[0]}]"
            raise fault(where, "a piece of zero length", "points that differ from the next one")
        return self

    @property
    def corners(self) -> Array:
        """Ends of its straight pieces in order, (P, 2) m."""
        if self.arc:
            angle = np.radians(np.linspace(self.arc.from_deg, self.arc.to_deg, self.arc.facets + 1))
            corners = self.arc.centre_m + self.arc.radius_m * np.stack([np.cos(angle), np.sin(angle)], -1)
        else:
            corners = np.reshape(self.points_m or (), (-1, 2)).astype(np.float64)
        return np.concatenate([corners, corners[:1]]) if self.closed else corners


class Scatterer(Strict):
    """A point that scatters to all sides: its path has the amplitude of 1 m times ``size_m / (d_1 d_2)``."""

    position_m: Point
    size_m: Positive


class Prior(Strict):
    """Half widths of the uniform prior about the start."""

    position_m: NotNegative = 0.5
    velocity_mps: NotNegative = 0.01
    heading_deg: float = Field(10.0, ge=0, le=180)


class Agent(Strict, table="[[agents]]"):
    """A mobile radio; waypoints give it a way to simulate.

    `acceleration_mps2` is the most that it accelerates sideways on that way: the truth's, whatever
    ``filter.acceleration_mps2`` makes of it. Among several agents, `present_s` says from when to when it is
    there: its way begins then, and it is waited for even if nothing is heard. `heading_sensor_deg` is the
    deviation of the heading that recordings of sampled signals hold (0: exact); without it they hold none.
    `height_m` is the height that it keeps, counted from where the heights of anchors are, and `height_std_m`
    the deviation of what is known of it. At each waypoint it stands still for `pause_s`, where that is given.
    """

    name: FolderName
    start_m: Point
    height_m: Metre | None = None
    height_std_m: HeightStd = 0.0
    start_heading_deg: Degree = 0.0
    waypoints_m: tuple[Point, ...] | None = None
    pause_s: tuple[NotNegative, ...] | None = None
    step_m: Positive = 0.05
    interval_s: Positive = 1.0
    acceleration_mps2: Positive = 0.03
    steps: int | None = Field(None, ge=1)
    prior: Prior = Prior()
    array: ArraySpec | None = None
    clock: Clock | None = None
    present_s: tuple[NotNegative, NotNegative] | None = None
    heading_sensor_deg: float | None = Field(None, ge=0, le=180)

    @model_validator(mode="after")
    def _leads_somewhere(self) -> Self:
        if self.present_s is not None and not self.present_s[0] < self.present_s[1]:
            raise fault("present_s", str(list(self.present_s)), "[from, to], rising")
        gaps = np.linalg.norm(np.diff(self.way, axis=0), axis=1)
        if self.waypoints_m is not None and (len(gaps) < 1 or (gaps < SAME_PLACE_M).any()):
            raise fault("waypoints_m", "no way to go", "waypoints that differ from the one before")
        if gaps.sum() > MOST_STEPS * self.step_m:
            raise fault("step_m", str(self.step_m), f"steps so long that {MOST_STEPS} reach the end")
        if self.pause_s is not None:
            there, most = len(self.waypoints_m or ()), MOST_STEPS - gaps.sum() / self.step_m
            if len(self.pause_s) != there:
                found, allowed = f"{len(self.pause_s)} of them", f"{there}, one for each of waypoints_m"
                raise fault("pause_s", found, allowed if there else "none, or waypoints_m, too")
            if sum(self.pause_s) > most * self.interval_s:
                found = f"{sum(self.pause_s):g} s in all"
                raise fault("pause_s", found, f"so little that {MOST_STEPS} steps reach the end")
        return self

    @property
    def way(self) -> Array:
        """Start and waypoints, (P, 2) m; a first waypoint that repeats the start counts once."""
        points = np.array([self.start_m, *(self.waypoints_m or ())], dtype=np.float64)
        repeats = len(points) > 1 and np.linalg.norm(points[1] - points[0]) < SAME_PLACE_M
        return points[1:] if repeats else points

    @property
    def pauses(self) -> Array:
        """How long it stands still at each point of `way`, (P,) s."""
        every = np.array([0.0, *(self.pause_s or [0.0] * len(self.waypoints_m or ()))])
        return every[len(every) - len(self.way) :]
