"""Monte Carlo studies: no run lost or counted twice, whatever happens."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_up_runs import AGENTS, Here, plan
from scene_samples import short
from tiny import TINY

from gridslam.cli.main import main
from gridslam.cli.study import _setting
from gridslam.errors import InputError
from gridslam.runs.network_run import map_network
from gridslam.simulation.network import simulate_network
from gridslam.studies.batches import batches
from gridslam.studies.jobs import source_of
from gridslam.studies.study import Study, identity, run_study
from gridslam.studies.tables import run_rows
from gridslam.world.scene import Scene
from gridslam.world.start import assumed_start


@pytest.fixture(scope="module")
def scene():
    return Scene.from_toml(TINY, "tiny")


def seeds_of(outcome):
    return [record["key"]["seed"] for record in outcome.records]


def test_interrupted_study_goes_on_and_does_no_run_twice(scene, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_study(plan(scene), tmp_path / "s", Here({1: KeyboardInterrupt()}))
    progress, rest = [], Here()
    outcome = run_study(plan(scene), tmp_path / "s", rest, progress=lambda *state: progress.append(state))
    assert seeds_of(outcome) == [0, 1, 2, 3]
    assert rest.done == [1, 0]  # 3 and 2 were there
    assert outcome.fresh == 2
    assert progress == [(2, 4), (3, 4), (4, 4)]
    more = Here()
    assert seeds_of(run_study(plan(scene, 6), tmp_path / "s", more)) == list(range(6))
    assert more.done == [5, 4]  # more seeds are the same study
    again = Here()
    assert run_study(plan(scene, 6), tmp_path / "s", again).fresh == 0
    assert again.done == []
    anew = Here()
    run_study(plan(scene), tmp_path / "s", anew, overwrite=True)
    assert sorted(anew.done) == [0, 1, 2, 3]


@pytest.mark.slow
@given(cut=st.floats(0, 1))
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_file_cut_anywhere_by_a_crash_loses_only_what_was_cut(scene, tmp_path, cut):
    folder = tmp_path / "s"
    run_study(plan(scene), folder, Here(), overwrite=folder.exists())
    content = (folder / "study.jsonl").read_bytes()
    size = int(cut * len(content))
    (folder / "study.jsonl").write_bytes(content[:size])
    rest = Here()
    assert seeds_of(run_study(plan(scene), folder, rest)) == [0, 1, 2, 3]
    kept = max(content[:size].count(b"\n") - 1, 0)
    assert len(rest.done) == 4 - kept
    lines = (folder / "study.jsonl").read_text().splitlines()
    assert sorted(json.loads(line)["key"]["seed"] for line in lines[1:]) == [0, 1, 2, 3]


def test_line_that_is_there_twice_counts_once(scene, tmp_path):
    run_study(plan(scene, 2), tmp_path / "s", Here())
    file = tmp_path / "s" / "study.jsonl"
    file.write_bytes(file.read_bytes() + file.read_bytes().splitlines(keepends=True)[1])
    outcome = run_study(plan(scene, 2), tmp_path / "s", Here())
    assert len(run_rows(batches(outcome))) == 2 * len(AGENTS)


def other_radio(header):
    header["scenes"] = [header["scenes"][0].replace("30.0", "31.0")]


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda header: header.update(version=99), "version: found 99"),
        (lambda header: header.update(gridslam="0.0.1"), "gridslam: found 0.0.1"),
        (lambda header: header.update(format="other"), "another kind of file"),
        (lambda header: header.update(settings=[["filter.births", [1]]]), "results of other settings"),
        (other_radio, "results of other scenes"),
    ],
)
def test_results_of_another_study_or_version_are_refused_and_kept(scene, tmp_path, spoil, says):
    run_study(plan(scene, 2), tmp_path / "s", Here())
    file = tmp_path / "s" / "study.jsonl"
    first, *rest = file.read_text().splitlines()
    header = json.loads(first)
    spoil(header)
    file.write_text("\n".join([json.dumps(header), *rest, ""]))
    before = file.read_bytes()
    with pytest.raises(InputError, match=says):
        run_study(plan(scene, 2), tmp_path / "s", Here())
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    "line", [b"not json", b"[1]", b'{"key": 1}', b'{"key": {}}', b"\xff\xfe", b"[" * 99999]
)
def test_damage_in_the_middle_is_reported_by_line(scene, tmp_path, line):
    run_study(plan(scene, 2), tmp_path / "s", Here())
    file = tmp_path / "s" / "study.jsonl"
    first, _, third = file.read_bytes().splitlines()
    file.write_bytes(b"\n".join([first, line, third, b""]))
    with pytest.raises(InputError, match="line 2"):
        run_study(plan(scene, 2), tmp_path / "s", Here())


def test_folder_of_something_else_and_a_study_at_work_are_refused(scene, tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="something that no study wrote"):
        run_study(plan(scene), tmp_path, Here(), overwrite=True)
    assert (tmp_path / "thesis.tex").read_text() == "precious"
    pytest.importorskip("fcntl")

    class Greedy(Here):
        def run(self, work, tasks):
            with pytest.raises(InputError, match="another study at work"):
                run_study(plan(scene), tmp_path / "s", Here())
            yield from super().run(work, tasks)

    assert seeds_of(run_study(plan(scene), tmp_path / "s", Greedy())) == [0, 1, 2, 3]


def test_failed_run_is_reported_not_recorded_and_tried_again(scene, tmp_path):
    outcome = run_study(plan(scene), tmp_path / "s", Here({2: RuntimeError("no luck")}))
    assert list(outcome.failures) == [2]
    assert "no luck" in outcome.failures[2]
    assert (outcome.records[2], outcome.fresh) == (None, 3)
    again = Here()
    assert not run_study(plan(scene), tmp_path / "s", again).failures
    assert again.done == [2]


def test_worker_of_another_version_is_refused(scene, tmp_path, monkeypatch):
    class Old(Here):
        def run(self, work, tasks):
            for index, record in super().run(work, tasks):
                yield index, {**record, "key": {**record["key"], "gridslam": "0.0.1"}}

    with pytest.raises(InputError, match=r"worker: gridslam: found version 0\.0\.1"):
        run_study(plan(scene), tmp_path / "s", Old())
    assert (tmp_path / "s" / "study.jsonl").read_bytes().count(b"\n") == 1


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"methods": ("magic",)}, "'magic'; allowed: grid"),
        ({"methods": ("grid", "grid")}, "each once"),
        ({"seeds": ()}, "one or more"),
        ({"agents": ("nobody",)}, "nobody"),
        ({"agents": ("agent1", "agent1")}, "agents: found .*each once"),
        ({"settings": (("filter.births", (0.1, 0.2, 0.1)),)}, "--set filter.births: found .*each once"),
        ({"settings": (("filter.particle", (1,)),)}, "particles"),
        ({"settings": (("radios.snr_at_1m_db", (1,)),)}, "no such table"),
        ({"settings": (("filter.particles.x", (1,)),)}, "no such table"),
        ({"settings": (("filter.particles", ("many",)),)}, "filter.particles"),
        ({"settings": (("filter.births", (0.1,)), ("filter.births", (0.2,)))}, "every key once"),
        ({"scenes": ()}, "scenes of different names"),
        ({"methods": ("grid", "direct")}, "radio.frequencies: found none"),
        ({"scenes": (Scene.load("annex"),), "methods": ("network", "grid")}, "clocks that aren't known"),
    ],
)
def test_study_that_cannot_be_run_is_refused_before_anything_is_written(scene, more, says):
    with pytest.raises(InputError, match=says):
        Study(**{"scenes": (scene,), **more})


def test_settings_may_be_lists(scene, tmp_path):
    """What a radio measures, say: every run is in a batch of its own settings, and told of."""
    varied = (("radio.measures", (["distance", "aoa"], ["distance", "aod", "aoa"])),)
    outcome = run_study(plan(scene, 2, settings=varied), tmp_path / "s", Here())
    found = batches(outcome)
    assert [len(batch.records) for batch in found] == [2, 2] * len(AGENTS)
    assert len(run_rows(found)) == 4 * len(AGENTS)


OWN = """
class Own:
    def __init__(self, scene, prior_map=None, agent=None, seed=0):
        self.agent = agent
    def step(self, scan):
        pass
    def map(self):
        pass
"""


def test_runs_of_a_method_that_was_edited_since_are_not_counted(scene, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    file = tmp_path / "edited_method.py"
    file.write_text(OWN)
    own = plan(scene, 2, methods=("edited_method:Own",))

    class Told(Here):
        def run(self, work, tasks):
            for index, record in super().run(work, tasks):
                yield index, record | {"source": source_of("edited_method:Own")}

    assert run_study(own, tmp_path / "s", Told()).fresh == 2
    assert run_study(own, tmp_path / "s", Told()).fresh == 0
    before = (tmp_path / "s" / "study.jsonl").read_bytes()
    file.write_text(OWN + "# better\n")
    with pytest.raises(InputError, match="edited_method:Own: found runs of another state of its file"):
        run_study(own, tmp_path / "s", Told())
    assert (tmp_path / "s" / "study.jsonl").read_bytes() == before
    assert run_study(plan(scene, 2), tmp_path / "s", Told()).fresh == 2, "other methods go on"
    assert run_study(own, tmp_path / "s", Told(), overwrite=True).fresh == 2

    class Editor(Told):
        def run(self, work, tasks):
            file.write_text(OWN + "# while it runs\n")
            yield from super().run(work, tasks)

    with pytest.raises(InputError, match="runs of another state of its file"):
        run_study(plan(scene, 3, methods=("edited_method:Own",)), tmp_path / "s", Editor())
    assert source_of("grid") is None


def test_jobs_are_every_combination_once(scene):
    settings = (("filter.particles", (50, 100)), ("radio.snr_at_1m_db", (20.0, 30.0, 40.0)))
    study = plan(scene, 3, settings=settings)
    keys = [job.key for job in study.jobs()]
    assert len({identity(key) for key in keys}) == len(keys) == 2 * 3 * 3
    assert {key["hash"] for key in keys} == {job.key["hash"] for job in study.jobs()}
    assert len({key["hash"] for key in keys}) == 6
    first = study.variants()[0]
    changed = Scene.from_toml(first.scene, "tiny")
    assert (changed.filter.particles, changed.radio.snr_at_1m_db) == (50, 20.0)
    assert first.label == "tiny, particles=50, snr_at_1m_db=20.0"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("filter.particles=1000,10_000", ("filter.particles", (1000, 10000))),
        ("filter.births = 0.1", ("filter.births", (0.1,))),
        ("name=\"a,b\",'c'", ("name", ("a,b", "c"))),
        ("grid.x_m=[0.0,1.0]", ("grid.x_m", ([0.0, 1.0],))),
    ],
)
def test_settings_are_read_as_in_a_scene_file(text, expected):
    assert _setting(text) == expected


@pytest.mark.parametrize(
    "text", ["", "filter.particles", "=3", "filter.particles=", "name=plain", "a=1]\nb=[2"]
)
def test_settings_that_say_nothing_are_refused(text):
    with pytest.raises(InputError, match="--set"):
        _setting(text)


def command(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["gridslam", "study", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


def test_command_says_what_is_wrong_in_one_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "tiny.toml").write_text(TINY)
    given = (tmp_path / "tiny.toml", "-o", tmp_path / "s")
    for wrong, says in (
        (("--method", "magic"), "magic"),
        (("--set", "filter.wrong=1"), "wrong"),
        (("--runs", "0"), "runs"),
        (("--scheduler", "nowhere", "--workers", "2"), "--workers"),
        (("--agent", "nobody"), f"{tmp_path / 'tiny.toml'}: agents: found 'nobody'"),
    ):
        assert command(monkeypatch, *given, *wrong) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert says in error
    assert not (tmp_path / "s").exists()


@pytest.mark.slow
def test_command_writes_goes_on_and_reports(scene, tmp_path, monkeypatch, capsys):
    (tmp_path / "tiny.toml").write_text(TINY)
    given = (tmp_path / "tiny.toml", "--runs", "2", "-o", tmp_path / "s")
    drawn = []
    monkeypatch.setattr("gridslam.studies.plots.draw_study", lambda folder, *_: drawn.append(folder))
    for fate, code, says in (
        ({0: KeyboardInterrupt()}, 130, "interrupted: 1 of 2 runs are kept"),
        ({0: RuntimeError("no luck")}, 1, "1 run failed (tiny, grid, seed 0: RuntimeError: no luck)"),
        ({}, 0, "2 of 2 runs, 1 of them new"),
        ({0: RuntimeError("never asked")}, 0, "2 of 2 runs, 0 of them new"),
    ):
        monkeypatch.setattr("gridslam.studies.workers.LocalWorkers", lambda count, fate=fate: Here(fate))
        assert command(monkeypatch, *given) == code
        output = capsys.readouterr()
        assert says in output.out + output.err
        assert (output.out + output.err).count("interrupted") == (code == 130), "once, not again at the end"
        assert "1 of them new" not in says or "2 of 2 runs\n" in output.err, "a line per run, in log files"
        assert (tmp_path / "s" / "failures.log").exists() == (code == 1)
    names = {path.name for path in Path(tmp_path / "s").iterdir()}
    assert names == {"study.jsonl", "runs.csv", "steps.csv", "summary.csv"}
    assert drawn == 3 * [tmp_path / "s"]


@pytest.mark.slow
@pytest.mark.usefixtures("runs_here")
def test_agents_that_a_method_takes_at_once_are_run_at_once(tmp_path):
    """As `gridslam run` does, without labels; with scores of clocks, which a study of one by one hasn't."""
    scene = short("exchange", 4, 256)
    study = Study((scene,), ("network",), seeds=(7,))
    outcome = run_study(study, tmp_path)
    (record,) = outcome.records
    names = [agent.name for agent in scene.agents]
    measurements, truth = simulate_network(scene, names, 7, unlabelled=True)
    starts = {name: assumed_start(scene, name, 7) for name in names}
    done = map_network(scene, measurements, 7, starts=starts, method="network")
    want = done.score(measurements.clocks, truth)
    assert list(record["agents"]) == names
    assert record["network"]["apparent_bias_rmse_ps"] == pytest.approx(want["apparent_bias_rmse_ps"])
    for name, run in done.runs.items():
        error = run.estimates[-1].position_m - truth.agents[name].trajectory.position_m[3]
        last = record["agents"][name]["steps"]["position_error_m"][-1]
        assert last == pytest.approx(np.hypot(*error), rel=1e-5)
    rows = run_rows(batches(outcome))
    assert {row["network_labels_judged"] for row in rows} == {want["labels_judged"]}
