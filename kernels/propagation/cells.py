"""Ray casting through grid cells and the messages to cells ([Li2026grid], eqs. (1), (2), (14), (43)-(45)).

A ray is the polyline anchor, interaction points, agent. It traverses cells T and meets cells H_b at
bounce b. The rays of one path run side by side, so they are walked together (`bundles`). Every slab
handles a fixed set of paths in order, so sums do not depend on the number of threads.

A message is a ratio of two means over a path's rays, in which a ray that doesn't touch the cell counts
alike. A crossed cell needs only the sum of V over the rays that cross it; a met cell the two lifts of its
own states above that. So a ray is walked twice at most: for V, and to add V to its cells.
"""

import taichi as ti

from gridslam.kernels.primitives.blocks import Belief, Casting, Cells, Draft, Links, Listed, Query, Slabs
from gridslam.kernels.primitives.device import ON_CPU, SPREAD
from gridslam.kernels.primitives.functions import log_of
from gridslam.kernels.primitives.launching import copying
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.tables import (
    BOUNCES,
    CLIP,
    LEAST,
    MEAN_CORNERS,
    MEAN_VALIDITY,
    MESSAGE,
    RAY_POSSIBLE,
    SENDS,
    SHARE_POSSIBLE,
    VALIDITY,
)
from gridslam.kernels.propagation.bundles import (
    ALONG_X,
    BEGIN,
    END,
    LANES,
    OWN,
    Front,
    Leg,
    advance,
    cross_row,
    lay_leg,
    leave_together,
    mark,
    meet_cells,
    rows_alone,
    set_pace,
    spare,
    split,
)
from gridslam.kernels.propagation.coefficients import coefficient_product
from gridslam.kernels.propagation.occupancy import CELL_BITS
from gridslam.kernels.propagation.paths import draw_path
from gridslam.kernels.propagation.rays import list_and_predict

TOTAL, OPEN_TO = 0, 1
"""Sums over the rays of a path: of ``V A + 1 - V``, and of V with chances to reflect as in eq. (1)."""


@ti.func
def crossed(slab, cell, add, sums: ti.template(), touched: ti.template(), count):
    """Add the V of rays that cross a cell, for eq. (43); return how many cells of the path are listed."""
    before, more = sums[3 * slab, cell], ti.cast(add, ti.f32)
    touched[2 * slab, count] = cell
    # read, then written: an addition in place would be atomic
    sums[3 * slab, cell] = before + more
    return count + ti.select((before == 0.0) & (more > 0.0), 1, 0)


@ti.func
def lifted(slab, cell, low, high, sums: ti.template(), touched: ti.template(), count):
    """Add the lifts of a ray that meets a cell, for eq. (44); they may cancel, so it is listed again."""
    n, row, one, two = count, 3 * slab, ti.cast(low, ti.f32), ti.cast(high, ti.f32)
    before1, before2 = sums[row + 1, cell], sums[row + 2, cell]
    fresh = (before1 == 0.0) & (before2 == 0.0) & ((one != 0.0) | (two != 0.0))
    if fresh and n < touched.shape[1]:
        touched[2 * slab + 1, n] = cell
        n += 1
    sums[row + 1, cell], sums[row + 2, cell] = before1 + one, before2 + two
    return n


@ti.func
def ratio_of(total, a, occupied, through, low, high):
    """Log ratio of a path's message to a cell, eqs. (43)-(45).

    `total` is the sum over the path's rays of ``V A + 1 - V``, `through` that of V over those that cross the
    cell, `low` and `high` are the lifts of those that meet it, if it is free and if it is occupied, and
    `occupied` is how likely that was.
    """
    lift, free = (a - 1) * through, 1 - occupied
    # both times 1 - o, since divisions take long
    if_free = ti.max((total + low) * free + lift * occupied, 1e-12)
    if_occupied = ti.max((total - lift + high) * free, 1e-12)
    t = ti.cast((if_occupied - if_free) / (if_occupied + if_free), ti.f32)
    s = t * t
    ratio = 2 * t * (1 + s * (1 / 3 + s * (0.2 + s * (1 / 7 + s * (1 / 9 + s / 11)))))
    if s > 0.11:  # a ratio beyond 1 to 2
        ratio = log_of(ti.cast(ti.min(if_occupied / if_free, 1e30), ti.f32))
    return ratio


@ti.func
def settle(
    slab, known, hits, total, a, clip, occupied: ti.template(), sums: ti.template(), touched: ti.template(),
    message: ti.template(), news: ti.template(),
):  # fmt: skip
    """Send messages to the cells that a path touches, and clear their sums: met cells, then the others.

    [Li2026grid], section III-H: of sums over all rays, then added to those of other paths and anchors.
    """
    row, most = 3 * slab, ti.cast(clip, ti.f32)
    for n in range(hits + known):
        cell = touched[2 * slab + 1, n] if n < hits else touched[2 * slab, n - hits]
        o, low, high = ti.cast(occupied[0, cell], ti.f64), ti.f64(0.0), ti.f64(0.0)
        if n < hits:
            low, high = sums[row + 1, cell], sums[row + 2, cell]
            sums[row + 1, cell], sums[row + 2, cell] = 0.0, 0.0
        ratio = ratio_of(total, a, o, sums[row, cell], low, high)
        sums[row, cell] = 0.0  # the message is 0 if the cell is listed again
        before = message[slab, cell]  # a slab has one thread, so nothing need be atomic
        message[slab, cell] = before + ti.max(-most, ti.min(ratio, most))
        news[slab, cell >> CELL_BITS] = ti.cast(1, ti.u8)


@ti.func
def draw_rays(
    row, rays, places: ti.template(), draft: ti.template(), listed: ti.template(), drawn: ti.template(),
    middle: ti.template(),
):  # fmt: skip
    """Draw the rays of a path, and add up the mean of their first and second corners; return at how many of
    their states the path is possible."""
    possible = 0
    for ray in range(rays):
        draw_path(draft.state, listed.path, places, row, ray, drawn)
        drawn[row * rays + ray, VALIDITY] = 0.0
        possible += ti.cast(drawn[row * rays + ray, RAY_POSSIBLE], ti.i32)
        for n in ti.static(range(4)):
            middle[n] += drawn[row * rays + ray, 2 + n] / rays
    return possible


@ti.func
def cross_leg(
    walk, plan, passed, slab, leg: ti.template(), front: ti.template(), grid: ti.template(),
    slabs: ti.template(), through: ti.template(), common: ti.template(), known: ti.template(),
):  # fmt: skip
    """Take a bundle along one leg through the cells T that it crosses, column by column.

    On the first walk ``1 - o`` of every cell goes into V: into `common` where all rays cross it, else into
    `through` of those that do. On the second, V is added to the cells.
    """
    ny, nx = grid.where.shape[0], grid.where.shape[1]
    flat = plan[ALONG_X] > 0.5
    columns, rows = (nx if flat else ny), (ny if flat else nx)
    along, across = (1 if flat else nx), (nx if flat else 1)
    begin, end = ti.max(ti.cast(plan[BEGIN], ti.i32), 0), ti.min(ti.cast(plan[END], ti.i32), columns - 1)
    set_pace(leg, front)
    apart, same, was = False, False, 0
    for c in range(begin, end + 1):
        will, one = leave_together(plan, c)
        lowest, highest = ti.max(ti.min(was, will), 0), ti.min(ti.max(was, will), rows - 1)
        together = same and one and highest - lowest < 2
        if together and lowest <= highest:  # a cell that a ray meets is looked at
            cell, beyond = c * along + lowest * across, c * along + highest * across
            together = slabs.met[slab, cell] == 0 and slabs.met[slab, beyond] == 0
        if ti.static(LANES == 1):
            together = True
            lowest, highest = rows_alone(c, leg)
            lowest, highest = ti.max(lowest, 0), ti.min(highest, rows - 1)
        if together:
            for r in range(lowest, highest + 1):
                cell, spared = c * along + r * across, False
                if ti.static(LANES == 1):
                    spared = slabs.met[slab, cell] != 0
                if not spared:
                    if walk == 0:
                        common *= 1 - ti.cast(grid.occupied[0, cell], ti.f64)
                    else:
                        known = crossed(slab, cell, passed, slabs.sums, slabs.touched, known)
        else:
            if not apart:
                split(leg.base, leg.slope, c, front.row, front.part)
            bottom, top = advance(c, leg, front)
            for r in range(ti.max(bottom, 0), ti.min(top, rows - 1) + 1):
                cell, add = c * along + r * across, 0.0
                free = 1 - grid.occupied[0, cell]
                if slabs.met[slab, cell] == 0:
                    add = cross_row(walk, r, front.low, front.high, free, through)
                else:  # rays that meet a cell don't traverse it
                    spare(slabs.place, slab, cell, front.low, front.since)
                    add = cross_row(walk, r, front.since, front.high, free, through)
                if walk == 1:
                    known = crossed(slab, cell, add, slabs.sums, slabs.touched, known)
        apart, same, was = not together, one, will


@ti.func
def open_rays(
    first, live, a, common, slab, drawn: ti.template(), line: ti.template(), through: ti.template(),
    sums: ti.template(),
):  # fmt: skip
    """Write V of a bundle's rays, eqs. (1) and (14), and add to `sums` over all rays of the path.

    `through` is what comes through the cells they don't share; afterwards, V as in messages, whose sum is
    returned.
    """
    passed = ti.f32(0.0)
    for i in range(live):
        v = ti.f64(0.0)
        if drawn[first + i, RAY_POSSIBLE] > 0.5:
            v = through[i] * common
            drawn[first + i, VALIDITY] = v * line[slab, 0, i] * line[slab, 1, i]
            sums[OPEN_TO] += drawn[first + i, VALIDITY]
            v *= line[slab, OWN, i] * line[slab, OWN + 1, i]
        sums[TOTAL] += v * a + 1 - v
        through[i] = ti.cast(v, ti.f32)
        passed += through[i]
    return passed


@ti.func
def lift_met(
    live, count, a, slab, through: ti.template(), grid: ti.template(), slabs: ti.template(),
    hits: ti.template(),
):  # fmt: skip
    """Add what the cells H_b would make of V if they were free, or occupied, eq. (44)."""
    for i in range(live):
        for b in range(count):
            v, own = ti.cast(through[i], ti.f64), slabs.line[slab, OWN + b, i]
            v1 = v / ti.max(own, 1e-12)
            for n in range(3 * b, 3 * b + 3):
                cell = slabs.place[slab, n, i]
                if cell >= 0 and v > 0:
                    v0 = v1 * (1 - (1 - own) / (1 - grid.occupied[0, cell]))
                    low, high = (v0 - v) * (a - 1), (v1 - v) * (a - 1)
                    hits = lifted(slab, cell, low, high, slabs.sums, slabs.touched, hits)


@ti.func
def cast_bundle(
    first, live, count, a, send, slab, grid: ti.template(), casting: ti.template(), slabs: ti.template(),
    sums: ti.template(), known: ti.template(), hits: ti.template(),
):  # fmt: skip
    """Cast `live` rays of a path side by side, from row `first` of `drawn` on, and sum up over them."""
    leg, front, through = Leg(), Front(), ti.Vector([1.0] * LANES)
    meet_cells(
        casting.drawn, first, live, count, grid.frame, grid.where.shape[1], grid.occupied, slab, slabs.line,
        slabs.place,
    )  # fmt: skip
    mark(slabs.place, slab, live, 1, slabs.met)
    common, passed = ti.f64(1.0), ti.f32(0.0)
    for walk in range(2 if send else 1):  # 0: V; 1: add it to the cells
        for corner in range(count + 1 if walk == 0 or passed > 0 else 0):
            plan = lay_leg(casting.drawn, first, live, corner, count, grid.frame, leg)
            cross_leg(walk, plan, passed, slab, leg, front, grid, slabs, through, common, known)
        if walk == 0:
            passed = open_rays(first, live, a, common, slab, casting.drawn, slabs.line, through, sums)
    mark(slabs.place, slab, live, 0, slabs.met)
    if send:
        lift_met(live, count, a, slab, through, grid, slabs, hits)


@ti.func
def cast_path(
    row, slab, places: ti.template(), draft: ti.template(), listed: ti.template(), grid: ti.template(),
    casting: ti.template(), slabs: ti.template(),
):  # fmt: skip
    """Draw and cast the rays of one path, bundle by bundle, and send its messages to the cells."""
    rays, count, a = draft.state.shape[1], listed.path[row, BOUNCES], casting.factor[row, MESSAGE]
    possible, middle = 0, ti.Vector([0.0, 0.0, 0.0, 0.0], dt=ti.f64)
    if casting.products.shape[0] > 0 or casting.factor[row, SENDS] > 0.5:
        possible = draw_rays(row, rays, places, draft, listed, casting.drawn, middle)
    # a path that is worth the same whether blocked or not sends nothing
    send = casting.factor[row, SENDS] > 0.5 and a != 1.0 and possible > grid.frame[LEAST] * rays
    sums, known, hits = ti.Vector([0.0, 0.0], dt=ti.f64), 0, 0
    for group in range((rays + LANES - 1) // LANES if possible > 0 else 0):
        first, live = row * rays + group * LANES, ti.min(LANES, rays - group * LANES)
        cast_bundle(first, live, count, a, send, slab, grid, casting, slabs, sums, known, hits)
    casting.seen[row, MEAN_VALIDITY] = sums[OPEN_TO] / ti.max(possible, 1)
    casting.seen[row, SHARE_POSSIBLE] = possible / ti.cast(rays, ti.f64)
    for n in ti.static(range(4)):
        casting.seen[row, MEAN_CORNERS + n] = middle[n]
    if casting.products.shape[0] > 0:
        coefficient_product(
            casting.drawn, listed.path, grid.where, grid.held, grid.reflection, grid.frame, row, rays,
            casting.products,
        )  # fmt: skip
    settle(
        slab, known, hits, sums[TOTAL], a, grid.frame[CLIP], grid.occupied, slabs.sums, slabs.touched,
        slabs.message, slabs.news,
    )  # fmt: skip


@copying("belief", "links", "reflection")
@ti.kernel
def cast(
    query: pack(Query),
    belief: pack(Belief),
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 6] anchors: see `blocks`
    links: pack(Links),
    draft: pack(Draft),
    listed: pack(Listed),
    grid: pack(Cells),
    casting: pack(Casting),
    slabs: pack(Slabs),
):
    """List and predict paths; cast the rays of all; add the log ratios to `message` of those that send.

    [Li2026grid], eqs. (1), (14), (43) to (45). Nothing is cast if no root of the covariance was found.
    A path sends only if it is possible at more than the least share of its states; an impossible ray has V 0.
    Beliefs about coefficients where rays meet walls are written if `products` has rows; if not, paths that
    aren't to send aren't cast, and count as impossible.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        if ti.static(ON_CPU):  # Taichi's SPIR-V compiler can't take both in one: see `Cells`
            list_and_predict(query, belief, places, links, draft, listed)
    for item in range(slabs.message.shape[0] * SPREAD):
        if item % SPREAD == 0:
            row = item // SPREAD
            while row < (listed.found[0] if draft.failed[0] == 0 else 0):
                cast_path(row, item // SPREAD, places, draft, listed, grid, casting, slabs)
                row += slabs.message.shape[0]
