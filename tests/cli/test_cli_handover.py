"""One product: a map of hybrid SLAM for grid SLAM and the other way round, by the command line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from feature_samples import learned
from scene_samples import shortened

import gridslam as gs
from gridslam.estimate_tables import SCATTERER
from gridslam.world.levels import COEFFICIENTS

runs = pytest.mark.usefixtures("no_figures")


def screen(tmp_path, steps, particles=1000):
    scene = shortened(gs.Scene.load("screen"), steps).with_filter(particles=particles)
    (tmp_path / "screen.toml").write_text(scene.to_toml())


def scored(tmp_path, run):
    return json.loads((tmp_path / run / "run.json").read_text())["agents"]["agent1"]


@pytest.mark.slow
@runs
def test_mirrors_that_were_learned_are_walls_and_cells_for_grid_slam_and_its_walls_features(say, tmp_path):
    screen(tmp_path, 40)
    learn = ("run", "screen.toml", "--method", "hybrid")
    assert say(*learn, "--seed", 3, "-o", "learned").code == 0
    first = gs.Map.load(tmp_path / "learned" / "map.h5")
    sure = np.hypot(first.surfaces.line[:, 0], first.surfaces.line[:, 1] - 8.0) < 0.3
    assert sure.sum() == 1, "the wall at x = 8"
    assert first.surfaces.reflection[sure] == pytest.approx(0.71, abs=0.1)
    assert first.occupied.any()
    assert scored(tmp_path, "learned")["surfaces_detected"] == len(first.surfaces)
    assert np.isfinite(first.surfaces.extent_m[sure]).all()
    known = ("run", "screen.toml", "--method", "grid", "--seed", 4)
    assert say(*known, "--map", "learned/map.h5", "-o", "walls").code == 0
    assert say(*known, "-o", "afresh").code == 0
    walls = gs.Map.load(tmp_path / "walls" / "map.h5")
    assert (walls.observed | ~first.observed).all(), "cells go on"
    assert scored(tmp_path, "walls")["map"]["auc"] >= scored(tmp_path, "afresh")["map"]["auc"]
    assert say(*learn, "--seed", 6, "--map", "walls/map.h5", "-o", "again").code == 0
    assert scored(tmp_path, "again")["features"] >= 3
    error = [scored(tmp_path, run)["position_rmse_m"] for run in ("learned", "again")]
    assert error[1] < error[0]
    again = gs.Map.load(tmp_path / "again" / "map.h5")
    assert again.observed[walls.observed].all(), "the grid's cells are handed on"
    assert scored(tmp_path, "again")["map"]["auc"] >= scored(tmp_path, "walls")["map"]["auc"] - 0.01
    assert len(again.surfaces) >= len(walls.surfaces)
    for sheet in (first, again):
        spread = sheet.surface_covariance
        assert np.abs(spread[:2, 2:4]).max() > 0, "what one agent found hangs together"
        assert np.linalg.eigvalsh(spread).min() > 0


@pytest.mark.slow
@runs
def test_nothing_of_a_map_is_lost_from_grid_to_hybrid_to_grid(say, tmp_path):
    screen(tmp_path, 20)
    assert say("run", "screen.toml", "--method", "grid", "--seed", 4, "-o", "walls").code == 0
    sheet = gs.Map.load(tmp_path / "walls" / "map.h5")
    level = np.exp(-0.5 * ((COEFFICIENTS - 0.4) / 0.1) ** 2)
    left = learned(
        [[-9.0, 3.0], [4.0, -3.0]], anchor_m=np.array([[0.5, 5.0], [90.0, 90.0]]), kind=np.full(2, SCATTERER),
        bias_m=np.array([9.7, 126.6]),
    )  # fmt: skip
    sheet = replace(sheet, features=left, levels={"floor": level / level.sum()})
    sheet.save(tmp_path / "whole.h5")
    again = ("run", "screen.toml", "--method", "hybrid", "--seed", 3, "--map", "whole.h5", "-o", "learned")
    assert say(*again).code == 0
    second = gs.Map.load(tmp_path / "learned" / "map.h5")
    met = second.evidence != sheet.evidence
    np.testing.assert_array_equal(second.coefficient[~met], sheet.coefficient[~met])
    assert second.observed[sheet.observed].all()
    np.testing.assert_array_equal(second.levels["floor"], sheet.levels["floor"])
    assert np.isin(sheet.surfaces.identity, second.surfaces.identity).all()
    last = ("run", "screen.toml", "--method", "grid", "--seed", 5, "--map", "learned/map.h5", "-o", "third")
    assert say(*last).code == 0
    third = gs.Map.load(tmp_path / "third" / "map.h5")
    for found in (second, third):
        gap = np.linalg.norm(found.features.position_m[:, None] - left.position_m, axis=-1)
        assert (gap.min(0) < 1.0).all()
    assert len(third.features) < len(second.features), "images are those of surfaces"
    assert third.observed[second.observed].all()


@pytest.mark.slow
@runs
def test_a_map_of_whoever_was_told_the_truth_says_so(say, tmp_path):
    screen(tmp_path, 3)
    assert say("run", "screen.toml", "--method", "hybrid-known", "-o", "told").code == 0
    again = ("run", "screen.toml", "--method", "hybrid", "--seed", 1)
    result = say(*again, "--map", "told/map.h5", "-o", "next")
    assert result.code == 0
    assert "whoever made it was told the true walls and scatterers" in result.err
    result = say("run", "screen.toml", "--method", "grid", "--map", "next/map.h5", "-o", "third")
    assert "whoever made it was told the true walls and scatterers" in result.err


@pytest.mark.slow
@runs
def test_measurements_that_a_map_holds_already_are_refused(say, short_room):
    first = ("run", short_room, "--agent", "agent1")
    assert say(*first, "--seed", 1, "-o", "first").code == 0
    again = say(*first, "--seed", 1, "--map", "first/map.h5", "-o", "again")
    assert again.code == 2
    (line,) = again.complaints
    assert "--map for agent1: found agent1's run " in line
    assert "made of these very measurements: they would count twice; allowed: a map made without" in line
    assert say(*first, "--seed", 2, "--map", "first/map.h5", "-o", "then").code == 0


@pytest.mark.slow
@runs
def test_maps_of_agents_that_were_lost_are_taken_with_a_note(say, tmp_path):
    scene = shortened(gs.Scene.load("room"), 2).with_filter(particles=100)
    for seed, notes in ((1, ["agent1: lost: 9.00 m off at step 9, the last"]), (2, [])):
        folder = tmp_path / f"run{seed}"
        folder.mkdir()
        gs.map_scene(scene, gs.simulate(scene, seed=seed), seed=seed).map.save(folder / "map.h5")
        (folder / "run.json").write_text(json.dumps({"agents": {"agent1": {}}, "notes": notes}))
    told = "note: run1/map.h5: by its run's notes, agent1: lost: 9.00 m off at step 9, the last: map it again"
    assert told in say("fuse", "run1", "run2", "-o", "both.h5").err
    (tmp_path / "room.toml").write_text(scene.to_toml())
    assert told in say("run", "room.toml", "--seed", 3, "--map", "run1", "-o", "next").err
    assert (
        "by its run's notes" not in say("run", "room.toml", "--seed", 3, "--map", "run2", "-o", "other").err
    )
