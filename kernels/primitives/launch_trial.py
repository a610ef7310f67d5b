"""A small kernel, and launches of it, by which quick launches are tried against Taichi's own."""

import numpy as np
import taichi as ti


def sample():
    """A kernel with arguments of all kinds."""

    @ti.kernel
    def small(
        anchor: ti.i32,
        factor: ti.f64,
        wide: ti.types.ndarray(dtype=ti.f64, ndim=2),
        thin: ti.types.argpack(
            narrow=ti.types.ndarray(dtype=ti.f32, ndim=1), whole=ti.types.ndarray(dtype=ti.i32, ndim=1)
        ),
        side: ti.types.ndarray(dtype=ti.types.vector(2, ti.f64), ndim=1),
        out: ti.types.ndarray(dtype=ti.f64, ndim=2),
    ):
        for i in range(wide.shape[0]):
            for j in range(wide.shape[1]):
                out[i, j] = anchor + factor * wide[i, j] + thin.narrow[j] * thin.whole[i] + side[i][1]

    return small


def attempts():
    """Arguments of launches one after the other: the same again, others, in turns, none, and views."""
    draw = np.random.default_rng(1)
    one, other, none = (
        (
            draw.normal(size=(n, m)),
            (draw.normal(size=m).astype(np.float32), np.arange(n, dtype=np.int32)),
            draw.normal(size=(n, 2)),
        )
        for n, m in ((3, 5), (4, 7), (0, 2))
    )
    fixed, part = (-one[0], *one[1:]), (one[0][1:], (one[1][0], one[1][1][1:]), one[2][1:])
    fixed[0].flags.writeable = False
    return [
        (1, 0.5, *one), (1, 0.5, *one), (2, 0.25, *one), (1, 0.5, *other), (2, 0.25, *one), (3, 2.0, *none),
        (1, -1.5, *fixed), (1, 0.5, *one), (300, 0.5, *part),
    ]  # fmt: skip
