"""Grid SLAM on `room`, and the command line end to end."""

import json
import subprocess
import sys
from dataclasses import replace

import h5py
import numpy as np
import pytest
from scene_samples import ENOUGH, shortened

import gridslam as gs
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.evaluation.bounds import known_map_bound
from gridslam.inference.scans.anchor_measurements import anchor_scans
from gridslam.io import files
from gridslam.kernels.primitives import taichi_inside
from gridslam.systems import values
from gridslam.systems.registry import METHODS, method_class

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
SEEDS = (1, 2, 3)


@pytest.fixture(scope="module")
def runs():
    scene = gs.Scene.load("room").with_filter(particles=ENOUGH)
    return [gs.map_scene(scene, gs.simulate(scene, "agent1", s), seed=s) for s in SEEDS]


@pytest.mark.slow
def test_every_seed_converges_and_reaches_the_known_map_bound(runs):
    scene = gs.Scene.load("room")
    bound, track = known_map_bound(scene, "agent1"), scene.track("agent1")
    limit = np.sqrt((bound.position_m[30:] ** 2).mean())
    for run in runs:
        error = np.linalg.norm(run.trajectory.position_m - track.position_m, axis=1)
        assert error[10:].max() < 0.5
        assert np.sqrt((error[30:] ** 2).mean()) < 1.25 * limit


@pytest.mark.slow
def test_the_covariance_is_consistent_over_the_seeds(runs):
    track = gs.Scene.load("room").track("agent1")
    nees = []
    for run in runs:
        gap = run.trajectory.position_m - track.position_m
        nees.append(np.einsum("ni,nij,nj->n", gap, np.linalg.inv(run.covariance[:, :2, :2]), gap)[30:])
    # 2 degrees of freedom; some 15 independent stretches per run: mean 2, standard error 2 / sqrt(45)
    assert 1.1 < np.mean(nees) < 2.9


@pytest.mark.slow
def test_four_walls_are_found_and_the_map_is_right(runs):
    truth = gs.ground_truth(gs.Scene.load("room"), "agent1")
    scores = [run.score(truth) for run in runs]
    assert sum(s["surfaces_detected"] == 4 for s in scores) >= 2
    for score in scores:
        assert score["map"]["occupied_recall"] > 0.9
        assert score["map"]["occupied_precision"] > 0.95
        assert score["map"]["free_recall"] > 0.98


@pytest.mark.slow
def test_the_next_agent_uses_the_map_from_its_first_step(runs):
    scene = gs.Scene.load("room")
    slam = gs.GridSlam(scene, prior_map=runs[0].map, seed=9)
    estimate = slam.step(next(iter(gs.simulate(scene, "agent1", 9))))
    assert estimate.detected.sum() >= len(runs[0].surfaces)
    assert (slam.map().observed >= runs[0].map.observed).all()


@pytest.mark.slow
def test_silence_neither_kills_surfaces_nor_gives_nan(runs):
    scene = gs.Scene.load("room")
    slam = gs.GridSlam(scene, prior_map=runs[0].map, seed=9)
    none = np.zeros(0)
    first = gs.Scan(0, 0.0, np.zeros(0, np.intp), none, none, none, none)
    assert np.isfinite(slam.step(first).position_m).all()


def test_a_resumed_filter_goes_on_bit_for_bit(tmp_path):
    scene = gs.Scene.load("room")
    scans = list(gs.simulate(scene, "agent1", 4))[:8]
    slam = gs.GridSlam(scene, seed=4)
    for scan in scans[:5]:
        slam.step(scan)
    slam.save(tmp_path / "checkpoint.h5")
    again = gs.GridSlam.resume(tmp_path / "checkpoint.h5")
    for scan in scans[5:]:
        one, two = slam.step(scan), again.step(scan)
        np.testing.assert_array_equal(one.covariance, two.covariance)
        np.testing.assert_array_equal(one.position_m, two.position_m)
    np.testing.assert_array_equal(slam.map().evidence, again.map().evidence)


def test_a_foreign_checkpoint_is_refused(tmp_path):
    (tmp_path / "no.h5").write_text("not HDF5")
    with pytest.raises(gs.InputError):
        gs.GridSlam.resume(tmp_path / "no.h5")


@pytest.fixture(scope="module")
def three_steps_on():
    """A filter that is written, and not stepped on."""
    scene = shortened(gs.Scene.load("room"), 3)
    slam = gs.GridSlam(scene, seed=4)
    for scan in gs.simulate(scene, "agent1", 4):
        slam.step(scan)
    return slam


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("surfaces/existence", (200,)),
        ("surfaces/single", (1, 2)),
        ("belief/mean", (6,)),
        ("calibration/turn", (7,)),
    ],
)
def test_a_checkpoint_whose_parts_do_not_fit_is_refused(tmp_path, three_steps_on, name, shape):
    put = files.put

    def spoiled(group, own, value, units):
        found = f"{group.name.strip('/')}/{own}"
        put(group, own, np.ones(shape) if found == f"believed/states/0/{name}" else value, units)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(values, "put", spoiled)
        three_steps_on.save(tmp_path / "checkpoint.h5")
    with pytest.raises(gs.InputError, match=name.split("/")[1]):
        gs.GridSlam.resume(tmp_path / "checkpoint.h5")


@pytest.mark.parametrize(
    ("name", "place", "value"),
    [
        ("ranges/information", (0, 0), -250.0),
        ("ranges/information", (0, 1), 0.5),
        ("sights/sums", (0, 0, 1, 1), -1.0),
        ("states/0/surfaces/extent", (0, 1), np.nan),
        ("states/0/surfaces/outermost", (0, 1), np.nan),
    ],
)
@pytest.mark.slow
def test_a_checkpoint_whose_numbers_cannot_be_is_refused(tmp_path, three_steps_on, name, place, value):
    three_steps_on.save(tmp_path / "checkpoint.h5")
    gs.GridSlam.resume(tmp_path / "checkpoint.h5")
    with h5py.File(tmp_path / "checkpoint.h5", "a") as file:
        file[f"believed/{name}"][place] = value
    with pytest.raises(gs.InputError, match=f"{name}: found numbers that can't be"):
        gs.GridSlam.resume(tmp_path / "checkpoint.h5")


def test_rows_of_anchors_that_the_scene_lacks_are_passed_over():
    scan = gs.Scan(0, 0.0, np.array([1, 7, -1, 0]), *(np.arange(4.0) + n for n in range(4)))
    each_scan = anchor_scans(scan, np.zeros((2, 4)))
    assert [h.amplitude.tolist() for h in each_scan] == [[6.0], [3.0]]
    none = np.zeros(0)
    assert [len(h) for h in anchor_scans(gs.Scan(0, 0.0, *[none] * 5), np.zeros((2, 4)))] == [
        0,
        0,
    ]


@pytest.mark.slow
def test_the_command_line_maps_room_and_repeats_bit_for_bit(say, tmp_path):
    """In a process of its own, with other threads: all files of the run are compared, so few steps do."""
    (tmp_path / "short.toml").write_text(shortened(gs.Scene.load("room"), 6).to_toml())
    words = ["run", "short.toml", "-o"]
    assert say(*words, "here").code == 0
    threads = "1" if taichi_inside.threads() > 1 else "3"
    command = [sys.executable, "-c", "from gridslam.cli.main import main; main()"]
    done = subprocess.run(
        [*command, *words, "there", "--threads", threads], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "agent1" in done.stdout
    found = []
    for folder in (tmp_path / "here", tmp_path / "there"):
        files = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        summary = json.loads(files.pop("run.json"))
        for key in ("seconds_per_step", "peak_memory_mb"):
            summary["agents"]["agent1"].pop(key)
        found.append((summary, files))
    (one, ours), (two, theirs) = found
    assert one == two
    assert ours.keys() == theirs.keys() > {"map.h5", "agent1/steps.h5", "agent1/trajectory.tum"}
    assert [name for name in ours if ours[name] != theirs[name]] == []
    assert len(ours["figures/agent1-map.png"]) > 10_000


WORDS = (
    ["run", "nowhere"],
    ["run", "room", "--particle", "3"],
    ["check", "missing.toml"],
    ["run", "room", "--agent", "nobody"],
)


@pytest.mark.parametrize("words", WORDS)
def test_bad_input_is_one_line_and_exit_code_2(words, say):
    result = say(*words)
    assert result.code == 2
    assert len(result.complaints) == 1
    assert "Traceback" not in result.err


@pytest.mark.slow
def test_bad_input_is_as_brief_in_a_process_of_its_own(tmp_path):
    command = [sys.executable, "-c", "from gridslam.cli.main import main; main()", *WORDS[-1]]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_an_agent_that_knows_the_map_meets_the_known_map_bound():
    scene = shortened(gs.Scene.load("room"), 80)
    bound, track, walls = known_map_bound(scene, "agent1"), scene.track("agent1"), scene.segments()
    lines = walls.line[np.unique(walls.surface, return_index=True)[1]]
    surfaces = SurfaceEstimate.from_lines(
        lines, np.tile(1e-8 * np.eye(2), (4, 1, 1)), np.full(4, 0.7), np.full(4, 0.01),
        np.ones(4), np.full((4, 2), np.nan), np.arange(4),
    )  # fmt: skip
    blank = gs.GridSlam(scene).map()
    known = replace(blank, surfaces=surfaces, surface_reflection=None)
    errors, nees = [], []
    for seed in (1, 2, 3, 4):
        run = gs.map_scene(
            scene, gs.simulate(scene, "agent1", seed), seed=seed, prior_map=known, particles=ENOUGH
        )
        gap = run.trajectory.position_m - track.position_m
        errors.append(gap)
        nees.append(np.einsum("ni,nij,nj->n", gap, np.linalg.inv(run.covariance[:, :2, :2]), gap))
    squared = (np.array(errors) ** 2).sum(-1)[:, 10:]
    limit = (bound.position_m[10:] ** 2).mean()
    # some 4 x 14 independent stretches: the mean square is within 30 % of the bound's nine times out of ten
    assert 0.6 < squared.mean() / limit < 1.4
    assert 1.3 < np.mean(nees) < 2.7


def test_an_adapted_number_of_particles_leads_to_the_same_place():
    scene = shortened(gs.Scene.load("room"), 12)
    scans, track = list(gs.simulate(scene, "agent1", 1)), []
    for adapt in (False, True):
        slam = gs.GridSlam(scene.with_filter(adapt_particles=adapt, particles=10_000), seed=1)
        track.append(np.array([slam.step(scan).position_m for scan in scans]))
    assert slam.work.particles.ask(slam.state.belief)[0] < slam.work.particles.count
    np.testing.assert_allclose(*track, atol=0.005)


def test_every_launch_of_a_running_filter_is_a_quick_one(monkeypatch):
    from gridslam.kernels.primitives import launching

    scene = shortened(gs.Scene.load("room"), 6)
    slam, (first, *rest) = gs.GridSlam(scene, seed=1), list(gs.simulate(scene, "agent1", 1))
    slam.step(first)
    fits, real = [], launching._hand_over
    monkeypatch.setattr(launching, "_hand_over", lambda *given: fits.append(real(*given)) or fits[-1])
    for scan in rest:
        slam.step(scan)
    assert len(fits) > 100
    assert all(fits)


@pytest.mark.slow
@pytest.mark.parametrize("method", sorted(name for name, entry in METHODS.items() if entry.takes == "paths"))
def test_filters_side_by_side_and_estimates_of_before_stay_as_they_are(method):
    def copies_of(estimate):
        surfaces, paths = estimate.surfaces, estimate.paths
        return [
            np.copy(part)
            for part in (
                estimate.position_m, estimate.covariance, surfaces.line, surfaces.line_cov,
                surfaces.existence, surfaces.extent_m, paths.distance_m, paths.existence, paths.points,
            )
        ]  # fmt: skip

    rooms = [gs.Scene.load(name).with_filter(particles=128) for name in ("room", "alcove")]
    each_scan = [list(gs.simulate(shortened(room, 5), "agent1", 1)) for room in rooms]
    alone = []
    for room, scans in zip(rooms, each_scan, strict=True):
        slam = method_class(method)(room, seed=1)
        kept = [(estimate, copies_of(estimate)) for estimate in map(slam.step, scans)]
        alone.append([copies for _, copies in kept])
        for estimate, copies in kept:
            for now, then in zip(copies_of(estimate), copies, strict=True):
                np.testing.assert_array_equal(now, then)
    both = [method_class(method)(room, seed=1) for room in rooms]
    for step, scans in enumerate(zip(*each_scan, strict=True)):
        for slam, scan, expected in zip(both, scans, alone, strict=True):
            for now, then in zip(copies_of(slam.step(scan)), expected[step], strict=True):
                np.testing.assert_array_equal(now, then)
