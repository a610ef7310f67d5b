"""One mapping run: progress, particles, frames, and what a run is judged against."""

import io

import numpy as np
import pytest
from rich.console import Console
from scene_samples import short, shortened

import gridslam as gs
from gridslam.evaluation.ground_truth import inherited_truth, known_bound, truth_of, with_truth
from gridslam.maps.frames import fitted, stamped
from gridslam.runs.progress import progress_bar
from gridslam.runs.steps import Steps, run_steps
from gridslam.world.trajectory import Trajectory

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
STEPS = 4


@pytest.fixture(scope="module")
def scene():
    return shortened(gs.Scene.load("room"), STEPS, agents=2)


@pytest.fixture(scope="module")
def measurements(scene):
    return gs.simulate(scene, "agent1", 1)


@pytest.fixture(scope="module")
def run(scene, measurements):
    return gs.map_scene(scene, measurements, seed=1, particles=300)


def shown(truth, run, terminal=True):
    console = Console(file=io.StringIO(), force_terminal=terminal, width=140, color_system=None)
    with progress_bar("agent1", truth, console) as tell:
        for done, estimate in enumerate(run.estimates, 1):
            tell(estimate, done, STEPS)
    return console.file.getvalue()


def test_bar_shows_steps_rate_error_and_surfaces(measurements, run):
    text = shown(measurements.truth, run)
    assert f"{STEPS}/{STEPS}" in text
    assert "steps/s" in text
    assert f"{run.estimates[-1].detected.sum()} surfaces" in text
    rmse = np.sqrt(((run.trajectory.position_m - measurements.truth.position_m) ** 2).sum(1).mean())
    assert f"error {100 * rmse:.1f} cm" in text


def test_bar_knows_no_error_without_truth_and_shows_nothing_in_a_file(measurements, run):
    assert "error" not in shown(None, run)
    assert shown(measurements.truth, run, terminal=False) == ""


def test_progress_is_a_bar_on_terminals_alone_or_whatever_is_called(scene, measurements, run, capsys):
    progress = []
    again = gs.map_scene(
        scene,
        measurements,
        seed=1,
        particles=300,
        progress=lambda *state: progress.append((state[0].step, *state[1:])),
    )
    assert progress == [(step, step + 1, STEPS) for step in range(STEPS)]
    quiet = gs.map_scene(scene, measurements, seed=1, particles=300, progress=True)
    assert capsys.readouterr() == ("", "")
    for other in (again, quiet):
        np.testing.assert_array_equal(other.trajectory.position_m, run.trajectory.position_m)


def test_particles_replace_those_of_the_scene(scene, measurements, run):
    assert run.scene.filter.particles == 300
    assert scene.filter.particles != 300
    with pytest.raises(gs.InputError, match="particles"):
        gs.map_scene(scene, measurements, particles=0)


def test_what_is_no_scene_or_truth_is_refused(measurements, run):
    with pytest.raises(gs.InputError, match=r"scene: found str; allowed: a Scene"):
        gs.map_scene("room", measurements)
    for use in (run.plot, run.score):
        with pytest.raises(gs.InputError, match=r"truth: found str; allowed: a Truth"):
            use("hall")


def test_unknown_method_names_the_known_ones(scene, measurements):
    with pytest.raises(gs.InputError, match=r"'magic'; allowed: .*grid"):
        gs.map_scene(scene, measurements, method="magic")


def test_measurements_of_one_agent_and_of_several_each_have_their_door(measurements):
    scene = gs.Scene.load("exchange")
    with pytest.raises(gs.InputError, match=r"map_scene"):
        gs.map_network(scene, measurements)
    several = gs.simulate(shortened(scene, 2, agents=2), ["agent1", "agent2"])
    with pytest.raises(gs.InputError, match=r"map_network"):
        gs.map_scene(scene, several)


def test_method_without_cells_has_no_map_scores(scene, measurements):
    run = gs.map_scene(scene, measurements, method="adaptive", particles=300)
    score = run.score(gs.ground_truth(scene, "agent1"))
    assert score["surfaces_true"] == 4
    assert set(score["map"].values()) == {None}


def test_map_says_in_which_frame_it_is(scene, run):
    assert run.map.provenance["anchors"] == ["A", "B"]
    same, note = fitted(run.map, scene)
    assert (same, note) == (run.map, None)
    moved = scene.model_dump(exclude_none=True)
    moved["anchors"][0]["position_m"] = (-3.0, 2.2)
    with pytest.raises(gs.InputError, match=r"anchor 'A' at \(-3.1, 2.2\) m"):
        fitted(run.map, gs.Scene.checked(moved, "moved"))
    with pytest.raises(gs.InputError, match="frame"):
        gs.fuse([run.map, stamped(run.map, gs.Scene.checked(moved, "moved"))])


def test_map_whose_frame_cannot_be_told_needs_the_users_word(scene, run):
    named = {key: value for key, value in run.map.provenance.items() if not key.startswith("anchor")}
    blank = gs.Map.blank((-1.0, -1.0), 0.1, (5, 6), run.map.prior)
    for provenance in (
        {},
        named,
        {"anchors": ["Z"], "anchor_x_m": [9.0], "anchor_y_m": [9.0]},
        {"anchors": 3},
    ):
        blank.provenance.clear()
        blank.provenance.update(provenance)
        with pytest.raises(gs.InputError, match=r"m.h5: frame.*--same-frame"):
            fitted(blank, scene, "m.h5")
        sheet, note = fitted(blank, scene, "m.h5", same_frame=True)
        assert sheet.shape == scene.grid.shape
        assert note.startswith("m.h5: 6 x 5 cells of 0.1 m resampled")
        assert fitted(sheet, scene) == (sheet, None)  # the word holds from then on


def test_frame_that_has_a_name_is_known_by_it(scene, run):
    def other(frame, anchors="radio {}"):
        data = scene.model_dump(exclude_none=True)
        data["anchors"] = [{**a, "name": anchors.format(a["name"])} for a in data["anchors"]]
        return gs.Scene.checked({**data, "frame": frame} if frame else data, "other")

    second = other("second floor")
    found = stamped(run.map, second)
    assert found.provenance["frame"] == "second floor"
    assert fitted(found, other("second floor", "lamp {}"))[1] is None
    with pytest.raises(gs.InputError, match="found frame second floor; allowed: frame first floor"):
        fitted(found, other("first floor"))
    with pytest.raises(gs.InputError, match="none of those of"):
        fitted(run.map, second)
    measurements = gs.Measurements.from_arrays({a: [[3.0]] for a in second.anchor_names})
    with pytest.raises(gs.InputError, match="frame"):
        gs.map_scene(second, measurements, prior_map=run.map)
    done = gs.map_scene(second, measurements, prior_map=run.map, same_frame=True)
    assert done.map.provenance["agents"] == ["agent1", "agent1"]
    assert gs.GridSlam(second, prior_map=run.map, same_frame=True).provenance["agents"] == ["agent1"]
    assert gs.Scene.from_toml(second.to_toml(), "again").frame == "second floor"


def test_inherited_surfaces_are_no_ghosts(scene, run):
    """A wall that only the earlier agent could hear of counts as true, and its cells as hit."""
    own, earlier = (gs.ground_truth(scene, name) for name in ("agent1", "agent2"))
    blind = gs.Truth(own.trajectory, own.paths.take(own.paths.bounces == 0), own.segments)
    alone, joined = run.score(blind), run.score(blind, [earlier])
    assert alone["surfaces_true"] == 0
    assert joined["surfaces_true"] == 4
    assert joined["surface_ospa_m"] < alone["surface_ospa_m"]
    assert alone["map"]["occupied_recall"] is None or joined["map"] != alone["map"]
    assert joined["position_rmse_m"] == alone["position_rmse_m"]


def test_map_tells_whose_truth_it_holds(scene, run):
    (found,) = inherited_truth(scene, run.map)
    np.testing.assert_array_equal(found.paths.points, gs.ground_truth(scene, "agent1").paths.points)
    assert inherited_truth(scene, run.map, latest=False) == []
    assert inherited_truth(scene, gs.Map.blank((0, 0), 0.1, (4, 4), 0.01)) == []


def test_recorded_track_is_interpolated_to_the_steps(measurements):
    def way(time):  # straight, and turning through pi
        place, speed = np.outer(time, [0.3, -0.2]), np.tile([0.3, -0.2], (len(time), 1))
        return Trajectory(time, place, speed, 3.0 + 0.1 * time)

    found = with_truth(measurements, way(np.linspace(-0.3, STEPS - 0.7, 8)), "x.tum").truth
    expected = way(np.arange(STEPS, dtype=float))
    for name in ("time_s", "position_m", "velocity_mps", "heading_rad"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
    with pytest.raises(gs.InputError, match=r"x.tum.*-0.3 to 2.5 s.*0 to 3 s"):
        with_truth(measurements, way(np.linspace(-0.3, 2.5, 8)), "x.tum")


def test_bound_is_of_the_scenes_own_way_alone(scene, measurements):
    own = truth_of(scene, "agent1", measurements.truth)
    assert known_bound(scene, "agent1", own).position_m.shape == (STEPS,)
    elsewhere = Trajectory(
        measurements.truth.time_s,
        measurements.truth.position_m + 0.1,
        measurements.truth.velocity_mps,
        measurements.truth.heading_rad,
    )
    assert known_bound(scene, "agent1", truth_of(scene, "agent1", elsewhere)) is None
    assert known_bound(scene, "agent1", measurements.truth) is None
    assert known_bound(scene, "agent1", None) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["screen", "overlap"])
def test_samples_have_a_bound_of_their_own_with_and_without_the_map(name):
    scene = short(name, 15)
    truth = gs.ground_truth(scene, "agent1")
    own, paths = (known_bound(scene, "agent1", truth, takes) for takes in ("signal", "paths"))
    assert not np.allclose(own.position_m, paths.position_m, rtol=0.01)
    assert np.isfinite(own.position_m).all()


def test_time_of_a_step_is_that_of_most_steps_not_of_those_that_compile(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("gridslam.runs.steps.time.perf_counter", lambda: clock[0])

    def step(scan):
        clock[0] += 9.0 if scan < 2 else 0.5
        return scan

    done = run_steps(step, None, range(9), Steps(), None, None, None)
    assert sum(done.seconds) == 21.5
    assert done.seconds_per_step == 0.5
