"""A method of one's own goes in by the same door as ours; what is no method is refused in one line."""

import ast
import json
import pickle
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from refusals import one_line
from tiny import TINY

import gridslam as gs
from gridslam.bench import bench
from gridslam.bench.plan import QUICK
from gridslam.runs.stopping import run_before
from gridslam.systems import registry
from gridslam.systems.registry import METHODS, method_class

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
NAME = "own_method:SightFilter"
SAMPLED = {
    "direct": "overlap", "direct-paper": "overlap", "direct_grid": "chamber", "hybrid": "screen",
    "hybrid-known": "screen", "hybrid-paper": "screen", "los": "screen",
}  # fmt: skip
"""Scenes whose samples a method takes."""
SCENE = gs.Scene.from_toml(TINY, "tiny")
MEASUREMENTS = gs.simulate(SCENE, "agent1", seed=1)


class Least:
    """All that a method needs; the cases below spoil it."""

    def __init__(self, scene, prior_map=None, agent=None, seed=0):
        self.scene, self.agent = scene, agent or scene.agents[0].name

    def step(self, scan):
        return gs.Estimate.of_pose(scan, self.scene.agent(self.agent).start_m, 0.0, np.eye(3))

    def map(self):
        return gs.Map.of_scene(self.scene)


def spoiled(**members):
    return type("Spoiled", (Least,), members)


@pytest.fixture
def example(monkeypatch):
    """The example's class, importable as it would be from its folder."""
    monkeypatch.syspath_prepend(EXAMPLES)
    return method_class(NAME)


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


def test_example_follows_the_agent_and_is_short(example):
    assert len((EXAMPLES / "own_method.py").read_text().splitlines()) <= 60
    room = gs.Scene.load("room")
    run = gs.map_scene(room, gs.simulate(room, "agent1", seed=1), example, seed=1)
    score = run.score(gs.ground_truth(room, "agent1"))
    assert run.method == NAME
    assert score["position_rmse_m"] < 2.5 * score["position_bound_m"]
    assert score["heading_rmse_deg"] < 2 * score["heading_bound_deg"]
    assert not run.map.observed.any()


def test_example_outlives_times_in_another_unit(example):
    """Steps of a day leave a covariance of kilometres: it ended in a traceback, "Singular matrix"."""
    room = gs.Scene.load("room")
    heard = gs.simulate(room, "agent1", seed=1)
    slow = replace(heard, time_s=1e5 * heard.time_s, interval_s=1e5 * heard.interval_s, truth=None)
    run = gs.map_scene(room, slow, example, seed=1)
    assert len(run.estimates) == len(heard)


@pytest.mark.slow
def test_run_takes_it_from_the_working_folder_and_its_folder_reads_back(say, tiny, tmp_path, no_figures):
    shutil.copy(EXAMPLES / "own_method.py", tmp_path)
    result = say("run", tiny, "--method", NAME, "-o", "r")
    assert (result.code, result.err) == (0, "")
    assert json.loads((tmp_path / "r" / "run.json").read_text())["method"] == NAME
    assert say("plot", "r").code == 0
    assert say("report", "r", "--still").code == 0
    assert NAME in (tmp_path / "r" / "report.html").read_text()
    # the blank map is of the scene's frame, so our methods go on from it
    result = say("run", tiny, "--agent", "agent2", "--map", "r/map.h5", "--method", "adaptive", "-o", "s")
    assert (result.code, result.err) == (0, "")


@pytest.mark.slow
def test_study_takes_it_in_fresh_worker_processes(say, tiny, tmp_path, monkeypatch):
    pytest.importorskip("joblib")
    monkeypatch.setattr("gridslam.studies.plots.draw_study", lambda *_: [])
    shutil.copy(EXAMPLES / "own_method.py", tmp_path)
    words = ("study", tiny, "--runs", 2, "--workers", 1, "--method", NAME, "-o", "s")
    result = say(*words)
    assert result.code == 0, result
    assert "2 of 2 runs, 2 of them new" in result.out
    assert NAME in (tmp_path / "s" / "summary.csv").read_text()
    assert "2 of 2 runs, 0 of them new" in say(*words).out


@pytest.mark.slow
def test_bench_times_its_steps_alone(example, monkeypatch, say, tmp_path):
    speed = bench.measure(QUICK, methods=[example])
    assert [step.method for step in speed.steps] == [NAME] * len(QUICK.particles)
    assert all(step.step_ms > 0 and step.not_kernel_share == 1 for step in speed.steps)
    assert json.loads(speed.to_json())["start_up"] is None
    result = say("bench", "--quick", "--method", NAME, "--json", "b.json")
    assert (result.code, result.err) == (0, "")
    assert len(json.loads((tmp_path / "b.json").read_text())["steps"]) == len(QUICK.particles)


@pytest.mark.slow
def test_bench_of_a_method_of_ours_alone_splits_its_steps_by_stage():
    (step,) = bench.measure(replace(QUICK, particles=(256,)), methods=["va"]).steps
    assert step.method == "va"
    assert any(name.startswith("kernel ") for name in step.stages_ms)


@pytest.mark.parametrize("name", sorted(METHODS))
def test_our_methods_are_what_a_method_has_to_be(name):
    found = method_class(name)
    assert method_class(found) is found
    assert registry.method_name(found) == name
    assert registry.taken_by(found) == METHODS[name].takes
    assert isinstance(found(gs.Scene.load(SAMPLED[name]) if name in SAMPLED else SCENE), gs.Slam)
    assert (name in SAMPLED) == (METHODS[name].takes == "signal")


def test_a_method_without_start_at_is_told_its_start_by_the_scene():
    from gridslam.world.start import assumed_start

    start = assumed_start(SCENE, "agent2", 3)
    run = gs.map_scene(SCENE, gs.simulate(SCENE, "agent2", 3), Least, "agent2", start=start)
    np.testing.assert_allclose(run.trajectory.position_m[0], start.position_m)
    assert (run.agent, run.start, run.scene) == ("agent2", "drawn", SCENE)


def lines(existence):
    """A surface that a method found."""
    half = np.full(1, 0.5)
    return gs.SurfaceEstimate.from_lines([[0.1, 2.0]], np.eye(2)[None], half, half, np.array([existence]))


@pytest.mark.parametrize(
    ("method", "says"),
    [
        (type("Empty", (), {}), "Empty without step"),
        (type("Mapless", (), {"step": Least.step}), "Mapless without map"),
        (spoiled(__init__=lambda self, scene: None), "constructor that differs"),
        (spoiled(__init__=lambda self, scene, prior_map=None, agent=None, seed=0: None), r"Spoiled\.agent"),
        (spoiled(step=lambda self, scan: None), r"Spoiled\.step: found a result of type NoneType"),
        (spoiled(map=lambda self: None), r"Spoiled\.map: found a result of type NoneType"),
        (spoiled(step=lambda self, s: replace(Least.step(self, s), covariance=np.eye(3))), "covariance"),
        (spoiled(step=lambda self, s: gs.Estimate.of_pose(s, [1, 2, 3], 0.0, np.eye(3))), "position_m"),
        (spoiled(step=lambda self, s: gs.Estimate.of_pose(s, [np.nan, 0], 0.0, np.eye(3))), "NaN"),
        (spoiled(step=lambda self, s: replace(Least.step(self, s), position_m=["a", "b"])), "numbers"),
        (spoiled(step=lambda self, s: replace(Least.step(self, s), time_s=-1.0)), "as in the scan"),
        (
            spoiled(step=lambda self, s: replace(Least.step(self, s), covariance=np.full((5, 5), np.nan))),
            r"Spoiled\.step: covariance\[0, 0\]: found NaN or infinity; allowed: finite numbers",
        ),
        (
            spoiled(step=lambda self, s: gs.Estimate.of_pose(s, [0, 0], 0.0, np.eye(3), surfaces=lines(1.2))),
            r"Spoiled\.step: surfaces\.existence\[0\]: found 1\.2; allowed: 0 to 1",
        ),
        (lambda scene: None, "no class"),
    ],
)
def test_a_class_that_is_no_method_is_refused_in_one_line(method, says):
    with pytest.raises(gs.InputError, match=says) as refused:
        gs.map_scene(SCENE, MEASUREMENTS, method)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nowhere_at_all:Toy", "no module 'nowhere_at_all'"),
        ("broken:Toy", "SyntaxError"),
        ("needy:Toy", "needs 'nowhere_at_all'"),
        ("good:Other", "no Other in good"),
        ("good:Toy", "good:Toy without step()"),
        ("good:VALUE", "no class"),
        ("good:", "package.module:Class"),
        (":Toy", "package.module:Class"),
        ("good.Toy", "grid, adaptive"),
    ],
)
def test_a_name_that_leads_nowhere_is_refused_in_one_line(say, tiny, tmp_path, monkeypatch, name, says):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "broken.py").write_text("class Toy(:\n")
    (tmp_path / "needy.py").write_text("import nowhere_at_all\n")
    (tmp_path / "good.py").write_text("VALUE = 3\nclass Toy:\n    pass\n")
    one_line(say("run", tiny, "--method", name, "-o", "r"), "--method", says)
    one_line(say("study", tiny, "--method", name, "-o", "s"), "method", says)
    one_line(say("bench", "--quick", "--method", name), "--method", says)
    assert not {"r", "s"} & {path.name for path in tmp_path.iterdir()}


def test_a_step_that_returns_nothing_ends_a_run_in_one_line(say, tiny, tmp_path, monkeypatch):
    monkeypatch.setattr("gridslam.systems.registry._imported", lambda path, where: spoiled(step=print))
    one_line(say("run", tiny, "--method", "any:Toy", "-o", "r"), "Spoiled.step", "NoneType")


@pytest.mark.parametrize(
    ("entered", "asked", "says"),
    [
        ("mine = own_method:SightFilter", "mine", None),
        ("mine = own_method:Other", "mine", "entry point 'mine' of gridslam.methods: found no Other"),
        ("grid = own_method:SightFilter", "grid", f"another name than {', '.join(METHODS)}"),
        ("mine = own_method:SightFilter", "magic", f"{', '.join(METHODS)}, mine"),
    ],
)
def test_packages_enter_methods_by_entry_points(tmp_path, monkeypatch, entered, asked, says):
    folder = tmp_path / "toy-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text(f"[{registry.GROUP}]\n{entered}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.syspath_prepend(EXAMPLES)
    if says is None:
        assert gs.map_scene(SCENE, MEASUREMENTS, asked).method == asked
        return
    with pytest.raises(gs.InputError, match=re.escape(says)):
        gs.map_scene(SCENE, MEASUREMENTS, asked)


def test_a_class_with_a_slip_in_its_name_is_told_which_ones_are_there(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    with pytest.raises(gs.InputError, match=r"found no SightFilt in own_method; .* here of SightFilter$"):
        registry.method_class("own_method:SightFilt")


def test_a_study_takes_a_class_by_name_and_refuses_one_that_workers_cannot_find():
    from gridslam.studies.study import Study

    assert Study((SCENE,), methods=(gs.AdaptiveSlam,)).methods == ("adaptive",)

    class Local(Least):
        pass

    with pytest.raises(gs.InputError, match="worker processes can import"):
        Study((SCENE,), methods=(Local,))


def test_estimates_made_by_hand_hold_what_they_are_given():
    scan = next(iter(MEASUREMENTS))
    estimate = gs.Estimate.of_pose(scan, [1, 2], 3 * np.pi / 2, np.diag([1.0, 2.0, 3.0]))
    assert (estimate.step, estimate.time_s) == (scan.step, scan.time_s)
    assert estimate.heading_rad == pytest.approx(-np.pi / 2)
    np.testing.assert_array_equal(np.diag(estimate.covariance), [1, 2, 100, 100, 3])
    assert not len(estimate.surfaces)
    assert not len(estimate.paths)
    assert estimate.health.ok
    with pytest.raises(gs.InputError, match="covariance"):
        gs.Estimate.of_pose(scan, [1, 2], 0.0, np.eye(4))
    with pytest.raises(gs.InputError, match="covariance: found a matrix that isn't symmetric"):
        gs.Estimate.of_pose(scan, [1, 2], 0.0, np.eye(3) + 0.1 * np.eye(3, k=1))
    gs.Estimate.of_pose(scan, [1, 2], 0.0, np.eye(3) + 1e-5 * np.eye(3, k=1))  # of single precision


def test_every_text_about_methods_is_that_of_the_registry():
    from gridslam.cli.main import app

    methods = (ROOT / "docs" / "methods.md").read_text(encoding="utf-8").splitlines()
    commands = typer.main.get_command(app).commands
    helps = [p.help for c in commands.values() for p in c.params if "--method" in p.opts]
    assert len(helps) == 4  # run, study, robustness, bench
    bibliography = (ROOT / "docs" / "bibliography.md").read_text(encoding="utf-8")
    for name, entry in METHODS.items():
        assert all(name in re.findall(r"[\w-]+", text) for text in helps)
        assert any(line.startswith(f"| `{name}` | {entry.about} |") for line in methods)
        assert f"`--method {name}`" in bibliography
        page, _, anchor = entry.page.partition("#")
        titles = re.findall(r"^#+ (.*)$", (ROOT / page).read_text(encoding="utf-8"), re.M)
        assert anchor in {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def test_no_other_list_of_methods_is_kept():
    for file in (ROOT / "gridslam").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        if sum(f'"{name}"' in text for name in METHODS) < 2:
            continue  # most files: parsing all of them takes a second
        for node in ast.walk(ast.parse(text)):
            items = node.keys if isinstance(node, ast.Dict) else getattr(node, "elts", [])
            held = {item.value for item in items if isinstance(item, ast.Constant)} & set(METHODS)
            assert len(held) < 2, f"{file.name}: {held}"


def test_examples_use_the_public_face_alone():
    for file in EXAMPLES.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                assert not any(alias.name.startswith("gridslam.") for alias in node.names), file
            if isinstance(node, ast.ImportFrom):
                assert not str(node.module).startswith("gridslam."), file


@pytest.mark.parametrize("fault", [ZeroDivisionError("theirs"), gs.InputError("Toy", "NaN", "numbers")])
def test_a_step_that_fails_costs_none_of_those_before_it(say, tiny, tmp_path, monkeypatch, fault):
    """The error is passed on as it is: it is theirs."""

    def step(self, scan):
        if scan.step == 2:
            raise fault
        return Least.step(self, scan)

    monkeypatch.setattr("gridslam.systems.registry._imported", lambda path, where: spoiled(step=step))
    words = ("run", tiny, "--agent", "agent1", "--method", "any:Toy", "-o", "r")
    if isinstance(fault, gs.InputError):
        assert say(*words).code == 2
    else:
        with pytest.raises(ZeroDivisionError, match="theirs"):
            say(*words)
    summary = json.loads((tmp_path / "r" / "run.json").read_text())
    assert summary["agents"]["agent1"]["steps"] == 2
    assert summary["notes"][0].startswith("cut short after 2 of ")
    assert len(gs.Trajectory.from_tum(tmp_path / "r" / "agent1" / "trajectory.tum")) == 2


def test_a_first_step_that_fails_costs_no_agent_that_is_through(say, tiny, tmp_path, monkeypatch):
    class Shy(Exception):
        """Takes no attribute of others."""

        def __setattr__(self, name, value):
            if not name.startswith("__"):
                raise AttributeError(name)
            super().__setattr__(name, value)

    def step(self, scan):
        if self.agent == "agent2":
            raise Shy
        return Least.step(self, scan)

    monkeypatch.setattr("gridslam.systems.registry._imported", lambda path, where: spoiled(step=step))
    with pytest.raises(Shy):
        say("run", tiny, "--method", "any:Toy", "-o", "r")
    assert list(json.loads((tmp_path / "r" / "run.json").read_text())["agents"]) == ["agent1"]


def test_what_a_step_raised_has_the_run_before_it_but_takes_it_to_no_other_process():
    def step(self, scan):
        return Least.step(self, scan) if scan.step < 2 else 1 / 0

    with pytest.raises(ZeroDivisionError) as caught:
        gs.map_scene(SCENE, MEASUREMENTS, spoiled(step=step))
    assert len(run_before(caught.value).estimates) == 2
    assert run_before(pickle.loads(pickle.dumps(caught.value))) is None
