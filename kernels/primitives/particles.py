"""Particles and samples of the joint belief: mean and root of the covariance applied to normal points."""

import taichi as ti

from gridslam.kernels import PATH_BLOCK, STATE_GIVEN, TAKE_ROOT
from gridslam.kernels.primitives.functions import cos_of, sin_of, turn_of, wrapped
from gridslam.kernels.primitives.layout import CLOCKS, HEADING, lines_in

BLOCK = PATH_BLOCK


@ti.func
def row_of(entry, head, size):
    """Row of particles for an entry of a view: of three for a line, the angle's first and the offset's third.

    Velocities, which no path depends on, have none.
    """
    lines = lines_in(head, size)
    row = ti.select(entry < HEADING, entry, 2)
    row = ti.select(entry >= CLOCKS, 3 + 3 * lines + entry - CLOCKS, row)
    of_line = 3 + (entry - head) // 2 * 3 + (entry - head) % 2 * 2
    return ti.select(entry >= head, of_line, row)


@ti.func
def draw_block(
    at, head, root: ti.template(), base: ti.template(), points: ti.template(), state: ti.template()
):
    """Write the states ``base + root points`` of the particles from `at` on, lines by their normals."""
    size = root.shape[0]
    for row in range(size):
        if row != 2 and row != 3:
            gap = ti.Vector([0.0] * BLOCK)
            for quad in range((row + 1) // 4):  # four at a time: sums are stored a quarter as often
                n = 4 * quad
                a, b, c, d = root[row, n], root[row, n + 1], root[row, n + 2], root[row, n + 3]
                for i in range(BLOCK):
                    k = at + i
                    gap[i] += (
                        a * points[n, k] + b * points[n + 1, k] + c * points[n + 2, k] + d * points[n + 3, k]
                    )
            for n in range((row + 1) // 4 * 4, row + 1):
                a = root[row, n]
                for i in range(BLOCK):
                    gap[i] += a * points[n, at + i]
            mean, cosine, sine = base[row, 0], base[row, 1], base[row, 2]
            out = row_of(row, head, size)
            if row < head or (row - head) % 2 == 1:
                for i in range(BLOCK):
                    state[out, at + i] = mean + gap[i]
            else:
                x, y = ti.Vector([0.0] * BLOCK), ti.Vector([0.0] * BLOCK)
                for i in range(BLOCK):
                    c, s = turn_of(wrapped(gap[i]))
                    x[i], y[i] = cosine * c - sine * s, sine * c + cosine * s
                for i in range(BLOCK):
                    state[out, at + i] = x[i]
                for i in range(BLOCK):
                    state[out + 1, at + i] = y[i]


@ti.func
def ready(belief: ti.template(), head, share, offset, rooted, draft: ti.template()):
    """Take the root of a covariance (Cholesky's), and draw some exact samples with it.

    Arguments are those of `rays.list_paths`.
    """
    size, bad = (0 if rooted == STATE_GIVEN else belief.mean.shape[0]), 0
    for j in range(size if rooted == TAKE_ROOT else 0):
        for i in range(j):
            draft.whole[i, j] = 0.0
        for i in range(j, size):
            rest = belief.covariance[i, j]
            for k in range(j):
                rest -= draft.whole[i, k] * draft.whole[j, k]
            if i == j:
                if not (rest > 0):
                    bad, rest = 1, ti.f64(1.0)
                draft.whole[j, j] = ti.sqrt(rest)
            else:
                draft.whole[i, j] = rest / draft.whole[j, j]
    draft.failed[0] = bad
    for i in range(size):
        draft.base[i, 0] = ti.cast(belief.mean[i], ti.f32)
        draft.base[i, 1], draft.base[i, 2] = (
            ti.cast(cos_of(belief.mean[i]), ti.f32),
            ti.cast(sin_of(belief.mean[i]), ti.f32),
        )
        for j in range(size):
            draft.root[i, j] = ti.cast(share * draft.whole[i, j], ti.f32)
        for k in range(draft.state.shape[1] if i != 2 and i != 3 else 0):
            at, column = belief.mean[i], (offset + k) % draft.points.shape[1]
            for j in range(i + 1):
                at += draft.whole[i, j] * draft.points[j, column]
            out = row_of(i, head, size)
            if i < head or (i - head) % 2 == 1:
                draft.state[out, k] = at
            else:
                draft.state[out, k], draft.state[out + 1, k] = cos_of(at), sin_of(at)
