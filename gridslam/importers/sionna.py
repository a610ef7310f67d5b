"""Paths of Sionna RT (its `Paths` class, since version 1.0) as arrays.

Only attributes are read, so that nothing here needs the package. Sionna RT gives directions in world
coordinates, whatever the orientations of the devices, delays in s (-1 for padding) and complex channel
coefficients, which hold the antenna patterns: trace with isotropic, vertically polarised antennas. Give the
path solver the first delays too: ``paths.cir(normalize_delays=True)`` shifts them, ``paths.tau`` doesn't.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import InputError
from gridslam.importers.raytracers import TracedPaths, measurements_of, network_of
from gridslam.measurements.network import NetworkMeasurements
from gridslam.measurements.table import Measurements
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene
from gridslam.world.start import require_scene

ANGLES = ("phi_t", "phi_r", "theta_t", "theta_r")
MOST_EXTENTS = 1000
"""Longest path that is believed, in diagonals of the scene: delays in ns or in m are far beyond."""


def measurements_from_sionna(
    paths: Any,
    scene: Scene,
    heading_rad: ArrayLike,
    *,
    uplink: bool = False,
    **more: Any,
) -> Measurements:
    """Take over what Sionna RT traced: exact paths, without noise (`receive` adds it).

    Parameters
    ----------
    paths : sionna.rt.Paths, or a sequence of them
        Its transmitters are the scene's anchors, in order; its receivers the agent, step by step.
    scene : Scene
        For the anchors' orientations and the radio.
    heading_rad : float or (N,) float, rad
        The agent's heading, the first angle of the receivers' orientation.
    uplink : bool
        Transmitters are the agent, receivers the anchors.
    **more
        ``slope_deg``, ``carrier_hz``, ``least_snr_db`` and ``agent`` of
        `gridslam.importers.raytracers.plane_table`; ``time_s``, ``interval_s``, ``truth`` and other
        arguments of `Measurements.from_arrays`.

    Raises
    ------
    InputError
        Not such an object, no scene, numbers of devices that don't match, delays that can't be in seconds, or
        a heading or choice that is no number.
    """
    return measurements_of(traced(paths, scene, uplink), scene, heading_rad, **more)


def network_from_sionna(
    paths: Any,
    scene: Scene,
    heading_rad: Mapping[str, ArrayLike],
    receivers: Mapping[str, ArrayLike],
    *,
    uplink: bool = False,
    **more: Any,
) -> NetworkMeasurements:
    """Take over what Sionna RT traced for several agents at once: exact paths, without noise or clocks.

    `gridslam.simulation.network.receive_network` adds these.

    Parameters
    ----------
    paths : sionna.rt.Paths, or a sequence of them
        Its transmitters are the scene's anchors, in order; its receivers the places of all agents.
    scene : Scene
        For the anchors' orientations, the radio and the agents.
    heading_rad : dict of agent to float or (N,) float, rad
    receivers : dict of agent to (N,) int
        Which of the receivers, counted over all objects, the agent is, step by step.
    uplink : bool
        Transmitters are the agents, receivers the anchors.
    **more
        As of `measurements_from_sionna`; ``truth`` is a dictionary of the agents' tracks.

    Raises
    ------
    InputError
        As of `measurements_from_sionna`, or agents that aren't the scene's.
    """
    return network_of(traced(paths, scene, uplink), scene, heading_rad, receivers, **more)


def traced(paths: Any, scene: Scene, uplink: bool = False) -> TracedPaths:
    """Collect what was traced.

    Parameters
    ----------
    paths : sionna.rt.Paths, or a sequence of them
        All receivers are steps, one object after the other; all transmitters are anchors.
    scene : Scene
        For its extent.
    uplink : bool
        The other way round: the transmitters are the steps, the receivers the anchors.

    Returns
    -------
    TracedPaths

    Raises
    ------
    InputError
        An attribute is missing or has a shape that Sionna RT doesn't give it, or delays can't be in seconds.

    Notes
    -----
    The gain is the root of the mean power over the antennas of both ends, the other quantities are those
    between the first antennas (with ``synthetic_array`` they are the same for all).
    """
    require_scene(scene)
    several = paths if isinstance(paths, Sequence) else [paths]
    if not several:
        raise InputError("paths", "none", "one Paths object or more")
    return TracedPaths.join([_one(item, scene, uplink) for item in several])


def _one(paths: Any, scene: Scene, uplink: bool) -> TracedPaths:
    tau = numbers_of(paths, "tau")
    several_antennas = tau.ndim == 5  # otherwise one value for the whole of a synthetic array
    if tau.ndim not in (3, 5):
        raise InputError("paths: tau", f"{tau.ndim} dimensions", "3 or 5, as Sionna RT gives them")
    columns = {"tau": tau} | {name: numbers_of(paths, name) for name in (*ANGLES, "valid")}
    for name, values in columns.items():
        if values.shape != tau.shape:
            raise InputError(f"paths: {name}", f"shape {values.shape}", f"shape {tau.shape}, as tau")
    if several_antennas:
        columns = {name: values[:, 0, :, 0] for name, values in columns.items()}
    power = (np.abs(coefficients(paths)) ** 2).mean(axis=(1, 3))
    if power.shape != columns["tau"].shape:
        raise InputError("paths: a", f"shape {power.shape} over the antennas", f"{columns['tau'].shape}")
    good = columns.pop("valid").astype(bool)
    require_seconds(columns["tau"][good], scene)
    require_whole(columns | {"a": power}, good)
    table = {name: np.where(good, values, np.nan) for name, values in columns.items()}
    table["gain"] = np.where(good, np.sqrt(power), np.nan)
    if uplink:
        table = {name: np.swapaxes(values, 0, 1) for name, values in table.items()}
    near, far = ("r", "t") if uplink else ("t", "r")
    return TracedPaths(
        delay_s=table["tau"],
        departure_rad=table[f"phi_{near}"],
        arrival_rad=table[f"phi_{far}"],
        departure_zenith_rad=table[f"theta_{near}"],
        arrival_zenith_rad=table[f"theta_{far}"],
        gain=table["gain"],
    )


def coefficients(paths: Any) -> NDArray[np.complex128]:
    """Complex channel coefficients, (receivers, antennas, transmitters, antennas, paths).

    Raises
    ------
    InputError
        There are none, or not of that shape.
    """
    pair = getattr(paths, "a", None)
    try:
        if isinstance(pair, tuple) and len(pair) == 2:
            real, imaginary = (np.asarray(part, dtype=np.float64) for part in pair)
        else:
            whole = np.asarray(pair)
            real, imaginary = np.real(whole), np.imag(whole)
    except (TypeError, ValueError):
        raise InputError("paths: a", "no numbers", "(real, imaginary), as Sionna RT gives") from None
    if real.ndim != 5 or real.shape != imaginary.shape:
        raise InputError(
            "paths: a", f"{real.ndim} dimensions", "(real, imaginary) with 5, as Sionna RT gives"
        )
    return real + 1j * imaginary


def numbers_of(paths: Any, name: str) -> NDArray:
    """An attribute as numbers.

    Raises
    ------
    InputError
        There is none, or it holds no numbers.
    """
    if not hasattr(paths, name):
        raise InputError(f"paths: {name}", "none", "a Paths object of Sionna RT 1.0 or later")
    try:
        return np.asarray(getattr(paths, name)).astype(np.float64)
    except (TypeError, ValueError):
        raise InputError(f"paths: {name}", "no numbers", "numbers, as Sionna RT gives them") from None


def require_seconds(tau: NDArray[np.float64], scene: Scene) -> None:
    """Refuse delays of valid paths that can't be in seconds.

    Raises
    ------
    InputError
        NaN, infinity, below 0, or more than light needs for `MOST_EXTENTS` times the scene's diagonal.
    """
    corners = np.vstack([np.transpose([scene.grid.x_m, scene.grid.y_m]), scene.anchor_positions])
    extent = float(np.linalg.norm(np.ptp(corners, axis=0)))
    most = MOST_EXTENTS * extent / SPEED_OF_LIGHT
    for wrong in tau[~((tau >= 0) & (tau <= most))][:1]:
        allowed = f"seconds, 0 to {most:.3g}: light over {MOST_EXTENTS} times the scene's {extent:.3g} m"
        raise InputError("paths: tau", f"{wrong:g} of a valid path", allowed)


def require_whole(columns: Mapping[str, NDArray], valid: NDArray[np.bool_]) -> None:
    """Refuse valid paths of which a gain or an angle isn't finite: they'd be lost without a word.

    Raises
    ------
    InputError
        Says how many there are.
    """
    for name, values in columns.items():
        wrong = valid & ~np.isfinite(values)
        if wrong.any():
            found = f"{wrong.sum()} of {valid.sum()} valid paths without a finite number"
            raise InputError(
                f"paths: {name}", found, "finite ones; set `valid` to False for paths that aren't there"
            )
