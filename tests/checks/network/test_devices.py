"""Each of several devices in a table is judged by itself, and named; right ones are left in peace."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.checks.network.devices import Device, device_lines, devices
from gridslam.checks.tables.unit_hypotheses import ADVICE, Suspicion
from gridslam.world.geometry import wrap

CANYON = short("canyon", 40)
ONE, OTHER = (agent.name for agent in CANYON.agents)
SPOILT = {
    "round trip": lambda t, own: {"distance_m": t.distance_m * np.where(own, 2, 1)},
    "flipped": lambda t, own: {"aoa_rad": np.where(own, -t.aoa_rad, t.aoa_rad)},
    "swapped": lambda t, own: {
        "aod_rad": np.where(own, t.aoa_rad, t.aod_rad),
        "aoa_rad": np.where(own, t.aod_rad, t.aoa_rad),
    },
    "turned": lambda t, own: {"aod_rad": wrap(t.aod_rad + 0.7 * (own & (t.anchor == 1)))},
    "milliseconds": lambda t, own: {"time_s": 1e3 * t.time_s},
}


@pytest.fixture(scope="module")
def heard():
    return gs.simulate(CANYON, [ONE, OTHER], 1)


def spoilt(heard, kind, whom=1):
    """The same with an error in one device's rows."""
    change = SPOILT[kind](heard.table, heard.agent == whom)
    return replace(heard, table=replace(heard.table, **change))


FLIPPED = Suspicion("aoa_rad", "flipped", ADVICE["flipped"], True, "100%")


def test_what_labels_and_clocks_have_said_is_not_said_twice():
    both = Device(ONE, [replace(FLIPPED, kind="names"), FLIPPED], "")
    fits = Device(OTHER, [], "units and frames fit the scene")
    assert device_lines([both, fits]) == [f"suspect: {ONE}: {FLIPPED}"] * 2 + [f"  {OTHER}: {fits.verdict}"]
    assert device_lines([both, fits], [ONE, OTHER]) == [f"suspect: {ONE}: {FLIPPED}"]


@pytest.mark.parametrize("mark", ["suspect: ", "unsure: "])
def test_marks_stay_where_the_exit_code_is_told_by_them(mark):
    assert device_lines([Device(ONE, [], f"{mark}line of sight")]) == [f"{mark}{ONE}: line of sight"]


def test_devices_whose_rows_have_no_labels_are_not_judged_by_themselves(heard):
    assert devices(heard.without_labels(), CANYON) == []


@pytest.mark.slow
def test_an_error_of_one_device_is_named_with_it(heard):
    first, second = devices(spoilt(heard, "flipped"), CANYON)
    assert (first.agent, first.found, second.agent) == (ONE, [], OTHER)
    assert "units and frames fit the scene" in first.verdict
    assert [item.kind for item in second.found] == ["flipped"]
    fits, suspect = device_lines([first, second])
    assert fits == f"  {ONE}: {first.verdict}"
    assert suspect.startswith(f"suspect: {OTHER}: aoa_rad: {ADVICE['flipped']} (")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["milliseconds", "round trip", "turned"])
def test_usual_errors_of_one_device_are_named(heard, kind):
    *others, found = devices(spoilt(heard, kind), CANYON)
    assert kind in {item.kind for item in found.found}
    assert kind == "milliseconds" or not any(other.found for other in others)


@pytest.mark.slow
def test_check_names_exchanged_devices_and_leaves_right_tables_in_peace(say, heard, tmp_path):
    (tmp_path / "s.toml").write_text(CANYON.to_toml())
    for name, table, code in (
        ("right", heard, 0),
        ("unlabelled", heard.without_labels(), 0),
        ("exchanged", replace(heard, agent=1 - heard.agent), 1),
    ):
        table.to_csv(tmp_path / f"{name}.csv")
        result = say("check", str(tmp_path / f"{name}.csv"), "--scene", str(tmp_path / "s.toml"))
        assert result.code == code, result.out
        assert ("suspect: " in result.out) == bool(code)
    assert f"{ONE}: agent: the table of {OTHER}, by where it begins: are names exchanged?" in result.out


@pytest.mark.slow
def test_too_few_lines_of_sight_to_judge_leave_exit_code_1(say, tmp_path):
    heard = gs.simulate(short("exchange", 40), ["agent1", "agent3"], 101)
    bare = replace(heard.table, aod_rad=np.full_like(heard.table.aod_rad, np.nan))
    replace(heard, table=bare).without_labels().to_csv(tmp_path / "a.csv")
    result = say("check", str(tmp_path / "a.csv"), "--scene", "exchange")
    assert result.code == 1
    assert "unsure: agent1, agent3: too few lines of sight to judge labels and clocks by" in result.out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["exchange", "annex"])
def test_unknown_clocks_accuse_nobody_and_angles_are_judged_all_the_same(name):
    scene = short(name, 40)
    right = gs.simulate(scene, [agent.name for agent in scene.agents][:2], 201)
    assert not any(one.found or one.verdict.startswith("suspect: ") for one in devices(right, scene))
    first, second = devices(spoilt(right, "swapped"), scene)
    assert (first.found, [item.kind for item in second.found]) == ([], ["swapped"])


@pytest.mark.slow
def test_a_straight_way_along_x_that_angles_alone_tell_roughly_is_no_way_in_the_world():
    """The course of places that are off by decimetres seemed to turn."""
    (own,) = devices(gs.simulate(gs.Scene.load("annex"), ["agent1"], 3), gs.Scene.load("annex"))
    assert own.found == []
