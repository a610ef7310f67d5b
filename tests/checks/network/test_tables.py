"""What `check` says of several agents' measurements."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short, shortened
from scipy.io import savemat

import gridslam as gs
from gridslam.checks.network.tables import describe_network, is_network
from gridslam.errors import InputError


@pytest.fixture(scope="module")
def scene():
    return short("exchange", 4)


def test_files_of_several_agents_are_described(scene, tmp_path):
    measurements = gs.simulate(scene, ["agent1", "agent3"], unlabelled=True)
    measurements.to_csv(tmp_path / "a.csv")
    measurements.to_h5(tmp_path / "a.h5")
    for name in ("a.csv", "a.h5"):
        assert is_network(tmp_path / name)
        lines = describe_network(tmp_path / name, scene)
        assert "of 2 agents, anchors A, B, C, D" in lines[0]
        assert "labels: 0% of the rows" in lines[1]
        assert any("agent3: steps 0 to 3" in line for line in lines)
        assert not any(line.startswith("suspect") for line in lines)
        assert lines[-1].startswith(
            "  no row says which anchor it is of: --method network and network_grid find"
        )
    needs = r"no row that names an anchor; allowed: --scene .* --method network and network_grid find out"
    with pytest.raises(InputError, match=needs):
        describe_network(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text("step,time_s,distance_m\n0,0,1.5\n")  # nor does it say whose it is
    with pytest.raises(InputError, match=needs):
        describe_network(tmp_path / "b.csv")


def test_clocks_and_labels_that_are_missing_are_named(scene, tmp_path):
    measurements = gs.simulate(scene, ["agent1"])
    assert (measurements.table.distance_m < 0).any()
    text = ["step,time_s,agent,anchor,distance_m"]
    rows = zip(measurements.table.step, measurements.table.time_s, measurements.table.distance_m, strict=True)
    text += [f"{step},{time},agent1,{'A' if k % 2 else ''},{far}" for k, (step, time, far) in enumerate(rows)]
    (tmp_path / "a.csv").write_text("\n".join(text))
    whole = scene.model_dump(exclude_none=True)
    whole.pop("clocks")
    for device in whole["anchors"] + whole["agents"]:
        device.pop("clock", None)
    lines = describe_network(tmp_path / "a.csv", gs.Scene.checked(whole, "still"))
    suspects = [line for line in lines if line.startswith("suspect")]
    assert len(suspects) == 2
    assert re.search(r"\[clocks\] with anchor_prior_ns = \d+ and run", suspects[0])
    assert "labels are missing on" in suspects[1]


def test_a_table_that_lacks_the_agents_is_told_so_where_clocks_are_unknown(scene, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("step,time_s,anchor,distance_m\n0,0,A,-3\n")
    assert is_network(path, scene)
    assert not is_network(path, shortened(gs.Scene.load("room"), 4, agents=2))
    with pytest.raises(InputError, match="no column 'agent'"):
        describe_network(path, scene)


def test_matlab_files_of_several_agents_are_described(scene, tmp_path):
    measurements = gs.simulate(scene, ["agent1", "agent3"])
    rows = {key: values[:, None] for key, values in measurements.table.columns.items()}
    rows |= {
        "anchor": measurements.table.anchor[:, None] + 1.0,
        "agent": 2 * measurements.agent[:, None] + 1.0,
    }
    savemat(tmp_path / "a.mat", rows)
    assert is_network(tmp_path / "a.mat")
    for world in (scene, None):
        assert "of 2 agents" in describe_network(tmp_path / "a.mat", world)[0]
    savemat(tmp_path / "b.mat", {key: value for key, value in rows.items() if key != "agent"})
    assert not is_network(tmp_path / "b.mat")


def test_tables_of_one_agent_are_none_of_these(tmp_path):
    measurements = gs.simulate(gs.Scene.load("room"), "agent1")
    measurements.to_csv(tmp_path / "a.csv")
    measurements.to_h5(tmp_path / "a.h5")
    assert not any(is_network(tmp_path / name) for name in ("a.csv", "a.h5"))


def test_methods_that_take_distances_as_they_are_refuse_unknown_clocks(scene):
    with pytest.raises(InputError, match=r"exchange: clocks: found clocks that aren't .*network"):
        gs.AdaptiveSlam(scene)
    whole = scene.model_dump(exclude_none=True)
    whole["clocks"] = {"anchor_prior_ns": 0.0}
    for device in whole["anchors"] + whole["agents"]:
        device.pop("clock", None)
    slam = gs.AdaptiveSlam(gs.Scene.checked(whole, "known"))
    assert np.isfinite(slam.state.belief.mean).all()


def test_a_table_without_anchors_is_suspected_where_run_would_refuse_it(tmp_path):
    room = gs.Scene.load("room")
    table = gs.simulate(room, "agent1", 1)
    table.to_csv(tmp_path / "whole.csv")
    rows = [line.split(",") for line in (tmp_path / "whole.csv").read_text().splitlines()[:200]]
    column = rows[0].index("anchor")
    kept = [",".join(row[:column] + row[column + 1 :]) for row in rows]
    (tmp_path / "bare.csv").write_text("\n".join(kept) + "\n")
    told = gs.Scene.from_toml(f"{room.to_toml()}\n[clocks]\nanchor_prior_ns = 5\n", "told")
    for scene, suspected in ((room, True), (told, False)):
        lines = describe_network(tmp_path / "bare.csv", scene)
        assert any("anchor: no row says which anchor it is of" in line for line in lines) == suspected


@pytest.mark.slow
def test_a_table_of_one_agent_whose_clocks_nobody_knows_is_judged_by_angles(say, tmp_path):
    """It was "unsure" for want of a column that a table of one agent doesn't need."""
    scene = short("exchange", 30)
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    right = gs.simulate(scene, "agent1", seed=1)
    right.to_csv(tmp_path / "a.csv")
    asked = "--scene", "scene.toml", "--agent", "agent1"
    said = say("check", "a.csv", *asked)
    assert (said.code, "agent1: line of sight to the anchors in" in said.out) == (0, True), said.out
    assert "aod_rad: " in said.out
    swapped = np.choose(right.anchor, [1, 0, 2, 3])
    replace(right, anchor=swapped).to_csv(tmp_path / "b.csv")
    said = say("check", "b.csv", *asked)
    assert said.code == 1
    assert "suspect: " in said.out
