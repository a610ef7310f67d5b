"""Launches without Taichi's look at every argument, which takes longer than most of these kernels run.

A call of a `ti.kernel` inspects each array anew, some 25 us apiece. Once a kernel is compiled, `quick` checks
only what machine code relies on, and hands over addresses; on the CPU only those of arrays that aren't the
same objects as at the launch before. Before that, Taichi reads the kernel: it notes for every expression
where it stands, which takes half the time and serves its complaints alone, and looks for a function's source
at every call of it.
"""

import gc
import threading
from contextlib import contextmanager
from ctypes import c_void_p
from functools import cache, wraps

import numpy as np
import taichi as ti
from taichi.lang.util import to_numpy_type

from gridslam.kernels.primitives.device import ON_CPU

_one_at_a_time = threading.RLock()
ndarray, HEAD, NOTHING = np.ndarray, object.__basicsize__, object()
MOST_KEPT, KEYS = 8, ("anchor", "only", "path", "radio")
"""Launches of a kernel that a thread keeps side by side; arguments that tell them apart, anchors mostly."""
PRIVATE = ("arguments", "compiled_kernels", "runtime")
"""What a kernel of Taichi 1.7 keeps of itself."""


def quick(kernel):
    """The same kernel, launched quickly; whatever isn't as it was compiled for goes Taichi's own way.

    Parameters
    ----------
    kernel : ti.kernel
        Its arguments are arrays of given type and number of dimensions, and numbers; it returns nothing.

    Notes
    -----
    A thread keeps the arguments of its last launches of each kernel, one for each of the last few anchors,
    and takes an array that it keeps for unchanged: nobody may give it another shape, type or size in place.
    """
    primal = getattr(kernel, "_primal", None)
    if not all(hasattr(primal, name) for name in PRIVATE):
        return kernel  # a Taichi that keeps these elsewhere
    kinds = [_kind(argument.annotation) for argument in primal.arguments]
    places = [(place,) for place in range(len(kinds))]
    own, key = threading.local(), _key(primal.arguments) if ON_CPU else None

    @wraps(kernel)
    def launch(*arguments):
        compiled = primal.compiled_kernels
        if not compiled:
            return _first(kernel, arguments)
        if len(compiled) != 1 or len(arguments) != len(kinds):
            return kernel(*arguments)
        (code,) = compiled.values()
        program = primal.runtime.prog
        kept = _kept(own, code, program, arguments, key)
        context, handed = kept.context, kept.handed
        if not ON_CPU:
            context, handed = code.make_launch_context(), [NOTHING] * len(kinds)
        for value, before, place, kind in zip(arguments, handed, places, kinds, strict=True):
            if value is not before and not _hand_over(context, handed, place, value, kind):
                return kernel(*arguments)
        return program.launch_kernel(kept.machine, context)

    return launch


def _key(arguments):
    """Which argument tells launches apart that are kept side by side; None for one launch alone."""
    names = [argument.name for argument in arguments]
    return next((names.index(name) for name in KEYS if name in names), None)


def _kept(own, code, program, arguments, key):
    """The launch that a thread keeps for such a key; else a new one, or the one not used for longest."""
    launches = own.__dict__.get("launches")
    if launches is None:
        launches = own.launches = []
    elif launches and (launches[-1].code is not code or launches[-1].program is not program):
        launches.clear()
    if key is None and launches:
        return launches[0]
    for one in launches:  # the anchor whose turn it is was last heard longest ago
        if one.handed[key] is arguments[key]:
            launches.remove(one)
            break
    else:
        one = launches.pop(0) if len(launches) == MOST_KEPT else _Kept(code, program, len(arguments))
    launches.append(one)
    return one


class _Kept:
    """What one thread keeps of a kernel: machine code, a launch, and the arguments that this holds."""

    def __init__(self, code, program, count):
        self.code, self.program = code, program
        self.machine = program.compile_kernel(program.config(), program.get_device_caps(), code)
        self.context, self.handed = code.make_launch_context(), [NOTHING] * count


def _first(kernel, arguments):
    """The first launch of all; should it fail, once more with places of expressions in the complaint.

    What Taichi makes of a kernel's source stays, so collecting garbage meanwhile finds none.
    """
    with _one_at_a_time:
        collects = gc.isenabled()
        gc.disable()
        try:
            with _hurried():
                return kernel(*arguments)
        except (TypeError, ti.TaichiCompilationError):
            return kernel(*arguments)
        finally:
            if collects:
                gc.enable()


@contextmanager
def _hurried():
    """Keep Taichi from noting where expressions stand, and from looking for a function's source again.

    If it is one that does as known.
    """
    try:
        from taichi.lang import kernel_impl as reading
        from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext as Reader

        noted, found = Reader.get_pos_info, reading.getsourcelines
    except (AttributeError, ImportError):
        yield
        return
    Reader.get_pos_info = lambda reader, node: ""
    reading.getsourcelines = _sources(found)
    try:
        yield
    finally:
        Reader.get_pos_info, reading.getsourcelines = noted, found


@cache
def _sources(find):
    """The same, with what was found before kept."""
    return cache(find)


def _hand_over(context, handed, place, value, kind):
    """Put one argument into a launch; whether it is of the right kind."""
    number = place[0]
    handed[number] = NOTHING  # if an interrupt comes between, nothing is taken for handed over
    if type(value) is ndarray and type(kind) is tuple:
        if value.dtype is not kind[0] or value.ndim != kind[1] or not value.flags.c_contiguous:
            return False
        context.set_arg_external_array_with_shape(place, address(value), value.nbytes, value.shape, 0)
        handed[number] = value  # which keeps it where it is
    elif kind is float or kind is int:
        if type(value) is not kind:
            return False
        (context.set_arg_float if kind is float else context.set_arg_int)(place, value)
        handed[number] = value
    elif isinstance(value, ti.Ndarray) and (to_numpy_type(value.dtype), len(value.shape)) == kind:
        context.set_arg_ndarray(place, value.arr)
    else:
        return False
    return True


def _told(array):
    """Where an array's first entry is, as NumPy tells."""
    return array.__array_interface__["data"][0]


def _read(array):
    """The same in an eighth of the time: the pointer follows what every Python object begins with."""
    return c_void_p.from_address(id(array) + HEAD).value


_samples = [np.zeros(shape)[start:] for shape in (1, 7, (3, 4)) for start in (0, 1)]
address = _read if all(_read(sample) == _told(sample) for sample in _samples) else _told
"""Where an array's first entry is; read from the array wherever that proves right."""


def _kind(annotation):
    """Type and number of dimensions of an array; `int` or `float` for a number."""
    if isinstance(annotation, ti.types.ndarray):
        return np.dtype(to_numpy_type(annotation.dtype)), annotation.ndim
    return int if annotation in (ti.i32, ti.i64) else float
