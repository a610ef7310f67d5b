"""Rows that are written twice are counted and told of; numbers that are rounded repeat by chance, too."""

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.checks.tables.repeats import repeats_line

HEARD = gs.simulate(gs.Scene.load("room"), "agent1", 1).columns


def doubled(rows):
    """The table with these rows once more, in the order of steps."""
    place = np.sort(np.concatenate([np.arange(len(HEARD["step"])), rows]))
    return {name: values[place] for name, values in HEARD.items()}


def written(columns, path):
    names = gs.Scene.load("room").anchor_names
    gs.Measurements(**columns, anchors=names).to_csv(path)
    return str(path)


@pytest.mark.parametrize("many", [50, len(HEARD["step"])])
def test_rows_that_repeat_are_counted(many):
    line = repeats_line(doubled(np.arange(many)))
    assert line.startswith(f"{many} of {len(HEARD['step']) + many} rows repeat another one")


def test_right_tables_rows_of_other_devices_and_cells_that_are_empty_are_no_repeats():
    assert repeats_line(HEARD) is None
    twice = doubled(np.arange(len(HEARD["step"])))
    assert repeats_line(twice, np.arange(len(twice["step"])) % 2) is None
    empty = {**HEARD, "aoa_rad": np.full(len(HEARD["step"]), np.nan)}
    assert repeats_line(empty) is None
    assert repeats_line({name: np.repeat(values, 2) for name, values in empty.items()}) is not None


def test_distances_alone_that_are_rounded_repeat_by_chance():
    step = np.repeat(np.arange(100), 10)
    alone = {"step": step, "anchor": np.zeros(1000, int), "distance_m": 1.0 + np.arange(1000) % 10}
    alone["distance_m"][::10] = 2.0
    assert repeats_line(alone) is None
    assert repeats_line({**alone, "aod_rad": alone["distance_m"]}) is not None


def test_check_suspects_them_without_a_scene_too(say, tmp_path):
    result = say("check", written(doubled(np.arange(100)), tmp_path / "a.csv"))
    assert result.code == 1
    assert f"suspect: 100 of {len(HEARD['step']) + 100} rows repeat another one" in result.out


def test_check_of_several_devices_does_as_well(say, tmp_path):
    gs.simulate(short("canyon", 10), ["agent1", "agent2"], 1).to_csv(tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "a.csv").write_text("\n".join([lines[0], *(line for line in lines[1:] for _ in range(2))]))
    result = say("check", str(tmp_path / "a.csv"))
    assert result.code == 1
    assert f"suspect: {len(lines) - 1} of {2 * len(lines) - 2} rows repeat another one" in result.out


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_run_notes_them(say, tmp_path):
    few = {name: values[: len(values) // 40] for name, values in HEARD.items()}
    file = written({name: np.repeat(values, 2) for name, values in few.items()}, tmp_path / "a.csv")
    result = say("run", "room", "--measurements", file, "-o", str(tmp_path / "out"))
    assert result.code == 0
    assert "rows repeat another one, every number alike" in result.err
