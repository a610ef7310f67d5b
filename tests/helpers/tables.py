"""Small measurement tables for tests."""

import numpy as np

from gridslam.world.columns import DEVIATIONS, KEYS, VALUES

COLUMNS = (*KEYS, *VALUES, *DEVIATIONS)


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
