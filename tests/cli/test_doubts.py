"""What `run` says of recorded measurements: no anchor is accused by an agent that moved as none can."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.runs import range_note
from gridslam.cli.doubts import absurd_notes, element_notes, fit_notes, start_notes
from gridslam.estimates import Health
from gridslam.inference.health import reasons
from gridslam.world.start import Start

ROOM = gs.Scene.load("room")


@pytest.mark.parametrize(("why", "accused"), [("", True), (reasons.leapt(13.2, 3), False)])
def test_an_agent_that_moved_as_none_can_accuses_no_anchor(why, accused, monkeypatch, tmp_path):
    monkeypatch.setattr(range_note, "range_note", lambda *_: "distances of anchor B seem 2.00 m too long")
    measurements = gs.simulate(ROOM, "agent1", seed=12)
    there = gs.Estimate.of_pose(
        measurements.scan(0), ROOM.track("agent1").position_m[0], 0.0, 1e-4 * np.eye(5)
    )
    estimates = [replace(there, health=Health(not why, why)), *20 * [there]]
    run = SimpleNamespace(agent="agent1", estimates=estimates, began=Start(ROOM.agents[0].start_m, 0.0))
    notes = fit_notes(ROOM, [run], [measurements], tmp_path / "heard.csv", "room")
    assert any("anchor B" in note for note in notes) == accused


@pytest.mark.parametrize(
    ("first_m", "second_m", "std_m", "said"),
    [(1.0, 0.9, 0.01, True), (0.7, 0.7, 0.01, False), (1.0, 0.9, 0.3, False), (1.6, 0.1, 0.08, False)],
)
def test_a_start_out_of_its_prior_is_told_if_first_poses_are_known(first_m, second_m, std_m, said):
    """Told to 0.5 m: 0.7 m is a corner of it; what leaps wasn't known."""
    scan, told = gs.simulate(ROOM, "agent1", seed=12).scan(0), np.array(ROOM.agents[0].start_m)
    covariance = np.diag([0.5 * std_m**2, 0.5 * std_m**2, 0.1, 0.1, 0.1])
    estimates = [
        gs.Estimate.of_pose(scan, np.add(told, (off, 0.0)), 0.0, covariance) for off in (first_m, second_m)
    ]
    run = SimpleNamespace(agent="agent1", estimates=estimates, began=Start(told, 0.0))
    notes = start_notes(ROOM, [run])
    assert [("1.0 m from the told start" in note) for note in notes] == [True] * said


def test_deviations_in_degrees_are_told_of_any_run():
    measurements = gs.simulate(ROOM, "agent1", seed=12)
    right = np.full(len(measurements.step), 0.06)
    run = SimpleNamespace(agent="agent1")
    assert absurd_notes([run], [replace(measurements, aoa_std_rad=right)]) == []
    (note,) = absurd_notes([run], [replace(measurements, aoa_std_rad=np.degrees(right))])
    assert note.startswith("agent1: suspect: aoa_std_rad: degrees, where radians belong")


def test_a_dead_antenna_of_a_recording_is_noted():
    heard = gs.simulate(gs.Scene.load("screen"), "agent1", seed=1, what="signal")
    run = SimpleNamespace(agent="agent1")
    assert absurd_notes([run], [heard]) == []
    samples = heard.samples.copy()
    samples[:, :, :, 1] = 0
    (note,) = absurd_notes([run], [replace(heard, samples=samples)])
    assert note.startswith("agent1: suspect: agent: element 2 of 4 hears nothing")


def test_elements_that_are_off_are_told_as_the_last_estimate_has_them():
    scan = gs.simulate(ROOM, "agent1", seed=12).scan(0)
    right = gs.Estimate.of_pose(scan, np.zeros(2), 0.0, 1e-4 * np.eye(5))
    off = replace(right, health=Health(True, "", elements=0.174))
    runs = [SimpleNamespace(agent=name, estimates=estimates) for name, estimates in (
        ("found", [right, off]), ("right", [off, right]), ("none", []),
    )]  # fmt: skip
    (note,) = element_notes(runs)
    assert note.startswith("found: antenna elements are off by 17% of what the recording says")
