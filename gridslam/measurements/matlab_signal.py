"""Sampled signals in MATLAB's ``.mat`` files, version 5 to 7.3.

Variables of their own, or the fields of one struct ``signal``: ``samples`` (complex: steps x anchors x
elements of the anchor x elements of the agent x frequencies, or steps x anchors x frequencies),
``carrier_hz``, ``frequency_hz``, ``anchors`` (a cell array of names; left out: they are numbered), and any
other argument of `Recording.from_arrays`.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from gridslam.errors import InputError
from gridslam.measurements.matlab import read_variables

GROUP = "signal"
NUMBERS = "carrier_hz", "interval_s", "heading_std_rad"
VECTORS = "frequency_hz", "time_s", "pulse", "noise_std", "heading_rad", "anchor_orientation_rad"
ARRAYS = "samples", "heard", "anchor_position_m", "anchor_element_m", "agent_element_m"
NEEDED = "samples", "carrier_hz", "frequency_hz"


def read_mat_signal(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a MATLAB file of sampled signals.

    Returns
    -------
    dict
        The arguments of `Recording.from_arrays`.

    Raises
    ------
    InputError
        Not such a file, cut short, or a variable that is missing or of another kind.
    """
    raw = read_variables(path, (*NUMBERS, *VECTORS, *ARRAYS, "anchors"), GROUP)
    for name in NEEDED:
        if name not in raw:
            raise InputError(
                str(path), f"no variable {name!r}", f"{', '.join(NEEDED)}, or a struct {GROUP!r}"
            )
    found: dict[str, Any] = {}
    for name, value in raw.items():
        where = f"{path}: {name}"
        if name == "anchors":
            if not isinstance(value, list):
                raise InputError(where, "something else", "a cell array of names")
            found[name] = tuple(value)
            continue
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiubc":
            raise InputError(where, "something else", "an array of numbers")
        if value.dtype.kind == "c" and name not in ("samples", "pulse"):
            raise InputError(where, "complex numbers", "real ones")
        if name in NUMBERS:
            if value.size != 1:
                raise InputError(where, f"{value.size} values", "one")
            found[name] = float(value.ravel()[0])
        else:
            found[name] = value.ravel(order="F") if name in VECTORS else value
    if "anchors" not in found:
        count = found["samples"].shape[1] if found["samples"].ndim > 1 else 0
        found["anchors"] = tuple(f"{number + 1}" for number in range(count))
    return found


def is_mat_signal(path: str | os.PathLike[str]) -> bool:
    """Whether a MATLAB file holds samples; of one that can't be read, no."""
    try:
        return "samples" in read_variables(path, ("samples",), GROUP)
    except InputError:
        return False
