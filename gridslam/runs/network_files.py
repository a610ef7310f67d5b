"""What a run of several agents writes beside its agents' files: offsets of clocks over time."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from gridslam.io.files import get, put, reading_h5, write_bytes, writing_h5
from gridslam.runs.clock_track import ClockTrack
from gridslam.world.clocks import ClockTruth

FORMAT = "gridslam-clocks"
CSV, H5 = "clocks.csv", "clocks.h5"


def clock_files(clocks: ClockTrack, truth: ClockTruth | None) -> dict[str, Callable[[Path], None]]:
    """Writers of the files, by name."""
    return {CSV: lambda path: write_csv(path, clocks), H5: lambda path: write_clocks(path, clocks, truth)}


def write_csv(path: str | os.PathLike[str], clocks: ClockTrack) -> None:
    """Write ``step,time_s,device,offset_s,offset_std_s``, a row for each step and device.

    Raises
    ------
    InputError
        The file can't be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("step", "time_s", "device", "offset_s", "offset_std_s"))
    rows = zip(clocks.step.tolist(), clocks.time_s.tolist(), clocks.offset_s, clocks.deviation_s, strict=True)
    for step, time, offset, deviation in rows:
        writer.writerows(
            (step, repr(time), name, repr(float(own)), repr(float(std)))
            for name, own, std in zip(clocks.device, offset, deviation, strict=True)
        )
    write_bytes(path, text.getvalue().encode("utf-8"))


def write_clocks(path: str | os.PathLike[str], clocks: ClockTrack, truth: ClockTruth | None = None) -> None:
    """Write offsets with the covariance of all as HDF5, and the true ones where they are known.

    Raises
    ------
    InputError
        The file can't be written.
    """
    with writing_h5(path, FORMAT) as file:
        file.attrs["anchors"] = clocks.anchors
        put(file, "device", np.array(clocks.device, dtype=h5py.string_dtype()), "text")
        put(file, "step", clocks.step, "1")
        put(file, "time_s", clocks.time_s, "s")
        put(file, "offset_s", clocks.offset_s, "s")
        put(file, "covariance_s2", clocks.covariance_s2, "s^2")
        put(file, "unset", clocks.unset, "1")
        if truth is not None:
            put(file, "true_offset_s", clocks.offset_s - clocks.errors(truth), "s")


def read_clocks(path: str | os.PathLike[str]) -> tuple[ClockTrack, ClockTruth | None]:
    """Read a file of `write_clocks`.

    Raises
    ------
    InputError
        Not such a file, cut short, or arrays that don't belong together.
    """
    with reading_h5(path, FORMAT) as file:
        names = tuple(name.decode("utf-8") for name in get(file, "device", (None,), "O"))
        step = get(file, "step", (None,), "iu")
        count, size, anchors = len(step), len(names), int(file.attrs.get("anchors", 0))
        track = ClockTrack(
            names, anchors, step, get(file, "time_s", (count,)), get(file, "offset_s", (count, size)),
            get(file, "covariance_s2", (count, size, size)), get(file, "unset", (count, anchors), "b"),
        )  # fmt: skip
        true = get(file, "true_offset_s", (count, size)) if "true_offset_s" in file else None
        return track, None if true is None else ClockTruth(names, track.time_s, true)
