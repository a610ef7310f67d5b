"""Evidence for lines, against its plain counterpart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam import reference


def weighed(*arguments):
    from gridslam.kernels.messages.line_evidence import weigh_lines

    evidence = arguments[-1].copy()
    weigh_lines(*arguments[:-1], evidence)
    return evidence


@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([0.0, 1.5]), st.sampled_from([1, 7]))
@settings(max_examples=30, deadline=None)
def test_evidence_is_that_of_the_twin(seed, fades, height, beams):
    draw = np.random.default_rng(seed)
    power = 4 * draw.exponential(size=(beams, 9, 20))
    power[draw.random(power.shape) < 0.2] = -1.0
    arguments = (
        power.astype(np.float32), draw.uniform(0.5, 2), 12.0,
        np.array([*draw.uniform(-5, 5, 2), draw.uniform(-3, 3), height]),
        np.array([*draw.uniform(-5, 5, 2), draw.uniform(-3, 3), *draw.uniform(-1, 1, 2)]),
        np.linspace(-6, 6, 11), draw.uniform(1, 30, 3), np.array([0.9, 0.05]), int(fades),
        np.exp(draw.uniform(-5, 5, (13, 11, 3))),
    )  # fmt: skip
    found, expected = weighed(*arguments), reference.weigh_lines(*arguments)
    # where a path falls on the border of two points of the table, rounding may take either
    close = np.isclose(found, expected, rtol=1e-3)
    assert close.mean() > 0.99


def test_one_line_is_as_worked_out_by_hand():
    # the line x = 2, anchor (0, 0), agent (0, 3): image at (4, 0), length 5
    power = np.full((1, 1, 10), 5.0, np.float32)
    place, pose = np.zeros(4), np.array([0.0, 3.0, 0.0, 0.0, 0.0])
    known = (power, 2.0, 10.0, place, pose, np.array([-2.0, 0.0, 2.0]), np.array([5.0]), np.array([0.9, 0.1]))
    before = np.ones((2, 3, 1))
    fading = weighed(*known, 1, before)
    ratio = 0.9 * np.exp(2.5 / 2 - np.log(2)) + 0.1
    assert fading[0, 2, 0] == pytest.approx(ratio, rel=1e-5)
    power[0, 0, 5] = -1.0  # beside a known path
    assert weighed(*known, 1, 4 * before)[0, 2, 0] == 4.0
    # y = 0 lies through the anchor: no path
    power[0, 0, 5] = 5.0
    assert weighed(*known, 0, 4 * before)[1, 1, 0] == 4.0
