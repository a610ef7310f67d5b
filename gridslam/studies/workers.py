"""Where the runs of a study are done: processes of this machine (joblib's loky) or a Dask cluster."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from types import ModuleType
from typing import Any, Protocol, TypeVar

from gridslam.errors import InputError
from gridslam.wording import counted

Task = TypeVar("Task")
Answer = TypeVar("Answer")
MOST_DEATHS = 3
"""How often workers may die in a row without anything finished between."""
CONNECT_S, WORKERS_S = 10, 30
"""How long to wait for a scheduler, and for its first worker."""
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Sums in linear algebra depend on the number of threads; with one, every worker gets the same numbers."""


class Workers(Protocol):
    """Something that does tasks, in any order, each at least once and reported exactly once."""

    def run(
        self, work: Callable[[Task], Answer], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Answer | BaseException]]:
        """Yield (index of the task, its answer or the exception that it raised) as they come."""
        ...


class LocalWorkers:
    """Processes of this machine, started afresh (never forked), each single-threaded.

    Parameters
    ----------
    count : int, optional
        Number of processes; default: one per core that this process may use.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count

    def run(
        self, work: Callable[[Task], Answer], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Answer | BaseException]]:
        """Do the tasks; those that a dying worker took along are done again in new processes.

        Raises
        ------
        InputError
            joblib isn't installed, or workers keep dying.
        """
        loky = _need("joblib.externals.loky", "joblib")
        left, deaths = list(range(len(tasks))), 0
        while left:
            # fewer at a time after a death: memory may be short, and what kills its worker takes fewer along
            count = max(1, min(self.count or loky.cpu_count(), len(left)) >> deaths)
            finished: set[int] = set()
            pool = loky.ProcessPoolExecutor(count, initializer=_beginning(), env=ONE_THREAD)
            try:
                for index, answer in _ahead(loky, pool, work, tasks, left, 2 * count):
                    finished.add(index)
                    yield index, answer
            except BrokenProcessPool:
                deaths = 1 if finished else deaths + 1
            finally:
                pool.shutdown(wait=True, kill_workers=True)
            # to and fro, so that no run is for ever behind the one that kills
            left = sorted(set(left) - finished, reverse=deaths % 2 == 1)
            if left and deaths >= MOST_DEATHS:
                found = f"processes that died {deaths} times in a row ({counted(len(left), 'run')} left)"
                raise InputError("workers", found, "enough memory for each, or fewer --workers")


class ClusterWorkers:
    """Workers of a Dask cluster; its scheduler repeats elsewhere what a dying worker took along.

    Parameters
    ----------
    address : str
        Of the scheduler, e.g. ``tcp://host:8786``.
    """

    def __init__(self, address: str) -> None:
        self.address = address

    def run(
        self, work: Callable[[Task], Answer], tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Answer | BaseException]]:
        """Do the tasks on the cluster.

        Raises
        ------
        InputError
            dask.distributed isn't installed, the scheduler can't be reached or goes away, it has no workers,
            they lack gridslam, or they keep dying.
        """
        distributed = _need("distributed", "dask[distributed]")
        with _quiet("distributed.client"), self._client(distributed) as client:
            futures = {client.submit(work, task, pure=False, retries=0): i for i, task in enumerate(tasks)}
            done = distributed.as_completed(
                list(futures), loop=client.loop, with_results=True, raise_errors=False
            )
            for future, answer in done:
                yield futures.pop(future), self._answer(distributed, future, answer)
                future.release()

    def _client(self, distributed: ModuleType) -> Any:
        try:
            distributed.comm.get_address_host_port(self.address)  # a client stumbles over what isn't one
            client = distributed.Client(self.address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError, ImportError) as error:
            reason = " ".join(str(error).split())[:100] or type(error).__name__
            raise InputError(
                f"--scheduler {self.address}", f"no scheduler ({reason})", "tcp://HOST:PORT of a running one"
            ) from None
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            client.close()
            raise InputError(
                f"--scheduler {self.address}", f"no worker within {WORKERS_S} s", "a cluster with workers"
            ) from None
        return client

    def _answer(self, distributed: ModuleType, future: Any, answer: Any) -> Any:
        where = f"--scheduler {self.address}"
        again = "a cluster that stays; the same command goes on from here"
        if future.status == "finished" and not isinstance(answer, CancelledError):
            return answer
        error = answer[1] if future.status == "error" and isinstance(answer, tuple) else None
        if isinstance(error, distributed.KilledWorker):
            raise InputError(where, "workers that died again and again with one run", again)
        if isinstance(error, ImportError):
            raise InputError(where, f"workers that can't import ({error})", "gridslam on every worker")
        if error is None:
            raise InputError(where, "a scheduler that went away", again)
        return error


def _ahead(
    loky: ModuleType,
    pool: Any,
    work: Callable[[Task], Answer],
    tasks: Sequence[Task],
    order: Sequence[int],
    most: int,
) -> Iterator[tuple[int, Answer | BaseException]]:
    """Do tasks in a pool, at most so many handed over at a time; all at once would end noisily on Ctrl-C."""
    waiting = iter(order)
    flying: dict[Any, int] = {}
    while True:
        for index in islice(waiting, most - len(flying)):
            flying[pool.submit(work, tasks[index])] = index
        if not flying:
            return
        broken = None
        for future in loky.wait(flying, return_when=loky.FIRST_COMPLETED).done:
            index, error = flying.pop(future), future.exception()
            if isinstance(error, BrokenProcessPool):
                broken = error
            else:
                yield index, error if error is not None else future.result()
        if broken is not None:
            raise broken


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    """Hold back a logger's tracebacks; what matters of them becomes one line."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(before)


def _beginning() -> Callable[[], None]:
    """What a process does first (a nested function travels by value: nothing is imported for it)."""

    def begin() -> None:
        import os
        import signal
        import threading

        import psutil

        # Ctrl-C reaches the whole process group; the parent alone ends the study, in good order
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        parent = psutil.Process(os.getppid())

        def follow() -> None:
            parent.wait()
            os._exit(1)  # it was killed: nobody waits for what is being done here

        threading.Thread(target=follow, daemon=True).start()

    return begin


def _need(module: str, package: str) -> ModuleType:
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            "study", f"no {package} here", "pip install 'gridslam[study]', in a clone -e '.[study]'"
        ) from None
