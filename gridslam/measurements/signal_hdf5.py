"""HDF5 files of sampled signals, format ``gridslam-signal``."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from gridslam.io.files import reading_h5, subgroup, writing_h5
from gridslam.measurements.datasets import ARRAYS, DEVICE, RECORDING, SIGNAL
from gridslam.measurements.hdf5_table import get_track, put_track
from gridslam.measurements.simulated import simulated_of

KIND = RECORDING.kind
OWN = ("time_s", "frequency_hz", "heard", "noise_std")
"""Datasets that are called so in `Recording.from_arrays`, too."""


def write_signal(path: str | os.PathLike[str], content: dict[str, Any]) -> None:
    """Write what `read_signal` returns.

    Raises
    ------
    InputError
        The file can't be written.
    """
    simulated = content.get("simulated")
    with writing_h5(path, KIND) as file:
        parts = {name: _parts(content[name]) for name in ("samples", "pulse")}
        own = parts | {name: content[name] for name in OWN} | {"samples@carrier_hz": content["carrier_hz"]}
        SIGNAL.put(file, own | ({} if simulated is None else simulated.attributes))
        anchors = ("position_m", "orientation_rad", "element_m")
        ARRAYS.put(file, {"name": content["anchors"]} | {name: content[f"anchor_{name}"] for name in anchors})
        measured = {"heading_rad": content["heading_rad"]}
        if content["heading_rad"] is not None:
            measured["heading_rad@std_rad"] = content["heading_std_rad"]
        DEVICE.put(file, {"element_m": content["agent_element_m"]} | measured)
        if content["truth"] is not None:
            put_track(file, content["truth"])


def read_signal(path: str | os.PathLike[str], checked: bool = True) -> dict[str, Any]:
    """Read a file: arrays in the shapes that it promises.

    Parameters
    ----------
    path : path
    checked : bool
        Whether numbers are held to what they may be, or read as they stand.

    Returns
    -------
    dict
        The arguments of `Recording.from_arrays`, and ``simulated``.

    Raises
    ------
    InputError
        Not such a file, cut short, links in it, more promised than it holds, or shapes that don't match.
    """
    with reading_h5(path, KIND) as file:
        sizes: dict[str, int] = {}
        signal = SIGNAL.get(file, sizes, ("time_s", "frequency_hz"), checked)
        anchors = ARRAYS.get(file, sizes, ("name", "position_m", "orientation_rad"), checked)
        more = ("samples", "samples@carrier_hz", "heard", "pulse", "noise_std")
        signal |= SIGNAL.get(file, sizes, more, checked)
        anchors |= ARRAYS.get(file, sizes, ("element_m",), checked)
        agent = DEVICE.get(file, sizes, checked=checked)  # all in it may be left out
        return {
            **{name: signal[name] for name in OWN},
            "samples": _complex(signal["samples"]),
            "carrier_hz": signal["samples@carrier_hz"],
            "pulse": None if signal["pulse"] is None else _complex(signal["pulse"]),
            "anchors": anchors.pop("name"),
            **{f"anchor_{name}": values for name, values in anchors.items()},
            "agent_element_m": agent["element_m"],
            "heading_rad": agent["heading_rad"],
            "heading_std_rad": agent["heading_rad@std_rad"] or 0.0,
            "truth": get_track(file) if "truth" in file else None,
            "simulated": simulated_of(subgroup(file, SIGNAL.name)),
        }


def _parts(values: np.ndarray) -> np.ndarray:
    """Complex numbers (...) as real and imaginary part, (..., 2)."""
    return np.stack([values.real, values.imag], axis=-1)


def _complex(parts: np.ndarray) -> np.ndarray:
    """The other way round; samples stay in single precision."""
    kind = np.complex64 if parts.dtype == np.float32 else np.complex128
    return np.ascontiguousarray(parts).view(kind)[..., 0]
