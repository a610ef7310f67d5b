"""Agents of which nothing was heard for long: found again, and sound, however long it was."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs

PAUSE_AT, FIRST_LEFT_OUT = 12, 10


def after_a_pause(make, recording, truth, pause_s, steps=20):
    """Errors and claims (m) from the pause on, in which an agent stood still, health, and the filter."""
    slam, rows, well = make(), [], []
    for number, scan in enumerate(recording):
        if number >= steps or FIRST_LEFT_OUT <= number < PAUSE_AT:
            continue
        late = pause_s if number >= PAUSE_AT else 0.0
        estimate = slam.step(replace(scan, time_s=scan.time_s + late))
        if number >= PAUSE_AT:
            well.append(estimate.health.ok)
            error = np.hypot(*(estimate.position_m[:2] - truth.position_m[number, :2]))
            rows.append([error, np.sqrt(np.trace(estimate.covariance[:2, :2]))])
    return np.array(rows), np.array(well), slam


@pytest.mark.parametrize("pause_s", [30.0, 1.8e9])
@pytest.mark.parametrize("name", ["GridSlam", "VirtualAnchorSlam", "NetworkSlam"])
def test_it_is_found_at_once_by_what_it_has_mapped(name, pause_s, tmp_path):
    scene = gs.Scene.load("room").with_filter(particles=300)
    heard, method = gs.simulate(scene, "agent1", 2), getattr(gs, name)
    rows, _, slam = after_a_pause(lambda: method(scene, seed=2), heard, scene.track("agent1"), pause_s)
    assert rows[1:, 0].max() < 0.1
    assert (rows[:, 0] < 4 * rows[:, 1]).all()
    slam.save(tmp_path / "state.h5")  # what can be written can be read
    method.resume(tmp_path / "state.h5")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "pause_s", "steps"), [(2, 60.0, 13), (3, 1.8e9, 13)])
def test_by_samples_of_single_antennas_it_is_looked_for_and_health_says_so(seed, pause_s, steps, tmp_path):
    """Minutes leave no more of where it is than decades do: it is searched for as at the first step."""
    scene = gs.Scene.load("overlap")
    heard = gs.simulate(scene, "agent1", seed, what="signal")
    rows, well, slam = after_a_pause(
        lambda: gs.DirectSlam(scene, waveform=heard.waveform), heard, scene.track("agent1"), pause_s, steps
    )
    side = np.array([scene.grid.x_m, scene.grid.y_m])
    assert rows[:, 0].max() < np.hypot(*np.ptp(side, axis=1))  # in the region; before, 70 m off
    wrong = (rows[:, 0] > 0.5) & (rows[:, 0] > 4 * rows[:, 1])
    assert not (wrong & well).any()
    slam.save(tmp_path / "state.h5")
    gs.DirectSlam.resume(tmp_path / "state.h5")
