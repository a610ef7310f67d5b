"""What `run` says of recorded measurements: no anchor is accused by an agent that moved as none can."""

from types import SimpleNamespace

import pytest

import gridslam as gs
from gridslam.checks import range_note
from gridslam.cli.doubts import fit_notes
from gridslam.estimates import Health
from gridslam.inference.health import reasons

ROOM = gs.Scene.load("room")


@pytest.mark.parametrize(("why", "accused"), [("", True), (reasons.leapt(13.2, 3), False)])
def test_an_agent_that_moved_as_none_can_accuses_no_anchor(why, accused, monkeypatch, tmp_path):
    monkeypatch.setattr(range_note, "range_note", lambda *_: "distances of anchor B seem 2.00 m too long")
    measurements = gs.simulate(ROOM, "agent1", seed=12)
    estimates = [SimpleNamespace(health=Health(not why, why))]
    run = SimpleNamespace(agent="agent1", estimates=[*estimates, *20 * [SimpleNamespace(health=Health())]])
    notes = fit_notes(ROOM, [run], [measurements], tmp_path / "heard.csv", "room")
    assert any("anchor B" in note for note in notes) == accused
