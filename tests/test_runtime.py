"""Threads of linear algebra: one within a step, whatever the system, and what there was before after it."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import gridslam as gs


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
