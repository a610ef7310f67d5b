"""Cures of distances and names have to explain more than the table as it stands, and more than luck does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from check_tables import BRIEF, SCENES, simulated_columns

from gridslam.checks.anchors import rivals
from gridslam.checks.anchors.offsets import offset_beside
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.checks.verdicts import against_scene

ROOM = SCENES["room"]
SENTINEL = rivals.Cure(None, {}, None)


@pytest.fixture(scope="module")
def late():
    """A table of distances that are 1.5 m too long, and what is explained with that error allowed for."""
    columns = simulated_columns("room", 1, steps=BRIEF)
    table = columns | {"distance_m": columns["distance_m"] + 1.5}
    return table, explain(table, ROOM, "agent1", error=rivals.range_errors(ROOM)[0])


def judged(monkeypatch, sight, after, before):
    """Let the cured table (as it is asked for first) and the table as it stands explain so much."""
    answers = iter((after, before))
    monkeypatch.setattr(rivals, "settled", lambda *_: replace(sight, **next(answers)))


@pytest.mark.slow
def test_an_error_of_all_distances_is_cured(late):
    table, sight = late
    cure = rivals.range_cure(table, ROOM, "agent1", sight)
    assert cure.suspicion.kind == "offset"
    np.testing.assert_allclose(table["distance_m"] - cure.table["distance_m"], 1.5, atol=0.1)


@pytest.mark.parametrize(
    ("after", "before", "cured"),
    [
        ({"explained": 0.9, "evidence": 500.0}, {"explained": 0.2, "evidence": 0.0}, True),
        ({"explained": 0.9, "evidence": 500.0}, {"explained": 0.9, "evidence": 496.0}, False),
        ({"explained": 0.9, "evidence": 500.0}, {"explained": 0.9, "evidence": 600.0}, False),
        ({"explained": 0.5, "evidence": 500.0}, {"explained": 0.2, "evidence": 0.0}, False),
    ],
)
def test_a_cure_of_distances_explains_clearly_more_than_the_table(late, monkeypatch, after, before, cured):
    table, sight = late
    judged(monkeypatch, sight, after, before)
    assert (rivals.range_cure(table, ROOM, "agent1", sight) is not None) == cured


@pytest.mark.parametrize("missing", [("distance_m",), ("aod_rad", "aoa_rad")])
def test_distances_without_angles_and_angles_without_distances_are_not_cured(late, missing):
    table, sight = late
    nothing = np.full(len(table["step"]), np.nan)
    assert rivals.range_cure(table | dict.fromkeys(missing, nothing), ROOM, "agent1", sight) is None


@pytest.mark.parametrize(("luck", "cured"), [(0.0, True), (450.0, True), (480.0, False), (700.0, False)])
def test_an_error_that_more_particles_make_up_for_is_no_cure(late, monkeypatch, luck, cured):
    """An error is tried by particles of its own, which find some of what they find by being more."""
    table, sight = late
    plain = replace(sight, evidence=0.0, explained=0.3)

    def explained(_table, _scene, _agent, world=False, error=None, crowd=1, **_more):
        if error is not None:
            return replace(sight, evidence=500.0, explained=0.9)
        return replace(plain, evidence=luck if crowd > 1 else 0.0)

    monkeypatch.setattr(rivals, "explain", explained)
    monkeypatch.setattr(rivals, "turn_cure", lambda *_: None)
    monkeypatch.setattr(rivals, "range_cure", lambda *_: SENTINEL)
    found = rivals.whole_cure(table, ROOM, "agent1", plain, plain)
    assert found is (SENTINEL if cured else None)


@pytest.mark.parametrize("evidence", [20.0, 40.0])
def test_names_are_exchanged_only_if_that_explains_clearly_more(late, monkeypatch, evidence):
    table, sight = late
    plain = replace(sight, evidence=0.0, explained=0.3)
    angles = table | {"distance_m": np.full(len(table["step"]), np.nan)}
    monkeypatch.setattr(rivals, "explain", lambda *_: replace(sight, evidence=evidence, explained=0.9))
    monkeypatch.setattr(rivals, "turn_cure", lambda *_: None)
    cure = rivals.whole_cure(angles, ROOM, "agent1", plain, plain)
    assert (cure is not None) == (evidence > rivals.CERTAIN)
    assert cure is None or cure.suspicion.kind == "names"


def test_suspicions_of_which_one_is_meant_say_so(late):
    """Exchanged names and another start explain the same lines of sight: whoever mends both is off again."""
    table, sight = late
    names = Suspicion("anchor", "names", "names exchanged", True, "100%")
    start = Suspicion("start", "start", "start_m doesn't fit", False, "100%")
    case = against_scene.Case(table, ROOM, "agent1", sight)
    account = against_scene.Account.of([names], table, sight)
    found = against_scene._with_start(case, account, (start, sight)).found
    assert [str(item) for item in found] == [
        "anchor: probably names exchanged (100%)",
        "start: probably this or what stands above of anchor, not both: start_m doesn't fit (100%)",
    ]
    flipped = Suspicion("aoa_rad", "flipped", "counted clockwise", False, "100%")
    plain = explain(table, ROOM, "agent1")
    first, second = offset_beside([flipped], table, table, ROOM, "agent1", plain)
    assert (first.column, second.column) == ("aoa_rad", "distance_m")
    assert (first.rivals, second.rivals) == ((), ("aoa_rad",))


def test_orders_that_exchange_fewest_come_first():
    """An anchor that isn't heard fits in any place: it was named as one of three that are exchanged."""
    for count in (2, 3, 4):
        tried = list(rivals.orders(count))
        moved = [sum(one != place for place, one in enumerate(order)) for order in tried]
        assert moved == sorted(moved)
        assert moved[0] == 2
        assert len(set(tried)) == math.factorial(count) - 1
