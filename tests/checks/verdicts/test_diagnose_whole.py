"""`check` on errors of whole tables: clocks, heights, names, times; and tables that nothing explains."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from check_tables import BRIEF, NAMES, SCENES, named, simulated_columns
from scene_samples import shortened

import gridslam as gs
from gridslam.checks.anchors.range_fit import RangeFit
from gridslam.checks.anchors.rivals import _named_beside
from gridslam.checks.columns.time_units import intervals
from gridslam.checks.scene.range_errors import RangeError
from gridslam.checks.sights.line_of_sight_filter import STEPS
from gridslam.checks.verdicts.diagnose import describe, suspicions
from gridslam.measurements.table import Measurements
from gridslam.world.radio import SPEED_OF_LIGHT

OFFSET_M = 5e-9 * SPEED_OF_LIGHT


def size(text, unit="m"):
    return float(re.search(rf"([\d.]+) {unit}\b", text)[1])


@pytest.mark.slow
def test_clock_offset_that_the_scene_allows_for_is_none():
    name = "alcove"
    columns = simulated_columns(name, 1, steps=BRIEF)
    late = columns | {"distance_m": columns["distance_m"] + OFFSET_M}
    text = SCENES[name].to_toml()
    for prior, kinds in ((10.0, []), (1.0, ["offset"])):
        scene = gs.Scene.from_toml(f"{text}\n[clocks]\nanchor_prior_ns = {prior}\n", name)
        found = suspicions(late, scene.anchor_names, scene, "agent1")
        assert [item.kind for item in found] == kinds
    nobody = scene.model_copy(update={"agents": ()})
    assert [item.kind for item in suspicions(late, scene.anchor_names, nobody)] == ["offset"]


@pytest.mark.slow
@pytest.mark.parametrize("anchor", [None, 0])
def test_a_table_with_such_an_offset_fits_the_scene(anchor, tmp_path):
    table = gs.simulate(SCENES["room"], "agent1", 3)
    rows = np.ones(len(table.anchor), bool) if anchor is None else table.anchor == anchor
    replace(table, distance_m=table.distance_m + OFFSET_M * rows).to_csv(tmp_path / "late.csv")
    scene = gs.Scene.from_toml(f"{SCENES['room'].to_toml()}\n[clocks]\nanchor_prior_ns = 10\n", "room")
    lines = describe(tmp_path / "late.csv", scene)
    assert "units and frames fit the scene" in lines[-1]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("room", 1), ("alcove", 2)])
class TestErrorsOfDistancesAreNamed:
    def test_clock_offset_of_all_anchors(self, name, seed):
        columns = simulated_columns(name, seed, steps=BRIEF)
        (found,) = named(columns | {"distance_m": columns["distance_m"] + OFFSET_M}, name)
        assert (found.column, found.kind, found.certain) == ("distance_m", "offset", True)
        assert "of all anchors" in found.text
        assert size(found.text) == pytest.approx(OFFSET_M, abs=0.1)
        assert size(found.text, "ns") == pytest.approx(5, abs=0.4)

    def test_clock_offset_of_one_anchor(self, name, seed):
        columns = simulated_columns(name, seed, steps=BRIEF)
        late = columns["distance_m"] + np.where(columns["anchor"] == 1, OFFSET_M, 0)
        (found,) = named(columns | {"distance_m": late}, name)
        assert (found.column, found.kind) == ("distance_m", "offset")
        assert "of anchor B " in found.text
        assert size(found.text) == pytest.approx(OFFSET_M, abs=0.1)

    def test_anchors_above_the_agent(self, name, seed):
        columns = simulated_columns(name, seed, steps=BRIEF)
        (found,) = named(columns | {"distance_m": np.hypot(columns["distance_m"], 1.5)}, name)
        assert (found.column, found.kind) == ("distance_m", "slant")
        assert "of all anchors" in found.text
        assert size(found.text) == pytest.approx(1.5, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "agent"), [(name, body.name) for name, scene in SCENES.items() for body in scene.agents]
)
def test_clean_tables_of_every_bundled_scene_raise_no_alarm(name, agent):
    scene = SCENES[name]
    assert suspicions(simulated_columns(name, 1, agent), scene.anchor_names, scene, agent) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["room", "canyon"])
def test_exchanged_anchors_are_named(name):
    columns, count = simulated_columns(name, 2, steps=BRIEF), len(SCENES[name].anchors)
    order = np.roll(np.arange(count), 1)
    found, *others = named(columns | {"anchor": order[columns["anchor"]]}, name)
    # the room is nearly the same turned by half: a start on the other side explains as much
    assert [item.kind for item in others] == (["start"] if name == "room" else [])
    assert (found.column, found.kind) == ("anchor", "names")
    for index, letter in enumerate(
        "ABC"[:count]
    ):  # what is called by another's name is that other's back again
        assert f"{letter} is the scene's {'ABC'[order.tolist().index(index)]}" in found.text


@pytest.mark.slow
def test_names_that_differ_in_case_are_named_and_the_rest_still_judged():
    columns, scene = simulated_columns("room", 1, steps=BRIEF), SCENES["room"]
    found = suspicions(columns | {"aoa_rad": -columns["aoa_rad"]}, ("a", "b"), scene)
    assert [(item.column, item.kind) for item in found] == [("anchor", "case"), ("aoa_rad", "flipped")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("epoch", "kind"),
    [(0.0, "milliseconds"), (1.7e12, "milliseconds"), (1.7e18, "nanoseconds"), (0.0, "fast")],
)
def test_times_that_are_no_seconds_are_named(epoch, kind):
    columns = simulated_columns("room", 1, steps=BRIEF)
    factor = {"nanoseconds": 1e9, "milliseconds": 1e3, "fast": 1e-3}[kind]
    (found,) = named(columns | {"time_s": epoch + factor * columns["time_s"]}, "room")
    assert (found.column, found.kind) == ("time_s", kind)


@pytest.mark.slow
def test_times_of_an_agent_that_goes_a_centimetre_a_step_are_named_too():
    """In 100 steps it gets no metre away, from which on a speed is told of others."""
    scene = shortened(gs.Scene.load("seminar"), 80)
    table = gs.simulate(scene, "agent1", 0)
    late = dict(table.columns) | {"time_s": 1e3 * table.time_s}
    (found,) = suspicions(late, table.anchors, scene, "agent1")
    assert (found.column, found.kind) == ("time_s", "milliseconds")


@pytest.mark.slow
def test_decibels_are_named_where_they_are_as_large_as_what_they_stand_for():
    data = SCENES["room"].model_dump(exclude_none=True)
    loud = gs.Scene.checked({**data, "radio": {**data["radio"], "snr_at_1m_db": 41}}, "loud")
    table = gs.simulate(loud, "agent1", 1)
    columns = {key: np.array(getattr(table, key)) for key in NAMES}
    assert suspicions(columns, loud.anchor_names, loud, "agent1") == []
    decibels = columns | {"amplitude": 20 * np.log10(columns["amplitude"])}
    (found,) = suspicions(decibels, loud.anchor_names, loud, "agent1")
    assert (found.column, found.kind) == ("amplitude", "dB")
    assert "+1 dB off" in found.reason, "too little to be noticed by the level"


@pytest.mark.slow
def test_few_lines_of_sight_suffice_where_the_faintest_are_at_the_threshold():
    """In the hall one anchor at a time is in sight, and decibels are as large as what they stand for."""
    columns = simulated_columns("hall", 1)
    for amplitude, kind in (
        (20 * np.log10(columns["amplitude"]), "dB"),
        (columns["amplitude"] ** 2, "power"),
    ):
        (found,) = named(columns | {"amplitude": amplitude}, "hall")
        assert (found.column, found.kind) == ("amplitude", kind)
        assert "at the scene's radio.detection_threshold_db" in found.reason
    assert named(columns, "hall") == []
    loud = columns["amplitude"] > 6.0  # a receiver with another threshold: nothing is told by that
    some = {key: values[loud] for key, values in columns.items()}
    assert [item for item in named(some, "hall") if item.column == "amplitude"] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3, 5])
def test_missing_distances_are_named(seed):
    columns = simulated_columns("room", seed, steps=BRIEF)
    del columns["distance_m"]
    (found,) = named(columns, "room")
    assert (found.column, found.kind) == ("distance_m", "missing")


@pytest.mark.slow
def test_half_a_fit_is_no_fit_and_no_cure_is_made_up(tmp_path):
    """Every second reading of each anchor's angles is another's: no cure explains that."""
    columns, draw = simulated_columns("room", 1, steps=BRIEF), np.random.default_rng(1)
    lost = np.isin(columns["step"], draw.choice(BRIEF, BRIEF // 2, replace=False))
    for key in ("aod_rad", "aoa_rad"):
        columns[key] = np.where(lost, draw.uniform(-3, 3, len(lost)), columns[key])
    assert named(columns, "room") == []
    path = tmp_path / "half.csv"
    Measurements(**columns, anchors=("A", "B")).to_csv(path)
    last = describe(path, SCENES["room"])[-1]
    assert last.startswith("suspect: ")
    assert "does not fit the scene" in last
    assert 30 <= int(re.search(r"in (\d+)% of", last)[1]) < 80


@pytest.mark.slow
def test_distances_that_are_all_off_do_not_make_amplitudes_squares():
    """Close to the one anchor heard, an offset bends their curve as a square would."""
    columns = simulated_columns("alcove", 1)
    columns = {key: values[columns["anchor"] == 0] for key, values in columns.items()}
    found = named(columns | {"distance_m": columns["distance_m"] + OFFSET_M}, "alcove")
    assert [(item.kind, item.certain) for item in found] == [("offset", False)]
    assert size(found[0].text) == pytest.approx(OFFSET_M, abs=0.3)


@pytest.mark.slow
def test_right_tables_are_not_said_to_misfit_where_too_little_is_known(tmp_path):
    """Distances alone, and an anchor that walls may hide all the way: no verdict, and no false one."""
    columns, path = simulated_columns("hall", 1), tmp_path / "heard.csv"
    Measurements(**columns, anchors=("A", "B")).to_csv(path)
    data = SCENES["hall"].model_dump(exclude_none=True)
    blind = gs.Scene.checked({**data, "walls": []}, "blind")
    last = describe(path, blind)[-1]
    assert last.startswith("unsure: line of sight to the anchors in")
    assert "B is never in line of sight: hidden by walls, of which the scene has none" in last
    empty = np.full(len(columns["step"]), np.nan)
    alone = columns | {name: empty for name in ("aod_rad", "aoa_rad", "amplitude")}
    alone["distance_m"] = np.random.default_rng(1).permutation(columns["distance_m"])
    Measurements(**alone, anchors=("A", "B")).to_csv(path)
    assert "distances alone don't tell where the agent is" in describe(path, SCENES["hall"])[-1]


@pytest.mark.slow
def test_tables_of_one_anchor_at_a_time_are_not_said_to_have_right_heights(tmp_path):
    columns, path = simulated_columns("room", 1, steps=BRIEF), tmp_path / "heard.csv"
    for turns, reported in ((False, False), (True, True)):
        rows = columns["anchor"] == columns["step"] // 8 % 2 if turns else columns["step"] >= 0
        Measurements(**{n: v[rows] for n, v in columns.items()}, anchors=("A", "B")).to_csv(path)
        last = describe(path, SCENES["room"])[-1]
        assert "units and frames fit the scene" in last
        assert ("heights and clocks can't be told: two anchors at once at 0 of" in last) == reported


def test_an_offset_stands_beside_a_height_of_the_same_anchors_alone():
    def fit(kind, anchors, size):
        return RangeFit(RangeError(kind, anchors), size, 100.0, 40)

    best = fit("slant", (0, 1), 2.0)
    assert _named_beside(best, [])
    assert _named_beside(best, [fit("offset", (0, 1), 0.4)])
    assert not _named_beside(best, [fit("offset", (0, 1), 0.2)])  # too small to be told
    assert not _named_beside(best, [fit("offset", (0,), 0.4)])
    assert not _named_beside(best, [fit("offset", (0, 1), 0.4), fit("slant", (0,), 2.0)])


@pytest.mark.slow
def test_exit_code_tells_scripts_of_suspects(say, tmp_path):
    columns = simulated_columns("room", 1, steps=BRIEF)
    for name, spoilt in (("good", {}), ("late", {"distance_m": columns["distance_m"] + OFFSET_M})):
        Measurements(**columns | spoilt, anchors=("A", "B")).to_csv(tmp_path / f"{name}.csv")
    good, late = say("check", "good.csv", "--scene", "room"), say("check", "late.csv", "--scene", "room")
    assert (good.code, good.err) == (0, "")
    assert "median interval between steps 1 s" in good.out
    assert (late.code, late.err) == (1, "")
    assert "1.50 m (5.0 ns) too long" in late.out
    few = {name: values[columns["step"] < 4] for name, values in columns.items()}
    few["distance_m"] = few["distance_m"][::-1]
    Measurements(**few, anchors=("A", "B")).to_csv(tmp_path / "few.csv")
    few = say("check", "few.csv", "--scene", "room")
    assert (few.code, "\nunsure: " in few.out, "too few to tell" in few.out) == (1, True, True)
    (tmp_path / "bad.csv").write_text("step,time_s\n")
    assert say("check", "bad.csv").code == 2
    assert "Exit code" in say("check", "--help").out


@pytest.mark.slow
@pytest.mark.parametrize("times", [np.inf, np.nan, [0.0, np.inf, 1.0], [-1e308, 1e308, -1e308]])
def test_times_that_are_no_numbers_are_looked_at_without_a_warning(times):
    columns = simulated_columns("room", 1, steps=BRIEF)
    columns["time_s"] = np.resize(np.array(times), len(columns["step"]))[columns["step"]]
    assert intervals(columns) == [] or intervals(columns)[0].startswith("  time_s: median")
    assert named(columns, "room") is not None


@pytest.mark.slow
@pytest.mark.parametrize(("metres", "seed"), [(1.0, 3), (2.0, 2)])
def test_where_one_anchor_is_in_sight_an_offset_stands_beside_other_cures_and_none_is_certain(metres, seed):
    """Hall: such distances are also those of twice the way, or of angles in the world."""
    scene = SCENES["hall"]
    columns = simulated_columns("hall", seed)
    columns["distance_m"] = columns["distance_m"] + metres
    found = suspicions(columns, scene.anchor_names, scene, "agent1")
    assert "offset" in {item.kind for item in found}
    assert not any(item.certain for item in found)


@pytest.mark.slow
def test_a_right_table_with_one_anchor_in_sight_is_given_no_offset():
    """Hall, all of it: an offset is tried with more particles, and more find more by themselves."""
    scene = SCENES["hall"]
    table = gs.simulate(scene, "agent1", 0)
    assert suspicions({key: np.array(getattr(table, key)) for key in NAMES}, table.anchors, scene) == []


@cache
def two_rooms():
    """A flat of two rooms with an anchor in each: for half of the way one of them is hidden."""
    corners = ((0.0, 0.0), (9.0, 0.0), (9.0, 7.0), (0.0, 7.0))
    walls = [
        {"name": "outer", "material": "brick", "points_m": corners, "closed": True},
        {"name": "low", "material": "brick", "points_m": ((5.0, 0.0), (5.0, 2.8))},
        {"name": "high", "material": "brick", "points_m": ((5.0, 3.9), (5.0, 7.0))},
    ]
    anchors = [
        {"name": "A", "position_m": (0.5, 6.5), "orientation_deg": -45.0},
        {"name": "B", "position_m": (8.5, 0.3), "orientation_deg": 135.0},
    ]
    way = ((4.0, 1.2), (4.2, 3.35), (6.0, 3.35))
    agent = {"name": "me", "start_m": (1.0, 1.0), "start_heading_deg": 0.0, "waypoints_m": way}
    data = {"grid": {"x_m": (-1.0, 10.0), "y_m": (-1.0, 8.0)}, "materials": {"brick": 0.7}}
    scene = gs.Scene.checked({**data, "walls": walls, "anchors": anchors, "agents": [agent]}, "flat")
    table = gs.simulate(scene, "me", 5)
    return scene, {key: np.array(getattr(table, key)[table.step < STEPS]) for key in NAMES}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kinds", "spoil"),
    [
        ([], lambda c: {}),
        (["nanoseconds"], lambda c: {"distance_m": c["distance_m"] / SPEED_OF_LIGHT * 1e9}),
        (["swapped"], lambda c: {"aod_rad": c["aoa_rad"], "aoa_rad": c["aod_rad"]}),
        (["level"], lambda c: {"amplitude": 2.5 * c["amplitude"]}),
    ],
)
def test_anchors_that_walls_hide_do_not_keep_errors_from_being_named(kinds, spoil):
    scene, columns = two_rooms()
    found = suspicions(columns | spoil(columns), ("A", "B"), scene)
    assert [item.kind for item in found] == kinds or (
        # 1.7 % apart: either may be named beside the other
        kinds == ["nanoseconds"]
        and [item.kind for item in found] == ["feet"]
        and "nanosec" in found[0].reason
    )
    if kinds == ["level"]:
        assert "radio.snr_at_1m_db of 30 dB is too low: 38 fits" in found[0].text


@pytest.mark.slow
def test_readings_that_fit_alike_are_named_side_by_side():
    """One anchor in sight, and angles that are mirrored: the direction of travel fits as well."""
    scene, columns = two_rooms()
    (found, *_) = suspicions(columns | {"aoa_rad": -columns["aoa_rad"]}, ("A", "B"), scene)
    assert found.column == "aoa_rad"
    assert not found.certain
    assert "clockwise" in found.text + found.reason
    assert "direction of travel" in found.text + found.reason
    loud = suspicions(columns | {"amplitude": 30 * columns["amplitude"]}, ("A", "B"), scene)
    assert [item.column for item in loud] == ["amplitude"]
    assert "radio.snr_at_1m_db of 30 dB is too low: 60 fits" in str(loud[0])


@pytest.mark.slow
def test_right_tables_are_right_where_the_agent_goes_out_of_sight_of_all_anchors(tmp_path):
    """Behind the door one anchor is heard by reflections alone: the agent must be followed there."""
    data = two_rooms()[0].model_dump(exclude_none=True)
    way = {"start_m": (2.5, 3.35), "waypoints_m": ((6.0, 3.35), (7.0, 5.5))}
    agents = [{**data["agents"][0], **way}]
    alone = gs.Scene.checked({**data, "anchors": data["anchors"][:1], "agents": agents}, "flat")
    gs.simulate(alone, "me", 5).to_csv(tmp_path / "a.csv")
    assert describe(tmp_path / "a.csv", alone)[-1].startswith("line of sight to the anchors in")
