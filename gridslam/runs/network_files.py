"""What a run of several agents writes beside its agents' files: offsets of clocks over time."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable
from pathlib import Path

from gridslam.io.datasets import Dataset, Group, Layout
from gridslam.io.files import reading_h5, write_bytes, writing_h5
from gridslam.runs.clock_track import ClockTrack
from gridslam.world.clocks import ClockTruth

CSV, H5 = "clocks.csv", "clocks.h5"
OFFSETS = Group("", (
    Dataset("@anchors", "1", "how many of the devices are anchors", least=0, kind="int64"),
    Dataset("device", "text", "names: the anchors', then the agents'", shape="D", kind="text"),
    Dataset("step", "1", "number of the step", least=0, shape="N", kind="int64"),
    Dataset("time_s", "s", "its time", shape="N"),
    Dataset("offset_s", "s", "offsets of the clocks as believed", shape="N, D"),
    Dataset("covariance_s2", "s^2", "covariance of all of a step together", shape="N, D, D"),
    Dataset("unset", "1", "anchors whose clocks no step had set yet", shape="N, J", kind="bool"),
    Dataset("true_offset_s", "s", "true offsets", "not known", shape="N, D"),
))  # fmt: skip
CLOCKS = Layout(H5, "gridslam-clocks", (1,), (OFFSETS,))


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
    true = None if truth is None else clocks.offset_s - clocks.errors(truth)
    with writing_h5(path, CLOCKS.kind) as file:
        OFFSETS.put(file, vars(clocks) | {"@anchors": clocks.anchors, "true_offset_s": true})


def read_clocks(path: str | os.PathLike[str]) -> tuple[ClockTrack, ClockTruth | None]:
    """Read a file of `write_clocks`.

    Raises
    ------
    InputError
        Not such a file, cut short, or arrays that don't belong together.
    """
    with reading_h5(path, CLOCKS.kind, CLOCKS.versions) as file:
        first = OFFSETS.get(file, names=("@anchors",))["@anchors"]
        found = OFFSETS.get(file, {"J": first})
    anchors, true = found.pop("@anchors"), found.pop("true_offset_s")
    track = ClockTrack(anchors=anchors, **found)
    return track, None if true is None else ClockTruth(track.device, track.time_s, true)
