"""Paths of three-dimensional ray tracers as measurements: Sionna RT, DeepMIMO.

A path that a map of walls can explain runs over vertical walls alone: it leaves and arrives at one slope.
Every other path (over a roof, and over floor and ceiling unless the scene has them) is left out. Where the
scene has heights, lengths stay as they are, and so do paths of any slope that lead from the anchor's height
to the agent's. Without heights,
what isn't too steep is projected on the plane: the azimuths as they are, the length times the cosine of the
slope. What a tracer lists twice counts once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from reprlib import repr as brief
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.importers.repeated_paths import repeated
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.table import Measurements
from gridslam.world.columns import ELEVATIONS
from gridslam.world.geometry import wrap
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.start import require_scene

if TYPE_CHECKING:
    from gridslam.world.levels import Verticals
    from gridslam.world.scene import Scene

CHOICES = ("slope_deg", "carrier_hz", "least_snr_db", "agent")
RANGES = {"slope_deg": (0.0, 90.0), "carrier_hz": (1.0, 1e15), "least_snr_db": (-np.inf, 1000.0)}
"""Of choices that are numbers."""
SAME_SLOPE_RAD = np.radians(1.0)
"""Largest difference of the slopes at both ends; slopes of ray tracers in single precision are this good."""
STEEPEST_DEG, SAME_HEIGHT_M = 30.0, 0.1
"""Steepest path that is projected; by how much paths may miss the agent's height, on top of 1 degree."""


@dataclass(frozen=True, eq=False)
class TracedPaths:
    """All paths of a ray tracer, in world directions; padding is NaN in `delay_s`.

    Attributes
    ----------
    delay_s : (N, J, L) float64, s
        Over N steps and J anchors.
    departure_rad, arrival_rad : (N, J, L) float64, rad
        Azimuth in which the path leaves the anchor, and from the agent towards where it comes from.
    departure_zenith_rad, arrival_zenith_rad : (N, J, L) float64, rad
        Angles of the same directions from the vertical.
    gain : (N, J, L) float64
        Magnitude of the channel coefficient, 1 being no loss at all.
    """

    delay_s: Array
    departure_rad: Array
    arrival_rad: Array
    departure_zenith_rad: Array
    arrival_zenith_rad: Array
    gain: Array

    def __post_init__(self) -> None:
        for field in fields(self):
            values = np.asarray(getattr(self, field.name), dtype=np.float64)
            object.__setattr__(self, field.name, values)
            if values.ndim != 3 or values.shape != self.delay_s.shape:
                raise InputError(
                    f"paths: {field.name}", f"shape {values.shape}", "one shape (N, J, L) for all"
                )

    @property
    def planar(self) -> NDArray[np.bool_]:
        """Paths with the same slope at both ends, (N, J, L)."""
        with np.errstate(invalid="ignore"):
            return np.abs(self.departure_zenith_rad + self.arrival_zenith_rad - np.pi) < SAME_SLOPE_RAD

    @property
    def angles_rad(self) -> tuple[Array, ...]:
        """Azimuths and angles from the vertical at both ends, each (N, J, L)."""
        azimuths = self.departure_rad, self.arrival_rad
        return *azimuths, self.departure_zenith_rad, self.arrival_zenith_rad

    @classmethod
    def join(cls, parts: Sequence[TracedPaths], axis: int = 0) -> TracedPaths:
        """Put the steps (axis 0) or the anchors (axis 1) of several one after another.

        Raises
        ------
        InputError
            None at all, or parts that don't agree along the other axis.
        """
        others = {part.delay_s.shape[1 - axis] for part in parts}
        if len(others) != 1:
            what = ("transmitters", "steps")[axis]
            raise InputError("paths", f"{sorted(others)} {what}", f"the same number of {what} in every part")
        width = max(part.delay_s.shape[2] for part in parts)

        def column(name: str) -> Array:
            values = [getattr(part, name) for part in parts]
            pads = [((0, 0), (0, 0), (0, width - v.shape[2])) for v in values]
            padded = [np.pad(v, pad, constant_values=np.nan) for v, pad in zip(values, pads, strict=True)]
            return np.concatenate(padded, axis=axis)

        return cls(**{field.name: column(field.name) for field in fields(cls)})

    def at(self, steps: ArrayLike, where: str) -> TracedPaths:
        """Those of some of the steps, in the order that is asked for.

        Raises
        ------
        InputError
            There is no such step; `where` says who asked.
        """
        rows, most = np.asarray(steps), len(self.delay_s)
        if rows.ndim != 1 or rows.dtype.kind not in "iu" or ((rows < 0) | (rows >= most)).any():
            raise InputError(where, f"shape {rows.shape}", f"whole numbers from 0 to {most - 1}")
        return TracedPaths(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def plane_table(
    paths: TracedPaths,
    scene: Scene,
    heading_rad: ArrayLike,
    slope_deg: float | None = None,
    carrier_hz: float | None = None,
    least_snr_db: float | None = None,
    agent: str | None = None,
) -> dict[str, Any]:
    """Quantities for `gridslam.Measurements.from_arrays`, of the paths that run in the plane.

    Parameters
    ----------
    paths : TracedPaths
        One step per heading, one anchor per anchor of the scene, in its order.
    scene : Scene
        Its anchors' orientations turn world directions into angles of departure, its radio gain into
        amplitude.
    heading_rad : float or (N,) float, rad
        Heading of the agent at each step.
    slope_deg : float, optional
        Steepest path that is kept; paths over the floor or the ceiling only once, and only if the scene has
        it. Default: any where the
        scene has heights, else 30: too small a value leaves out the line of sight to anchors close by; the
        amplitude isn't projected, and at 30 degrees is 13 % below what the plane lets expect.
    carrier_hz : float or None
        Frequency that was traced; None takes the scene's.
    least_snr_db : float or None
        Weaker paths are left out; None takes the scene's detection threshold. For `simulate.receive`, which
        decides itself what is detected, go some 10 dB below that.
    agent : str, optional
        Whose height it is, where the scene has heights; default: the first.

    Returns
    -------
    dict of dict of (N, L) arrays
        ``distance_m``, ``aod_rad``, ``aoa_rad`` and ``amplitude`` by anchor, padded with NaN; and elevations,
        where the scene's arrays measure any.

    Raises
    ------
    InputError
        No scene, numbers of steps or anchors that don't match, a heading that is no finite number, or a
        choice out of `RANGES`.

    Notes
    -----
    Amplitudes are roots of SNRs ([Li2026grid], eq. (2)): line of sight at 1 m has ``snr_at_1m_db``, and
    a ray tracer gives it the gain ``lambda / (4 pi)``; so ``u = u_1m |a| 4 pi / lambda``.
    """
    require_scene(scene)
    _check_choices({"slope_deg": slope_deg, "carrier_hz": carrier_hz, "least_snr_db": least_snr_db})
    steps, count, _ = paths.delay_s.shape
    if count != len(scene.anchors):
        raise InputError("paths: transmitters", str(count), f"{len(scene.anchors)}, as the scene has anchors")
    heading = headings(heading_rad, steps)
    wavelength = SPEED_OF_LIGHT / (scene.radio.carrier_hz if carrier_hz is None else carrier_hz)
    signal = scene.signal_model()
    amplitude = signal.amplitude_at_1m * paths.gain * 4 * np.pi / wavelength
    least = signal.threshold if least_snr_db is None else 10 ** (least_snr_db / 20)
    slope, length = np.abs(paths.departure_zenith_rad - 0.5 * np.pi), SPEED_OF_LIGHT * paths.delay_s
    steepest = slope_deg if slope_deg is not None else 90.0 if scene.has_heights else STEEPEST_DEG
    with np.errstate(invalid="ignore"):
        usable = (slope <= np.radians(steepest)) & (paths.delay_s > 0) & (amplitude > least)
        usable &= _in_space(paths, length, scene.verticals(agent)) if scene.has_heights else paths.planar
    usable &= ~repeated(paths.delay_s, paths.angles_rad, paths.gain)
    columns = {
        "distance_m": length if scene.has_heights else length * np.cos(slope),
        "aod_rad": wrap(paths.departure_rad - scene.anchor_orientations[:, None]),
        "aoa_rad": wrap(paths.arrival_rad - heading[:, None, None]),
        "amplitude": amplitude,
    }
    for end, zenith in enumerate((paths.departure_zenith_rad, paths.arrival_zenith_rad)):
        if scene.has_heights and any(signal.elevated):
            columns[ELEVATIONS[end]] = 0.5 * np.pi - zenith
    cut = {name: np.where(usable, values, np.nan) for name, values in columns.items()}
    return {
        name: {anchor: values[:, j] for j, anchor in enumerate(scene.anchor_names)}
        for name, values in cut.items()
    }


def headings(heading_rad: ArrayLike, steps: int) -> Array:
    """One heading for each step, (N,) rad, of one for all or one for each.

    Raises
    ------
    InputError
        Neither, or no finite numbers.
    """
    allowed = f"one finite number, or one for each of {steps}"
    try:
        heading = np.asarray(heading_rad, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("heading_rad", brief(heading_rad), allowed) from None
    if heading.shape not in ((), (steps,)):
        raise InputError("heading_rad", f"shape {heading.shape}", allowed)
    if not np.isfinite(heading).all():
        raise InputError("heading_rad", "NaN or infinity", allowed)
    return np.broadcast_to(heading, (steps,))


def _check_choices(choices: Mapping[str, float | None]) -> None:
    for name, value in choices.items():
        low, high = RANGES[name]
        known = isinstance(value, int | float | np.integer | np.floating)
        if value is not None and not (known and low <= value <= high):
            raise InputError(name, brief(value), f"a number from {low:g} to {high:g}, or None")


def _in_space(paths: TracedPaths, length: Array, ways: Verticals) -> NDArray[np.bool_]:
    """Paths over vertical walls and at most one of the scene's levels, (N, J, L); lengths in m."""
    rise, near = length * np.cos(paths.departure_zenith_rad), SAME_HEIGHT_M + SAME_SLOPE_RAD * length
    # up and down again over floor and ceiling keeps the slope, too
    usable = paths.planar & (np.abs(rise + ways.height[0][:, None]) < near)
    mirrored = np.abs(paths.departure_zenith_rad - paths.arrival_zenith_rad) < SAME_SLOPE_RAD
    for image in ways.height[1:]:
        usable |= mirrored & (np.abs(rise - image[:, None]) < near)
    return np.asarray(usable)


def measurements_of(paths: TracedPaths, scene: Scene, heading_rad: ArrayLike, **more: Any) -> Measurements:
    """Measurements of what was traced; see `gridslam.importers.sionna.measurements_from_sionna`."""
    choice = {name: more.pop(name) for name in CHOICES if name in more}
    tables = plane_table(paths, scene, heading_rad, **choice)
    known = {
        "anchor_position_m": scene.anchor_places,
        "anchor_orientation_rad": scene.anchor_orientations,
    }
    return Measurements.from_arrays(**tables, **{**known, **more})


def network_of(
    paths: TracedPaths,
    scene: Scene,
    heading_rad: Mapping[str, ArrayLike],
    steps: Mapping[str, ArrayLike],
    **more: Any,
) -> NetworkMeasurements:
    """Measurements of several agents of what was traced for all of them.

    Parameters
    ----------
    paths : TracedPaths
        Places of all agents, in any order.
    heading_rad : dict of agent to float or (N,) float, rad
    steps : dict of agent to (N,) int
        Which of the places it passes, step by step, all from the same first step.
    truth : dict of agent to Trajectory, optional
    **more
        As of `measurements_of`, for all.

    Raises
    ------
    InputError
        Agents that aren't the scene's, or of which something is missing, or places that aren't there.
    """
    tracks = more.pop("truth", None) or {}
    for what, given in (("heading_rad", heading_rad), ("receivers", steps), ("truth", tracks)):
        if not isinstance(given, Mapping):
            raise InputError(what, type(given).__name__, "a dictionary, with an entry for each agent's name")
    for what, given in (("heading_rad", heading_rad), ("truth", tracks)):
        unknown = [name for name in given if name not in steps]
        if unknown:
            raise InputError(f"{what}: agent", repr(unknown[0]), ", ".join(steps) or "none here")
    parts = {}
    for name, own in steps.items():
        scene.agent(name)
        if name not in heading_rad:
            raise InputError("heading_rad", f"none of {name!r}", f"one for each of {', '.join(steps)}")
        mine = paths.at(own, f"steps of {name!r}")
        parts[name] = measurements_of(
            mine, scene, heading_rad[name], **more, agent=name, truth=tracks.get(name)
        )
    return NetworkMeasurements.of_agents(parts)
