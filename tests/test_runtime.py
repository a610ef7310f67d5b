"""Linear algebra has one thread within a step, threads take turns, and nobody goes on after a fork."""

import copy
import os
import threading
import warnings

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import gridslam as gs
from gridslam import runtime
from gridslam.errors import InputError


class Nothing:
    """What was heard, as far as the front door looks at it."""

    step, time_s = 0, 0.0

    def __len__(self):
        return 0


@pytest.mark.parametrize(
    ("system", "name"), [(gs.GridSlam, "room"), (gs.DirectSlam, "overlap"), (gs.NetworkSlam, "exchange")]
)
def test_steps_leave_linear_algebra_one_thread_and_others_what_they_had(system, name, monkeypatch):
    """Where cores are busy, threads that wait for each other took 180 ms for a matrix of 61 rows, not 0.6."""
    seen, slam = [], system(gs.Scene.load(name), seed=1)

    class Seen(Exception):
        pass

    def look(scan):
        seen.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        raise Seen

    monkeypatch.setattr(slam, "_advanced", look)
    monkeypatch.setattr(slam, "_checked", lambda scan, after: scan)
    with threadpool_limits(2, user_api="blas"):
        before = [pool["num_threads"] for pool in threadpool_info()]
        with pytest.raises(Seen):
            slam.step(Nothing())
        assert set(seen) == {1}
        assert [pool["num_threads"] for pool in threadpool_info()] == before


def test_threads_take_turns_at_one_filter_and_not_at_its_copies(monkeypatch):
    """Steps of four threads at once ended in a damaged heap."""
    slam, seen = gs.GridSlam(gs.Scene.load("room"), seed=1), []

    def another_thread_may(turns):
        found = []
        other = threading.Thread(target=lambda: found.append(turns.lock.acquire(blocking=False)))
        other.start()
        other.join()
        return found[0]

    def look(scan):
        apart = copy.deepcopy(slam)
        seen.extend(map(another_thread_may, (slam.turns, copy.copy(slam).turns, apart.turns)))
        raise InputError("scan", "nothing", "something")

    monkeypatch.setattr(slam, "_checked", lambda scan, after: scan)
    monkeypatch.setattr(slam, "_advanced", look)
    with pytest.raises(InputError):
        slam.step(Nothing())
    assert seen == [False, False, True], "a copy shares the workspace, a deep one has its own"
    assert another_thread_may(slam.turns), "after a step, even one that failed"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="systems without fork")
def test_a_forked_child_says_so_and_waits_for_nobody():
    """It waited for Taichi's threads, of which it has none, for ever."""
    runtime.start()
    slam = gs.GridSlam(gs.Scene.load("room"), seed=1)
    with slam.turns.lock, warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns of forks beside threads
        child = os.fork()
    if child == 0:
        told = 0
        for go_on in (runtime.start, lambda: slam.step(Nothing()), runtime.once_started(int)):
            try:
                go_on()
            except InputError as error:
                told += 'allowed: multiprocessing.get_context("spawn")' in str(error)
        os._exit(0 if told == 3 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert runtime.start() == "cpu"
