"""What `run` says of recorded measurements: no anchor is accused by an agent that moved as none can."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
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
    there = gs.Estimate.of_pose(
        measurements.scan(0), ROOM.track("agent1").position_m[0], 0.0, 1e-4 * np.eye(5)
    )
    estimates = [replace(there, health=Health(not why, why)), *20 * [there]]
    run = SimpleNamespace(agent="agent1", estimates=estimates)
    notes = fit_notes(ROOM, [run], [measurements], tmp_path / "heard.csv", "room")
    assert any("anchor B" in note for note in notes) == accused
