"""Pauses of a table, and clocks that were set on the way."""

import numpy as np
import pytest

from gridslam.checks.columns.time_units import absurd_times, intervals, set_clocks

STEPS = np.repeat(np.arange(12), 2)


def table(pause_s, interval_s=0.1):
    """Twelve steps of two rows, with a pause before the seventh."""
    return {"step": STEPS, "time_s": interval_s * STEPS + np.where(STEPS > 5, pause_s, 0.0)}


@pytest.mark.parametrize(("pause_s", "told"), [(0.0, False), (2.0, False), (9.0, True), (2e9, True)])
def test_a_long_pause_is_told(pause_s, told):
    assert ("from step 5 to step 6" in " ".join(intervals(table(pause_s)))) == told


def test_slow_tables_have_no_pause_where_they_are_slow_throughout():
    assert len(intervals(table(0.0, interval_s=60.0))) == 1
    assert intervals({"step": np.zeros(3, int), "time_s": np.zeros(3)}) == []


def test_a_clock_that_was_set_is_suspect_and_a_month_is_not():
    (suspect,) = set_clocks(table(1.79e9))
    said = "time_s: a clock that was set on the way, 1.79e+09 s from step 5 to step 6"
    assert str(suspect) == f"{said} (nobody measures for years)"
    assert not set_clocks(table(2.6e6))
    assert not set_clocks({"step": np.arange(3), "time_s": 1.79e9 + np.arange(3.0)})


@pytest.mark.parametrize(
    ("interval_s", "kind"),
    [(1e8, "nanoseconds"), (5e6, "microseconds"), (1e5, "microseconds"), (1e12, "nanoseconds")],
)
def test_steps_days_apart_are_no_seconds(interval_s, kind):
    (suspect,) = absurd_times(table(0.0, interval_s))
    assert (suspect.column, suspect.kind) == ("time_s", kind)


@pytest.mark.parametrize("first", [0.0, 1.7e9, 3.9e9, 1.3e10, 6.4e10])
def test_seconds_of_any_era_are_seconds(first):
    for interval_s in (0.1, 5.0):
        late = table(2e5, interval_s)
        assert not absurd_times(late | {"time_s": first + late["time_s"]})
    late = table(0.0, 100.0)
    assert bool(absurd_times(late | {"time_s": first + late["time_s"]})) == (first > 7.3e9)
