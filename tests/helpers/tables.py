"""Small measurement tables for tests."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from gridslam.measurements.table import Measurements
from gridslam.world.columns import DEVIATIONS, KEYS, VALUES

COLUMNS = (*KEYS, *VALUES, *DEVIATIONS)
HEADER = "step,time_s,anchor,distance_m,aod_rad,aoa_rad,amplitude"
ROW = "0,0.0,A,1.0,0.5,0.5,3.0"


def table(count=4, **changes):
    good = {
        "anchors": ("A", "B"),
        "step": np.arange(count),
        "time_s": 0.5 * np.arange(count),
        "anchor": np.arange(count) % 2,
        "distance_m": np.linspace(1, 2, count),
        "aod_rad": np.linspace(-3, 3, count),
        "aoa_rad": np.linspace(3, -3, count),
        "amplitude": np.linspace(2, 9, count),
    }
    return good | changes


def same(one, other, names=COLUMNS):
    for name in names:
        left, right = getattr(one, name), getattr(other, name)
        if left is None or right is None:
            assert left is right, name
        else:
            np.testing.assert_array_equal(left, right, err_msg=name)
            assert left.dtype == right.dtype


@st.composite
def measurements(draw):
    anchors = draw(st.sampled_from([("A",), ("A", "B"), ('north "1", left', "tür", "3")]))
    count = draw(st.integers(1, 12))
    step = np.cumsum(draw(st.lists(st.integers(0, 2), min_size=count, max_size=count)))
    pace = draw(st.sampled_from([1.0, 0.1, 1 / 3]))
    maybe = st.one_of(st.just(np.nan), st.floats(1e-6, 1e6, allow_subnormal=False))
    angle = st.one_of(st.just(np.nan), st.floats(-3.14, 3.14, allow_subnormal=False))
    column = {name: draw(st.lists(angle, min_size=count, max_size=count)) for name in ("aod_rad", "aoa_rad")}
    column["amplitude"] = draw(st.lists(maybe, min_size=count, max_size=count))
    column["distance_m"] = draw(
        st.lists(st.floats(1e-6, 1e6, allow_subnormal=False), min_size=count, max_size=count)
    )
    for name in draw(st.sets(st.sampled_from(DEVIATIONS))):
        column[name] = draw(st.lists(maybe, min_size=count, max_size=count))
    anchor = draw(st.lists(st.integers(0, len(anchors) - 1), min_size=count, max_size=count))
    return Measurements(anchors=anchors, step=step, time_s=5 + pace * step, anchor=anchor, **column)


def late(measurements, metres, anchor=None):
    """Measurements of all anchors or one, so many metres too long."""
    rows = np.ones(len(measurements.anchor), bool) if anchor is None else measurements.anchor == anchor
    return replace(measurements, distance_m=np.abs(measurements.distance_m + metres * rows))
