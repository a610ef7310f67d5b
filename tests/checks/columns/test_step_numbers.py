"""Numbers of steps that count something else, and numbers where names of anchors belong."""

import numpy as np
import pytest
from scipy.io import savemat

import gridslam as gs
from gridslam.checks.columns.time_units import strides_line
from gridslam.checks.verdicts.diagnose import describe

ROOM = gs.Scene.load("room")
HEARD = gs.simulate(ROOM, "agent1", 1)


@pytest.mark.parametrize(("stride", "first"), [(1000, 0), (2, 7)])
def test_steps_that_rise_by_a_stride_are_told_with_what_is_silent(stride, first):
    line = strides_line(first + stride * np.repeat(np.arange(20), 3))
    silent = 19 * (stride - 1)
    assert f"numbers rise by {stride}, or multiples of it" in line
    assert f"{silent} of {19 * stride + 1} steps are silent" in line


def test_silent_steps_and_short_tables_are_left_in_peace():
    assert strides_line(np.array([0, 2, 4, 5, *range(8, 30, 2)])) is None
    assert strides_line(2 * np.arange(9)) is None
    assert strides_line(np.arange(30)) is None
    assert strides_line(np.zeros(0, int)) is None


@pytest.mark.usefixtures("no_figures")
def test_check_suspects_them_and_run_notes_them(say, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = {name: values[HEARD.step < 12] for name, values in HEARD.columns.items()}
    gs.Measurements(**rows | {"step": 5 * rows["step"]}, anchors=ROOM.anchor_names).to_csv("a.csv")
    found = say("check", "a.csv")
    assert found.code == 1
    assert "suspect: step: numbers rise by 5" in found.out
    assert (
        "note: step: numbers rise by 5" in say("run", "room", "--measurements", "a.csv", "--steps", "3").err
    )


def test_numbers_for_anchors_are_refused_as_run_does_but_of_matlab(tmp_path):
    """`check` said that such a table fits, and `run` refused it."""
    rows = {name: values[HEARD.step < 30] for name, values in HEARD.columns.items()}
    path = tmp_path / "a.csv"
    gs.Measurements(**rows, anchors=("1", "2")).to_csv(path)
    assert "suspect: anchor: numbers that aren't names of the scene (A, B) (found 1, 2)" in describe(
        path, ROOM
    )
    savemat(tmp_path / "a.mat", {"measurements": rows | {"anchor": rows["anchor"] + 1}})
    assert not [line for line in describe(tmp_path / "a.mat", ROOM) if line.startswith("suspect")]
