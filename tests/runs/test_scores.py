"""Scores of runs, and files of their steps."""

from dataclasses import fields, replace

import h5py
import numpy as np
import pytest
from run_samples import hall, some_estimate, some_run
from tiny import TINY

import gridslam as gs
from gridslam.cli.doubts import truth_notes
from gridslam.errors import InputError
from gridslam.estimates import Health
from gridslam.evaluation.bounds import known_map_bound
from gridslam.evaluation.ground_truth import heard_paths, tells_heading
from gridslam.runs.notes import lost_note
from gridslam.runs.step_files import read_steps, write_steps
from gridslam.simulation.image_source import ground_truth
from gridslam.systems.registry import maps_features


@pytest.fixture(scope="module")
def scene():
    return hall()


def test_score_without_truth_is_null_where_it_needs_truth(scene):
    scores = some_run(scene, "agent1").score(None)
    assert scores["surfaces_detected"] == 1
    assert scores["steps"] == len(scene.track("agent1"))
    known = {"surfaces_detected", "steps", "interrupted", "seconds_per_step", "peak_memory_mb", "map"}
    known |= {"health", "position_std_m", "heading_std_deg"}
    assert {key for key, value in scores.items() if value is not None} == known
    assert set(scores["map"].values()) == {None}


def test_score_against_the_truth(scene):
    scores = some_run(scene, "agent1", error=0.6).score(ground_truth(scene, "agent1"))
    for name in ("position_rmse_m", "position_p95_m", "final_position_error_m"):
        assert scores[name] == pytest.approx(0.6)
    assert scores["heading_rmse_deg"] == pytest.approx(0)
    assert scores["diverged"] is True
    assert (scores["surfaces_true"], scores["surfaces_detected"]) == (1, 1)
    assert scores["surface_ospa_m"] == pytest.approx(0, abs=1e-9)
    assert scores["map"]["occupied_recall"] == 1
    assert scores["map"]["free_precision"] == 1


def test_known_track_alone_scores_the_track_alone(scene):
    scores = some_run(scene, "agent1", error=0.1).score(scene.track("agent1"))
    assert scores["position_rmse_m"] == pytest.approx(0.1)
    assert scores["diverged"] is False
    assert scores["surfaces_true"] is None
    assert scores["map"]["auc"] is None


def test_squared_errors_are_in_units_of_what_was_claimed_and_of_nothing_claimed_there_are_none(scene):
    track = scene.track("agent1")
    claimed = np.tile(np.diag([0.01, 0.04, 1.0, 1.0, 1.0]), (len(track), 1, 1))
    run = replace(some_run(scene, "agent1", error=0.6), covariance=claimed)
    shift = run.trajectory.position_m[0] - track.position_m[0]
    want = shift[0] ** 2 / 0.01 + shift[1] ** 2 / 0.04
    scores = run.score(track)
    assert scores["position_nees"] == pytest.approx(want)
    assert scores["position_median_nees"] == pytest.approx(want)
    assert scores["silent_steps"] == 0
    sure = replace(run, covariance=0.01 * claimed)
    assert sure.score(track)["silent_steps"] == len(track), "off by 0.6 m, claims 2 cm, and is well"
    said = [replace(one, health=Health(ok=False, why="lost")) for one in run.estimates]
    assert replace(sure, estimates=said).score(track)["silent_steps"] == 0
    assert replace(run, covariance=0 * claimed).score(track)["position_nees"] is None


def test_truth_of_another_scene_is_refused(scene):
    run, own = some_run(scene, "agent1"), ground_truth(scene, "agent1")
    other = gs.ground_truth(gs.Scene.load("room"), "agent1")
    went = own.trajectory
    late = replace(went, time_s=went.time_s + 0.05)
    first = gs.Trajectory(went.time_s[:3], went.position_m[:3], went.velocity_mps[:3], went.heading_rad[:3])
    for truth, says in (
        (replace(other, trajectory=own.trajectory), rf"other walls \(4 pieces\) than those of {scene.name}"),
        (replace(own, trajectory=late), "steps at other times than the run's"),
        (replace(own, trajectory=first), "3 steps at other times"),
    ):
        for ask in (run.score, run.plot):
            with pytest.raises(InputError, match=says):
                ask(truth)
    assert run.score(own)["surfaces_true"] is not None


@pytest.mark.parametrize("ask", ["score", "plot"])
def test_earlier_truths_that_are_none_or_of_another_scene_are_refused(scene, ask):
    run, own = some_run(scene, "agent1"), ground_truth(scene, "agent1")
    other = gs.ground_truth(gs.Scene.load("room"), "agent1")
    for earlier, says in (
        (own, "earlier: found Truth;"),
        (3, "earlier: found int;"),
        ([own, run.map], r"earlier\[1\]: found Map;"),
        ([other], rf"earlier\[0\]: found other walls \(4 pieces\) than those of {scene.name}"),
    ):
        with pytest.raises(InputError, match=says):
            getattr(run, ask)(own, earlier)


def test_steps_read_back_equal_with_and_without_rows(tmp_path):
    written = [some_estimate(*sizes) for sizes in ((0, 0, 0), (1, 3, 2), (2, 0, 5), (3, 2, 0))]
    write_steps(tmp_path / "steps.h5", written)
    again = read_steps(tmp_path / "steps.h5")
    assert len(again) == 4
    for a, b in zip(written, again, strict=True):
        assert np.isnan(b.seconds)
        for name in ("step", "time_s", "position_m", "velocity_mps", "heading_rad", "covariance", "detected"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        for table in ("surfaces", "paths", "hypotheses", "rings"):
            for field in fields(getattr(a, table)):
                np.testing.assert_array_equal(
                    getattr(getattr(a, table), field.name), getattr(getattr(b, table), field.name)
                )
    write_steps(tmp_path / "none.h5", [])
    assert read_steps(tmp_path / "none.h5") == []


def test_steps_of_a_file_without_hypotheses_have_none(tmp_path):
    written = [some_estimate(1, 3, 1)]
    assert len(written[0].hypotheses)
    write_steps(tmp_path / "steps.h5", written)
    with h5py.File(tmp_path / "steps.h5", "a") as file:
        del file["hypotheses"]
    (again,) = read_steps(tmp_path / "steps.h5")
    assert not len(again.hypotheses)


def test_steps_of_a_file_without_owners_serve_all_anchors(tmp_path):
    written = [some_estimate(0, 3, 1)]
    assert (written[0].surfaces.owner >= 0).any()
    write_steps(tmp_path / "steps.h5", written)
    with h5py.File(tmp_path / "steps.h5", "a") as file:
        del file["surfaces/owner"]
    (again,) = read_steps(tmp_path / "steps.h5")
    assert again.surfaces.owner.tolist() == [-1, -1, -1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("surfaces/offset", [0, 3, 0, 3, 5]),
        ("paths/offset", [0, 0, 2, 7, 99]),
        ("hypotheses/offset", [0, 0, 9, 9, 9]),
        ("rings/offset", [0, 2, 1, 7, 7]),
        ("steps/time_s", [0.0, 1.0]),
    ],
)
def test_steps_that_contradict_themselves_are_refused(tmp_path, name, values):
    write_steps(
        tmp_path / "steps.h5",
        [some_estimate(*sizes) for sizes in ((0, 0, 0), (1, 3, 2), (2, 0, 5), (3, 2, 0))],
    )
    with h5py.File(tmp_path / "steps.h5", "a") as file:
        del file[name]
        file[name] = np.array(values)
    with pytest.raises(InputError, match=r"steps\.h5"):
        read_steps(tmp_path / "steps.h5")


def test_what_a_method_does_not_find_out_is_not_scored():
    """Features of a method that maps none, and a heading that recordings hold exactly."""
    assert [maps_features(name, "ab") for name in ("hybrid", "mine:Mine")] == [2, 2]
    assert [maps_features("los", ""), maps_features("grid", None)] == [None, None]
    assert maps_features("grid", "ab") is None, "paths that no surface explains"
    screen = gs.Scene.load("screen")
    assert not tells_heading(screen, "agent1", "signal")
    assert tells_heading(screen, "agent1", "paths")


def test_the_bound_leaves_out_steps_of_which_nothing_was_heard():
    """Of a table that had lost 50 steps the bound was that of the whole way, 1.65 cm beside 117."""
    scene = gs.Scene.from_toml(TINY, "tiny")
    truth, run = ground_truth(scene, "agent1"), some_run(scene, "agent1")
    steps = len(run.trajectory)
    late = tuple(range(steps // 2, steps))
    whole, silent = (replace(run, unheard=gone).score(truth)["position_bound_m"] for gone in ((), late))
    without = truth.paths.take(truth.paths.step < steps // 2)
    bound = known_map_bound(scene, "agent1", without).position_m
    assert silent == pytest.approx(np.sqrt((bound**2).mean()))
    assert silent > 1.05 * whole
    faint = scene.model_dump(exclude_none=True)
    faint["radio"]["snr_at_1m_db"] = 5.0
    faint = gs.Scene.checked(faint, scene.name)
    paths = ground_truth(faint, "agent1").paths
    assert heard_paths(faint, "agent1", paths, late) is paths, "their detection probability prices it in"


def test_steps_in_a_hole_of_the_true_track_are_not_scored_and_the_note_says_so(scene):
    track = scene.track("agent1")
    first, last = track.time_s[2], track.time_s[-2]
    gone = (track.time_s > first) & (track.time_s < last)
    holed = replace(track, holes_s=np.array([[first, last]]))
    run = some_run(scene, "agent1")
    run = replace(run, trajectory=replace(run.trajectory, position_m=track.position_m + 2.0 * gone[:, None]))
    assert run.score(track)["position_rmse_m"] > 1
    scores = run.score(holed)
    assert (scores["position_rmse_m"], scores["diverged"]) == (0, False)
    assert lost_note("agent1", run.trajectory, holed, run.estimates) is None
    heard = replace(gs.simulate(scene, "agent1", seed=1), truth=holed)
    said = f"agent1: the true track has no pose from {first:g} to {last:g} s: steps in between aren't scored"
    assert truth_notes(scene, [run], [heard]) == [said]
    twice = replace(heard, truth=replace(track, holes_s=np.array([[first, last], [first - 1.5, first]])))
    assert truth_notes(scene, [run], [twice])[0].count("and in 1 other hole:") == 1
    nothing = replace(track, holes_s=np.array([[-1.0, 1e9]]))
    assert run.score(nothing)["position_rmse_m"] is None
