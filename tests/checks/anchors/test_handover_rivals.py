"""What handovers and the first poses name that a filter passes, and what they refute."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.anchors import handover_rivals
from gridslam.checks.anchors.handover_rivals import explanations, handover_rival, is_sound
from gridslam.checks.sights.handovers import Ties
from gridslam.checks.starts.told_start import other_start_told
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.checks.verdicts.by_handovers import named, refuted
from gridslam.world.geometry import wrap

SCENE, WHO = gs.Scene.load("hall"), "agent1"
"""Two anchors far from each other; in the first 100 steps, which the filter looks at, A alone is in sight."""


@pytest.fixture(scope="module")
def heard():
    return dict(gs.simulate(SCENE, WHO, 1).columns)


def _moved(**changes):
    body = SCENE.agent(WHO).model_copy(update=changes)
    return SCENE.model_copy(update={"agents": (body, *SCENE.agents[1:])})


def test_a_right_table_is_sound(heard):
    assert is_sound(Ties.of(heard, SCENE, WHO), SCENE, WHO)
    assert named([], heard, SCENE, WHO) == []


def test_a_turned_anchor_is_named_by_handovers(heard):
    """The filter's first 100 steps don't hold it: 100 % of the scans fit."""
    aod = heard["aod_rad"] + np.where(heard["anchor"] == 1, np.radians(20), 0.0)
    found = handover_rival(heard | {"aod_rad": np.asarray(wrap(aod))}, SCENE, WHO)
    assert (found.column, found.kind, found.certain) == ("aod_rad", "turned", True)
    assert found.text == "anchor B is turned by -20 degrees: its orientation_deg of -90 should be about -110"
    assert "lines of sight of two anchors within three steps put the agent in one place" in found.reason


def test_exchanged_names_are(heard):
    found = handover_rival(heard | {"anchor": 1 - heard["anchor"]}, SCENE, WHO)
    assert (found.kind, found.certain) == ("names", True)


def test_an_anchor_elsewhere_is(heard):
    moved = SCENE.anchors[1].model_copy(update={"position_m": (5.0, 4.0)})
    scene = SCENE.model_copy(update={"anchors": (SCENE.anchors[0], moved)})
    found = handover_rival(heard, scene, WHO)
    assert (found.column, found.kind) == ("anchor", "place")
    assert "anchor B stands near (6.0, 4.0)" in found.text.replace("3.9", "4.0")


def test_an_offset_of_an_anchor_that_comes_into_sight_late_is(heard):
    late = heard["distance_m"] + 1.5 * (heard["anchor"] == 1)
    found = handover_rival(heard | {"distance_m": late}, SCENE, WHO)
    assert (found.column, found.kind) == ("distance_m", "offset")
    assert re.match(r"distances of anchor B are 1\.[45]\d m .* too long", found.text)


def test_a_place_that_does_nearly_as_well_as_an_offset_is_named_beside_it(heard, monkeypatch):
    """Places are blunt: a far anchor's are known to half a metre, its lengths to a tenth."""
    late = np.abs(heard["distance_m"] - 0.9 * (heard["anchor"] == 1))
    ties = Ties.of(heard | {"distance_m": late}, SCENE, WHO)
    found = explanations(heard | {"distance_m": late}, SCENE, WHO, ties)
    place, offset = (next(one for one in found if one.rival.kind == kind) for kind in ("place", "offset"))
    assert place.rival.anchors == offset.rival.anchors == (1,)
    for gains, both in (((140.0, 105.0), True), ((140.0, 60.0), False)):
        told = [replace(one, gain=gain) for one, gain in zip((place, offset), gains, strict=True)]
        monkeypatch.setattr(handover_rivals, "explanations", lambda *_, told=told: told)
        text = handover_rival(heard | {"distance_m": late}, SCENE, WHO).text
        assert "anchor B stands near" in text
        assert ("; or distances of anchor B are" in text) == both


def test_arrivals_counted_clockwise_and_bearings_are_told_apart(heard):
    found = handover_rival(heard | {"aoa_rad": -heard["aoa_rad"]}, SCENE, WHO)
    assert (found.column, found.text) == ("aoa_rad", "counted clockwise; angles are counter-clockwise")
    stand = Ties.of(heard, SCENE, WHO).seen
    heading = np.interp(heard["step"], np.sort(np.unique(heard["step"])), _headings(heard, stand))
    bearing = np.asarray(wrap(0.5 * np.pi - heard["aoa_rad"] - heading))
    found = handover_rival(heard | {"aoa_rad": bearing}, SCENE, WHO)
    assert "clockwise from north (compass bearings)" in found.text


def _headings(table, seen):
    """Headings (N,) of the steps by the lines of sight."""
    rows = np.sort(np.concatenate(seen.sights))
    steps = np.unique(table["step"])
    return np.interp(steps, seen.step[rows], np.unwrap(seen.facing[rows]))


def test_a_start_elsewhere_and_arrivals_of_another_axis_are_named(heard):
    assert other_start_told(heard, SCENE, WHO) is None
    x, y = SCENE.agent(WHO).start_m
    found = other_start_told(heard, _moved(start_m=(x + 2.0, y)), WHO)
    assert found.certain
    assert f"with a start at about ({x:.1f}, {y:.1f}) m" in found.text
    for off in (0.5 * np.pi, np.pi):
        turned = heard | {"aoa_rad": np.asarray(wrap(heard["aoa_rad"] + off))}
        found = other_start_told(turned, SCENE, WHO)
        assert not found.certain  # it may as well face another way
        assert "start_heading_deg" in found.text
        assert ("the direction of travel" if off > 3 else "aoa_rad is +") in found.text


def test_what_the_prior_allows_is_not_accused(heard):
    x, y = SCENE.agent(WHO).start_m
    scene = _moved(start_m=(x + 0.4, y + 0.4), start_heading_deg=SCENE.agent(WHO).start_heading_deg + 9)
    assert named([], heard, scene, WHO) == []


@pytest.mark.slow
def test_a_missing_wall_accuses_no_one(heard):
    """Reflections off it pass for lines of sight: fewer of them are no reason to move an anchor."""
    for number in range(len(SCENE.walls)):
        walls = tuple(wall for other, wall in enumerate(SCENE.walls) if other != number)
        scene = SCENE.model_copy(update={"walls": walls})
        assert named([], heard, scene, WHO) == []


def test_handovers_that_fit_refute_what_a_lost_filter_finds(heard):
    """Of a right table of five rooms `check` said that angles of an anchor are counted clockwise."""
    turned = Suspicion("aod_rad", "turned", "angles of anchor B are counted clockwise", True, "")
    feet = Suspicion("distance_m", "feet", "feet", True, "")
    assert refuted([turned], heard, SCENE, WHO)
    assert not refuted([feet], heard, SCENE, WHO)
    mirrored = np.where(heard["anchor"] == 1, -1, 1) * heard["aod_rad"]
    assert not refuted([turned], heard | {"aod_rad": mirrored}, SCENE, WHO)
    assert not refuted([turned], heard, replace_walls(()), WHO)
    alone = {name: values[heard["anchor"] == 0] for name, values in heard.items()}
    few = {
        name: np.concatenate([alone[name], values[heard["anchor"] == 1][:2]])
        for name, values in heard.items()
    }
    order = np.argsort(few["step"], kind="stable")
    assert not refuted([turned], {name: values[order] for name, values in few.items()}, SCENE, WHO)


def replace_walls(walls):
    """The scene with other walls."""
    return SCENE.model_copy(update={"walls": walls})


def test_what_says_why_is_left_alone(heard):
    """Units come first; of amplitudes handovers tell nothing."""
    aod = heard["aod_rad"] + np.where(heard["anchor"] == 1, np.radians(20), 0.0)
    table = heard | {"aod_rad": np.asarray(wrap(aod))}
    feet = Suspicion("distance_m", "feet", "feet", True, "")
    loud = replace(feet, column="amplitude", kind="level")
    assert named([feet], table, SCENE, WHO) == [feet]
    assert [item.kind for item in named([loud], table, SCENE, WHO)] == ["turned", "level"]
