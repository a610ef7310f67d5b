"""Elevations as they are simulated, imported, bounded, stored and checked; docs/model.md, (M301)."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import replace_layers, shortened, tall

import gridslam as gs
from gridslam.checks.verdicts.diagnose import describe
from gridslam.errors import InputError
from gridslam.evaluation.bounds import unknown_map_bound
from gridslam.importers.raytracers import TracedPaths, plane_table
from gridslam.maps.run_identity import Identity
from gridslam.simulation.image_source import simulate_labelled, true_paths
from gridslam.simulation.reception import true_elevations
from gridslam.world.columns import ELEVATIONS, OPTIONAL
from gridslam.world.geometry import elevations
from gridslam.world.levels import CEILING, DIRECT, FLOOR
from gridslam.world.radio import SPEED_OF_LIGHT

ROOM = gs.Scene.load("room")


def test_an_anchor_above_is_seen_upwards_and_sees_the_agent_downwards():
    # 1.5 m up, 2 m away: 2.5 m, atan(3/4); an image in a ceiling is above, too, but its path leaves upwards
    found = elevations(np.array([2.5, 2.5]), np.array([1.5, 1.5]), np.array([True, False]))
    up = np.arctan2(1.5, 2.0)
    np.testing.assert_allclose(found, [[-up, up], [up, up]])
    scene = tall()
    paths = true_paths(scene, "agent1")
    there = true_elevations(paths, scene, "agent1")
    assert (there[paths.over == DIRECT] * [-1, 1] > 0).all()
    assert (there[paths.over == CEILING] > 0).all()
    assert (there[paths.over == FLOOR] < 0).all()


def test_zenith_angles_of_ray_tracers_become_elevations():
    scene, up = tall(levels=False), np.arctan2(1.5, 2.0)
    column = lambda value: np.full((1, 2, 1), value)  # noqa: E731
    traced = TracedPaths(
        column(2.5 / SPEED_OF_LIGHT), column(0.1), column(-0.4), column(0.5 * np.pi + up),
        column(0.5 * np.pi - up), column(0.01),
    )  # fmt: skip
    table = plane_table(traced, scene, 0.0)
    assert table["aod_elevation_rad"]["A"][0, 0] == pytest.approx(-up)
    assert table["aoa_elevation_rad"]["A"][0, 0] == pytest.approx(up)
    assert "aoa_elevation_rad" not in plane_table(traced, tall(1, False), 0.0)


def test_layers_add_columns_and_leave_all_others_as_they_were():
    flat, high = (gs.simulate(tall(layers), "agent1", seed=3) for layers in (1, 5))
    assert set(high.columns) - set(flat.columns) == set(ELEVATIONS)
    for name, column in flat.columns.items():
        np.testing.assert_array_equal(column, high.columns[name])


@pytest.mark.slow
def test_simulated_elevations_are_as_rough_as_the_arrays_layers_leave_them():
    scene = tall(steps=60)
    paths, radio, gaps = true_paths(scene, "agent1"), scene.signal_model("agent1"), []
    clean = true_elevations(paths, scene, "agent1")
    for seed in range(12):
        measurements, cause = simulate_labelled(scene, "agent1", seed)
        rows, own = np.flatnonzero(cause >= 0), cause[cause >= 0]
        std = radio.elevation_std(paths.amplitude[own], paths.anchor[own], np.cos(clean[own, 1]))
        gaps.append((measurements.aoa_elevation_rad[rows] - clean[own, 1]) / std[:, 1])
        gaps.append((measurements.aod_elevation_rad[rows] - clean[own, 0]) / std[:, 0])
    assert np.concatenate(gaps).std() == pytest.approx(1.0, abs=0.02)


def test_tables_keep_elevations_and_refuse_what_cannot_be(tmp_path):
    measurements = gs.simulate(tall(reports_std=True, steps=5), "agent1", seed=1)
    assert set(OPTIONAL) <= set(measurements.columns)
    measurements.to_csv(tmp_path / "a.csv")
    measurements.to_h5(tmp_path / "a.h5")
    for back in (gs.Measurements.from_csv(tmp_path / "a.csv"), gs.Measurements.from_h5(tmp_path / "a.h5")):
        for name in OPTIONAL:
            np.testing.assert_allclose(back.columns[name], measurements.columns[name], rtol=1e-12)
    with pytest.raises(InputError, match=r"aoa_elevation_rad\[0\].*pi/2"):
        replace(measurements, aoa_elevation_rad=np.full(len(measurements.step), 2.0))
    scan = measurements.scan(2)
    with pytest.raises(InputError, match=r"aod_elevation_rad\[0\].*pi/2"):
        replace(scan, aod_elevation_rad=np.full(len(scan), -2.0)).checked(2)
    plain = replace(scan, **dict.fromkeys(OPTIONAL))
    assert len(list(plain.content())) == 8 < len(list(scan.content()))
    one, other = (replace(plain, **{name: np.full(len(scan), 0.1)}) for name in ELEVATIONS)
    start = Identity.of(np.zeros((2, 2)))
    assert len({str(start.after(each)) for each in (plain, one, other)}) == 3


def test_elevations_lower_the_bound_of_unknown_heights_and_touch_no_other():
    unsure = [unknown_map_bound(tall(n, height_std_m=0.3, steps=8), "agent1").position_m for n in (1, 40)]
    assert (unsure[1] < unsure[0]).all()
    planar = [unknown_map_bound(replace_layers(shortened(ROOM, 8), n), "agent1").position_m for n in (1, 40)]
    np.testing.assert_array_equal(*planar)


def test_planar_scenes_and_sampled_signals_know_no_layers():
    assert set(gs.simulate(replace_layers(ROOM, 5), "agent1", seed=1).columns).isdisjoint(ELEVATIONS)
    with pytest.raises(InputError, match=r"array.layers: found 3; allowed: 1"):
        gs.simulate(replace_layers(gs.Scene.load("screen"), 3), "agent1", seed=1, what="signal")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda v: -v, "counted downwards"),
        (lambda v: np.clip(0.5 * np.pi - v, -1.57, 1.57), "angles from the vertical"),
        (lambda v: v, None),
    ],
)
def test_check_names_elevations_that_are_none(tmp_path, spoil, words):
    scene = tall(levels=False, steps=60)
    measurements = gs.simulate(scene, "agent1", seed=1)
    replace(measurements, aoa_elevation_rad=spoil(measurements.aoa_elevation_rad)).to_csv(tmp_path / "a.csv")
    lines = [line for line in describe(tmp_path / "a.csv", scene) if line.startswith("suspect")]
    assert len(lines) == (words is not None)
    assert all("aoa_elevation_rad" in line and words in line for line in lines)


@pytest.mark.slow
def test_check_says_where_nothing_is_made_of_elevations(tmp_path):
    scene = tall(levels=False, steps=12)
    gs.simulate(scene, "agent1", seed=1).to_csv(tmp_path / "a.csv")
    notes = [line for line in describe(tmp_path / "a.csv", ROOM) if "elevation" in line and "note" in line]
    assert ["no heights" in line for line in notes] == [True, True]
    notes = describe(tmp_path / "a.csv", tall(1, False))
    assert sum("isn't used: it has no deviations" in line for line in notes) == 2
    (alone,) = [line for line in describe(tmp_path / "a.csv") if "elevation" in line and "note" in line]
    assert alone == (
        "note: aod_elevation_rad and aoa_elevation_rad: only --method grid and adaptive use them, "
        "in scenes with heights"
    )
