"""Bundles: the rays of one path side by side, leg by leg, as lines over the columns of the grid.

Columns run along x, or along y where the rays rather go that way; "row" is the other coordinate. What is
known of each ray stands beside that of the others (in "lanes"), so that loops over them vectorise. From the
extremes of all of them at a leg's ends follows in which columns they cross the same cells.
"""

import taichi as ti

from gridslam.kernels.device import ON_CPU

LANES = 48 if ON_CPU else 1
"""Rays that are walked together: on the CPU they share its vectors, on a GPU they only filled registers."""
LINES, PLACES = 10, 18
"""Rows of `line` and `place`, which hold what is known of a bundle, one ray per column."""
FAR = 1 << 20
"""Number of a column or row where no grid reaches."""
BASE, SLOPE, LINE = 0, 1, 2
"""Rows of `line` for a leg, ``BASE + SLOPE u``, and their number; after all legs, `MET`."""
MET = 3 * LINE
"""First row of `line` for the chance that a bounce reflects, in V (2) and in messages (2)."""
FROM, TO, ENTRY, EXIT, LEG = range(5)
"""Rows of `place` for a leg: its first and its last column, the rows in which it begins and ends there; their
number. After all legs, `HIT`."""
HIT = 3 * LEG
"""First row of `place` for the cells met, three per bounce, as numbers or -1."""
NUDGE = 1e-9
"""Cells by which a ray is shifted so that it never runs through a corner: within that, rounding decides."""


@ti.func
def cell_of(x, origin, per_metre):
    """Index of the cell that holds a coordinate."""
    return ti.cast(ti.floor((x - origin) * per_metre), ti.i32)


@ti.func
def lay_legs(
    drawn: ti.template(), first, live, count, frame: ti.template(), slab, line: ti.template(),
    place: ti.template(),
):  # fmt: skip
    """Write the legs of all rays; return what the whole bundle has in common, by legs.

    That is: whether columns run along x; the first and the last column of any ray; the first and the last
    edge that all rays cross; lowest ray there and its slope, highest ray there and its slope.
    """
    plan, per_metre = ti.Matrix.zero(ti.f64, 3, 9), 1 / frame[2]
    for corner in range(count + 1):
        wide, tall = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        for k in range(first, first + live):
            wide += ti.abs(drawn[k, 2 * corner + 2] - drawn[k, 2 * corner])
            tall += ti.abs(drawn[k, 2 * corner + 3] - drawn[k, 2 * corner + 1])
        flat, own, leg = wide >= tall, corner * LINE, corner * LEG
        u, w = 2 * corner + (0 if flat else 1), 2 * corner + (1 if flat else 0)
        ou, ow = (frame[0] if flat else frame[1]), (frame[1] if flat else frame[0])
        begin, end, inner, outer = FAR, -FAR, -FAR, FAR
        for i in range(line.shape[2]):
            k, there = first + i, False
            if i < live:
                there = drawn[k, 12] > 0.5
            if there:
                u0, w0 = (drawn[k, u] - ou) * per_metre, (drawn[k, w] - ow) * per_metre
                u1, w1 = (drawn[k, u + 2] - ou) * per_metre, (drawn[k, w + 2] - ow) * per_metre
                # through a corner of cells, Amanatides and Woo's walk steps along y first
                nudge = NUDGE if (w1 >= w0 if flat else w0 >= w1) else -NUDGE
                if u1 < u0:
                    u0, u1 = u1, u0
                    w0, w1 = w1, w0
                slope = (w1 - w0) / (u1 - u0) if u1 - u0 > NUDGE else ti.cast(0.0, ti.f64)
                line[slab, own + SLOPE, i], line[slab, own + BASE, i] = slope, w0 - slope * u0 + nudge
                start, stop = ti.cast(ti.floor(u0), ti.i32), ti.cast(ti.floor(u1), ti.i32)
                place[slab, leg + FROM, i], place[slab, leg + TO, i] = start, stop
                place[slab, leg + ENTRY, i] = ti.cast(ti.floor(w0), ti.i32)
                place[slab, leg + EXIT, i] = ti.cast(ti.floor(w1), ti.i32)
                begin, end = ti.min(begin, start), ti.max(end, stop)
                inner, outer = ti.max(inner, start + 1), ti.min(outer, stop)
            else:  # comes to no column
                line[slab, own + SLOPE, i], line[slab, own + BASE, i] = 0.0, 0.0
                place[slab, leg + FROM, i], place[slab, leg + TO, i] = FAR, -FAR
                place[slab, leg + ENTRY, i], place[slab, leg + EXIT, i] = 0, 0
        lowest, highest = ti.cast(FAR, ti.f64), ti.cast(-FAR, ti.f64)
        lower, higher = ti.cast(FAR, ti.f64), ti.cast(-FAR, ti.f64)
        if outer > inner:
            for i in range(live):
                if place[slab, leg + FROM, i] < FAR:
                    slope, at = line[slab, own + SLOPE, i], line[slab, own + BASE, i]
                    one, other = at + slope * inner, at + slope * outer
                    lowest, highest = ti.min(lowest, one), ti.max(highest, one)
                    lower, higher = ti.min(lower, other), ti.max(higher, other)
        length = ti.max(outer - inner, 1)
        plan[corner, 0] = 1.0 if flat else 0.0
        plan[corner, 1], plan[corner, 2], plan[corner, 3], plan[corner, 4] = begin, end, inner, outer
        plan[corner, 5], plan[corner, 6] = lowest - NUDGE, (lower - lowest) / length
        plan[corner, 7], plan[corner, 8] = highest + NUDGE, (higher - highest) / length
    return plan


@ti.func
def meet_cells(
    drawn: ti.template(), first, live, count, frame: ti.template(), occupied: ti.template(), slab,
    line: ti.template(), place: ti.template(),
):  # fmt: skip
    """Write the cells H_b of all rays and their chance to reflect; return the cells' bounds, by bounces."""
    ny, nx, per_metre = occupied.shape[1], occupied.shape[2], 1 / frame[2]
    box = ti.Matrix([[FAR, -1, FAR, -1], [FAR, -1, FAR, -1]])
    for n in range(6):
        for i in range(line.shape[2]):
            place[slab, HIT + n, i] = -1
    for n in range(4):
        for i in range(line.shape[2]):
            line[slab, MET + n, i] = 1.0
    for i in range(live):
        k = first + i
        for b in range(count):
            if drawn[k, 12] > 0.5:
                clear_v, clear_m = ti.cast(1.0, ti.f64), ti.cast(1.0, ti.f64)
                inside = 0
                for n in range(3):
                    off = (n - 1) * frame[2]
                    ix = cell_of(drawn[k, 2 * b + 2] + off * drawn[k, 8 + 2 * b], frame[0], per_metre)
                    iy = cell_of(drawn[k, 2 * b + 3] + off * drawn[k, 9 + 2 * b], frame[1], per_metre)
                    if ix >= 0 and iy >= 0 and ix < nx and iy < ny:
                        cell, fresh = iy * nx + ix, 1
                        for other in range(n):
                            if place[slab, HIT + 3 * b + other, i] == cell:
                                fresh = 0
                        if fresh == 1:
                            place[slab, HIT + 3 * b + n, i] = cell
                            clear_v *= 1 - occupied[1, iy, ix]
                            clear_m *= 1 - occupied[0, iy, ix]
                            inside = 1
                            box[b, 0], box[b, 1] = ti.min(box[b, 0], ix), ti.max(box[b, 1], ix)
                            box[b, 2], box[b, 3] = ti.min(box[b, 2], iy), ti.max(box[b, 3], iy)
                line[slab, MET + b, i] = 1 - clear_v if inside == 1 else frame[3]
                line[slab, MET + 2 + b, i] = 1 - clear_m if inside == 1 else frame[3]
    return box
