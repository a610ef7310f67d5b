"""`check` on measurements: the usual errors are named, and clean tables raise no alarm."""

from itertools import cycle

import numpy as np
import pytest
from check_tables import simulated_columns

import gridslam as gs
from gridslam.checks.sights.line_of_sight_filter import explain, turning_rad
from gridslam.checks.verdicts.diagnose import describe, summary, suspicions
from gridslam.errors import InputError
from gridslam.measurements.table import Measurements
from gridslam.simulation.image_source import simulate
from gridslam.world.geometry import wrap
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene

SCENES = {name: Scene.load(name) for name in ("room", "alcove")}
BRIEF = 60
"""Steps of tables with errors: fewer tell less, and take less time. Clean tables are whole."""
CHEAP = {"seconds", "power"}
LONGER = {"world aoa", "dB"}
"""What shows in turns, or with a better fit, only."""


@pytest.fixture(scope="module")
def tables():
    return {
        (name, seed): simulate(scene, "agent1", seed) for name, scene in SCENES.items() for seed in (1, 2)
    }


def columns(table, steps=None):
    names = ("step", "time_s", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    rows = slice(None) if steps is None else table.step < steps
    return {name: np.array(getattr(table, name)[rows]) for name in names}


def kinds(table, names, scene):
    return [(item.column, item.kind) for item in suspicions(table, names, scene)]


ALIKE = ("nanoseconds", "feet")
"""These are 1.7 % apart: either may be named beside the other."""
SPOILT = {
    "aoa in degrees": ("aoa_rad", "degrees", lambda c, s, h: np.degrees(c["aoa_rad"])),
    "aod in degrees": ("aod_rad", "degrees", lambda c, s, h: np.degrees(c["aod_rad"])),
    "turned twice": ("aoa_rad", "radians twice", lambda c, s, h: np.radians(c["aoa_rad"])),
    "seconds": ("distance_m", "seconds", lambda c, s, h: c["distance_m"] / SPEED_OF_LIGHT),
    "nanoseconds": ("distance_m", "nanoseconds", lambda c, s, h: c["distance_m"] / SPEED_OF_LIGHT * 1e9),
    "millimetres": ("distance_m", "millimetres", lambda c, s, h: c["distance_m"] * 1e3),
    "centimetres": ("distance_m", "centimetres", lambda c, s, h: c["distance_m"] * 100),
    "feet": ("distance_m", "feet", lambda c, s, h: c["distance_m"] / 0.3048),
    "round trip": ("distance_m", "round trip", lambda c, s, h: c["distance_m"] * 2),
    "clockwise aoa": ("aoa_rad", "flipped", lambda c, s, h: -c["aoa_rad"]),
    "clockwise aod": ("aod_rad", "flipped", lambda c, s, h: -c["aod_rad"]),
    "world aoa": ("aoa_rad", "world frame", lambda c, s, h: wrap(c["aoa_rad"] + h)),
    "travel": ("aoa_rad", "backwards", lambda c, s, h: wrap(c["aoa_rad"] + np.pi)),
    "dB": ("amplitude", "dB", lambda c, s, h: 20 * np.log10(c["amplitude"])),
    "power": ("amplitude", "power", lambda c, s, h: c["amplitude"] ** 2),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "name"),
    [
        pytest.param(case, name, marks=[] if case in CHEAP else pytest.mark.slow)
        for case, name in zip(SPOILT, cycle(SCENES), strict=False)  # each in one of two rooms
    ],
)
def test_each_usual_error_is_named_and_nothing_else(tables, case, name):
    column, kind, spoil = SPOILT[case]
    table, scene = tables[name, 1], SCENES[name]
    good = columns(table, None if case in LONGER else BRIEF)
    spoilt = spoil(good, scene, table.truth.heading_rad[good["step"]])
    found = suspicions(good | {column: spoilt}, table.anchors, scene)
    if case in ALIKE:
        (one,) = found
        assert not one.certain
        assert all(word in str(one) for word in ALIKE)
    else:
        assert [(item.column, item.kind, item.certain) for item in found] == [(column, kind, True)]


@pytest.mark.slow
def test_distances_beyond_the_radio_are_named_with_the_largest(tables):
    table, scene = tables["room", 1], SCENES["room"]
    good = columns(table, BRIEF)
    (one,) = suspicions(good | {"distance_m": 1e9 * good["distance_m"]}, table.anchors, scene)
    assert (one.column, one.kind, one.certain) == ("distance_m", "beyond", True)
    allowed = f"radio.max_distance_m allows {scene.radio.max_distance_m:g} m"
    assert f"up to {1e9 * good['distance_m'].max():.4g} m" in one.text
    assert allowed in one.text


@pytest.mark.slow
def test_two_errors_at_once_are_both_named(tables):
    table = tables["room", 1]
    good = columns(table, BRIEF)
    both = {"distance_m": good["distance_m"] / SPEED_OF_LIGHT, "aoa_rad": -good["aoa_rad"]}
    assert kinds(good | both, table.anchors, SCENES["room"]) == [
        ("distance_m", "seconds"),
        ("aoa_rad", "flipped"),
    ]
    world = wrap(good["aod_rad"] + SCENES["room"].anchor_orientations[good["anchor"]])
    swapped = {"aod_rad": good["aoa_rad"], "aoa_rad": good["aod_rad"]}
    assert kinds(good | swapped, table.anchors, SCENES["room"]) == [("aod_rad", "swapped")]
    assert kinds(good | {"aod_rad": world}, table.anchors, SCENES["room"]) == [("aod_rad", "world frame")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("room", 1), ("alcove", 2)])
@pytest.mark.parametrize("missing", [(), ("amplitude",), ("aod_rad",), ("aoa_rad", "aod_rad")])
def test_clean_tables_raise_no_alarm(tables, name, seed, missing):
    table = tables[name, seed]
    good = {key: values for key, values in columns(table).items() if key not in missing}
    assert suspicions(good, table.anchors, SCENES[name]) == []
    assert suspicions(good, table.anchors) == []


@pytest.mark.slow
def test_agent_that_never_turns_raises_no_alarm_about_the_world_frame():
    whole = SCENES["room"].model_dump(exclude_none=True)
    straight = {**whole["agents"][0], "waypoints_m": ((1.5, -1.4),), "steps": None}
    scene = Scene.checked({**whole, "agents": ({k: v for k, v in straight.items() if v},)}, "room")
    table = simulate(scene, "agent1", 1)
    assert suspicions(columns(table), table.anchors, scene) == []


@pytest.mark.slow
def test_clutter_alone_raises_no_alarm():
    draw = np.random.default_rng(3)
    table = columns(simulate(SCENES["room"], "agent1", 1))
    count = len(table["step"])
    table |= {"distance_m": draw.uniform(0.1, 60, count), "amplitude": 2 + draw.exponential(0.3, count)}
    table |= {name: draw.uniform(-3, 3, count) for name in ("aod_rad", "aoa_rad")}
    assert suspicions(table, ("A", "B"), SCENES["room"]) == []


@pytest.mark.slow
@pytest.mark.parametrize("value", [-999.0, 0.0])
def test_padding_is_named_and_the_rest_still_judged(tables, value):
    table = tables["room", 1]
    good = columns(table, BRIEF)
    rows = np.arange(len(good["step"])) % 7 == 3
    names = ("distance_m", "aod_rad", "aoa_rad", "amplitude")
    padded = good | {name: np.where(rows, value, good[name]) for name in names}
    found = suspicions(padded | {"aoa_rad": -padded["aoa_rad"]}, table.anchors, SCENES["room"])
    found += suspicions(padded, table.anchors, SCENES["room"])
    # with the sign of one column turned its -999 is another filler than that of the others
    first = ["padding"] if value == 0 else ["padding", "padding"]
    assert [item.kind for item in found] == [*first, "flipped", "padding"]
    assert f"{rows.sum()} of" in found[0].reason


def test_few_scans_tell_little(tmp_path, tables):
    path = tmp_path / "heard.csv"
    tables["room", 1].to_csv(path)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:1] + [line for line in lines if line.startswith(("0,", "1,"))]))
    said = describe(path, SCENES["room"])[-1]
    assert said.endswith("in about 4 of 4 scans: units and frames fit the scene, as far as so few scans tell")


@pytest.mark.slow
def test_lines_tell_units_what_is_missing_and_what_is_refused(tmp_path, tables):
    table = tables["room", 1]
    path = tmp_path / "heard.csv"
    table.to_csv(path)
    lines = describe(path, SCENES["room"])
    assert any(line.startswith("  distance_m: ") and " m, median" in line for line in lines)
    assert "units and frames fit the scene" in lines[-1]
    rows = [line.split(",") for line in path.read_text().splitlines()]
    place = rows[0].index("aoa_rad")
    for row in rows[1:]:
        row[place] = repr(float(np.degrees(float(row[place]))))
    path.write_text("\n".join(",".join(row[:-1]) for row in rows))
    lines = describe(path, SCENES["room"])
    assert "  amplitude: not measured" in lines
    assert [line.split(":")[0] for line in lines[-2:]] == ["suspect", "refused"]
    assert "degrees" in lines[-2]


@pytest.mark.slow
@pytest.mark.parametrize("spoil", ["time", "rows"])
def test_nothing_is_said_to_fit_of_a_table_that_is_refused(tmp_path, tables, spoil):
    path = tmp_path / "heard.csv"
    tables["room", 1].to_csv(path)
    head, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    at = [head.split(",").index(name) for name in ("step", "time_s")]
    first = next(row[at[1]] for row in cells if row[at[0]] == "3")
    if spoil == "time":
        for row in cells:
            row[at[1]] = first if row[at[0]] == "4" else row[at[1]]
    else:
        cells += [row for row in cells if row[at[0]] == "3"]
    path.write_text("\n".join([head, *(",".join(row) for row in cells)]))
    lines = describe(path, SCENES["room"])
    assert lines[-1].startswith("refused: ")
    assert not any("fit the scene" in line for line in lines)


def test_same_lines_from_every_format(tmp_path, tables):
    table = tables["alcove", 1]
    table.to_csv(tmp_path / "a.csv")
    table.to_h5(tmp_path / "a.h5")
    lines, more = describe(tmp_path / "a.csv"), describe(tmp_path / "a.h5")
    told = "  simulated: alcove, agent1, seed 1"
    assert more == [f"{lines[0]}, true track known", told, *lines[1:]]


@pytest.mark.slow
def test_other_anchors_and_agents_are_refused(tmp_path, tables):
    table = tables["room", 1]
    found = suspicions(columns(table), ("X", "Y"), SCENES["room"])
    assert [item.column for item in found] == ["anchor"]
    assert suspicions(columns(table), ("1", "2"), SCENES["room"], numbers=True) == []
    with pytest.raises(InputError):
        suspicions(columns(table), table.anchors, SCENES["room"], "nobody")
    with pytest.raises(InputError):
        describe(tmp_path / "none.csv")


def test_sight_follows_the_agent(tables):
    table = tables["alcove", 2]
    seen = explain(columns(table), SCENES["alcove"], "agent1")
    gap = np.linalg.norm(seen.position_m - table.truth.position_m[: len(seen.position_m)], axis=1)
    assert np.median(gap) < 0.25
    assert turning_rad(table.truth.position_m) > np.pi / 2
    assert turning_rad(np.linspace([0, 0], [5, 5], 100)) < 1e-6


def test_empty_table_is_described():
    empty = Measurements.from_arrays({"A": [[], []], "B": [[], []]})
    assert suspicions(columns(empty), ("A", "B"), SCENES["room"]) == []


@pytest.mark.slow
def test_a_table_of_unknown_clocks_is_not_judged_and_not_refused(tmp_path):
    scene = gs.Scene.load("exchange")
    gs.simulate(scene, "agent1", 1).to_csv(tmp_path / "heard.csv")
    said = describe(tmp_path / "heard.csv", scene, "agent1")
    assert said[-1].startswith("unsure: distances hold offsets of the scene's clocks, up to 33 m")
    assert not [line for line in said if line.startswith(("suspect", "refused"))]


@pytest.mark.parametrize(("first", "says"), [(0.0, "0 to 59 s"), (1764201600.0, "59 s from 1764201600 s on")])
def test_times_since_1970_are_told_by_their_span(first, says):
    columns = simulated_columns("room", 1, steps=60)
    line = summary(columns | {"time_s": columns["time_s"] + first}, ("A", "B"))[0]
    assert f"(0 to 59, {says})" in line
