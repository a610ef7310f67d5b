"""Variances in columns of deviations are named by what the radio measures; rough deviations aren't."""

import numpy as np
import pytest
from check_tables import SCENES, simulated_columns

from gridslam.checks.columns.deviations import degrees, too_exact, variances
from gridslam.checks.tables.unit_hypotheses import absurd

ROOM = SCENES["room"]


def table(factor=1.0, power=1.0):
    """A table whose deviations are those of its radio, times a factor, to a power."""
    columns = simulated_columns("room", 3, steps=20)
    usual = ROOM.signal_model().distance_scale / columns["amplitude"]
    return columns | {"distance_std_m": (factor * usual) ** power}


@pytest.mark.parametrize("factor", [0.6, 1.0, 1.5])
def test_squares_are_named_with_what_they_should_be(factor):
    (found,) = variances(table(factor, 2), ROOM)
    assert (found.column, found.kind, found.certain) == ("distance_std_m", "variances", False)


@pytest.mark.parametrize("factor", [0.2, 0.5, 1.0, 3.0, 10.0])
def test_deviations_are_not(factor):
    assert variances(table(factor), ROOM) == []


def test_little_tells_nothing():
    few = {name: values[:10] for name, values in table(1, 2).items()}
    assert variances(few, ROOM) == []
    missing = table(1, 2) | {"amplitude": np.full(len(table()["step"]), np.nan)}
    assert variances(missing, ROOM) == []
    assert variances({"step": np.zeros(0)}, ROOM) == []


def test_deviations_of_angles_beyond_a_quarter_of_a_turn_are_degrees():
    columns = simulated_columns("room", 3, steps=5)
    right = np.full(len(columns["step"]), 0.05)
    assert absurd(columns | {"aoa_std_rad": right})[0] == []
    (found,), table = absurd(columns | {"aoa_std_rad": np.degrees(right)})
    assert (found.column, found.kind, found.certain) == ("aoa_std_rad", "degrees", True)
    np.testing.assert_allclose(table["aoa_std_rad"], right)


@pytest.mark.slow
def test_deviations_of_angles_far_wider_than_they_scatter_are_degrees():
    """Of less than a degree and a half: none of them is beyond a quarter of a turn."""
    columns = simulated_columns("room", 3)
    right = np.full(len(columns["step"]), np.radians(0.9))
    assert degrees(columns | {"aoa_std_rad": right}, ROOM, "agent1")[0] == []
    (found,), table = degrees(columns | {"aod_std_rad": np.degrees(right)}, ROOM, "agent1")
    assert (found.column, found.kind) == ("aod_std_rad", "degrees")
    np.testing.assert_allclose(table["aod_std_rad"], right)


def test_a_bandwidth_that_is_far_too_small_is_told_by_how_exact_distances_are():
    columns = simulated_columns("room", 3)
    assert too_exact(columns, ROOM) == []
    radio = ROOM.radio.model_copy(update={"bandwidth_hz": ROOM.radio.bandwidth_hz / 50})
    narrow = ROOM.model_copy(update={"radio": radio})
    (found,) = too_exact(columns, narrow)
    assert "far more exact than radio.bandwidth_hz" in found.text
    own = columns | {"distance_std_m": np.full(len(columns["step"]), 0.02)}
    assert too_exact(own, narrow) == [], "it says how exact they are"
