"""Real worker processes, here and on a Dask cluster: same numbers, and no run lost when one dies."""

import os
import pickle
import sys
import warnings
from contextlib import contextmanager

import pytest
from tiny import TINY

from gridslam.errors import InputError
from gridslam.studies import workers
from gridslam.studies.study import Study, run_job, run_study
from gridslam.studies.workers import ClusterWorkers, LocalWorkers
from gridslam.world.scene import Scene

pytest.importorskip("joblib")


def study(seeds):
    """Of the method whose kernels are loaded soonest, in each process."""
    return Study((Scene.from_toml(TINY, "tiny"),), methods=("va",), seeds=tuple(range(seeds)))


def numbers(record):
    return {name: (own["scores"], own["steps"]) for name, own in record["agents"].items()}


def doomed(folder, when):
    """Work that ends its whole process at some tasks, the first time or always (pickled by value)."""

    def work(task):
        import os
        from pathlib import Path

        mark = Path(folder) / f"{task}"
        with mark.open("a") as file:
            file.write("x")
        if when == "always" and task == 2:
            os._exit(1)
        if when == "once" and task % 3 == 1 and mark.stat().st_size == 1:
            os._exit(1)
        if when == "wrong" and task == 2:
            raise ZeroDivisionError("two")
        return task**2

    return work


@contextmanager
def cluster(processes, threads=1):
    """A real scheduler with worker processes on the loopback, which gives a run two chances."""
    distributed = pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    with warnings.catch_warnings(), dask.config.set({"distributed.scheduler.allowed-failures": 1}):
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(
            n_workers=processes,
            threads_per_worker=threads,
            processes=True,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=50,
        ) as running:
            yield running
            with distributed.Client(running) as client:  # one that is just being replaced can't be closed
                client.wait_for_workers(processes)


@pytest.mark.slow
def test_local_processes_and_a_cluster_give_the_numbers_of_runs_one_by_one(tmp_path):
    # each process takes seconds to start, its runs hardly any; two at once do plain tasks below
    jobs = study(2).jobs()
    expected = [numbers(run_job(job)) for job in jobs]
    local = run_study(study(2), tmp_path / "local", LocalWorkers(1))
    assert [numbers(record) for record in local.records] == expected
    with cluster(1, threads=2) as running:
        remote = run_study(study(2), tmp_path / "remote", ClusterWorkers(running.scheduler_address))
        assert [numbers(record) for record in remote.records] == expected
    again = run_study(study(2), tmp_path / "local", ClusterWorkers("tcp://127.0.0.1:9"))  # nothing to ask it
    assert (again.fresh, again.records) == (0, local.records)


@pytest.mark.slow
def test_tasks_of_a_process_that_dies_are_done_again(tmp_path):
    found = list(LocalWorkers(2).run(doomed(tmp_path, "once"), range(6)))
    assert sorted(found) == [(task, task**2) for task in range(6)]


@pytest.mark.slow
def test_process_that_always_dies_ends_the_study_after_the_others_are_done(tmp_path):
    found = []

    def collect():
        for answer in LocalWorkers(2).run(doomed(tmp_path, "always"), range(5)):
            found.append(answer)

    with pytest.raises(InputError, match=r"died 3 times in a row \(1 run left\)"):
        collect()
    assert sorted(found) == [(task, task**2) for task in (0, 1, 3, 4)]


def test_bad_input_travels_whole_from_a_worker():
    error = pickle.loads(pickle.dumps(InputError("here", "this", "that")))
    assert (error.where, error.found, error.allowed) == ("here", "this", "that")
    assert str(error) == "here: found this; allowed: that"


@pytest.mark.slow
def test_error_of_a_task_is_its_answer(tmp_path):
    found = dict(LocalWorkers(1).run(doomed(tmp_path, "wrong"), range(4)))
    error = found.pop(2)
    assert repr(error) == "ZeroDivisionError('two')"
    assert found == {0: 0, 1: 1, 3: 9}


@pytest.mark.slow
def test_cluster_does_again_what_a_dying_worker_took_along_and_gives_up_on_what_kills_all(tmp_path):
    with cluster(2) as running:
        workers = ClusterWorkers(running.scheduler_address)
        once, always, wrong = (tmp_path / name for name in ("once", "always", "wrong"))
        for folder in (once, always, wrong):
            folder.mkdir()
        found = list(workers.run(doomed(once, "once"), range(4)))
        assert sorted(found) == [(task, task**2) for task in range(4)]
        assert isinstance(dict(workers.run(doomed(wrong, "wrong"), range(3)))[2], ZeroDivisionError)
        with pytest.raises(InputError, match="died again and again"):
            list(workers.run(doomed(always, "always"), range(3)))


@pytest.mark.slow
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x", "", "127.0.0.1:99999"])
def test_scheduler_that_cannot_be_reached_is_one_clear_line(address, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(workers, "CONNECT_S", 0.3)
    with pytest.raises(InputError, match="no scheduler") as caught:
        list(ClusterWorkers(address).run(abs, [1]))
    assert "\n" not in str(caught.value)


def test_without_the_extra_the_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "joblib.externals.loky", None)
    with pytest.raises(InputError, match="pip install"):
        list(LocalWorkers().run(os.getpid, [1]))
