"""The simulator as statistics: misses, noise, amplitudes and clutter follow their laws; walls hide."""

import numpy as np
import pytest
from scene_samples import shortened
from scipy import stats

import gridslam as gs
from gridslam.simulation.image_source import simulate_labelled, true_paths, visible
from gridslam.world.geometry import wrap

SEEDS = range(12)


@pytest.fixture(scope="module")
def scene():
    return gs.Scene.load("room")


@pytest.fixture(scope="module")
def paths(scene):
    return true_paths(scene, "agent1")


@pytest.fixture(scope="module")
def batch(scene):
    """Measurements of many seeds, and what caused each."""
    return [simulate_labelled(scene, "agent1", seed) for seed in SEEDS]


def caused(batch, column):
    return np.concatenate([getattr(measurements, column)[label >= 0] for measurements, label in batch])


@pytest.mark.slow
def test_paths_are_detected_as_often_as_their_amplitude_promises(scene, paths, batch):
    chance = scene.signal_model("agent1").detection_probability(paths.amplitude)
    count = np.zeros(len(paths))
    for _, label in batch:
        count[label[label >= 0]] += 1
    for low, high in ((0, 0.1), (0.1, 0.4), (0.4, 0.7), (0.7, 0.95), (0.95, 1.01)):
        rows = (chance >= low) & (chance < high)
        trials = rows.sum() * len(SEEDS)
        assert trials > 100
        spread = np.sqrt((chance[rows] * (1 - chance[rows])).sum() * len(SEEDS)) + 1e-9
        assert abs(count[rows].sum() - chance[rows].sum() * len(SEEDS)) < 4 * spread + 1


@pytest.mark.slow
def test_noise_is_normal_with_the_fisher_deviation(scene, paths, batch):
    signal = scene.signal_model("agent1")
    rows = np.concatenate([label[label >= 0] for _, label in batch])
    amplitude, anchor = paths.amplitude[rows], paths.anchor[rows]
    for column, std in (
        ("distance_m", signal.distance_std(amplitude)),
        ("aod_rad", signal.angle_std(amplitude, paths.aod_rad[rows], signal.anchor_aperture[anchor])),
        ("aoa_rad", signal.angle_std(amplitude, paths.aoa_rad[rows], signal.agent_aperture)),
    ):
        gap = caused(batch, column) - getattr(paths, column)[rows]
        gap = gap if column == "distance_m" else wrap(gap)
        narrow = std < 0.5  # a wider angle wraps
        normal = gap[narrow] / std[narrow]
        assert stats.kstest(normal, "norm").pvalue > 1e-4, column


def test_amplitudes_of_detections_are_rician_above_the_threshold(scene, paths, batch):
    signal = scene.signal_model("agent1")
    rows = np.concatenate([label[label >= 0] for _, label in batch])
    scale = signal.amplitude_std(paths.amplitude[rows])
    law = stats.rice(paths.amplitude[rows] / scale, scale=scale)
    floor = law.cdf(signal.threshold)
    share = (law.cdf(caused(batch, "amplitude")) - floor) / (1 - floor)
    assert stats.kstest(share[floor < 0.9], "uniform").pvalue > 1e-4
    assert caused(batch, "amplitude").min() > signal.threshold


def test_clutter_is_poisson_uniform_and_faint(scene, batch):
    signal = scene.signal_model("agent1")
    table = {c: [] for c in ("distance_m", "aod_rad", "aoa_rad", "amplitude", "step", "anchor")}
    for measurements, label in batch:
        for column, values in table.items():
            values.append(getattr(measurements, column)[label < 0])
    false = {c: np.concatenate(v) for c, v in table.items()}
    cells = len(scene.track("agent1")) * len(scene.anchors) * len(SEEDS)
    assert abs(len(false["step"]) - signal.false_alarms * cells) < 4 * np.sqrt(signal.false_alarms * cells)
    assert stats.kstest(false["distance_m"] / signal.max_distance_m, "uniform").pvalue > 1e-4
    for column in ("aod_rad", "aoa_rad"):
        assert stats.kstest(false[column] / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-4
    assert stats.kstest(false["amplitude"] ** 2 - signal.threshold**2, "expon").pvalue > 1e-4


def test_a_seed_repeats_and_another_differs(scene, batch):
    again, label = simulate_labelled(scene, "agent1", SEEDS[0])
    np.testing.assert_array_equal(again.distance_m, batch[0][0].distance_m)
    np.testing.assert_array_equal(label, batch[0][1])
    assert (
        len(again.distance_m) != len(batch[1][0].distance_m)
        or (again.distance_m != batch[1][0].distance_m).any()
    )


@pytest.mark.parametrize("name", ["room", "alcove"])
def test_every_leg_of_every_path_is_clear_and_reflects_at_the_mirror_angle(name):
    scene = gs.Scene.load(name)
    paths, walls = true_paths(scene, "agent1"), scene.segments()
    start, end, _ = paths.legs
    assert visible(start + 1e-6 * (end - start), end - 1e-6 * (end - start), walls).all()
    single = np.flatnonzero(paths.bounces == 1)
    line = walls.line[paths.segment[single, 0]]
    normal = np.stack([np.cos(line[:, 0]), np.sin(line[:, 0])], -1)
    arms = [paths.points[single, k] - paths.points[single, 1] for k in (0, 3)]
    cosines = [(arm * normal).sum(1) / np.linalg.norm(arm, axis=1) for arm in arms]
    np.testing.assert_allclose(*cosines, atol=1e-9)


DOOR = """
name = "door"
[grid]
x_m = [-1.0, 5.0]
y_m = [-1.0, 5.0]
[materials]
brick = 0.6
[[anchors]]
name = "A"
position_m = [1.0, 2.0]
[[walls]]
material = "brick"
points_m = [[2.0, 0.0], [2.0, {low}]]
[[walls]]
material = "brick"
points_m = [[2.0, {high}], [2.0, 4.0]]
[[agents]]
name = "a"
start_m = [3.0, 2.0]
waypoints_m = [[3.2, 2.0]]
step_m = 0.05
"""


@pytest.mark.parametrize(("low", "high", "open_"), [(1.5, 2.5, True), (2.2, 2.5, False)])
def test_a_door_is_a_gap_that_lets_paths_through(low, high, open_):
    scene = gs.Scene.from_toml(DOOR.format(low=low, high=high))
    paths = true_paths(scene, "a")
    assert (len(paths) > 0) == open_
    assert not (paths.bounces > 0).any()


def test_a_lone_antenna_measures_no_angle_and_is_no_error():
    text = DOOR.format(low=1.5, high=2.5) + "[agents.array]\nrows = 1\ncolumns = 1\n"
    scene = gs.Scene.from_toml(text)
    measurements = gs.simulate(scene, "a", 1)
    assert np.isnan(measurements.aoa_rad).all()
    assert np.isfinite(measurements.aod_rad).all()
    assert np.isfinite(gs.map_scene(scene, measurements, seed=1, particles=500).trajectory.position_m).all()


@pytest.mark.parametrize(("name", "angles"), [("screen", ["aod_rad"]), ("overlap", ["aod_rad", "aoa_rad"])])
def test_an_angle_that_no_array_measures_is_missing_of_clutter_too(name, angles):
    """In `screen` one antenna at the anchor measures no departure: 17 rows had one, all of them clutter."""
    scene = shortened(gs.Scene.load(name), 60)
    measurements, cause = simulate_labelled(scene, scene.agents[0].name, 1)
    assert (cause < 0).any()
    for angle in ("aod_rad", "aoa_rad"):
        assert np.isnan(getattr(measurements, angle)).all() == (angle in angles)


def test_the_only_agent_needs_no_name_and_several_are_listed(scene):
    assert scene.agents[0].name == "agent1"
    named, unnamed = gs.simulate(scene, "agent1", 1), gs.simulate(scene, seed=1)
    np.testing.assert_array_equal(unnamed.distance_m, named.distance_m)
    assert len(gs.ground_truth(scene).trajectory) == len(gs.ground_truth(scene, "agent1").trajectory)
    recording = gs.simulate(shortened(gs.Scene.load("overlap"), 2), what="signal")
    assert len(recording) == 2
    canyon = gs.Scene.load("canyon")
    for call in (gs.simulate, gs.ground_truth):
        with pytest.raises(
            gs.InputError, match="agent: found none named, of several; allowed: 'agent1', 'ag"
        ):
            call(canyon)
    nobody = canyon.model_copy(update={"agents": ()})
    with pytest.raises(gs.InputError, match="agent: found none in scene canyon; allowed: a scene with"):
        gs.simulate(nobody)
