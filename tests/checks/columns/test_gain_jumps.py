"""A gain that jumps is named with its step and size; fading, shadows and one anchor's change are none."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.columns.gain_jumps import gain_jump
from gridslam.checks.runs.range_note import misread
from gridslam.checks.verdicts.diagnose import suspicions

ROOM = gs.Scene.load("room")
HEARD = gs.simulate(ROOM, "agent1", 1)


def louder(by):
    """The table, each amplitude times what a function of steps and anchors says."""
    factor = by(HEARD.step, HEARD.anchor)
    return replace(HEARD, amplitude=HEARD.amplitude * factor)


def found(heard):
    columns = {name: np.asarray(values) for name, values in heard.columns.items()}
    return gain_jump(columns, ROOM, "agent1")


@pytest.mark.parametrize(
    ("since", "factor", "says"), [(60, 2.0, "dB louder (times"), (110, 0.3, "dB fainter (times 0.3")]
)
def test_a_gain_that_jumps_is_named_by_check_and_run(since, factor, says):
    heard = louder(lambda step, _: np.where(step >= since, factor, 1.0))
    columns = {name: np.asarray(values) for name, values in heard.columns.items()}
    (item,) = suspicions(columns, heard.anchors, ROOM, "agent1")
    assert item.text.startswith("all paths are ")
    assert says in item.text
    assert f"from about step {since} on" in item.text
    assert misread(ROOM, "agent1", heard) == [str(item)]


def test_a_right_table_and_one_that_is_loud_all_along_have_none():
    assert found(HEARD) == []
    assert found(louder(lambda step, _: np.full(len(step), 3.0))) == []
    assert found(replace(HEARD, amplitude=np.full(len(HEARD.step), np.nan))) == []


def test_one_anchor_that_becomes_fainter_is_no_gain():
    """A door, or who stands before it, may do that."""
    assert found(louder(lambda step, anchor: np.where((step >= 60) & (anchor == 0), 0.3, 1.0))) == []


def test_two_anchors_that_change_at_once_by_other_factors_are_no_gain():
    factor = np.array([2.0, 6.0])
    assert found(louder(lambda step, anchor: np.where(step >= 60, factor[anchor], 1.0))) == []


def test_an_only_anchor_tells_no_gain():
    own = HEARD.anchor == 0
    alone = replace(HEARD, **{name: values[own] for name, values in HEARD.columns.items()})
    assert found(replace(alone, amplitude=alone.amplitude * np.where(alone.step >= 60, 2.0, 1.0))) == []


def test_a_level_that_rises_over_many_looks_is_no_jump():
    assert found(louder(lambda step, _: 2.0 ** np.clip((step - 60) / 14, 0, 1))) == []


def test_a_short_while_of_loudness_at_the_end_is_not_judged():
    assert found(louder(lambda step, _: np.where(step >= 146, 3.0, 1.0))) == []


@pytest.mark.parametrize("correlated", [0, 20])
def test_fading_and_shadows_are_no_jump(correlated):
    draw = np.random.default_rng(2)
    keep = np.exp(-1 / correlated) if correlated else 0.0
    for _ in range(5):
        level = draw.normal(size=(150, 2))
        for step in range(1, 150):
            level[step] = keep * level[step - 1] + np.sqrt(1 - keep**2) * level[step]
        assert found(louder(lambda step, anchor, own=level: 10 ** (4 * own[step, anchor] / 20))) == []
