"""What a filter is told of the start: drawn from its prior where data are simulated, and recorded."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short
from tiny import TINY

import gridslam as gs
from gridslam.cli.main import main
from gridslam.studies.study import Study, run_study
from gridslam.world.geometry import wrap
from gridslam.world.start import assumed_start


def call(monkeypatch, words):
    """Exit code of the command line."""
    monkeypatch.setattr(sys, "argv", ["gridslam", *map(str, words)])
    try:
        main()
    except SystemExit as end:
        return end.code or 0
    return 0


@pytest.fixture(scope="module")
def scene():
    return gs.Scene.from_toml(TINY, "tiny")


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


def test_heights_that_are_drawn_stay_between_floor_and_ceiling():
    data = gs.Scene.load("ceiling").model_dump(exclude_none=True)
    data["ceiling"] = {"height_m": 2.9, "height_std_m": 0.2, "coefficient": 0.4}
    low = gs.Scene.checked(data, "low")
    agent, found = low.agents[0].name, []
    for seed in range(60):
        heights = assumed_start(low, agent, seed).heights_m
        gs.Scene.from_toml(low.at_heights(agent, heights).to_toml(), "told")  # as a checkpoint holds it
        found.append(heights["ceiling"])
    assert 2.7 < min(found) < 2.8
    assert max(found) > 3.1


def test_starts_are_drawn_uniformly_about_the_true_one_within_the_prior(scene):
    drawn = [assumed_start(scene, "agent1", seed) for seed in range(2000)]
    track, prior = scene.track("agent1"), scene.agent("agent1").prior
    gap = np.array([start.position_m for start in drawn]) - track.position_m[0]
    turn = np.degrees(wrap(np.array([start.heading_rad for start in drawn]) - track.heading_rad[0]))
    for values, half in (
        (gap[:, 0], prior.position_m),
        (gap[:, 1], prior.position_m),
        (turn, prior.heading_deg),
    ):
        assert np.abs(values).max() <= half
        # uniform: standard deviation half / sqrt(3), mean 0 within 4 standard errors, and close to the ends
        assert values.std() == pytest.approx(half / np.sqrt(3), rel=0.05)
        assert abs(values.mean()) < 4 * half / np.sqrt(3 * len(values))
        assert np.abs(values).max() > 0.99 * half
    assert np.abs(np.corrcoef(np.column_stack([gap, turn]).T) - np.eye(3)).max() < 0.1


@pytest.mark.parametrize("seed", [-1, 1.5, "1", None])
def test_seed_that_is_none_is_told_as_such(seed):
    scene = gs.Scene.load("room")
    calls = (
        lambda: assumed_start(scene, "agent1", seed),
        lambda: gs.simulate(scene, "agent1", seed),
        lambda: gs.GridSlam(scene, seed=seed),
        lambda: gs.VirtualAnchorSlam(scene, seed=seed),
    )
    for call in calls:
        with pytest.raises(gs.InputError, match=r"^seed: found .*; allowed: a whole number, 0 or more$"):
            call()
    assert assumed_start(scene, "agent1", np.int64(3)).how == "drawn"


def test_a_start_repeats_by_seed_and_differs_by_seed_and_agent(scene):
    one, two = assumed_start(scene, "agent1", 3), assumed_start(scene, "agent1", 3)
    assert one.position_m.tolist() == two.position_m.tolist()
    assert one.heading_rad == two.heading_rad
    off = [
        assumed_start(scene, name, 3).position_m - scene.track(name).position_m[0]
        for name in ("agent1", "agent2")
    ]
    assert (off[0] != off[1]).all()
    assert (one.position_m != assumed_start(scene, "agent1", 4).position_m).all()


def test_a_drawn_start_stays_in_the_region_and_an_exact_one_is_the_scenes(scene):
    data = scene.model_dump(exclude_none=True)
    data["agents"] = [{"name": "agent1", "start_m": [-4.79, 0.0], "prior": {"position_m": 2.0}}]
    edge = gs.Scene.checked({**data, "walls": []}, "edge")
    assert min(assumed_start(edge, "agent1", seed).position_m[0] for seed in range(20)) == -4.8
    exact = assumed_start(edge, "agent1", 5, "exact")
    assert (exact.how, exact.position_m.tolist(), exact.heading_rad) == ("exact", [-4.79, 0.0], 0.0)
    with pytest.raises(gs.InputError, match="start: found 'vague'; allowed: drawn or exact"):
        assumed_start(edge, "agent1", 5, "vague")


def test_the_filter_begins_where_it_is_told(scene):
    measurements, start = gs.simulate(scene, "agent1", 1), assumed_start(scene, "agent1", 1)
    slam = gs.GridSlam(scene, seed=1)
    slam.start_at(start.position_m, start.heading_rad)
    np.testing.assert_array_equal(slam.state.belief.mean, [*start.position_m, 0, 0, start.heading_rad])
    drawn = gs.map_scene(scene, measurements, seed=1, start=start)
    own = gs.map_scene(scene, measurements, seed=1, start="exact")
    assert (drawn.start, own.start) == ("drawn", "exact")
    np.testing.assert_array_equal(
        drawn.trajectory.position_m, [slam.step(scan).position_m for scan in measurements]
    )
    assert (drawn.trajectory.position_m != own.trajectory.position_m).any()
    with pytest.raises(gs.InputError, match="start: found told after 3 steps; allowed: before the first"):
        slam.start_at(start.position_m, 0.0)
    with pytest.raises(gs.InputError, match=r"start: .*nan.*finite"):
        gs.GridSlam(scene).start_at([np.nan, 0.0], 0.0)


@pytest.mark.slow
def test_python_draws_starts_of_what_was_simulated_and_takes_the_scenes_of_the_rest(scene, tmp_path):
    heard = gs.simulate(scene, "agent1", 1)
    heard.to_csv(tmp_path / "heard.csv")
    recorded = gs.Measurements.from_csv(tmp_path / "heard.csv", scene.anchor_names)
    own, drawn = assumed_start(scene, "agent1", 1, "exact"), assumed_start(scene, "agent1", 1)

    def began(measurements, start=None):
        run = gs.map_scene(scene, measurements, seed=1, start=start, particles=64)
        return run.start, *run.began.position_m.tolist()

    assert began(heard) == began(recorded, "drawn") == ("drawn", *drawn.position_m.tolist())
    assert began(recorded) == ("scene", *own.position_m.tolist())
    assert began(heard, "exact") == ("exact", *own.position_m.tolist())
    assert began(recorded, (-1.0, 0.5, 0.2)) == ("told", -1.0, 0.5)
    for wrong in ("vague", (1.0, 2.0), (1.0, 2.0, "north"), (1.0, 2.0, np.nan)):
        with pytest.raises(gs.InputError, match=r"^start: found .*; allowed: drawn or exact"):
            began(heard, wrong)


@pytest.mark.slow
def test_starts_of_several_agents_and_of_samples_follow_the_same_rule(tmp_path):
    exchange = short("exchange", 2)
    heard = gs.simulate(exchange, ("agent1", "agent3"), 1)
    for starts, told in ((None, "drawn"), ("exact", "exact")):
        runs = gs.map_network(exchange, heard, seed=1, starts=starts, particles=64).runs
        assert {run.start for run in runs.values()} == {told}
    recorded = replace(heard, table=replace(heard.table, simulated=None))
    assert {run.start for run in gs.map_network(exchange, recorded, particles=64).runs.values()} == {"scene"}
    samples = gs.simulate(short("screen", 2), "agent1", 1, what="signal")
    samples.to_h5(tmp_path / "samples.h5")
    assert gs.Recording.from_h5(tmp_path / "samples.h5").simulated == samples.simulated is not None


@pytest.mark.slow
def test_a_run_says_which_start_was_told(file, tmp_path, no_figures, monkeypatch, capsys):
    measurements = tmp_path / "heard.csv"
    assert call(monkeypatch, ["simulate", file, "-o", measurements]) == 0
    summaries = {}
    for name, more in {
        "default": [], "drawn": ["--start", "drawn"], "exact": ["--start", "exact"],
        "recorded": ["--measurements", measurements],
    }.items():  # fmt: skip
        assert call(monkeypatch, ["run", file, "--agent", "agent1", "-o", tmp_path / name, *more]) == 0
        summaries[name] = json.loads((tmp_path / name / "run.json").read_text())
    assert [summaries[n]["start"] for n in ("default", "drawn", "exact", "recorded")] == [
        "drawn",
        "drawn",
        "exact",
        "scene",
    ]
    start = assumed_start(gs.Scene.load(file), "agent1", summaries["default"]["seed"])
    pose = {"position_m": start.position_m.tolist(), "heading_deg": np.degrees(start.heading_rad)}
    assert summaries["default"]["starts"] == {"agent1": pose}
    rmse = {name: summary["agents"]["agent1"]["position_rmse_m"] for name, summary in summaries.items()}
    assert rmse["default"] == rmse["drawn"] != rmse["exact"]
    capsys.readouterr()
    for words in (["--start", "vague"], ["--measurements", measurements, "--start", "drawn"]):
        assert call(monkeypatch, ["run", file, "--agent", "agent1", "-o", tmp_path / "none", *words]) == 2
        assert capsys.readouterr().err.startswith("error: --start")


def test_a_study_tells_drawn_starts_and_records_it(scene, tmp_path):
    class Here:
        def run(self, work, tasks):
            yield from ((index, work(task)) for index, task in enumerate(tasks))

    found = {}
    for start in ("drawn", "exact"):
        plan = Study((scene,), seeds=(1,), agents=("agent1",), start=start)
        record = run_study(plan, tmp_path / start, Here()).records[0]
        assert record["key"]["start"] == start
        assert json.loads((tmp_path / start / "study.jsonl").read_text().splitlines()[0])["start"] == start
        found[start] = record["agents"]["agent1"]["steps"]["position_error_m"]
    assert found["drawn"] != found["exact"]
    assert Study((scene,)).start == "drawn"
    with pytest.raises(gs.InputError, match="results of other start"):
        run_study(Study((scene,), seeds=(1,), agents=("agent1",), start="drawn"), tmp_path / "exact", Here())
    with pytest.raises(gs.InputError, match="study: start: found 'vague'"):
        Study((scene,), start="vague")
