"""What is said of a run: who was lost, and what its filter complained of, in the same words everywhere."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from run_samples import hall, some_measurements, some_run

from gridslam.checks.files.other_files import run_line
from gridslam.cli.run_end import Done, _table
from gridslam.estimate_tables import SurfaceStretches
from gridslam.runs.notes import (
    grave_notes,
    health_notes,
    lost_makers,
    lost_note,
    silence_note,
    unsaid_note,
    whole_walls_note,
)
from gridslam.runs.run_files import read_run, write_run
from gridslam.simulation.image_source import ground_truth
from gridslam.viewers.report import write_report

LOST = "agent1: lost: 0.60 m off at step 20, the last"


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        ({}, None),
        ({3: 4.0}, None),  # before it has settled
        ({15: 1.07}, "a: up to 1.07 m off at step 15, found again"),
        ({35: 1.07}, "a: up to 1.07 m off at step 35, 0.00 m at the end"),
        ({30: 2.0, 39: 1.5}, "a: lost: up to 2.00 m off at step 30, 1.50 m at the end"),
        ({38: 2.0, 39: 9.3}, "a: lost: 9.30 m off at step 39, the last"),
    ],
)
def test_whoever_was_off_is_said_to_be_lost_or_found_again(errors, said):
    track = hall().track("agent1")
    course = replace(
        track, time_s=np.arange(40.0), position_m=np.zeros((40, 2)), velocity_mps=np.zeros((40, 2)),
        heading_rad=np.zeros(40),
    )  # fmt: skip
    off = np.zeros((40, 2))
    for step, error in errors.items():
        off[step, 1] = error
    assert lost_note("a", replace(course, position_m=off), course) == said
    assert lost_note("a", course, None) is None


def test_health_is_told_with_its_steps():
    score = {"steps": 20, "health": {"why": {"nothing heard for 3 steps": 4}}}
    assert health_notes("a", score) == ["a: nothing heard for 3 steps (at 4 of 20 steps)"]
    assert health_notes("a", {}) == []


def done_of(error, **more):
    scene = hall()
    run, heard = some_run(scene, "agent1"), some_measurements(scene, "agent1")
    grows = np.linspace(0, error, len(run.trajectory))[:, None] * [1, 0]
    run = replace(run, trajectory=replace(run.trajectory, position_m=run.trajectory.position_m + grows))
    score = run.score(ground_truth(scene, "agent1"))
    score["health"]["why"] = {"nothing heard for 3 steps": 4}
    return scene, Done([run], [heard], [score], {}, more.pop("progress", ""), **more)


def test_weighty_notes_come_first_and_all_are_kept():
    _, done = done_of(
        0.6,
        notes=["agent1: height 1 m", "agent1: suspect: A and B seem exchanged"],
        before=["departures from A aren't measured"],
        progress="5 of 21 steps of agent1",
    )
    assert done.kept == [
        "cut short after 5 of 21 steps of agent1",
        LOST,
        "agent1: suspect: A and B seem exchanged",
        "departures from A aren't measured",
        "agent1: height 1 m",
    ]
    assert done_of(0.1)[1].kept == []


def test_errors_of_a_lost_agent_leave_the_table_its_width():
    _, done = done_of(0.1)
    wide = dict(done.scores[0], position_rmse_m=4321.0, position_bound_m=None, heading_rmse_deg=178.4567)
    titles = [column.header for column in _table(done.runs, [wide]).columns]
    assert titles.count("NEES\nmedian") == 1
    assert titles[4].startswith("heading")
    position, heading = (next(iter(_table(done.runs, [wide]).columns[n].cells)) for n in (2, 4))
    assert (position, heading) == ("432100", "178")
    blind = dict(wide, position_rmse_m=None, position_std_m=0.0123)
    assert next(iter(_table(done.runs, [blind]).columns[2].cells)) == "+-1.23"


@pytest.mark.slow
def test_report_and_check_say_what_the_terminal_did(tmp_path):
    scene, done = done_of(0.6, before=["departures from A aren't measured"])
    for kept in (done.kept, []):  # of a run whose folder says nothing of it, too
        settings = {"notes": kept}
        write_run(
            tmp_path / "out", scene, done.runs, done.observations, done.scores, settings, overwrite=True
        )
        (tmp_path / "out" / "figures").mkdir()
        Image.new("L", (4, 4)).save(tmp_path / "out" / "figures" / "agent1-map.png")
        page = write_report(tmp_path / "out", moving=False).read_text(encoding="utf-8")
        assert page.count(LOST) == 1
        assert page.count("agent1: nothing heard for 3 steps (at 4 of 21 steps)") == 1
        assert page.count("departures from A aren&#x27;t measured") == len(kept) / 2
        said = run_line(tmp_path / "out").splitlines()[1:]
        assert said.count(f"note: {LOST}") == 1
        assert said[-1] == "note: agent1: nothing heard for 3 steps (at 4 of 21 steps)"
        assert len(said) == 2 + len(kept) // 2
        assert grave_notes(read_run(tmp_path / "out")) == [LOST]
    score = json.loads((tmp_path / "out" / "run.json").read_text())["agents"]["agent1"]
    assert score["surfaces_detected"] == 1
    assert run_line(tmp_path / "out").startswith("run of hall by grid: agent1 (21 steps, 1 surface)\n")


def test_whoever_was_wrong_without_a_word_is_told_of_and_who_has_no_health_at_all():
    """REFA was 8 cm off and claimed 1.9, and nothing was said."""
    score = {"silent_steps": 7, "steps": 20, "position_nees": 90.0}
    assert unsaid_note("a", score, "grid") == (
        "a: off by over 4 of its own deviations at 7 of 20 steps, while its health is well"
    )
    assert unsaid_note("a", score, "refa").endswith(
        "refa, kept as published, has no health that could say so"
    )
    assert unsaid_note("a", score, "mine:Own").endswith("while its health is well")
    assert unsaid_note("a", score | {"silent_steps": 0}, "refa") is None
    assert unsaid_note("a", score | {"position_nees": None}, "refa") is None, "it claims a deviation of 0"
    assert unsaid_note("a", {"silent_steps": None}, "refa") is None


def test_a_long_silence_is_told_and_a_short_one_isnt():
    told = silence_note("a", (3, *range(60, 110)), 161)
    assert told == "a: nothing was heard at 51 of 161 steps, the longest time from step 60 to 109"
    assert silence_note("a", (), 161) is None
    assert "count" not in told
    assert silence_note("a", tuple(range(60)), 161).endswith("count its steps from 0")
    assert silence_note("a", tuple(range(0, 40, 2)), 161) is None


def test_a_method_without_cells_is_said_to_draw_walls_across_doors():
    grid = some_run(hall(), "agent1").map
    table = some_run(hall(), "agent1").surfaces
    hit = replace(table, extent_m=np.array([[-3.0, 3.0]] * 2))
    bare = replace(grid, observed=np.zeros(grid.shape, bool), surfaces=hit)
    assert whole_walls_note(bare, "adaptive").startswith(
        "adaptive maps no cells: each wall is drawn and exported from its first hit to its last, across doors"
    )
    heard = replace(bare, stretches=SurfaceStretches.empty())
    assert whole_walls_note(heard, "adaptive").startswith(
        "adaptive maps no cells: walls are drawn and exported where paths were reflected by them"
    )
    assert whole_walls_note(replace(grid, surfaces=hit), "grid") is None
    assert whole_walls_note(replace(bare, surfaces=table), "direct") is None  # none was hit
    assert whole_walls_note(replace(bare, surfaces=None), "los") is None


def test_maps_of_lost_agents_are_known_by_the_run_that_they_lie_in(tmp_path):
    assert lost_makers(None) == lost_makers(tmp_path / "map.h5") == []
    summary = {
        "agents": {"agent1": {}, "agent2": {}},
        "notes": [LOST, "agent2: up to 1.07 m off, found again"],
    }
    (tmp_path / "agent1").mkdir()
    (tmp_path / "run.json").write_text(json.dumps(summary))
    (note,) = lost_makers(tmp_path / "map.h5")
    assert note == f"{tmp_path / 'map.h5'}: by its run's notes, {LOST}: map it again, or go on from another"
    assert len(lost_makers(tmp_path / "agent1" / "map.h5")) == 1
    assert lost_makers(tmp_path / "agent2" / "map.h5") == []
    assert lost_makers(tmp_path / "agent" / "map.h5") == [], "another, whose name begins alike"
    (tmp_path / "run.json").write_text("{")
    assert lost_makers(tmp_path / "map.h5") == []
