"""Launches without Taichi's look at every argument, which takes longer than most of these kernels run.

A call of a `ti.kernel` inspects each array anew, some 25 us apiece. Once a kernel is compiled, `quick` checks
only what machine code relies on, and hands over the arrays' addresses.
"""

from ctypes import addressof, c_char
from functools import wraps

import numpy as np
import taichi as ti
from taichi.lang.util import to_numpy_type

PRIVATE = ("arguments", "compiled_kernels", "runtime")
"""What a kernel of Taichi 1.7 keeps of itself."""


def quick(kernel):
    """The same kernel, launched quickly; whatever isn't as it was compiled for goes Taichi's own way.

    Parameters
    ----------
    kernel : ti.kernel
        Its arguments are arrays of given type and number of dimensions, and numbers; it returns nothing.
    """
    primal = getattr(kernel, "_primal", None)
    if not all(hasattr(primal, name) for name in PRIVATE):
        return kernel  # a Taichi that keeps these elsewhere
    kinds = [_kind(argument.annotation) for argument in primal.arguments]

    @wraps(kernel)
    def launch(*arguments):
        compiled = primal.compiled_kernels
        if len(compiled) != 1 or len(arguments) != len(kinds):
            return kernel(*arguments)
        (code,) = compiled.values()
        program, context = primal.runtime.prog, code.make_launch_context()
        for place, value in enumerate(arguments):
            if not _hand_over(context, place, value, kinds[place]):
                return kernel(*arguments)
        machine = program.compile_kernel(program.config(), program.get_device_caps(), code)
        return program.launch_kernel(machine, context)

    return launch


def _hand_over(context, place, value, kind):
    """Put one argument into a launch; whether it is what machine code was compiled for."""
    if type(value) is np.ndarray:
        if (value.dtype, value.ndim) != kind or not value.flags.c_contiguous:
            return False
        context.set_arg_external_array_with_shape((place,), address(value), value.nbytes, value.shape, 0)
    elif kind is float or kind is int:
        if type(value) is not kind:
            return False
        (context.set_arg_float if kind is float else context.set_arg_int)((place,), value)
    elif isinstance(value, ti.Ndarray) and (to_numpy_type(value.dtype), len(value.shape)) == kind:
        context.set_arg_ndarray((place,), value.arr)
    else:
        return False
    return True


def address(array):
    """Where an array's first entry is; `ctypes` tells it in a third of the time that NumPy takes."""
    try:
        return addressof(c_char.from_buffer(array))
    except (BufferError, TypeError, ValueError):  # read-only or empty
        return array.__array_interface__["data"][0]


def _kind(annotation):
    """Type and number of dimensions of an array; `int` or `float` for a number."""
    if isinstance(annotation, ti.types.ndarray):
        return np.dtype(to_numpy_type(annotation.dtype)), annotation.ndim
    return int if annotation in (ti.i32, ti.i64) else float
