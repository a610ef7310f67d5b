"""A right table of a device that turns on the spot isn't accused because the line-of-sight filter lost it."""

from dataclasses import replace

import numpy as np
import pytest
from check_tables import BRIEF, SCENES, simulated, simulated_columns

from gridslam.checks.anchors.rivals import FAIR_CROWD
from gridslam.checks.sights.fit import FITTING
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.starts import followed as again
from gridslam.checks.starts.followed import followed, upheld
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.world.geometry import wrap

ALCOVE = SCENES["alcove"]
FLIPPED = [Suspicion("aoa_rad", "flipped", "counted clockwise", True, "100%")]


def turning(columns, degrees, step=30):
    """The same of a device that turns on the spot."""
    return columns | {"aoa_rad": wrap(columns["aoa_rad"] - np.radians(degrees) * (columns["step"] >= step))}


def test_a_sharp_turn_is_followed_where_the_usual_way_loses_the_device():
    table = turning(simulated_columns("alcove", 1, steps=BRIEF), 90)
    plain = explain(table, ALCOVE, "agent1")
    assert plain.explained < FITTING
    assert followed(table, ALCOVE, "agent1", plain).explained >= FITTING


def test_what_fits_is_never_exchanged_for_what_fits_worse(monkeypatch):
    """Through doors the device may be lost that straight on is followed."""
    table = simulated_columns("alcove", 1, steps=20)
    plain = explain(table, ALCOVE, "agent1")
    lost = replace(plain, explained=0.4, evidence=0.0)
    monkeypatch.setattr(again, "explain", lambda *_, **__: lost)
    assert followed(table, ALCOVE, "agent1", plain) is plain


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [False, True])
def test_a_reading_is_accused_only_if_it_fits_worse_by_sharp_turns_too(wrong):
    right = turning(simulated_columns("alcove", 1, steps=BRIEF), 50)
    flipped = right | {"aoa_rad": -right["aoa_rad"]}
    table, read = (flipped, right) if wrong else (right, flipped)
    held = upheld(table, read, FLIPPED, ALCOVE, "agent1", explain(table, ALCOVE, "agent1"))
    assert (held is None) == wrong


@pytest.mark.slow
def test_check_says_that_it_fits(say, tmp_path):
    table = simulated("alcove", 1, "agent1")
    columns = turning({"aoa_rad": table.aoa_rad, "step": table.step}, 50)
    replace(table, aoa_rad=columns["aoa_rad"]).to_csv(tmp_path / "turn.csv")
    result = say("check", str(tmp_path / "turn.csv"), "--scene", "alcove")
    assert result.code == 0
    assert "units and frames fit the scene" in result.out


@pytest.mark.parametrize("angles", [False, True])
def test_by_distances_alone_names_are_accused_only_by_many_particles(monkeypatch, angles):
    """The usual number lost a right table by luck, and an exchange of names fitted better by 42 nats."""
    table = simulated_columns("alcove", 1, steps=20)
    plain = explain(table, ALCOVE, "agent1")
    if not angles:
        table = {name: values for name, values in table.items() if not name.endswith("_rad")}
    renamed = table | {"anchor": 1 - table["anchor"]}

    def seen(columns, *_, **way):
        own = columns["anchor"] is table["anchor"]
        usual, many = (6.0, 91.0) if own else (49.0, 53.0)
        return replace(plain, evidence=many if way.get("crowd") == FAIR_CROWD else usual, explained=0.65)

    monkeypatch.setattr(again, "explain", seen)
    monkeypatch.setattr(again, "least_share", lambda _: 0.3)
    names = [Suspicion("anchor", "names", "names exchanged", True, "")]
    assert (upheld(table, renamed, names, ALCOVE, "agent1", plain) is None) == angles
