"""Arrays of DeepMIMO (its Dataset of version 4, one per transmitter) as paths.

Conventions of DeepMIMO, of which only the arrays are read: ``delay`` in s; ``aod_az``, ``aoa_az`` azimuths
and ``aod_el``, ``aoa_el`` angles from the vertical, all in degrees and world coordinates, the arrival towards
where the path comes from; ``power`` in dB of the channel gain (dBm at 0 dBm sent); each (users, paths),
padded with NaN. Elevations may be left out.
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
from gridslam.world.scene import Scene

ARRAYS = ("delay", "aod_az", "aoa_az", "aod_el", "aoa_el", "power")
NEEDED = tuple(name for name in ARRAYS if not name.endswith("_el"))
LONGEST_S, SMALL, FEW = 1e-3, 4 * np.pi, 10
"""Delay (300 km) beyond which delays aren't in seconds; two turns, within which angles are that are radians,
wrapped or not; paths below which all angles may be small by chance."""


def measurements_from_deepmimo(
    datasets: Sequence[Mapping[str, Any]],
    scene: Scene,
    heading_rad: ArrayLike,
    *,
    users: ArrayLike | None = None,
    **more: Any,
) -> Measurements:
    """Take over arrays of DeepMIMO: exact paths, without noise (`receive` adds it).

    Parameters
    ----------
    datasets : sequence of mappings, one per anchor in the scene's order
        See the head of this file for the arrays and their conventions.
    users : (N,) int, optional
        Users along which the agent moves; otherwise all, in order.
    scene, heading_rad, **more
        As in `gridslam.importers.sionna.measurements_from_sionna`.

    Raises
    ------
    InputError
        An array is missing, or shapes that don't match.
    """
    return measurements_of(traced(datasets, users), scene, heading_rad, **more)


def network_from_deepmimo(
    datasets: Sequence[Mapping[str, Any]],
    scene: Scene,
    heading_rad: Mapping[str, ArrayLike],
    users: Mapping[str, ArrayLike],
    **more: Any,
) -> NetworkMeasurements:
    """Take over arrays of DeepMIMO for several agents at once: exact paths, without noise or clocks.

    `gridslam.simulation.network.receive_network` adds these.

    Parameters
    ----------
    datasets : sequence of mappings, one per anchor in the scene's order
        As of `measurements_from_deepmimo`.
    scene : Scene
        For the anchors' orientations, the radio and the agents.
    heading_rad : dict of agent to float or (N,) float, rad
    users : dict of agent to (N,) int
        Users along which each agent moves.
    **more
        As of `gridslam.importers.sionna.network_from_sionna`.

    Raises
    ------
    InputError
        An array is missing, shapes that don't match, or agents that aren't the scene's.
    """
    return network_of(traced(datasets), scene, heading_rad, users, **more)


def traced(datasets: Sequence[Mapping[str, Any]], users: ArrayLike | None = None) -> TracedPaths:
    """Collect what was traced.

    Parameters
    ----------
    datasets : sequence of mappings, one per anchor
        A Dataset of DeepMIMO, or a dictionary of its arrays; without elevations the paths count as
        horizontal.
    users : (N,) int, optional
        Users along which the agent moves, in order; otherwise all, in theirs.

    Raises
    ------
    InputError
        An array is missing, is no table, or has another shape than ``delay``; there is no such user; or
        delays or angles can't be seconds or degrees.
    """
    if isinstance(datasets, Mapping) or not len(datasets):
        raise InputError("datasets", "one mapping" if datasets else "none", "a list, one item per anchor")
    found = TracedPaths.join([_one(item, k, users) for k, item in enumerate(datasets)], axis=1)
    _require_units(found)
    return found


def _require_units(paths: TracedPaths) -> None:
    """Refuse delays that aren't seconds, and angles that aren't degrees.

    A path leaves and arrives in opposite directions along a line of sight, and with zenith angles that sum to
    180 degrees over walls: both ends' angles are never all as small as radians are.

    Raises
    ------
    InputError
        Either.
    """
    there = np.isfinite(paths.delay_s) & (paths.delay_s > 0)
    if not there.any():
        return
    middle = float(np.median(paths.delay_s[there]))
    if middle > LONGEST_S:
        raise InputError("datasets: delay", f"{middle:.4g} in the median", "seconds (of ns, times 1e-9)")
    ends = {
        "aod_az, aoa_az": (paths.departure_rad, paths.arrival_rad),
        "aod_el, aoa_el": (paths.departure_zenith_rad, paths.arrival_zenith_rad),
    }
    for names, both in ends.items():
        angle = np.degrees(np.abs(np.stack(both)[:, there]))
        angle = angle[np.isfinite(angle)]
        if len(angle) >= 2 * FEW and 0 < angle.max() <= SMALL:
            raise InputError(f"datasets: {names}", f"none beyond {angle.max():.3g}", "degrees, not radians")


def _one(dataset: Mapping[str, Any], number: int, users: ArrayLike | None) -> TracedPaths:
    table: dict[str, NDArray[np.float64]] = {}
    for name in ARRAYS:
        where = f"datasets[{number}].{name}"
        try:
            values = np.asarray(dataset[name], dtype=np.float64)
        except (KeyError, AttributeError):
            if not name.endswith("_el"):
                allowed = f"all of {', '.join(NEEDED)} (aod_el and aoa_el may be left out)"
                raise InputError(where, "none", allowed) from None
            values = np.full_like(table["delay"], 90.0)
        except (TypeError, ValueError) as error:
            raise InputError(where, "no numbers", "an array (users, paths)") from error
        if values.ndim != 2 or values.shape != table.get("delay", values).shape:
            raise InputError(where, f"shape {values.shape}", "(users, paths), the same for all")
        table[name] = values
    rows = np.arange(len(table["delay"])) if users is None else np.asarray(users)
    if rows.ndim != 1 or rows.dtype.kind not in "iu" or ((rows < 0) | (rows >= len(table["delay"]))).any():
        raise InputError("users", f"shape {rows.shape}", f"whole numbers from 0 to {len(table['delay']) - 1}")
    cut = {name: values[rows][:, None, :] for name, values in table.items()}
    return TracedPaths(
        delay_s=cut["delay"],
        departure_rad=np.radians(cut["aod_az"]),
        arrival_rad=np.radians(cut["aoa_az"]),
        departure_zenith_rad=np.radians(cut["aod_el"]),
        arrival_zenith_rad=np.radians(cut["aoa_el"]),
        gain=10 ** (cut["power"] / 20),
    )
