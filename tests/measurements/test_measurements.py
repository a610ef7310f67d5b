"""Measurement tables: steps, arrays, and what they refuse."""

import numpy as np
import pytest
from tables import same, table

from gridslam.errors import InputError
from gridslam.measurements.table import Measurements
from gridslam.world import columns
from gridslam.world.columns import VALUES

# ---- steps


def test_missing_steps_are_empty_scans_with_times_between_and_beyond():
    measurements = Measurements(
        **table(3, step=[1, 1, 4], time_s=[10.0, 10.0, 16.0]), interval_s=0.5, steps=7
    )
    assert len(measurements) == 7
    scans = list(measurements)
    assert [len(scan) for scan in scans] == [0, 2, 0, 0, 1, 0, 0]
    assert [scan.step for scan in scans] == list(range(7))
    assert [scan.time_s for scan in scans] == [9.5, 10, 12, 14, 16, 16.5, 17]
    np.testing.assert_array_equal(measurements.scan(1).anchor, [0, 1])
    np.testing.assert_array_equal(measurements.scan(4).amplitude, [9])
    assert measurements.scan(4).distance_std_m is None
    with pytest.raises(IndexError):
        measurements.scan(7)
    with pytest.raises(IndexError):
        measurements.scan(-1)


def test_interval_is_the_median_of_what_was_heard():
    assert Measurements(**table(3, step=[0, 2, 3], time_s=[0.0, 4.0, 6.0])).interval_s == 2.0
    assert Measurements(**table(1)).interval_s == 1.0


def test_silence_has_steps_and_times():
    measurements = Measurements(**table(0), interval_s=0.1, steps=3)
    assert [scan.time_s for scan in measurements] == [0.0, 0.1, 0.2]
    assert sum(len(scan) for scan in measurements) == 0
    assert len(Measurements(**table(0))) == 0


def test_angles_are_wrapped_and_columns_read_only():
    measurements = Measurements(**table(2, aod_rad=[4.0, -np.pi]))
    np.testing.assert_allclose(measurements.aod_rad, [4 - 2 * np.pi, np.pi])
    with pytest.raises(ValueError, match="read-only"):
        measurements.distance_m[0] = 3


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"anchors": ()}, "anchors"),
        ({"anchors": ("A", "A")}, "anchors"),
        ({"distance_m": [1.0, 2.0]}, "distance_m"),
        ({"anchor_position_m": np.zeros((3, 2))}, "anchor_position_m"),
        ({"anchor_position_m": np.full((2, 2), np.nan)}, "anchor_position_m"),
        ({"step": [0, 1, 3, 2]}, "step[3]"),
        ({"step": [-1, 0, 1, 2]}, "step[0]"),
        ({"step": [0, 1, 2, 10**12]}, "step[3]"),
        ({"time_s": [0.0, 1, 1, 2]}, "time_s[2]"),
        ({"time_s": [0.0, 1, 0.5, 2]}, "time_s[2]"),
        ({"time_s": [0.0, 1, np.nan, 2]}, "time_s[2]"),
        ({"step": [0, 1, 1, 2]}, "time_s[2]"),
        ({"anchor": [0, 1, 2, 0]}, "anchor[2]"),
        ({"anchor": [0, -1, 0, 0]}, "anchor[1]"),
        ({"distance_m": [1.0, -1, 1, 1]}, "distance_m[1]"),
        ({"distance_m": [1.0, np.inf, 1, 1]}, "distance_m[1]"),
        ({"amplitude": [1.0, 1, 0, 1]}, "amplitude[2]"),
        ({"aoa_rad": [0.1, 0.2, 90, 0]}, "aoa_rad[2]"),
        ({"aoa_rad_std": 0}, None),
        ({"aoa_std_rad": [0.1, 0.2, 0.0, 0.1]}, "aoa_std_rad[2]"),
        ({"aoa_std_rad": [0.1, 0.2, np.inf, 0.1]}, "aoa_std_rad[2]"),
        ({name: [1.0, np.nan, 1, 1] for name in VALUES}, "distance_m[1]"),
        ({"steps": 2}, "steps"),
        ({"steps": 10**12}, "steps"),
        ({"interval_s": -1.0}, "interval_s"),
        ({"interval_s": np.nan}, "interval_s"),
    ],
)
def test_impossible_table_is_refused_with_its_row(changes, where):
    if where is None:
        with pytest.raises(TypeError):
            Measurements(**table(**changes))
        return
    with pytest.raises(InputError) as caught:
        Measurements(**table(**changes))
    assert caught.value.where == f"measurements: {where}"


# ---- arrays


def test_ragged_lists_and_padded_arrays_agree():
    nan = np.nan
    ragged = Measurements.from_arrays(
        {"A": [[2.0, 5.5], [], [2.1]], "B": [[4.0], [4.1], []]},
        amplitude={"A": [[9.0, 3.0], [], [8.0]], "B": [[7.0], [7.1], []]},
        interval_s=0.2,
    )
    padded = Measurements.from_arrays(
        {"A": np.array([[2.0, 5.5], [nan, nan], [2.1, nan]]), "B": np.array([[4.0], [4.1], [nan]])},
        amplitude={"A": np.array([[9.0, 3.0], [nan, nan], [8.0, nan]]), "B": np.array([[7.0], [7.1], [nan]])},
        interval_s=0.2,
    )
    same(ragged, padded)
    np.testing.assert_array_equal(ragged.step, [0, 0, 0, 1, 2])
    np.testing.assert_array_equal(ragged.anchor, [0, 0, 1, 1, 0])
    np.testing.assert_array_equal(ragged.distance_m, [2.0, 5.5, 4.0, 4.1, 2.1])
    np.testing.assert_array_equal(ragged.amplitude, [9, 3, 7, 7.1, 8])
    assert np.isnan(ragged.aoa_rad).all()
    np.testing.assert_allclose(ragged.time_s, [0, 0, 0, 0.2, 0.4])


def test_one_path_per_step_and_silent_last_steps():
    measurements = Measurements.from_arrays(
        {"A": [3.0, np.nan, 3.2, np.nan]}, distance_std_m={"A": [0.1, 0.1, 0.1, 0.1]}
    )
    assert len(measurements) == 4
    assert [len(scan) for scan in measurements] == [1, 0, 1, 0]
    np.testing.assert_array_equal(measurements.distance_std_m, [0.1, 0.1])


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        ({"amplitude": {"A": [[1.0], [1.0, 2.0]]}}, "amplitude['A'][1]"),
        ({"amplitude": {"B": [[1.0], [1.0]]}}, "amplitude"),
        ({"amplitude": {"A": [[1.0]]}}, "amplitude['A']"),
        ({"time_s": [0.0]}, "time_s"),
        ({"time_s": [1.0, 0.0]}, "time_s[1]"),
    ],
)
def test_arrays_that_do_not_match_are_refused(arguments, where):
    with pytest.raises(InputError) as caught:
        Measurements.from_arrays({"A": [[1.0], [2.0]]}, **arguments)
    assert caught.value.where == f"measurements: {where}"


@pytest.mark.parametrize(
    "column", [one for one in columns.TABLE if one.name not in columns.KEYS], ids=lambda one: one.name
)
def test_a_table_is_held_to_the_limits_that_the_reference_states(column):
    """Written once, in `gridslam.world.columns`: what checks refuse, and what docs/file-formats.md allows."""
    row = {"step": np.array([0]), "time_s": np.zeros(1), "anchor": np.array([0]), "distance_m": np.ones(1)}
    ends = [value for value in (column.least, column.most) if np.isfinite(value)]
    kept = [] if column.open else ends
    for value in (*kept, 0.5):
        columns.check_columns(row | {column.name: np.array([value])}, 1, lambda row, name: name)
    for value in (np.inf, *([column.least] if column.open else [end * 1.01 for end in ends])):
        with pytest.raises(InputError, match=column.name):
            columns.check_columns(row | {column.name: np.array([value])}, 1, lambda row, name: name)
