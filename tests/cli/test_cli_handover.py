"""One product: a map of hybrid SLAM for grid SLAM and the other way round, by the command line."""

import json

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs

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
    learn = ("run", "screen.toml", "--method", "hybrid", "--seed", 3)
    assert say(*learn, "-o", "learned").code == 0
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
    assert say(*learn, "--map", "walls/map.h5", "-o", "again").code == 0
    assert scored(tmp_path, "again")["features"] >= 3
    error = [scored(tmp_path, run)["position_rmse_m"] for run in ("learned", "again")]
    assert error[1] < error[0]


@pytest.mark.slow
@runs
def test_a_map_of_whoever_was_told_the_truth_says_so(say, tmp_path):
    screen(tmp_path, 3)
    assert say("run", "screen.toml", "--method", "hybrid-known", "-o", "told").code == 0
    said = say("run", "screen.toml", "--method", "hybrid", "--map", "told/map.h5", "-o", "next")
    assert said.code == 0
    assert "whoever made it was told the true walls and scatterers" in said.err
    said = say("run", "screen.toml", "--method", "grid", "--map", "next/map.h5", "-o", "third")
    assert "whoever made it was told the true walls and scatterers" in said.err


@runs
def test_measurements_that_a_map_holds_already_are_named(say, short_room):
    first = ("run", short_room, "--agent", "agent1")
    assert "count twice" not in say(*first, "--seed", 1, "-o", "first").out
    for seed, twice in ((1, True), (2, False)):
        said = say(*first, "--seed", seed, "--map", "first/map.h5", "-o", f"then-{seed}")
        assert ("agent1: the map it began with holds these very measurements" in said.out) == twice
