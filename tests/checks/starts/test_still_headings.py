"""What `check` says of arrivals by which the agent never looks where it goes, or always faces one way."""

import numpy as np
import pytest
from lab_samples import ANCHORS, heard, heard_facing, lab, suspected
from scene_samples import short

import gridslam as gs
from gridslam.checks.verdicts.diagnose import suspicions
from gridslam.checks.verdicts.verdict import verdict
from gridslam.world.geometry import wrap

NAMES = tuple(ANCHORS)


def arriving(turned):
    """The table with other arrivals, made of its own and of the headings in the world."""
    right = heard(NAMES)
    return right | {"aoa_rad": wrap(turned(right["aoa_rad"], heard_facing(NAMES)))}


@pytest.mark.slow
def test_compass_bearings_are_named_as_such():
    """Read clockwise they fit a start that faces north."""
    table = arriving(lambda own, facing: np.pi / 2 - own - facing)
    (found,) = suspected(table, lab(NAMES, walls=True, start_heading_deg=90.0))
    assert (found.column, found.kind) == ("aoa_rad", "compass")
    assert "clockwise from north (compass bearings)" in found.text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "wrong"),
    [("alcove", ("aod_rad",))]
    + [(name, ("aod_rad", "aoa_rad")) for name in ("alcove", "hall", "pillars")]
    + [(name, ("aoa_rad",)) for name in ("hall", "canyon")],
)
def test_compass_bearings_are_named_of_either_angle_and_of_both(name, wrong):
    """Also where one anchor is in sight that faces north: departures then fit counted clockwise as well."""
    scene = short(name, 60)
    table = gs.simulate(scene, "agent1", 1)
    bearings = {
        "aod_rad": table.aod_rad + scene.anchor_orientations[table.anchor],
        "aoa_rad": table.aoa_rad + scene.track("agent1").heading_rad[table.step],
    }
    read = dict(table.columns) | {column: wrap(np.pi / 2 - bearings[column]) for column in wrong}
    found = suspicions(read, table.anchors, scene, "agent1")
    assert [item.column for item in found] == list(wrong)
    assert all("clockwise from north (compass bearings)" in item.text for item in found)


@pytest.mark.slow
def test_a_heading_that_stays_while_the_way_turns_is_suspected():
    table = arriving(lambda own, facing: own + facing - np.radians(70))
    (found,) = suspected(table, lab(NAMES, walls=True, start_heading_deg=70.0))
    assert (found.column, found.kind, found.certain) == ("aoa_rad", "world frame", False)
    assert "nothing is wrong if it does" in found.reason
    assert suspected(heard(NAMES), lab(NAMES, walls=True)) == []


@pytest.mark.slow
def test_a_sideways_array_that_fits_its_told_heading_is_noted():
    table = arriving(lambda own, _: own + np.pi / 2)
    order = np.arange(len(NAMES))
    turned = verdict(table, order, lab(NAMES, walls=True, start_heading_deg=-90.0), "me")
    assert "units and frames fit the scene" in turned
    assert "the agent goes to its left all the way" in turned
    assert "all the way" not in verdict(heard(NAMES), order, lab(NAMES, walls=True), "me")
