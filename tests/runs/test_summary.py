"""`run.json` holds what is described, and whoever reads it holds it to that, in a line."""

import json
from pathlib import Path

import numpy as np
import pytest
from run_samples import hall, write
from scene_samples import raised, shortened, with_levels

import gridslam as gs
from gridslam.errors import InputError
from gridslam.runs.run_files import read_run, read_summary, write_run
from gridslam.runs.summary import SUMMARY, Entry, described, hold
from gridslam.simulation.network import simulate_network


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """What runs left: of two agents never there, of unknown heights and places, of a network, of files."""
    place = tmp_path_factory.mktemp("written")
    write(place / "hall", hall())
    scene = with_levels(raised(shortened(gs.Scene.load("room"), 3), [1.5, 1.1])).model_dump(exclude_none=True)
    scene["agents"][0]["height_std_m"] = 0.05
    scene["anchors"][0]["position_std_m"] = 0.05
    scene["floor"] |= {"height_std_m": 0.05, "coefficient_std": 0.1}
    scene["filter"] = {**scene["filter"], "particles": 100}
    scene = gs.Scene.checked(scene, "high")
    heard = gs.simulate(scene, "agent1", seed=1)
    run = gs.map_scene(scene, heard, seed=1)
    source = {"file": "a.csv", "sha256": "0" * 64}
    more = {"source": [source, source], "map": source, "notes": ["agent1: lost: at last"]}
    write_run(place / "high", scene, [run], [heard], [run.score(gs.ground_truth(scene, "agent1"))], more)

    data = gs.Scene.load("exchange").model_dump(exclude_none=True)
    brief = {**data, "agents": [{**agent, "steps": 3} for agent in data["agents"][:2]]}
    scene = gs.Scene.checked({**brief, "filter": {**data["filter"], "particles": 100}}, "net")
    heard, truth = simulate_network(scene, [agent.name for agent in scene.agents], 1)
    done = gs.map_network(scene, heard, seed=1)
    runs, scores = list(done.runs.values()), {"network": done.score(truth.clocks, truth)}
    parts = [heard[run.agent] for run in runs]
    write_run(place / "net", scene, runs, parts, [run.score() for run in runs], scores)
    return {path.parent.name: json.loads(path.read_text()) for path in place.glob("*/run.json")}


@pytest.mark.slow
def test_what_is_written_is_what_is_described(written):
    found = set()
    for summary in written.values():
        entries = {key: one for key, _, one in described(summary)}
        assert {key for key, one in entries.items() if one is None} - {"threads"} == set()
        assert {key for key, one in entries.items() if isinstance(one, dict)} == set()
        found |= {one.name for one in entries.values() if isinstance(one, Entry)}
        hold(summary, "run.json")
    assert {one.name for one in SUMMARY} - found == {"agents.NAME.health.why.REASON"}, (
        "of runs in good health"
    )


def spoilt(one):
    """Values that it can't be."""
    words = {"text": 3, "true or false": 1, "list of text": ["a", 2], "two numbers": [1.0]}
    bad = [words.get(one.kind, "many"), [[]]]
    if one.kind in ("number", "whole number"):
        bad += [True, float("nan"), float("inf")] + [one.least - 1] * bool(np.isfinite(one.least))
        bad += [one.most + 0.1] * bool(np.isfinite(one.most)) + [0.5] * (one.kind == "whole number")
    return bad + (["told by nobody"] if one.words else [])


@pytest.mark.parametrize("one", SUMMARY, ids=lambda one: one.name)
def test_values_are_held_to_what_is_described(tmp_path, one):
    parts = [part.lower() if part.isupper() else part for part in one.name.split(".")]

    def summary(value):
        for part in reversed(parts):
            value = {part: value}
        return {"agents": {"name": {}}} | value

    for value in (*spoilt(one), None):
        (tmp_path / "run.json").write_text(json.dumps(summary(value)))
        if value is None:
            assert read_summary(tmp_path)
            continue
        with pytest.raises(InputError) as caught:
            read_summary(tmp_path)
        assert caught.value.where == f"{tmp_path / 'run.json'}: {'.'.join(parts)}"
        assert caught.value.allowed == one.allowed
        assert "\n" not in str(caught.value)
    ends = [end for end in (one.least, one.most) if np.isfinite(end)]
    for end in ends if one.kind == "number" else []:
        hold(summary(float(end)), "run.json")


def test_tables_are_tables_and_other_keys_are_passed_over():
    with pytest.raises(InputError, match=r"run\.json: network: found 3; allowed: a table"):
        hold({"network": 3}, "run.json")
    with pytest.raises(InputError, match=r"run\.json: source\[1\]\.file: found 3; allowed: text"):
        hold({"source": [{"file": "a"}, {"file": 3}]}, "run.json")
    hold({"mine": 3, "agents": {"NAME": {"mine": "yes", "health": {"why": {}}}}}, "run.json")


def test_a_report_of_a_run_whose_scores_are_no_numbers_is_refused(tmp_path):
    """It ended in a traceback."""
    write(tmp_path / "out", hall())
    path = Path(tmp_path / "out" / "run.json")
    path.write_text(path.read_text().replace('"position_rmse_m": 0.0', '"position_rmse_m": "none"'))
    with pytest.raises(
        InputError, match=r"agents\.agent1\.position_rmse_m: found 'none'; allowed: 0 or more"
    ):
        read_run(tmp_path / "out")
