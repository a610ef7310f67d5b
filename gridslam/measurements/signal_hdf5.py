"""HDF5 files of sampled signals, format ``gridslam-signal``."""

from __future__ import annotations

import os
from typing import Any

import h5py
import numpy as np

from gridslam.errors import InputError
from gridslam.io.files import get, put, reading_h5, subgroup, writing_h5
from gridslam.measurements.hdf5_table import get_track, put_track
from gridslam.measurements.simulated import simulated_of

KIND = "gridslam-signal"


def write_signal(path: str | os.PathLike[str], content: dict[str, Any]) -> None:
    """Write what `read_signal` returns.

    Raises
    ------
    InputError
        The file can't be written.
    """
    samples = content["samples"]
    with writing_h5(path, KIND) as file:
        signal = file.create_group("signal")
        if content.get("simulated") is not None:
            content["simulated"].put(signal)
        put(signal, "samples", _parts(samples).astype(np.float32), "any")
        signal["samples"].attrs["carrier_hz"] = content["carrier_hz"]
        for name, unit in (("time_s", "s"), ("frequency_hz", "Hz"), ("heard", "1")):
            put(signal, name, content[name], unit)
        put(signal, "pulse", _parts(content["pulse"]), "1")
        if content["noise_std"] is not None:
            put(signal, "noise_std", content["noise_std"], "as samples")
        anchors, agent = file.create_group("anchors"), file.create_group("agent")
        put(anchors, "name", np.array(content["anchors"], dtype=h5py.string_dtype()), "text")
        for name, key, unit in (
            ("position_m", "anchor_position_m", "m"),
            ("orientation_rad", "anchor_orientation_rad", "rad"),
            ("element_m", "anchor_element_m", "m"),
        ):
            if content[key] is not None:
                put(anchors, name, content[key], unit)
        put(agent, "element_m", content["agent_element_m"], "m")
        if content["heading_rad"] is not None:
            put(agent, "heading_rad", content["heading_rad"], "rad")
            agent["heading_rad"].attrs["std_rad"] = content["heading_std_rad"]
        if content["truth"] is not None:
            put_track(file.create_group("truth"), content["truth"])


def read_signal(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a file: arrays in the shapes that it promises, their content as it stands.

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
        signal, group = subgroup(file, "signal"), subgroup(file, "anchors")
        agent = subgroup(file, "agent") if "agent" in file else {}  # all in it may be left out
        frequency, time = get(signal, "frequency_hz", (None,)), get(signal, "time_s", (None,))
        names = tuple(name.decode("utf-8", "replace") for name in get(group, "name", (None,), "O"))
        steps, anchors, count = len(time), len(names), len(frequency)
        samples = _complex(get(signal, "samples", (steps, anchors, None, None, count, 2), "f"))
        elements, carried = samples.shape[2:4]
        where = f"{path}: /signal/samples"
        if "carrier_hz" not in signal["samples"].attrs:
            raise InputError(f"{where}: carrier_hz", "none", "the carrier, as an attribute of samples, Hz")
        has_heading = "heading_rad" in agent
        return {
            "samples": samples,
            "carrier_hz": _number(signal["samples"].attrs["carrier_hz"], f"{where}: carrier_hz"),
            "frequency_hz": frequency,
            "time_s": time,
            "heard": get(signal, "heard", (steps, anchors)) if "heard" in signal else None,
            "pulse": _complex(get(signal, "pulse", (count, 2))) if "pulse" in signal else None,
            "noise_std": get(signal, "noise_std", (anchors,)) if "noise_std" in signal else None,
            "anchors": names,
            "anchor_position_m": _optional(group, "position_m", (anchors, 2)),
            "anchor_orientation_rad": _optional(group, "orientation_rad", (anchors,)),
            "anchor_element_m": _optional(group, "element_m", (anchors, elements, 2)),
            "agent_element_m": _optional(agent, "element_m", (carried, 2)),
            "heading_rad": get(agent, "heading_rad", (steps,)) if has_heading else None,
            "heading_std_rad": _number(
                agent["heading_rad"].attrs.get("std_rad", 0.0), f"{path}: /agent/heading_rad: std_rad"
            )
            if has_heading
            else 0.0,
            "truth": get_track(subgroup(file, "truth")) if "truth" in file else None,
            "simulated": simulated_of(signal),
        }


def _optional(
    group: h5py.Group | dict[str, h5py.Dataset], name: str, shape: tuple[int | None, ...]
) -> np.ndarray | None:
    return get(group, name, shape) if name in group else None


def _number(value: object, where: str) -> float:
    try:
        return float(np.asarray(value).item())
    except (TypeError, ValueError) as error:
        raise InputError(where, str(error), "a number") from None


def _parts(values: np.ndarray) -> np.ndarray:
    """Complex numbers (...) as real and imaginary part, (..., 2)."""
    return np.stack([values.real, values.imag], axis=-1)


def _complex(parts: np.ndarray) -> np.ndarray:
    """The other way round; samples stay in single precision."""
    kind = np.complex64 if parts.dtype == np.float32 else np.complex128
    return (
        np.ascontiguousarray(parts).view(kind)[..., 0]
        if parts.dtype in (np.float32, np.float64)
        else (parts[..., 0] + 1j * parts[..., 1])
    )
