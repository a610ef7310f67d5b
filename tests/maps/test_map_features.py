"""Learned features in a map's file, and from a belief to a map and back."""

import json
from dataclasses import fields, replace

import h5py
import numpy as np
import pytest
from map_samples import random_map
from scene_samples import shortened

import gridslam as gs
from gridslam.errors import InputError
from gridslam.estimate_tables import FREE, MIRROR, SCATTERER, FeatureEstimate
from gridslam.inference.management.features.feature_tables import classify, feature_estimate, with_features
from gridslam.inference.state.features.features import FeatureBank, entries, places
from gridslam.inference.state.features.hybrid_state import JointBelief
from gridslam.maps.fusion import fuse
from gridslam.maps.map import Map

ANCHORS = np.array([[3.0, 4.0], [-2.0, 1.0]])


def belief(seed=0):
    draw = np.random.default_rng(seed)
    one = JointBelief(
        np.array([0.5, -0.3, 1.0, 0.0]), 0.1 * np.eye(4), FeatureBank.empty(), np.full(2, 0.9), np.ones(2),
        np.array([2.0, 3.0]),
    )  # fmt: skip
    for n, point in enumerate(([-6.0, 2.0, 0.0], [2.0, -5.0, 3.0], [9.0, 7.0, 1.0])):
        origin = draw.normal(size=2)
        one = one.with_feature(n % 2, entries(np.array(point), origin), np.eye(3), origin, 1.0 + n, 10 + n, 4)
    root = draw.normal(size=(13, 13)) * [*[0.1] * 4, *[0.1, 0.02, 0.1] * 3]
    root[:, 6] = 0.0
    return replace(one, covariance=root.T @ root)


def test_features_come_back_from_a_file(tmp_path):
    table, joint = feature_estimate(belief(), ANCHORS)
    sheet = replace(random_map(1), features=table, feature_covariance=joint)
    sheet.save(tmp_path / "map.h5")
    found = Map.load(tmp_path / "map.h5")
    for field in fields(FeatureEstimate):
        np.testing.assert_array_equal(getattr(found.features, field.name), getattr(table, field.name))
    np.testing.assert_array_equal(found.feature_covariance, joint)
    assert found.in_words().endswith(
        f"1 surface, {len(table)} features (points that paths seem to come from)"
    )


def test_a_map_without_features_has_none(tmp_path):
    random_map(1).save(tmp_path / "map.h5")
    assert Map.load(tmp_path / "map.h5").features is None


@pytest.mark.parametrize(("name", "value"), [("variance", -1.0), ("bias_m", np.nan)])
def test_features_that_cannot_be_are_refused(tmp_path, name, value):
    table, joint = feature_estimate(belief(), ANCHORS)
    replace(random_map(1), features=table, feature_covariance=joint).save(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "r+") as file:
        file[f"features/{name}"][0] = value
    with pytest.raises(InputError):
        Map.load(tmp_path / "map.h5")


def test_a_covariance_of_other_features_is_refused():
    table, joint = feature_estimate(belief(), ANCHORS)
    with pytest.raises(InputError, match="feature_covariance"):
        replace(random_map(1), features=table, feature_covariance=joint[:3, :3])


def test_the_next_agent_starts_from_the_same_places_and_as_unsure():
    table, joint = feature_estimate(belief(), ANCHORS)
    fresh = JointBelief(
        np.array([1.0, 2.0, 0.0, 0.0]),
        np.eye(4),
        FeatureBank.empty(),
        np.full(2, 0.5),
        np.ones(2),
        np.ones(2),
    )
    found = with_features(fresh, table, joint, ANCHORS)
    np.testing.assert_allclose(
        places(found.mean, found.features.origin_m), np.column_stack([table.position_m, table.bias_m])
    )
    again, square = feature_estimate(found, ANCHORS)
    np.testing.assert_allclose(square, joint, atol=1e-9)
    np.testing.assert_allclose(again.covariance, table.covariance, atol=1e-9)
    np.testing.assert_array_equal(found.noise, [2.0, 3.0])
    np.testing.assert_array_equal(found.covariance[:4, 4:], 0.0)


def test_features_of_anchors_that_are_not_here_are_left_out():
    table, joint = feature_estimate(belief(), ANCHORS)
    found = with_features(belief().keep(np.zeros(3, bool)), table, joint, ANCHORS[1:])
    assert len(found.features) == 1
    np.testing.assert_allclose(places(found.mean, found.features.origin_m)[0], [2.0, -5.0, 3.0])


def test_kinds_follow_from_the_extra_length():
    anchor, square = np.array([3.0, 4.0]), np.diag([0.01, 0.01, 0.01])
    sure = np.diag([0.01, 0.01, 0.0])
    assert classify(np.array([-6.0, 2.0, 0.0]), sure, anchor) == MIRROR
    assert classify(np.array([-6.0, 2.0, 0.15]), square, anchor) == MIRROR
    assert classify(np.array([3.0, -2.0, 6.1]), square, anchor) == SCATTERER
    assert classify(np.array([3.0, -2.0, 3.0]), square, anchor) == FREE


def fused_with(table, joint, **more):
    other = replace(table, **more)
    sheets = [
        replace(random_map(seed), features=one, feature_covariance=square)
        for seed, one, square in ((1, table, joint), (2, other, joint))
    ]
    return fuse(sheets, same_frame=True).features


def test_features_that_agree_are_fused_and_known_better():
    table, joint = feature_estimate(belief(), ANCHORS)
    found = fused_with(table, joint)
    assert len(found) == len(table)
    for n, place in enumerate(table.position_m):
        row = np.argmin(np.hypot(*(found.position_m - place).T))
        np.testing.assert_allclose(found.position_m[row], place, atol=1e-6)
        np.testing.assert_allclose(
            found.covariance[row, :2, :2], 0.5 * table.covariance[n, :2, :2], rtol=1e-3
        )
        assert found.steps_seen[row] == 2 * table.steps_seen[n]


def test_features_of_other_anchors_or_places_stay_apart_and_powers_follow_the_noise():
    table, joint = feature_estimate(belief(), ANCHORS)
    assert len(fused_with(table, joint, anchor_m=table.anchor_m + 1)) == 2 * len(table)
    assert len(fused_with(table, joint, position_m=table.position_m + 20)) == 2 * len(table)
    louder = fused_with(table, joint, noise=100 * table.noise, variance=100 * table.variance)
    ratio = np.sort(louder.variance / louder.noise) / np.sort(table.variance / table.noise[0])
    assert np.ptp(np.log(louder.noise)) == 0
    np.testing.assert_allclose(ratio, 1.0, rtol=0.6)


def test_the_features_of_one_map_stay_as_they_are_when_fused_with_another():
    table, joint = feature_estimate(belief(), ANCHORS)
    sheet = replace(random_map(1), features=table, feature_covariance=joint)
    found = fuse([sheet, random_map(2)], same_frame=True)
    np.testing.assert_array_equal(found.features.position_m, table.position_m)
    np.testing.assert_array_equal(found.feature_covariance, joint)


def test_features_are_exported_with_their_deviations(tmp_path):
    table, joint = feature_estimate(belief(), ANCHORS)
    replace(random_map(1), features=table, feature_covariance=joint).to_csv(tmp_path)
    rows = np.genfromtxt(tmp_path / "features.csv", delimiter=",", names=True)
    np.testing.assert_allclose(rows["bias_m"], table.bias_m, rtol=1e-8)
    np.testing.assert_allclose(rows["x_std_m"] ** 2, table.covariance[:, 0, 0], rtol=1e-7)
    np.testing.assert_array_equal(rows["kind"], table.kind)
    random_map(1).to_csv(tmp_path / "plain")
    assert not (tmp_path / "plain" / "features.csv").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize(("method", "called"), [("grid", "unexplained"), ("hybrid", "features")])
def test_paths_that_no_surface_explains_are_not_exported_as_features(say, tmp_path, method, called):
    table, joint = feature_estimate(belief(), ANCHORS)
    folder = tmp_path / "run"
    folder.mkdir()
    replace(random_map(1), features=table, feature_covariance=joint).save(folder / "map.h5")
    (folder / "run.json").write_text(json.dumps({"method": method, "agents": {"a": {}}}))
    assert say("export", "run/map.h5", "-o", "out").code == 0
    found = {path.stem for path in (tmp_path / "out").iterdir()} & {"features", "unexplained"}
    assert found == {called}
    assert {path.suffix for path in (tmp_path / "out").glob(f"{called}.*")} == {".csv", ".geojson"}


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_paths_that_no_surface_explains_are_not_drawn_as_features(say, tmp_path):
    short = shortened(gs.Scene.load("room"), 6)
    (tmp_path / "short.toml").write_text(short.to_toml())
    assert say("run", "short.toml", "--seed", 1, "-o", "out").code == 0
    own, (table, joint) = tmp_path / "out" / "agent1" / "map.h5", feature_estimate(belief(), ANCHORS)
    replace(gs.Map.load(own), features=table, feature_covariance=joint).save(own)
    assert say("plot", "out").code == 0
    drawn = {path.stem for path in (tmp_path / "out" / "figures").iterdir()}
    assert "agent1-map" in drawn
    assert not drawn & {"agent1-features", "agent1-sights"}


def test_features_are_points_in_geojson(tmp_path):
    from gridslam.importers.geojson import write_features

    table, _ = feature_estimate(belief(), ANCHORS)
    write_features(tmp_path / "features.geojson", table)
    rows = json.loads((tmp_path / "features.geojson").read_text())["features"]
    np.testing.assert_allclose([row["geometry"]["coordinates"] for row in rows], table.position_m)
    np.testing.assert_allclose([row["properties"]["bias_m"] for row in rows], table.bias_m)
    assert rows[0]["properties"]["kind"] in ("free", "mirror", "scatterer")
    assert rows[1]["properties"]["anchor_m"] == ANCHORS[1].tolist()
