"""Anchors that stand as roughly as the scene tells of them aren't suspected; those farther off are."""

from dataclasses import replace

import numpy as np
import pytest
from check_tables import BRIEF, SCENES, simulated_columns

import gridslam as gs
from gridslam.checks.anchors.handover_rivals import handover_rival
from gridslam.checks.scene.allowed_for import error_allowed, shift_allowed, turn_allowed
from gridslam.checks.scene.range_errors import RangeError
from gridslam.checks.signals.files import describe_signal
from gridslam.checks.verdicts.diagnose import suspicions
from gridslam.checks.verdicts.verdict import verdict


def told(name, shift=(0.0, 0.0), turn=0.0, place_std=0.0, turn_std=0.0, clocks=None):
    """A scene whose first anchor is told elsewhere than it stands (m, degrees), and how roughly."""
    data = SCENES[name].model_dump(exclude_none=True) | ({} if clocks is None else {"clocks": clocks})
    first, *others = data["anchors"]
    first = first | {
        "position_m": tuple(np.add(first["position_m"], shift)),
        "orientation_deg": first["orientation_deg"] + turn,
        "position_std_m": place_std, "orientation_std_deg": turn_std,
    }  # fmt: skip
    return gs.Scene.checked({**data, "anchors": [first, *others]}, name)


def kinds(columns, scene):
    return {one.kind for one in suspicions(columns, scene.anchor_names, scene, "agent1")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off", "rough", "too_well"),
    [
        ({"turn": 10.0}, {"turn_std": 4.0}, {"turn_std": 2.0}),
        ({"turn": -25.0}, {"turn_std": 10.0}, {"turn_std": 4.0}),
        ({"shift": (0.4, -0.3)}, {"place_std": 0.2}, {"place_std": 0.02}),
    ],
)
def test_what_deviations_allow_for_is_not_suspected(off, rough, too_well):
    columns = simulated_columns("room", 1, steps=BRIEF)
    assert kinds(columns, told("room", **off))
    assert kinds(columns, told("room", **off, **too_well))
    assert not kinds(columns, told("room", **off, **rough))


@pytest.mark.slow
def test_a_table_that_fits_as_deviations_allow_is_said_to_fit():
    columns, scene = simulated_columns("room", 1, steps=BRIEF), told("room", turn=-25.0, turn_std=10.0)
    assert "units and frames fit the scene" in verdict(columns, np.arange(2), scene, "agent1")


@pytest.mark.slow
@pytest.mark.parametrize(("place_std", "suspected"), [(0.0, True), (0.1, True), (0.3, False)])
def test_one_distance_too_long_is_a_place_that_is_told_roughly(place_std, suspected):
    columns = simulated_columns("room", 1, steps=BRIEF)
    late = columns | {"distance_m": columns["distance_m"] + 0.7 * (columns["anchor"] == 0)}
    assert bool(kinds(late, told("room", place_std=place_std))) == suspected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off", "rough"),
    [({"turn": 20.0}, {"turn_std": 10.0}), ({"shift": (1.0, -1.0)}, {"place_std": 0.6})],
)
def test_handovers_allow_for_them_too(off, rough):
    columns = simulated_columns("alcove", 1)
    assert handover_rival(columns, told("alcove", **off), "agent1") is not None
    assert handover_rival(columns, told("alcove", **off, **rough), "agent1") is None


def test_bounds_are_three_deviations():
    scene = told("room", place_std=0.2, turn_std=4.0)
    far = np.array([2.0, 4.0, 9.0])
    most = 3 * np.hypot(np.radians(4.0), 0.2 / 4.0)
    assert [turn_allowed(by * most, 0, far, scene) for by in (-0.99, 1.01)] == [True, False]
    assert turn_allowed(3 * np.radians(3.9), 0, np.zeros(0), scene)
    assert not turn_allowed(0.01, 1, far, scene)
    assert [shift_allowed(np.array([0.0, by]), 0, scene) for by in (0.59, -0.61)] == [True, False]
    own, every = RangeError("offset", (0,)), RangeError("offset", (0, 1))
    assert [error_allowed(own, size, scene, None) for size in (-0.59, 0.61)] == [True, False]
    assert not error_allowed(every, 0.3, scene, None)  # the other anchor stands as told
    height = RangeError("slant", (0,))
    assert [error_allowed(height, size, scene, None, 2.0) for size in (1.6, 1.7)] == [True, False]
    clocks = told("room", clocks={"anchor_prior_ns": 10.0})
    assert [error_allowed(own, size, clocks, None) for size in (3.0, 4.0)] == [True, False]


def test_lines_of_sight_of_samples_are_looked_for_as_far_as_anchors_may_stand(tmp_path):
    screen = gs.Scene.load("screen")
    heard = gs.simulate(screen, "agent1", 1, what="signal")
    replace(heard, anchor_position_m=None, anchor_orientation_rad=None).to_h5(tmp_path / "z.h5")
    for std, weak in ((0.0, True), (0.8, False)):
        data = screen.model_dump(exclude_none=True)
        place = tuple(np.add(data["anchors"][0]["position_m"], [2.0, 0.0]))
        data["anchors"] = [data["anchors"][0] | {"position_m": place, "position_std_m": std}]
        lines = describe_signal(tmp_path / "z.h5", gs.Scene.checked(data, "screen"))
        assert any("weak or hidden" in line for line in lines) == weak
