"""The benchmark measures what it says, and leaves the filter as it found it."""

import json
import math
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scene_samples import shortened

import gridslam as gs
from gridslam import runtime
from gridslam.bench import bench
from gridslam.bench import features as bench_features
from gridslam.bench import growth as bench_growth
from gridslam.bench import heard_paths as bench_heard_paths
from gridslam.bench import single_kernels as bench_single_kernels
from gridslam.bench import stages as bench_stages
from gridslam.bench import start as bench_start
from gridslam.bench import superposition as bench_superposition
from gridslam.bench.contests import CONTESTS, PARTS
from gridslam.bench.plan import QUICK, Plan
from gridslam.errors import InputError
from gridslam.kernels.primitives.watching import WATCHERS

runtime_started = pytest.fixture(scope="module", autouse=True)(lambda: runtime.start())
LAUNCH_S = 1e-4
EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def quick():
    """What a brief measurement of everything found, start-up left out, and the parts it told of."""
    progress = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "start_up", lambda repeats, device: bench_start.StartUp(1.0, False, 3.0, 2.0))
        return bench.measure(QUICK, tell=lambda *words: progress.append(words)), progress


def numbers(value):
    if isinstance(value, dict):
        return [n for child in value.values() for n in numbers(child)]
    if isinstance(value, list):
        return [n for child in value for n in numbers(child)]
    return [] if isinstance(value, str | bool) or value is None else [value]


@pytest.mark.slow
def test_everything_is_in_the_json_as_positive_finite_numbers(quick):
    found = json.loads(quick[0].to_json())
    assert set(found) == {
        "format", "version", "plan", "machine", "kernels", "steps", "growth", "start_up", "seconds",
    }  # fmt: skip
    assert found["machine"]["device"] == "cpu"
    assert found["machine"]["threads"] >= 1
    assert set(found["machine"]["versions"]) == set(bench_start.PACKAGES)
    assert [g["of"] for g in found["growth"]] == [
        "particles", "hypotheses", "surfaces", "measurements", "grid cells", "steps",
    ]  # fmt: skip
    for growth in found["growth"]:
        powers = growth.pop("exponent"), growth.pop("cpu_exponent")
        assert all(map(math.isfinite, powers))  # of a brief measurement they may be anything
    found["machine"].pop("load")
    stages = [step.pop("stages_ms") for step in found["steps"]]
    assert all(n >= 0 and math.isfinite(n) for n in numbers(stages))
    assert all(n > 0 and math.isfinite(n) for n in numbers(found))
    assert [(s["method"], s["scene"], s["particles"]) for s in found["steps"]] == [
        ("grid", "alcove", 256), ("grid", "alcove", 1024), ("grid", "canyon", 256), ("grid", "canyon", 256),
        ("adaptive", "alcove", 256), ("adaptive", "alcove", 1024),
    ]  # fmt: skip


@pytest.mark.slow
def test_ratios_and_rates_are_those_of_the_times(quick):
    for kernel in quick[0].kernels:
        assert kernel.ratio == pytest.approx(kernel.twin_s / kernel.kernel_s)
        assert kernel.ns_per_unit == pytest.approx(1e9 * kernel.kernel_s / kernel.units)
        assert kernel.kernel_best_s <= kernel.kernel_s
    for step in quick[0].steps:
        assert step.steps_per_s == pytest.approx(1000 / step.step_ms)
        inside = sum(ms for name, ms in step.stages_ms.items() if name.startswith("kernel "))
        assert step.not_kernel_share == pytest.approx(1 - inside / sum(step.stages_ms.values()))


@pytest.mark.slow
def test_every_kernel_there_is_has_a_twin_to_compete_with(quick):
    all_of_them = set(CONTESTS) | set(bench_features.NAMES) | set(bench_single_kernels.NAMES)
    all_of_them |= set(bench_superposition.NAMES) | set(bench_heard_paths.NAMES)
    assert all_of_them == set(bench_stages.kernels())
    assert {kernel.name for kernel in quick[0].kernels} == all_of_them
    launched = {name for step in quick[0].steps for name in step.stages_ms if name.startswith("kernel ")}
    assert launched | {f"kernel {name}" for name in PARTS} == {f"kernel {name}" for name in CONTESTS}


@pytest.mark.slow
def test_progress_tells_every_part_once(quick):
    speed, progress = quick
    assert [done for _, done, _ in progress] == list(range(len(progress)))
    assert {total for _, _, total in progress} == {len(progress)}
    assert len(progress) == len(speed.steps) + 3


@pytest.mark.slow
def test_watching_changes_nothing_for_the_filter():
    scene = shortened(gs.Scene.load("room"), 4).with_filter(particles=128)
    plain, watched = gs.GridSlam(scene, seed=3), gs.GridSlam(scene, seed=3)
    for scan in gs.simulate(scene, "agent1", seed=3):
        expected = plain.step(scan)
        with bench_stages.Stopwatch(watched.work).watching() as watch:
            found = watched.step(scan)
        assert not WATCHERS
        np.testing.assert_array_equal(found.covariance, expected.covariance)
    assert watch.launches["cast"] == len(scene.anchors) + 1


def test_nobody_watches_after_a_failure():
    slam = gs.GridSlam(shortened(gs.Scene.load("room"), 2).with_filter(particles=128))
    with pytest.raises(ZeroDivisionError), bench_stages.Stopwatch(slam.work).watching():
        _ = 1 / 0
    assert not WATCHERS


def test_stages_of_a_step_add_up_to_it_and_launches_are_no_kernels():
    scene = shortened(gs.Scene.load("room"), 2).with_filter(particles=128)
    slam = gs.GridSlam(scene, seed=3)
    scans = list(gs.simulate(scene, "agent1", seed=3))
    slam.step(scans[0])
    with bench_stages.Stopwatch(slam.work).watching() as watch:
        began = time.perf_counter()
        slam.step(scans[1])
        whole = time.perf_counter() - began
    watch.count(slam.info.seconds)
    stages = watch.of_step(2 * whole, 2, dict.fromkeys(watch.launches, LAUNCH_S))
    assert sum(stages.values()) == pytest.approx(whole)
    assert stages["launches"] <= LAUNCH_S * sum(watch.launches.values()) / 2 * (1 + 1e-9)
    assert stages["launches"] > 0
    assert {"updates", "births", "cells", "evaluation", "bookkeeping"} < set(stages)


@pytest.mark.parametrize("power", [0.0, 1.0, 2.5])
def test_exponent_of_a_power_law_is_its_power(power):
    size = [10, 100, 500]
    times = [[3e-3 * n**power for n in size], [1e-3 * n for n in size]]
    found = bench_growth.fitted("things", size, *times, [1.0] * 3)
    assert found.exponent == pytest.approx(power, abs=1e-9)
    assert found.cpu_exponent == pytest.approx(1)


def test_one_size_has_no_exponent():
    assert bench_growth.fitted("things", [3, 3], [0.1, 0.2], [0.1, 0.1], [1.0, 1.0]).exponent is None


@pytest.mark.parametrize("sides", Plan().surfaces)
def test_polygons_have_as_many_surfaces_as_sides(sides):
    scene = bench_growth.polygon(sides, 64)
    assert len(set(scene.segments().surface.tolist())) == sides
    assert len(scene.track("agent1")) >= Plan().before + Plan().timed


def test_bundled_scene_is_long_enough_for_the_plan():
    plan = Plan()
    assert len(gs.Scene.load("alcove").track("agent1")) >= max(*plan.steps, plan.kernel_before + 10)


def test_cell_visits_of_a_straight_ray_are_the_cells_on_its_way():
    drawn = np.array([[0.5, 0.5, 3.5, 0.5, 3.5, 0.5, 3.5, 0.5, 1, 0, 1, 0, 1, 0]])
    case = {
        "state": np.zeros((3, 1)), "path": np.array([[0, -1, -1, 0]]), "drawn": drawn,
        "factor": np.ones((1, 2)), "frame": np.array([0.0, 0.0, 1.0, 0.1, 12.0, 0.5, 0.05, 0.0]),
        "where": np.zeros((4, 4), np.int32), "found": np.ones(1, int),
    }  # fmt: skip
    assert CONTESTS["cast"].units(case) == 4


@pytest.mark.slow
def test_command_writes_the_json_it_shows(say, quick, monkeypatch, tmp_path):
    kept = quick[0]

    def measure(plan, device, threads, tell, methods):
        assert (plan, device, threads, methods) == (QUICK, "auto", None, [])
        return kept

    monkeypatch.setattr(bench, "measure", measure)
    result = say("bench", "--quick", "--json", "speed.json")
    assert (result.code, result.err) == (0, "")
    assert json.loads((tmp_path / "speed.json").read_text()) == json.loads(kept.to_json())
    for kernel in kept.kernels:
        assert f"{kernel.name} " in result.out
    assert "…" not in result.out, "no table is cut"


ONE_KERNEL = """
import time
from gridslam import runtime
from gridslam.kernels.primitives.launching import agrees
runtime.start("cpu")
assert agrees()
print(time.time())
"""


@pytest.mark.slow
def test_first_start_compiles_the_kernels_and_the_next_finds_them(monkeypatch):
    """With a program that needs one kernel: to compile all of them takes half a minute."""
    whole, compiled = bench_start._child, []

    def child(code, words, environment=None):
        if environment:
            cache = Path(environment["TI_OFFLINE_CACHE_FILE_PATH"])
            compiled.append(len(list(cache.iterdir())) if cache.is_dir() else 0)
        return whole(code, words, environment)

    monkeypatch.setattr(bench_start, "_child", child)
    monkeypatch.setattr(bench_start, "FIRST_STEP", ONE_KERNEL)
    found = bench_start.start_up(1)
    assert compiled[0] == 0
    assert compiled[1] > 0
    assert not found.import_starts_taichi
    assert min(found.import_s, found.cold_s, found.warm_s) > 0


@pytest.mark.slow
def test_first_step_of_a_run_is_told_once_it_is_done_and_nothing_more(tmp_path, monkeypatch):
    """With a method that starts at once: Taichi's takes ten seconds to load its kernels."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(EXAMPLES), *sys.path]))
    before, words = time.time(), ["run", "room", "--device", "cpu", "-o", str(tmp_path / "run")]
    words += ["--method", "own_method:SightFilter"]
    assert before < float(bench_start._child(bench_start.FIRST_STEP, words)) < time.time()
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["", "missing/speed.json"])
def test_json_that_cant_be_written_is_refused_before_anything_is_measured(say, name, monkeypatch, tmp_path):
    monkeypatch.setattr(bench, "measure", lambda *_: pytest.fail("measured"))
    result = say("bench", "--json", tmp_path / name)
    assert result.code == 2
    assert len(result.complaints) == 1
    assert "--json" in result.complaints[0]


def test_unknown_device_is_refused(say):
    assert say("bench", "--device", "abacus").code == 2
    with pytest.raises(InputError, match="device"):
        bench.measure(QUICK, "abacus")
