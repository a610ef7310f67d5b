"""Direct grid SLAM where no line of sight is heard at first, and where posts scatter."""

import numpy as np
import pytest

import gridslam as gs

STEPS = 12
ROOM = """
name = "behind a shelf"
[radio]
frequencies = 49
frequency_step_hz = 12.5e6
snr_at_1m_db = 36.0
array = { rows = 3, columns = 3, spacing_wavelengths = 0.4 }
[grid]
x_m = [-1.0, 7.0]
y_m = [-1.0, 5.0]
[materials]
concrete = 0.7
metal = 0.95
[[anchors]]
name = "A"
position_m = [5.1, 1.7]
orientation_deg = 57.9
[[anchors]]
name = "B"
position_m = [4.6, 1.75]
orientation_deg = -82.5
[[walls]]
material = "metal"
points_m = [[0.0, 0.0], [5.8, 0.0], [5.8, 4.0], [0.0, 4.0], [0.0, 0.0]]
[[walls]]
material = "concrete"
points_m = [[1.5, 0.8], [1.5, 1.85]]
[[walls]]
material = "concrete"
points_m = [[2.5, 2.0], [3.4, 2.0]]
[[agents]]
name = "agent1"
start_m = [0.8, 1.3]
start_heading_deg = 57.5
waypoints_m = [[2.2, 3.5], [4.5, 1.25]]
step_m = 0.02
steps = 12
[filter]
particles = 500
"""


def off_and_sure(scene, run):
    error = run.trajectory.position_m[:, :2] - scene.track("agent1").position_m[:, :2]
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(run.covariance[:, :2, :2]), error)
    return np.hypot(*error.T), squares


@pytest.mark.slow
def test_double_bounces_over_corners_do_not_lead_a_hidden_agent_astray():
    """Born as walls at the first scan, they led it 1 to 2 m off, sure of itself, in seven of eight seeds."""
    scene, wrong = gs.Scene.from_toml(ROOM, "room"), 0
    for seed in range(2):
        heard = gs.simulate(scene, "agent1", seed, what="signal")
        run = gs.map_scene(scene, heard, method="direct_grid", seed=seed, start="exact")
        off, squares = off_and_sure(scene, run)
        wrong += int(((squares > 16) & (off > 0.3)).sum())
        assert off[-1] < 0.2
    assert wrong == 0


@pytest.mark.slow
def test_new_paths_that_wait_are_kept_and_survive_a_checkpoint(tmp_path):
    scene = gs.Scene.from_toml(ROOM, "room")
    heard = gs.simulate(scene, "agent1", 1, what="signal")
    slam = gs.DirectGridSlam(scene, waveform=heard.waveform)
    track = scene.track("agent1")
    slam.start_at(track.position_m[0], float(track.heading_rad[0]))
    estimate = [slam.step(heard.scan(number)) for number in range(3)][-1]
    left = slam.state.leftovers
    assert len(left) > 0
    assert len(left.pose) == 3
    assert np.isfinite(left.value).all()
    assert set(left.anchor.tolist()) == {0, 1}
    # what bore a surface isn't kept: no leftover of the latest step lies where a sure path does
    paths = estimate.paths
    sure = np.column_stack([paths.anchor, paths.distance_m])[paths.existence > 0.9]
    latest = left.back == 0
    for anchor, length in zip(left.anchor[latest], left.value[latest, 0], strict=True):
        assert np.abs(sure[sure[:, 0] == anchor, 1] - length).min(initial=9.0) > 0.05
    slam.save(tmp_path / "a.h5")
    again = gs.DirectGridSlam.resume(tmp_path / "a.h5")
    np.testing.assert_array_equal(again.state.leftovers.value, left.value)
    one, other = slam.step(heard.scan(3)), again.step(heard.scan(3))
    np.testing.assert_array_equal(one.covariance, other.covariance)


@pytest.mark.slow
def test_a_post_is_not_shown_as_a_wall_and_walls_are():
    data, post = gs.Scene.load("chamber").model_dump(exclude_none=True), [-0.2, -0.2]
    data["agents"][0]["steps"], data["radio"]["snr_at_1m_db"] = 60, 42.0
    data["scatterers"] = [{"position_m": post, "size_m": 0.4}]
    scene = gs.Scene.checked(data, "chamber")
    run = gs.map_scene(
        scene, gs.simulate(scene, "agent1", 5, what="signal"), method="direct_grid", start="exact"
    )
    last = run.estimates[-1].surfaces
    normal = np.stack([np.cos(last.line[:, 0]), np.sin(last.line[:, 0])], 1)
    through = np.abs(last.line[:, 1] - normal @ post) < 0.1
    assert through.sum() >= 2
    assert last.existence[through].max() < 0.5
    assert (last.existence[~through] > 0.9).sum() >= 4
