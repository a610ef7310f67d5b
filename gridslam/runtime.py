"""The only place that starts Taichi: once, lazily, quietly; a runtime that the caller started is reused."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator
from functools import cache
from types import ModuleType

from threadpoolctl import ThreadpoolController

from gridslam.errors import InputError

_started: str | None = None


def start(device: str = "auto", threads: int | None = None) -> str:
    """Start Taichi if it isn't running and return the device in use ("cpu" or "gpu").

    Raises
    ------
    InputError
        A GPU was asked for and can't be had, or another device is already running.
    """
    global _started
    if device not in ("auto", "cpu", "gpu"):
        raise InputError("device", repr(device), "auto, cpu or gpu")
    if _started is None:
        os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
        import taichi as ti

        if device == "gpu":
            raise InputError("device", "gpu", "cpu or auto; no kernel runs on a GPU yet")
        if not _running(ti):
            options = {"cpu_max_num_threads": threads} if threads else {}
            with contextlib.redirect_stdout(io.StringIO()):  # it announces itself whatever it is told
                ti.init(arch=ti.cpu, log_level=ti.ERROR, verbose=False, offline_cache=True, **options)
        _started = "cpu"
    elif device not in ("auto", _started):
        raise InputError("device", repr(device), f"auto or {_started}, which is running already")
    return _started


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep NumPy's linear algebra to one thread: its matrices are small here, and idle threads spin."""
    with _pools().limit(limits=1, user_api="blas"):
        yield


@cache
def _pools() -> ThreadpoolController:
    return ThreadpoolController()


def _running(ti: ModuleType) -> bool:
    """Whether the caller has started Taichi: a second `ti.init` would reset every field in the process."""
    try:
        return ti.lang.impl.get_runtime().prog is not None
    except ti.TaichiRuntimeError:
        return False
