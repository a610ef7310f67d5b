"""A table that begins late is named, and called suspect where the start is where it begins."""

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.checks.starts.late_tables import late_line
from gridslam.checks.starts.start_search import start_words
from gridslam.checks.verdicts.diagnose import describe


@pytest.mark.slow
def test_a_table_that_was_cut_is_suspect_by_a_start_where_it_begins_alone(tmp_path):
    """`check` took the start for the first row's, `run` for step 0's: 107 cm instead of 2.1."""
    scene = short("room", 100)
    heard, truth = gs.simulate(scene, "agent1", 3), gs.ground_truth(scene, "agent1").trajectory
    heard.to_csv(tmp_path / "full.csv")
    head, *rows = (tmp_path / "full.csv").read_text().splitlines()
    rows = [row.split(",", 1) for row in rows if row[0].isdigit() and int(row.split(",")[0]) >= 60]
    for name, back in (("late", 0), ("late0", 60)):
        cut = "\n".join([head, *(f"{int(step) - back},{rest}" for step, rest in rows)])
        (tmp_path / f"{name}.csv").write_text(cut + "\n")
    told = scene.starting("agent1", truth.position_m[60], truth.heading_rad[60])
    late, counted = (describe(tmp_path / f"{name}.csv", told) for name in ("late", "late0"))
    (said,) = (line for line in late if "60 silent steps" in line)
    assert said.startswith("suspect: step: the table begins at step 60")
    assert not [line for line in counted if "silent steps" in line]
    own = [line for line in describe(tmp_path / "late.csv", scene) if "the table begins at step 60" in line]
    assert [line[:2] for line in own] == ["  "], "a start that the agent has left isn't called"


def test_few_silent_steps_are_not_named_and_a_start_is_that_of_step_0():
    assert late_line({"step": np.array([5, 6])}) is None
    assert late_line({"step": np.zeros(0, int)}) is None
    assert "begins at step 6:" in late_line({"step": np.array([7, 6])})
    start = np.array([1.0, 2.0, 0.0])
    assert start_words(start, False, 0.0).endswith("those of the table's first step")
    assert "those of step 0, 60 silent steps before" in start_words(start, False, 0.0, 60)
