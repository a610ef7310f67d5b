"""What Taichi 1.7 keeps to itself and the package asks it for; no other file names its private modules.

Settings in force, types, and how it reads kernels. What kernels and launches keep to themselves is used in
`launching` alone, which tries itself against Taichi's own launches.
"""

import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import DTypeLike
from taichi.lang import impl
from taichi.lang.util import to_numpy_type, to_taichi_type

_WRAPPED_ONCE = SimpleNamespace(fill=cache(textwrap.fill), dedent=textwrap.dedent)


def is_running() -> bool:
    """Whether somebody has started Taichi: a second `ti.init` would reset every field in the process."""
    try:
        return impl.get_runtime().prog is not None
    except ti.TaichiRuntimeError:
        return False


def architecture() -> Any:
    """What it runs on, as `ti.x64` or `ti.cuda`."""
    return impl.current_cfg().arch


def threads() -> int:
    """How many threads its kernels take at most, on a CPU."""
    return int(impl.current_cfg().cpu_max_num_threads)


def taichi_type(dtype: DTypeLike) -> Any:
    """Taichi's type of NumPy's."""
    return to_taichi_type(np.dtype(dtype))


def numpy_type(kind: Any) -> Any:
    """NumPy's type of Taichi's."""
    return to_numpy_type(kind)


@contextmanager
def read_quickly() -> Iterator[None]:
    """Keep Taichi from noting where expressions stand, and from looking for a function's source again.

    Nor are its lines wrapped again. If it is one that does as known.
    """
    try:
        from taichi.lang import kernel_impl as reading
        from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext as Reader

        noted, found, wrapped = Reader.get_pos_info, reading.getsourcelines, reading.textwrap
    except (AttributeError, ImportError):
        yield
        return
    Reader.get_pos_info = lambda reader, node: ""
    reading.getsourcelines, reading.textwrap = _sources(found), _WRAPPED_ONCE
    try:
        yield
    finally:
        Reader.get_pos_info, reading.getsourcelines, reading.textwrap = noted, found, wrapped


@cache
def _sources(find: Callable[..., Any]) -> Callable[..., Any]:
    """The same, with what was found before kept."""
    return cache(find)
