"""What `check` says of a scene whose true clocks aren't as it tells filters."""

import pytest

import gridslam as gs
from gridslam.checks.scene.lines import scene_lines


def noted(anchor=(), agent=(), clocks=()):
    """What is noted of `exchange` with other clocks of its first devices."""
    data = gs.Scene.load("exchange").model_dump(exclude_none=True)
    for part, changes in (("anchors", anchor), ("agents", agent)):
        own = data[part][0].get("clock") or {}
        data[part][0]["clock"] = own | dict(changes)
    data["clocks"] |= dict(clocks)
    lines = scene_lines(gs.Scene.checked(data, "exchange"))
    return [
        line.removeprefix("note: true clocks leave what [clocks] allows for: ")
        for line in lines
        if "true clocks" in line
    ]


def test_clocks_within_their_priors_are_left_in_peace():
    assert not noted()
    assert not noted(anchor={"drift_ppb": 5.0}, clocks={"drift_prior_ppb": 10.0})
    assert not noted(anchor={"jump_ns": 60.0, "jump_s": 30.0})  # a clock that jumps is found again


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"anchor": {"drift_ppb": 5.0, "zigzag_s": None}}, "A drifts by "),
        ({"anchor": {"offset_ns": 40.0, "prior_ns": 30.0}}, "A begins at 40 ns, where 30 are allowed for"),
        ({"agent": {"drift_ppb": 1000.0}, "clocks": {"drift_prior_ppb": 1.0}}, "agent1 drifts by "),
        (
            {
                "anchor": {"drift_ppb": 200.0, "prior_ns": 0.0, "offset_ns": 0.0, "zigzag_s": None},
                "clocks": {"drift_prior_ppb": 500.0},
            },
            "A drifts by ",
        ),
        ({"agent": {"drift_ppb": 1000.0, "jump_s": 5.0}}, "agent1 drifts by "),
        ({"agent": {"offset_ns": -7.0, "prior_ns": 2.0}}, "agent1 begins at -7 ns, where 2 are allowed for"),
    ],
)
def test_a_drift_and_an_offset_beyond_what_is_told_are_noted(changes, words):
    (said,) = noted(**changes)
    assert said.startswith(words)
