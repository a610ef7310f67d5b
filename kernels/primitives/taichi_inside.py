"""What Taichi 1.7 keeps to itself and the package asks it for; no other file knows of it.

Settings in force, types, how it reads kernels, what kernels keep of themselves, and launches. `launching`
tries reading and launches against Taichi's own before it relies on them.
"""

import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import taichi as ti
from numpy.typing import DTypeLike
from taichi.lang import impl
from taichi.lang.util import to_numpy_type, to_taichi_type

PRIVATE = ("arguments", "compiled_kernels", "runtime")
"""What a kernel keeps of itself."""
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
    """A function that finds sources, with what it found before kept."""
    return cache(find)


def inner(kernel: Any) -> Any:
    """What a kernel keeps of itself, or None of a Taichi that keeps it elsewhere."""
    primal = getattr(kernel, "_primal", None)
    return primal if all(hasattr(primal, name) for name in PRIVATE) else None


def compiled_and_program(primal: Any) -> tuple[dict[Any, Any], Any]:
    """What was compiled of an inner kernel so far, and the program that runs; asked at every launch."""
    return primal.compiled_kernels, primal.runtime.prog


def machine_code(program: Any, code: Any) -> Any:
    """Machine code of a compiled kernel."""
    return program.compile_kernel(program.config(), program.get_device_caps(), code)


class Arguments:
    """What the arguments of a launch are put into, each at its place, a tuple of an int.

    Parameters
    ----------
    program, code, machine : object
        Of `compiled_and_program`, and of `machine_code`.

    The methods are Taichi's own, bound once: a wrapper around each would take as long as they do.

    Attributes
    ----------
    launch : callable
        Launches the kernel with what was put in.
    array : callable
        Takes a place, an address, a size in bytes, a shape (empty: as it was) and 0.
    real, whole : callable
        Take a place and a number.
    """

    __slots__ = ("array", "context", "launch", "real", "whole")

    def __init__(self, program: Any, code: Any, machine: Any) -> None:
        context = self.context = code.make_launch_context()
        self.launch = partial(program.launch_kernel, machine, context)
        self.array = context.set_arg_external_array_with_shape
        self.real, self.whole = context.set_arg_float, context.set_arg_int

    def pack(self, place: tuple[int], pack: Any) -> None:
        """Put in a pack."""
        self.context.set_arg_argpack(place, pack._ArgPack__argpack)

    def device_array(self, place: tuple[int], array: ti.Ndarray) -> None:
        """Put in an array of Taichi's own."""
        self.context.set_arg_ndarray(place, array.arr)
