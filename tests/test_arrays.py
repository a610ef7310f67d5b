"""Copies of values."""

import dataclasses
from functools import cached_property

import numpy as np
import pytest

from gridslam.arrays import replace
from gridslam.inference.beliefs.calibration import Calibration


@dataclasses.dataclass(frozen=True)
class Checked:
    size: int = 1

    def __post_init__(self):
        assert self.size


class Twice(Calibration):
    @cached_property
    def double(self):
        return 2 * self.pull


def test_a_copy_has_other_fields_and_nothing_that_was_cached():
    value = Twice.start(2)
    assert value.double == 2 * value.pull
    other = replace(value, pull=3.0)
    assert type(other) is Twice
    assert (other.double, other.pull) == (6.0, 3.0)
    assert value.pull != 3.0
    expected = dataclasses.replace(value, pull=3.0)
    for field in dataclasses.fields(value):
        np.testing.assert_array_equal(getattr(other, field.name), getattr(expected, field.name))
    with pytest.raises(dataclasses.FrozenInstanceError):
        other.pull = 4.0


def test_fields_that_are_none_and_classes_with_checks_of_their_own_are_refused():
    with pytest.raises(TypeError, match="Calibration has no field pulled"):
        replace(Calibration.start(2), pulled=3.0)
    with pytest.raises(TypeError, match=r"dataclasses\.replace"):
        replace(Checked(), size=2)
