"""A table whose anchors are ranged one after the other is told so; others aren't."""

import warnings

import numpy as np
import pytest

import gridslam as gs
from gridslam.errors import Note
from gridslam.measurements.ranged_in_turn import in_turn_words


def table(time_s, anchor, **more):
    return {"time_s": np.asarray(time_s, float), "anchor": np.asarray(anchor), **more}


TURNS = table(0.1 * np.arange(40), np.arange(40) % 4)


def said(tmp_path, header, rows):
    path = tmp_path / "a.csv"
    path.write_text(header + "\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        gs.Measurements.from_csv(path)
    return [str(one.message) for one in notes if issubclass(one.category, Note)]


def test_anchors_that_are_ranged_in_turn_are_told(tmp_path):
    rows = [(0.05 * k, "ABC"[k % 3], 2.0 + 0.01 * k) for k in range(60)]
    (note,) = said(tmp_path, "time_s,anchor,distance_m", rows)
    assert "60 steps, one for each time; a silent one isn't there; 0 of 60 rows share their time" in note
    assert note.endswith("if it is meant, a column step that numbers them says so")
    assert said(tmp_path, "step,time_s,anchor,distance_m", [(k, *row) for k, row in enumerate(rows)]) == []


def test_rows_that_share_a_time_are_counted():
    """Every 20th round two anchors answer at once."""
    time = TURNS["time_s"].copy()
    time[20] = time[21]
    assert in_turn_words(table(time, TURNS["anchor"])).startswith("; 2 of 40 rows share")


def test_devices_are_told_apart():
    """Two tags that are ranged at once, by one anchor each, don't share a time with another anchor's."""
    agent = np.repeat([0, 1], 40)
    both = table(np.tile(TURNS["time_s"], 2), np.concatenate([TURNS["anchor"], 3 - TURNS["anchor"]]))
    assert in_turn_words({**both, "agent": agent}).startswith("; 0 of 80 rows")


@pytest.mark.parametrize(
    "right",
    [
        table(np.repeat(0.1 * np.arange(40), 2), np.tile([0, 1], 40)),
        table(0.1 * np.arange(40), np.repeat([0, 1, 2, 3], 10)),
        table(0.1 * np.arange(40), np.zeros(40, int)),
        table(0.1 * np.arange(40), np.full(40, -1)),
        table(0.1 * np.arange(8), np.arange(8) % 4),
        table([], []),
    ],
)
def test_other_tables_are_left_in_peace(right):
    """Rounds at once, anchors one room after the other, an only one, unlabelled ones, a few rows."""
    assert in_turn_words(right) == ""


def test_rounds_of_which_most_is_lost_are_left_in_peace():
    """At every fourth time two anchors are heard, at the others one of both."""
    time, anchor = np.arange(40.0), np.arange(40) % 2
    both = np.arange(0, 40, 4)
    order = np.argsort(np.concatenate([time, time[both]]), kind="stable")
    rows = table(
        *(
            np.concatenate([all_, one])[order]
            for all_, one in ((time, time[both]), (anchor, 1 - anchor[both]))
        )
    )
    assert in_turn_words(rows) == ""


def test_devices_that_are_heard_once_each_take_no_turns():
    assert in_turn_words(table(np.zeros(40), np.arange(40) % 2, agent=np.arange(40))) == ""
