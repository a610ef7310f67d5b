"""What depends on the device that Taichi runs on when the kernels are first imported."""

import taichi as ti

from gridslam.kernels.primitives import taichi_inside

ARCH = taichi_inside.architecture() if taichi_inside.is_running() else ti.cpu
ON_CPU = ARCH in (ti.x64, ti.arm64)

SPREAD = 512 if ON_CPU else 1
"""Loop items for a task that fills a thread: on the CPU, Taichi gives so many to one thread at least."""

TASKS = 16 if ON_CPU else 1 << 30
"""Tasks at most that a loop is cut into: each is `SPREAD` items, which take 1 us to walk through."""

WIDE = ON_CPU or ARCH == ti.cuda
"""Whether transcendental functions come in double precision; SPIR-V devices have them in single alone."""
