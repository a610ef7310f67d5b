"""What a study leaves when it ends: tables, figures and report are of all runs that its folder holds."""

import base64
import csv
from types import SimpleNamespace

import numpy as np
import pytest
from made_up_runs import Here, made_up
from tiny import TINY

from gridslam.evaluation.consistency import silent_steps
from gridslam.io.files import write_bytes
from gridslam.studies import plots
from gridslam.studies.batches import batches
from gridslam.studies.jobs import run_job
from gridslam.studies.results import write_results
from gridslam.studies.study import Outcome, Study
from gridslam.world.scene import Scene

GIVEN = ("study", "tiny.toml", "--agent", "agent1", "-o", "mix")


@pytest.fixture
def study(say, tmp_path, monkeypatch):
    """The command line in a folder with a small scene; runs are made up, figures say whose they are."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(TINY)
    monkeypatch.setattr("gridslam.studies.workers.LocalWorkers", lambda count: Here())

    def draw(directory, found, form="png", width=plots.WHOLE_IN):
        (directory / "figures").mkdir(exist_ok=True)
        whose = " ".join(f"{batch.method}:{batch.runs}" for batch in found)
        write_bytes(directory / f"figures/tiny-agent1-errors.{form}", f"{whose} {width:.2f}".encode())

    monkeypatch.setattr("gridslam.studies.plots.draw_study", draw)
    return say


def methods(path):
    with path.open(newline="") as file:
        return [row["method"] for row in csv.DictReader(file)]


def test_other_methods_add_to_a_study_and_no_figure_of_fewer_stays(study, tmp_path):
    """Once, the report of two commands, the second in pdf, had the second's table and the first's figures."""
    mix = tmp_path / "mix"
    assert study(*GIVEN, "--runs", "1", "--method", "grid").code == 0
    told = study(*GIVEN, "--runs", "1", "--method", "va", "--format", "pdf", "--width", "8.8")
    assert told.code == 0
    assert told.out.splitlines()[-1] == (
        "mix: 1 of 1 run, 1 of them new; with those that were there before, tables and figures are of 2"
    )
    for name in ("runs", "summary"):
        assert methods(mix / f"{name}.csv") == ["va", "grid"], "those asked for first"
    figures = {path.name: path.read_text() for path in (mix / "figures").iterdir()}
    assert figures == {
        "tiny-agent1-errors.png": "va:1 grid:1 8.00",
        "tiny-agent1-errors.pdf": "va:1 grid:1 3.46",
    }
    assert study("report", "mix").code == 0
    page = (mix / "report.html").read_text()
    assert base64.b64encode(b"va:1 grid:1 8.00").decode() in page
    assert "<td>grid</td>" in page


def test_fewer_runs_than_are_there_leave_none_out(study, tmp_path):
    assert study(*GIVEN, "--runs", "3").code == 0
    told = study(*GIVEN, "--runs", "1", "--seed", "1")
    assert "1 of 1 run, 0 of them new; with those that were there before" in told.out
    assert len(methods(tmp_path / "mix/runs.csv")) == 3
    assert "before" not in study(*GIVEN, "--runs", "3").out


def test_figures_of_the_same_runs_stay_in_the_width_that_they_have(study, tmp_path):
    for form in ("png", "pdf"):
        assert study(*GIVEN, "--runs", "1", "--format", form, "--width", "8.8").code == 0
    figures = tmp_path / "mix/figures"
    assert {path.read_text() for path in figures.iterdir()} == {"grid:1 3.46"}


def test_stored_runs_of_a_class_that_is_gone_stay_in_the_tables(study, tmp_path, monkeypatch):
    own = tmp_path / "gone_soon.py"
    own.write_text(
        "class Mine:\n"
        "    def __init__(self, scene, prior_map=None, agent=None, seed=0): ...\n"
        "    def step(self, scan): ...\n"
        "    def map(self): ...\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert study(*GIVEN, "--runs", "1", "--method", "gone_soon:Mine").code == 0
    own.unlink()
    monkeypatch.delitem(__import__("sys").modules, "gone_soon")
    assert study(*GIVEN, "--runs", "1").code == 0
    assert methods(tmp_path / "mix/summary.csv") == ["grid", "gone_soon:Mine"]


def test_drawing_that_is_stopped_leaves_no_figure_of_other_runs(tmp_path, monkeypatch):
    """Figures go before the tables change: at no time do both tell of different runs."""
    plan = Study((Scene.from_toml(TINY, "tiny"),), seeds=(0, 1), agents=("agent1",))
    records = [made_up(job) for job in plan.jobs()]
    (tmp_path / "figures").mkdir()
    old, mine = tmp_path / "figures/tiny-agent1-rays.svg", tmp_path / "figures/mine.png"
    for path in (old, mine):
        path.write_text("of one run")

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("gridslam.studies.plots.draw_study", stop)
    with pytest.raises(KeyboardInterrupt):
        write_results(tmp_path, batches(Outcome(plan, records)))
    assert (old.exists(), mine.exists(), (tmp_path / "summary.csv").exists()) == (False, True, True)


def test_steps_that_are_wrong_and_don_t_say_so_are_counted():
    """Above four claimed deviations, and only while health is well."""
    errors, claimed = np.array([0.1, 0.39, 0.41, 5.0, 5.0]), np.array([0.1, 0.1, 0.1, 0.1, 2.0])
    steps = SimpleNamespace(position_error_m=errors, position_claimed_m=claimed)
    estimates = [SimpleNamespace(health=SimpleNamespace(ok=ok)) for ok in (True, True, True, False, True)]
    assert silent_steps(estimates, steps) == 1


@pytest.mark.parametrize(
    ("counts", "cell", "shown"), [((2, 5), "7.0", " 7 "), ((0, 0), "0.0", " 0 "), ((2, None), "", " - ")]
)
def test_silent_steps_stand_in_the_tables(study, tmp_path, monkeypatch, counts, cell, shown):
    """Of a study that began before they were counted, the sum is left empty rather than too small."""

    class Counted(Here):
        def run(self, work, tasks):
            for index, record in super().run(work, tasks):
                count = counts[record["key"]["seed"]]
                scores = record["agents"]["agent1"]["scores"]
                record["agents"]["agent1"]["scores"] = scores | (
                    {} if count is None else {"silent_steps": count}
                )
                yield index, record

    monkeypatch.setattr("gridslam.studies.workers.LocalWorkers", lambda count: Counted())
    told = study(*GIVEN, "--runs", "2")
    assert told.code == 0
    row = told.out.splitlines()[1]
    assert shown in row
    assert "silent" in told.out.splitlines()[0]
    with (tmp_path / "mix/summary.csv").open(newline="") as file:
        assert next(csv.DictReader(file))["silent_steps"] == cell
    with (tmp_path / "mix/runs.csv").open(newline="") as file:
        assert [one["silent_steps"] for one in csv.DictReader(file)] == [
            "" if count is None else str(count) for count in counts
        ]


def test_a_real_run_has_them(say, tmp_path):
    """By a filter that stands still at its start and is sure of that."""
    (tmp_path / "tiny.toml").write_text(TINY.replace("steps = 3", "steps = 20"))
    (tmp_path / "sure_of_it.py").write_text(
        "import numpy as np\n"
        "import gridslam as gs\n\n\n"
        "class Sure:\n"
        "    def __init__(self, scene, prior_map=None, agent=None, seed=0):\n"
        "        self.start, self.blank = scene.filter_model(agent).start_mean, gs.Map.of_scene(scene)\n"
        "        self.agent = agent\n\n"
        "    def step(self, scan):\n"
        "        return gs.Estimate.of_pose(scan, self.start[:2], self.start[4], 1e-4 * np.eye(5))\n\n"
        "    def map(self):\n"
        "        return self.blank\n"
    )
    scene = Scene.load(str(tmp_path / "tiny.toml"))
    (job,) = Study((scene,), ("sure_of_it:Sure",), agents=("agent1",)).jobs()
    scores = run_job(job)["agents"]["agent1"]["scores"]
    assert 10 < scores["silent_steps"] <= scores["steps"] == 20
