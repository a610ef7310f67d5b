"""The only place that starts Taichi: once, lazily, quietly; a runtime that the caller started is reused."""

from __future__ import annotations

import contextlib
import io
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from functools import cache, wraps
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray
from threadpoolctl import ThreadpoolController

from gridslam.errors import InputError

Found = TypeVar("Found")
Resident = Any
"""An array where the device has it: NumPy's on the CPU, Taichi's on a GPU."""

_started: str | None = None
_forked = False
SPARE_THREADS = 1
"""More threads than cores: a system may wake several on one core and leave them there for half a millisecond,
which is longer than most launches take. One more finds the idle core; two more compete with the others."""


def start(device: str = "auto", threads: int | None = None) -> str:
    """Start Taichi if it isn't running and return the device in use ("cpu" or "gpu").

    What isn't said is the CPU: two cores of it are as fast as the radio, and results repeat bit for bit.

    Parameters
    ----------
    device : str
        auto, cpu or gpu.
    threads : int, optional
        Of the kernels on a CPU (default: `threads_for` its cores); results don't depend on them.

    Raises
    ------
    InputError
        A GPU was asked for and can't be had, another device is already running, or the process was forked
        from one in which Taichi ran.
    """
    global _started
    require_not_forked()
    if _started is not None and device == "auto":  # as every launch of a kernel asks
        return _started
    if device not in ("auto", "cpu", "gpu"):
        raise InputError("device", repr(device), "auto, cpu or gpu")
    if _started is None:
        os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
        import taichi as ti

        from gridslam.kernels.primitives import taichi_inside

        reused = taichi_inside.is_running()
        if not reused:
            options: dict[str, Any] = {"cpu_max_num_threads": threads or threads_for(_cores())}
            arch = [ti.cuda, ti.vulkan] if device == "gpu" else ti.cpu
            if device != "gpu":  # LLVM does the same: four fifths of compiling, and no faster kernels
                options["cfg_optimization"] = False
            # it announces itself, and that it found no GPU, whatever it is told
            with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                ti.init(arch=arch, log_level=ti.ERROR, verbose=False, offline_cache=True, **options)
        _started = "cpu" if taichi_inside.architecture() in (ti.x64, ti.arm64) else "gpu"
        if device == "gpu" and _started == "cpu" and not reused:
            raise InputError("device", "gpu", "cpu or auto: Taichi finds no CUDA or Vulkan device")
    if device not in ("auto", _started):
        raise InputError("device", repr(device), f"auto or {_started}, which is running already")
    return _started


def once_started(find: Callable[[], Found]) -> Callable[[], Found]:
    """What a function finds once Taichi runs, as it imports a kernel: found once, since an import at every
    launch takes as long as handing over an array."""

    @cache
    def first() -> Found:
        start()
        return find()

    @wraps(find)
    def found() -> Found:
        require_not_forked()
        return first()

    return found


def require_not_forked() -> None:
    """Refuse to go on in a process that was forked from one in which Taichi ran.

    Raises
    ------
    InputError
    """
    if _forked:
        allowed = 'multiprocessing.get_context("spawn"): kernels that ran before a fork never end after it'
        raise InputError("device", "a process that was forked", allowed)


def _after_fork() -> None:
    """Taichi's threads aren't in a forked child, which would wait for them for ever."""
    global _forked
    _forked = _started is not None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def threads_for(cores: int) -> int:
    """How many threads kernels run on if nobody says: one for one core."""
    return cores + SPARE_THREADS if cores > 1 else 1


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def resident(array: NDArray[Any]) -> Resident:
    """The array where kernels find it without a copy: itself on the CPU, a copy of it on a GPU."""
    if start() == "cpu":
        return array
    held = room(array.shape, array.dtype)
    held.from_numpy(array)
    return held


def room(shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> Resident:
    """An array on the device in use that nothing was written to yet."""
    if start() == "cpu":
        return np.empty(shape, dtype)
    import taichi as ti

    from gridslam.kernels.primitives.taichi_inside import taichi_type

    return ti.ndarray(taichi_type(dtype), shape)


def on_host(held: Resident) -> NDArray[Any]:
    """A resident array as one of NumPy's."""
    return held if isinstance(held, np.ndarray) else held.to_numpy()


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep NumPy's linear algebra to one thread: its matrices are small here, and threads that wait for each
    other spin, which takes a hundred times as long where the cores are busy.

    Threads of Python may do so side by side: the last of them to leave sets free again.
    """
    _limits.enter()
    try:
        yield
    finally:
        _limits.leave()


class Turns:
    """Holds a lock by which threads take turns; deep copies hold locks of their own.

    The lock itself is entered: an interrupt within methods of ours would leave it taken.
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()

    def __deepcopy__(self, memo: dict[int, Any]) -> Turns:
        return Turns()


class _Limits:
    """How many are within `one_blas_thread`, and what sets the threads free."""

    def __init__(self) -> None:
        self._lock, self._within = threading.Lock(), 0
        self._held = contextlib.ExitStack()

    def enter(self) -> None:
        with self._lock:
            if self._within == 0 and any(pool.get_num_threads() != 1 for pool in _pools().lib_controllers):
                self._held.enter_context(_pools().limit(limits=1))
            self._within += 1

    def leave(self) -> None:
        with self._lock:
            self._within -= 1
            if self._within == 0:
                self._held.close()


_limits = _Limits()


@cache
def _pools() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")
