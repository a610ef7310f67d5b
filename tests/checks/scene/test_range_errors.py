"""What spoils distances, written as every particle takes it, against each kind's own words."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.checks.scene.range_errors import RangeError
from gridslam.world.geometry import slant

HEIGHT = np.array([0.0, 1.5, -0.7])


@pytest.mark.parametrize("kind", ["offset", "slant", "rise", "plan"])
@pytest.mark.parametrize("anchors", [(0, 1, 2), (1,), ()])
@given(level=st.floats(0, 50), size=st.floats(-5, 8))
def test_every_kind_is_a_height_and_an_offset_that_grow_with_its_size(kind, anchors, level, size):
    error = RangeError(kind, anchors)
    fixed, tilt, added = error.by_size(HEIGHT).T
    found = slant(level, fixed + tilt * size) + added * size
    expected = [error.spoilt(np.array(level), size, number, HEIGHT[number]) for number in range(3)]
    assert found == pytest.approx(np.array(expected))
