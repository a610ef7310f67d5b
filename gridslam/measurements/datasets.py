"""What `measurements.h5` and `signal.h5` hold: datasets with types, units, ranges and meanings."""

from __future__ import annotations

import numpy as np

from gridslam.io.datasets import Dataset, Group, Layout
from gridslam.world.columns import MOST_STEPS, NOT_MEASURED, TABLE, Column

UNKNOWN = "not known"
SIMULATED = (
    Dataset("@scene", "1", "of what was simulated: name of the scene", "recorded", kind="text", free=True),
    Dataset("@seed", "1", "of what was simulated: seed of the random numbers", "recorded", 0,
            kind="int64", free=True),
    Dataset("@agents", "1", "of what was simulated: who heard it", "recorded", shape="A", kind="text",
            free=True),
)  # fmt: skip


def _of_column(one: Column) -> Dataset:
    whole = one.name in ("step", "anchor")
    return Dataset(
        one.name, one.unit, one.meaning, one.default, -1 if one.name == "anchor" else one.least, one.most,
        one.open, shape="M", kind="int64" if whole else "float64",
        nan=NOT_MEASURED if one.default != "required" else "",
    )  # fmt: skip


_TIMED = tuple(_of_column(one) for one in TABLE[:2])
ROWS = Group("measurements", (
    Dataset("@steps", "1", "number of steps, silent ones included", "up to the last one heard", 0, MOST_STEPS,
            kind="int64"),
    Dataset("@interval_s", "s", "time between steps, for silent ones at either end", "their median", 0),
    Dataset("@unlabelled", "1", "whether rows may leave open whose they are (anchor -1)", "false",
            kind="bool"),
    Dataset("@pseudo", "1", "whether offsets of clocks are in the distances, which may then be negative",
            "false", kind="bool"),
    *SIMULATED,
    *_TIMED,
    Dataset("agent", "index", "who heard it: a row of `/agents`", "one agent", 0, shape="M", kind="int64"),
    *(_of_column(one) for one in TABLE[2:]),
))  # fmt: skip
NAMES = Dataset("name", "text", "names", shape="J", kind="text")
FACING = Dataset("orientation_rad", "rad", "directions from which angles of departure count", UNKNOWN,
                 shape="J")  # fmt: skip
ANCHORS = Group("anchors", (
    NAMES,
    Dataset("position_m", "m", "where they are, with heights where the scene has some", UNKNOWN,
            shape="J, 2 or 3"),
    FACING,
))  # fmt: skip
AGENTS = Group("agents", (
    Dataset("name", "text", "names", shape="I", kind="text"),
    Dataset("present", "step", "first step of each, and the one after its last", "all steps", 0,
            shape="I, 2", kind="int64"),
), "one agent")  # fmt: skip
TRACK = Group("truth", (
    Dataset("time_s", "s", "times of the true track, rising", shape="T"),
    Dataset("position_m", "m", "true positions", shape="T, 2"),
    Dataset("velocity_mps", "m/s", "true velocities", shape="T, 2"),
    Dataset("heading_rad", "rad", "true headings", shape="T"),
    Dataset("height_m", "m", "true heights", "in a plane", shape="T"),
    Dataset("holes_s", "s", "from when to when nothing is known of the way", "none", shape="H, 2"),
), "not known")  # fmt: skip
CLOCKS = Group("truth/clocks", (
    Dataset("device", "text", "names of anchors and agents", shape="D", kind="text"),
    Dataset("time_s", "s", "times of the true offsets", shape="C"),
    Dataset("offset_s", "s", "true offsets of the clocks", shape="C, D"),
), "not known")  # fmt: skip
MEASUREMENTS = Layout(
    "measurements.h5", "gridslam-measurements", (1, 2), (ROWS, ANCHORS, AGENTS, TRACK, CLOCKS)
)

SIGNAL = Group("signal", (
    *SIMULATED,
    Dataset("samples", "any", "real and imaginary part, in any scale", shape="N, J, A, B, F, 2",
            kind="float32", nan="in snapshots that weren't heard", endless=True),
    Dataset("samples@carrier_hz", "Hz", "carrier frequency", least=0, open=True),
    Dataset("time_s", "s", "times of the steps, rising", shape="N"),
    Dataset("frequency_hz", "Hz", "frequencies about the carrier, rising, evenly spaced, 8 or more",
            shape="F"),
    Dataset("heard", "1", "whether the anchor was heard at the step", "all were", shape="N, J", kind="bool"),
    Dataset("pulse", "1", "spectrum of the pulse, real and imaginary part", "flat, or divided out already",
            shape="F, 2"),
    Dataset("noise_std", "as samples", "standard deviation of the noise, from which its estimate starts",
            "of the samples", 0, open=True, shape="J"),
))  # fmt: skip
ARRAYS = Group("anchors", (
    NAMES,
    Dataset("position_m", "m", "where they are", UNKNOWN, shape="J, 2"),
    FACING,
    Dataset("element_m", "m", "elements of their arrays, in their own frames, x forward",
            "needless of lone antennas", shape="J, A, 2"),
))  # fmt: skip
DEVICE = Group("agent", (
    Dataset("element_m", "m", "elements of the agent's array, in its own frame, x forward",
            "needless of a lone antenna", shape="B, 2"),
    Dataset("heading_rad", "rad",
            "measured headings; hybrid SLAM, its references and direct grid SLAM use them", "not measured",
            -8 * np.pi, 8 * np.pi, shape="N"),
    Dataset("heading_rad@std_rad", "rad", "their standard deviation; 0: exact", "0", 0),
), "a lone antenna, no headings")  # fmt: skip
RECORDING = Layout("signal.h5", "gridslam-signal", (1,), (SIGNAL, ARRAYS, DEVICE, TRACK))
