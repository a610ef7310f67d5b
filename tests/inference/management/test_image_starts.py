"""Starts known badly, of one antenna: every place is tried, wrong ones go, and what remains is said."""

from dataclasses import replace

import numpy as np
import pytest
from delay_snapshots import BAND, received

import gridslam as gs
from gridslam.errors import InputError
from gridslam.inference.management.samples.image_starts import (
    begun,
    find_peaks,
    find_places,
    is_one,
)
from gridslam.inference.state.population import Population
from gridslam.inference.state.samples.images import DirectState
from gridslam.world.signal_scan import SignalScan


def scene_of(half_m, steps=12):
    """`overlap`, with a start known to so many metres either way."""
    data = gs.Scene.load("overlap").model_dump(exclude_none=True)
    data["agents"][0]["steps"], data["agents"][0]["prior"]["position_m"] = steps, half_m
    return gs.Scene.checked(data, "overlap")


def slam_of(recording, half_m, start):
    """Direct SLAM that is told such a start."""
    slam = gs.DirectSlam(scene_of(half_m), waveform=recording.waveform)
    slam.start_at(np.asarray(start), 0.0)
    return slam


def recording_of(seed, steps=12):
    return gs.simulate(scene_of(0.1, steps), "agent1", seed=seed, what="signal")


def state_at(x, y, spread=0.1):
    return DirectState.start(np.array([x, y, 0.0, 0.0]), np.full(4, spread**2), 2)


def test_a_start_within_a_cell_is_taken_as_it_is():
    assert not begun(state_at(1, 1), BAND).searching
    assert begun(state_at(1, 1, spread=1.7), BAND).searching


def test_lengths_of_paths_are_found_one_by_one():
    """Amplitudes 30, 10 and 6 over noise of 1; 2.2 m is less than three c/B from the strongest."""
    rng = np.random.default_rng(2)
    samples = received(rng, [4.0, 6.2, 11.0], [30, 10j, -6])
    found = np.sort(find_peaks(BAND, samples, 1.0))
    assert all(np.abs(found - true).min() < 0.1 for true in (4.0, 6.2, 11.0))
    assert len(find_peaks(BAND, samples / 1e3, 1.0)) == 0


def test_the_true_place_is_among_those_that_are_tried():
    recording = recording_of(7, 3)
    slam = slam_of(recording, 3.0, [3.0, 3.0])
    places = find_places(slam.state, recording.scan(0), slam.model, BAND)
    away = np.linalg.norm(places - recording.truth.position_m[0], axis=1)
    assert away.min() < 0.3
    low, high = np.transpose([slam.scene.grid.x_m, slam.scene.grid.y_m])
    assert ((places >= low) & (places <= high)).all()


@pytest.mark.slow
def test_a_start_known_to_3_m_is_found_and_never_wrong_without_a_word():
    recording = recording_of(6, 2)
    truth = recording.truth.position_m
    slam = slam_of(recording, 3.0, truth[0] + [1.5, 2.0])
    for scan in recording:
        estimate = slam.step(scan)
        wrong = np.linalg.norm(estimate.position_m - truth[scan.step]) > 0.5
        assert not (wrong and estimate.health.ok)
        if scan.step == 0:
            assert "places remain" in estimate.health.why
            assert len(estimate.hypotheses) > 1
            assert estimate.hypotheses.weight.sum() == pytest.approx(1)
    best = min(np.linalg.norm(s.belief.mean[:2] - truth[-1]) for s in slam.population.states)
    assert best < 0.15


@pytest.mark.slow
def test_of_a_mirrored_world_both_places_remain(tmp_path):
    """Distances to two anchors say nothing of the side of the line through them."""
    recording = recording_of(3, 2)
    slam = slam_of(recording, 4.0, [4.0, 4.0])
    estimates = [slam.step(scan) for scan in recording]
    a, b = slam.scene.anchor_positions
    along = (b - a) / np.linalg.norm(b - a)
    true = recording.truth.position_m[-1]
    mirrored = 2 * (a + along * (along @ (true - a))) - true
    for place in (true, mirrored):
        assert np.linalg.norm(estimates[-1].hypotheses.position_m - place, axis=1).min() < 0.3
    assert "places remain" in estimates[-1].health.why
    slam.save(tmp_path / "two.h5")
    again = gs.DirectSlam.resume(tmp_path / "two.h5")
    assert again.population.log_weight == slam.population.log_weight
    np.testing.assert_array_equal(
        again.population.states[1].belief.mean, slam.population.states[1].belief.mean
    )


@pytest.mark.slow
def test_nothing_heard_is_said_and_searched_for_later():
    recording = recording_of(1, 2)
    slam = slam_of(recording, 3.0, [2.0, 1.6])
    scan = recording.scan(0)
    silent = SignalScan(0, scan.time_s, scan.samples, np.zeros(2, bool))
    assert slam.step(silent).health.why.startswith("start not found yet")
    assert slam.population.searching
    population = slam.population
    slam.step(recording.scan(1))
    assert population.searching
    assert not slam.population.searching
    assert len(slam.population) > 1


def test_hypotheses_are_one_where_agent_and_images_are():
    here = state_at(1.0, 1.0)
    assert is_one(here, state_at(1.05, 1.0))
    assert not is_one(here, state_at(2.0, 1.0))


def test_weights_of_a_file_that_cannot_be_are_refused():
    slam = gs.DirectSlam(scene_of(0.1, 3))
    broken = replace(Population.of(slam.state), log_weight=(-1.0,))
    with pytest.raises(InputError, match="log_weight"):
        slam.require_sound(broken, slam.model, "file")
