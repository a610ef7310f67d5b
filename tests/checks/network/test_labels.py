"""Labels and clocks of several agents that don't fit the scene are named; those that do are left in peace."""

import re
from dataclasses import replace

import numpy as np
import pytest
from workshop import workshop

import gridslam as gs
from gridslam.checks.network.devices import devices
from gridslam.checks.network.labels import judge_labels, suspicion_lines, untold_lines
from gridslam.checks.network.sights import crossed
from gridslam.checks.network.tables import describe_network

STEPS = 40


def label_and_clock_lines(measurements, scene):
    """What is said of labels and clocks alone."""
    judged = judge_labels(measurements, scene)
    return [*untold_lines(judged), *suspicion_lines(judged, scene)]


def short(name="exchange", **changes):
    whole = gs.Scene.load(name).model_dump(exclude_none=True)
    for agent in whole["agents"]:
        agent["steps"] = STEPS
    return whole | changes


@pytest.fixture(scope="module")
def scene():
    return gs.Scene.checked(short(), "short")


@pytest.fixture(scope="module")
def measurements(scene):
    return gs.simulate(scene, ["agent1", "agent3"], seed=101)


def relabelled(measurements, change):
    anchor = measurements.table.anchor.copy()
    change(anchor)
    return replace(measurements, table=replace(measurements.table, anchor=anchor))


def still(scene, names=("agent1", "agent3"), **clocks):
    """The same scene with clocks that are believed to be right, or with other priors."""
    whole = short()
    if clocks:
        whole["clocks"] = whole["clocks"] | clocks
    else:
        whole.pop("clocks")
        for device in whole["anchors"] + whole["agents"]:
            device.pop("clock", None)
    return gs.Scene.checked(whole, "still")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["exchange", "annex"])
def test_what_fits_is_not_suspected(name):
    whole = gs.Scene.checked(short(name), "short")
    names = [agent.name for agent in whole.agents][:2]
    for seed in (201, 202):
        measurements = gs.simulate(whole, names, seed)
        assert label_and_clock_lines(measurements, whole) == []
        assert label_and_clock_lines(measurements.without_labels(), whole) == []


@pytest.mark.slow
def test_exchanged_labels_of_one_agent_or_of_all_are_named(scene, measurements):
    def exchange(anchor, mine):
        one, other = mine & (anchor == 1), mine & (anchor == 2)
        anchor[one], anchor[other] = 2, 1

    one = relabelled(measurements, lambda anchor: exchange(anchor, measurements.agent == 1))
    pairs = "C is the scene's B, B is the scene's C"
    assert label_and_clock_lines(one, scene) == [f"suspect: labels exchanged for agent3: {pairs}"]
    both = relabelled(measurements, lambda anchor: exchange(anchor, measurements.agent >= 0))
    assert label_and_clock_lines(both, scene) == [f"suspect: labels exchanged for all agents: {pairs}"]


def test_rows_with_another_anchors_label_are_counted(scene, measurements):
    def some(anchor):
        rows = np.flatnonzero((measurements.agent == 0) & (anchor == 3))
        anchor[rows[::3]] = 0

    lines = label_and_clock_lines(relabelled(measurements, some), scene)
    assert len(lines) == 1
    assert lines[0].startswith("suspect: agent1: ")
    assert lines[0].endswith("of the line of sight to D are labelled A")


@pytest.mark.slow
def test_offsets_without_clocks_or_beyond_their_priors_are_named(scene, measurements):
    for unlabelled in (False, True):
        received = measurements.without_labels() if unlabelled else measurements
        lines = label_and_clock_lines(received, still(scene))
        assert len(lines) == 4
        assert all("give the scene [clocks] with anchor_prior_ns = " in line for line in lines)
    offsets = [float(line.split("by ")[1].split(" m")[0]) for line in lines]
    np.testing.assert_allclose(offsets, np.array([-29.5, -9.5, 10.5, 30.5]), atol=0.5)
    narrow = label_and_clock_lines(measurements, still(scene, anchor_prior_ns=50.0))
    assert [line.split(" are off")[0][-1] for line in narrow] == ["A", "D"]
    assert all("prior in [clocks] is too narrow" in line for line in narrow)


@pytest.mark.slow
def test_one_width_of_clocks_is_proposed_and_nothing_else_suspected(scene, measurements, tmp_path):
    """Three widths for one key were, and feet, or a start elsewhere, of distances that clocks spoil."""
    measurements.to_csv(tmp_path / "a.csv")
    lines = [x for x in describe_network(tmp_path / "a.csv", still(scene)) if x.startswith("suspect: ")]
    assert lines[0].startswith("suspect: negative distances hold offsets of clocks")
    assert [line.split(" are off")[0][-1] for line in lines[1:]] == ["A", "B", "C", "D"]
    (width,) = {re.search(r"anchor_prior_ns = (\d+)", line)[1] for line in lines}
    assert int(width) > 1e9 * 30.57 / 299792458


@pytest.mark.slow
def test_a_device_whose_distances_clocks_spoil_is_judged_by_its_angles(measurements, scene):
    late = replace(measurements.table, distance_m=measurements.table.distance_m + 40.0)
    late = replace(measurements, table=late)
    told = devices(late, still(scene), measurements.agents)
    assert [one.found for one in told] == [[], []]
    assert any(one.found for one in devices(late, still(scene)))


@pytest.mark.slow
def test_too_few_lines_of_sight_say_nothing(scene, measurements):
    bare = replace(measurements.table, aod_rad=np.full_like(measurements.table.aod_rad, np.nan))
    lines = label_and_clock_lines(replace(measurements, table=bare), scene)
    assert lines == ["unsure: agent1, agent3: too few lines of sight to judge labels and clocks by"]


@pytest.mark.slow
def test_check_says_so_and_leaves_exit_code_1(say, scene, measurements, tmp_path):
    (tmp_path / "s.toml").write_text(scene.to_toml())
    swapped = relabelled(measurements, lambda anchor: np.copyto(anchor, np.array([1, 0, 2, 3])[anchor]))
    swapped.to_csv(tmp_path / "a.csv")
    result = say("check", str(tmp_path / "a.csv"), "--scene", str(tmp_path / "s.toml"))
    assert result.code == 1
    assert "suspect: labels exchanged for all agents: B is the scene's A, A is the scene's B" in result.out
    assert not any("suspect" in line for line in describe_network(tmp_path / "a.csv"))


def test_directions_cross_where_they_meet():
    place = np.array([[0.0, 0], [4, 0], [0, 0], [1, 0], [0, 0]])
    point = np.array([[1.0, 2], [1, 2], [3, 0], [3, 0], [5, 5]])
    away = point - place
    found = crossed(np.array([0, 0, 1, 1, 2]), place, np.arctan2(away[:, 1], away[:, 0]), np.hypot(*away.T))
    np.testing.assert_allclose(found[:2], point[:2], atol=1e-9)
    assert np.isnan(found[2:]).all()  # parallel ones, and one alone


@pytest.mark.slow
def test_reflections_that_fit_another_way_accuse_nobody():
    """Angles alone follow them through the workshop: labels and distances as they stand fit the right way."""
    for seed in (1, 3):
        received = gs.simulate(workshop(), ["r1", "r2"], seed)
        for scene in (workshop(), workshop(walls=False)):
            for table in (received, received.without_labels()):
                assert [x for x in label_and_clock_lines(table, scene) if "suspect" in x] == []
    late = received.table.distance_m + 6.0 * (received.table.anchor == 1)
    off = replace(received, table=replace(received.table, distance_m=late))
    (line,) = [x for x in label_and_clock_lines(off, workshop()) if "suspect" in x]
    assert line.startswith("suspect: distances of anchor B are off by +6.0")


@pytest.mark.slow
def test_exchanged_labels_are_named_where_angles_alone_follow_reflections():
    received = gs.simulate(workshop(), ["r1", "r2"], 3)

    def exchange(anchor):
        own = (received.agent == 1) & (anchor < 2)
        anchor[own] = 1 - anchor[own]

    lines = label_and_clock_lines(relabelled(received, exchange), workshop())
    assert lines == ["suspect: labels exchanged for r2: B is the scene's A, A is the scene's B"]
