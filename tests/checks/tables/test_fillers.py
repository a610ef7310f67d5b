"""Numbers that stand for nothing are found column by column, and named as the file has them."""

import numpy as np
import pytest
from check_tables import SCENES, simulated_columns

from gridslam.checks.tables.fillers import fillers, padding
from gridslam.checks.verdicts.diagnose import describe
from gridslam.errors import InputError
from gridslam.measurements.table import Measurements

COLUMNS = simulated_columns("room", 1, steps=30)


@pytest.mark.parametrize("name", ["aod_rad", "aoa_rad", "distance_m", "amplitude"])
@pytest.mark.parametrize("value", [-999.0, 0.0, 9999.0, 1e7])
def test_a_filler_of_one_column_is_named_with_its_rows(name, value):
    rows = np.arange(len(COLUMNS["step"])) % 20 == 3
    (found,), rest = padding(COLUMNS | {name: np.where(rows, value, COLUMNS[name])})
    assert (found.column, found.kind, found.certain) == (name, "padding", True)
    assert f"{value:g} stands for nothing" in found.text
    assert found.reason == f"{rows.sum()} of {len(rows)} rows"
    assert value not in rest[name]
    assert len(rest["step"]) == len(rows) - rows.sum() * (name == "distance_m")


def test_whole_rows_of_fillers_are_named_once_and_left_out():
    rows = np.arange(len(COLUMNS["step"])) % 9 == 0
    names = ("distance_m", "aod_rad", "aoa_rad", "amplitude")
    (found,), rest = padding(COLUMNS | {name: np.where(rows, -1.0, COLUMNS[name]) for name in names})
    assert found.column == ", ".join(names)
    assert len(rest["step"]) == (~rows).sum()


def test_what_is_measured_is_no_filler():
    draw = np.random.default_rng(1)
    assert padding(COLUMNS) == ([], COLUMNS)
    assert fillers(np.round(draw.normal(0, 20, 3000))) == []  # whole degrees: 0 among them
    assert fillers(np.full(50, 1.0)) == []
    assert fillers(draw.lognormal(1, 2, 3000)) == []
    assert fillers(np.zeros(0)) == []


@pytest.mark.slow
def test_fillers_in_degrees_are_named_as_they_are_written(tmp_path):
    path = tmp_path / "heard.csv"
    Measurements(**COLUMNS, anchors=("A", "B")).to_csv(path)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    place = rows[0].index("aoa_rad")
    rows[0][place] = "aoa_deg"
    for number, row in enumerate(rows[1:]):
        row[place] = "-999" if number % 15 == 4 else repr(float(np.degrees(float(row[place]))))
    path.write_text("\n".join(",".join(row) for row in rows))
    said = [line for line in describe(path, SCENES["room"]) if line.startswith("suspect")]
    assert len(said) == 1
    assert "aoa_deg: padding: -999 stands for nothing" in said[0]
    with pytest.raises(InputError) as refused:
        Measurements.from_csv(path)
    assert "aoa_deg: found -999.0; allowed: degrees, 360 at most" in str(refused.value)
