"""Answers are worked out once for the same arguments, and anew for any others."""

from dataclasses import dataclass

import numpy as np
import pytest

from gridslam.checks.sights.remembered import LATEST, remembered


@dataclass(frozen=True)
class Kind:
    name: str


class Thing:
    pass


@pytest.fixture
def counted():
    """A function that is remembered, and the list of its calls."""
    calls = []

    @remembered
    def total(table, thing, kind=None, times=1):
        calls.append(1)
        return times * sum(float(values.sum()) for values in table.values())

    return total, calls


def test_the_same_is_worked_out_once(counted):
    total, calls = counted
    thing = Thing()
    for _ in range(3):
        assert total({"a": np.arange(3.0)}, thing, Kind("x"), times=2) == 6.0
    assert len(calls) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"table": {"a": np.array([0.0, 1.0, 3.0])}},
        {"table": {"b": np.arange(3.0)}},
        {"table": {"a": np.arange(3)}},
        {"table": {"a": np.arange(3.0)[None]}},
        {"kind": Kind("y")},
        {"times": 2},
        {"thing": Thing()},
    ],
)
def test_any_other_argument_is_another_question(counted, change):
    total, calls = counted
    usual = {"table": {"a": np.arange(3.0)}, "thing": Thing(), "kind": Kind("x"), "times": 1}
    total(**usual)
    total(**usual | change)
    assert len(calls) == 2


def test_an_array_that_was_changed_is_another_one(counted):
    total, calls = counted
    values, thing = np.arange(3.0), Thing()
    total({"a": values}, thing)
    values[0] = 5.0
    assert total({"a": values}, thing) == 8.0
    assert len(calls) == 2


def test_only_the_latest_are_kept(counted):
    total, calls = counted
    thing = Thing()
    for number in range(LATEST + 1):
        total({"a": np.array([float(number)])}, thing)
    total({"a": np.array([0.0])}, thing)
    assert len(calls) == LATEST + 2
