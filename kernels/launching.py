"""Launches without Taichi's look at every argument, which takes longer than most of these kernels run.

A call of a `ti.kernel` inspects each array anew, some 25 us apiece. Once a kernel is compiled, `quick` checks
only what machine code relies on, and hands over the arrays' addresses.
"""

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
        Its arguments are arrays of given type and number of dimensions, and floats; it returns nothing.
    """
    primal = getattr(kernel, "_primal", None)
    if not all(hasattr(primal, name) for name in PRIVATE):
        return kernel  # a Taichi that keeps these elsewhere
    kinds = [_kind(argument.annotation) for argument in primal.arguments]

    @wraps(kernel)
    def launch(*arguments):
        compiled = primal.compiled_kernels
        if len(compiled) != 1 or not _fit(arguments, kinds):
            return kernel(*arguments)
        (code,) = compiled.values()
        program, context = primal.runtime.prog, code.make_launch_context()
        for place, value in enumerate(arguments):
            if kinds[place] is None:
                context.set_arg_float((place,), value)
            elif type(value) is not np.ndarray:
                context.set_arg_ndarray((place,), value.arr)
            else:
                address = value.__array_interface__["data"][0]
                context.set_arg_external_array_with_shape((place,), address, value.nbytes, value.shape, 0)
        machine = program.compile_kernel(program.config(), program.get_device_caps(), code)
        return program.launch_kernel(machine, context)

    return launch


def _kind(annotation):
    """Type and number of dimensions of an array; None for a float."""
    if isinstance(annotation, ti.types.ndarray):
        return np.dtype(to_numpy_type(annotation.dtype)), annotation.ndim
    return None


def _fit(arguments, kinds):
    """Whether machine code that was compiled for `kinds` may run on the arguments."""
    if len(arguments) != len(kinds):
        return False
    for value, kind in zip(arguments, kinds, strict=True):
        if kind is None:
            if type(value) is not float:
                return False
        elif type(value) is np.ndarray:
            if not (value.dtype == kind[0] and value.ndim == kind[1] and value.flags.c_contiguous):
                return False
        elif not (
            isinstance(value, ti.Ndarray)
            and to_numpy_type(value.dtype) == kind[0]
            and len(value.shape) == kind[1]
        ):
            return False
    return True
