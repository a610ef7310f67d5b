"""What depends on the device that Taichi runs on when the kernels are first imported."""

import taichi as ti

ARCH = ti.lang.impl.current_cfg().arch if ti.lang.impl.get_runtime().prog is not None else ti.cpu
ON_CPU = ARCH in (ti.x64, ti.arm64)

SPREAD = 512 if ON_CPU else 1
"""Loop items for a task that fills a thread: on the CPU, Taichi gives so many to one thread at least."""

WIDE = ON_CPU or ARCH == ti.cuda
"""Whether transcendental functions come in double precision; SPIR-V devices have them in single alone."""
