"""A column that is read otherwise and another start, where a table fits both ways."""

import numpy as np
import pytest
from lab_samples import ANCHORS, heard, lab, suspected

from gridslam.checks.scene.views import enclosed
from gridslam.checks.starts.start_search import anywhere

PAIR = ("north", "south")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_arrivals_counted_clockwise_are_named_before_a_start_behind_a_wall(seed):
    """The way's image by the wall explains all that is reflected there: two anchors tell no more."""
    right = heard(PAIR, seed=seed)
    column, start = suspected(right | {"aoa_rad": -right["aoa_rad"]}, lab(PAIR))
    assert (column.column, column.kind) == ("aoa_rad", "flipped")
    assert (start.kind, start.rivals) == ("start", ("aoa_rad",))
    assert suspected(right, lab(PAIR)) == []


@pytest.mark.slow
def test_a_start_behind_a_wall_isnt_named_if_reflections_are_often_missed():
    right = heard(PAIR)
    seen = np.arange(len(right["step"])) % 5 == 0  # lines of sight
    seen |= np.random.default_rng(2).random(len(seen)) < 0.7
    right = {name: values[seen] for name, values in right.items()}
    (found,) = suspected(right | {"aoa_rad": -right["aoa_rad"]}, lab(PAIR))
    assert (found.column, found.kind, found.certain) == ("aoa_rad", "flipped", True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "told"), [(PAIR, {"start_heading_deg": 90.0}), (tuple(ANCHORS), {"start_m": (1.6, 3.3)})]
)
def test_a_wrong_start_stays_one(names, told):
    (found,) = suspected(heard(names), lab(names, **told))
    assert (found.column, found.kind) == ("start", "start")


@pytest.mark.slow
def test_an_array_that_is_mounted_sideways_is_named_beside_a_heading():
    """Both fit alike; who goes ahead as told has another axis."""
    right = heard(tuple(ANCHORS))
    *_, found = suspected(right | {"aoa_rad": right["aoa_rad"] + np.pi / 2}, lab(tuple(ANCHORS)))
    assert (found.kind, found.certain) == ("start", False)
    first, second = found.text.split("; or ")
    assert first.startswith("aoa_rad is +")
    assert second.startswith("start_heading_deg of 0 doesn't fit")


def test_a_start_outside_of_the_walls_is_none():
    table = heard(PAIR)
    wrong = table | {"aoa_rad": -table["aoa_rad"]}
    assert anywhere(wrong, lab(PAIR), "me").start[1] < 0  # where the scene has no walls, it may be
    x, y, _ = anywhere(wrong, lab(PAIR, walls=True), "me").start
    assert 0 < x < 7
    assert 0 < y < 5


def test_walls_enclose_places_but_for_doors():
    walls = lab(PAIR, walls=True).segments()
    assert enclosed(np.array([[3.5, 2.5], [0.5, 0.5], [-0.5, 2.0], [3.0, 7.0]]), walls).tolist() == [
        True,
        True,
        False,
        False,
    ]
    assert not enclosed(np.array([3.5, 2.5]), lab(PAIR).segments())
