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
from gridslam.kernels.propagation.bundles import (
    FAR,
    LANES,
    OWN,
    cross_row,
    lay_leg,
    mark,
    meet_cells,
    rows_alone,
    spare,
    split,
    step_of,
)
from gridslam.kernels.propagation.coefficients import coefficient_product
from gridslam.kernels.propagation.occupancy import CELL_BITS
from gridslam.kernels.propagation.paths import draw_path
from gridslam.kernels.propagation.rays import list_and_predict


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
    """Log ratio of a path's message to a cell, eqs. (43)-(45), by its rays' sum and the cell's own three."""
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
            slab = item // SPREAD
            ny, nx = grid.where.shape[0], grid.where.shape[1]
            paths, rays = (listed.found[0] if draft.failed[0] == 0 else 0), draft.state.shape[1]
            row = slab
            while row < paths:
                count, a = listed.path[row, 0], casting.factor[row, 0]
                total, known, hits, possible = ti.f64(0.0), 0, 0, 0
                open_to, middle = ti.f64(0.0), ti.Vector([0.0, 0.0, 0.0, 0.0], dt=ti.f64)
                wanted = casting.products.shape[0] > 0 or casting.factor[row, 1] > 0.5
                for ray in range(rays if wanted else 0):
                    draw_path(draft.state, listed.path, places, row, ray, casting.drawn)
                    casting.drawn[row * rays + ray, 13] = 0.0
                    possible += ti.cast(casting.drawn[row * rays + ray, 12], ti.i32)
                    for n in ti.static(range(4)):
                        middle[n] += casting.drawn[row * rays + ray, 2 + n] / rays
                # a path that is worth the same whether blocked or not sends nothing
                send = casting.factor[row, 1] > 0.5 and a != 1.0 and possible > grid.frame[5] * rays
                for group in range((rays + LANES - 1) // LANES if possible > 0 else 0):
                    first, live = row * rays + group * LANES, ti.min(LANES, rays - group * LANES)
                    through, since = ti.Vector([1.0] * LANES), ti.Vector([0] * LANES)
                    low, high, enter = ti.Vector([0] * LANES), ti.Vector([0] * LANES), ti.Vector([0] * LANES)
                    part, rise, rest = ti.Vector([0] * LANES), ti.Vector([0] * LANES), ti.Vector([0] * LANES)
                    start, stop = ti.Vector([0] * LANES), ti.Vector([0] * LANES)
                    entry, leave = ti.Vector([0] * LANES), ti.Vector([0] * LANES)
                    origin = ti.Vector([0.0] * LANES, dt=ti.f64)
                    slope = ti.Vector([0.0] * LANES, dt=ti.f64)
                    meet_cells(
                        casting.drawn,
                        first,
                        live,
                        count,
                        grid.frame,
                        nx,
                        grid.occupied,
                        slab,
                        slabs.line,
                        slabs.place,
                    )
                    mark(slabs.place, slab, live, 1, slabs.met)
                    common, passed = ti.f64(1.0), ti.f32(0.0)
                    for walk in range(2 if send else 1):  # 0: V; 1: add it to the cells
                        for corner in range(count + 1 if walk == 0 or passed > 0 else 0):
                            plan = lay_leg(
                                casting.drawn,
                                first,
                                live,
                                corner,
                                count,
                                grid.frame,
                                origin,
                                slope,
                                start,
                                stop,
                                entry,
                                leave,
                            )
                            step_of(slope, rise, rest)
                            flat = plan[0] > 0.5
                            columns, rows = (nx if flat else ny), (ny if flat else nx)
                            along, across = (1 if flat else nx), (nx if flat else 1)
                            begin = ti.max(ti.cast(plan[1], ti.i32), 0)
                            end = ti.min(ti.cast(plan[2], ti.i32), columns - 1)
                            inner, outer = plan[3], plan[4]
                            fresh, same, was = False, False, 0
                            for c in range(begin, end + 1):
                                # between the extremes of the rays at both ends there is no other row
                                past = c + 1 - inner
                                least = ti.floor(plan[5] + past * plan[6])
                                most = ti.floor(plan[7] + past * plan[8])
                                one = least == most and past >= 0 and c + 1 <= outer
                                will = ti.cast(least, ti.i32)
                                lowest, highest = ti.max(ti.min(was, will), 0), ti.max(was, will)
                                highest = ti.min(highest, rows - 1)
                                together = same and one and highest - lowest < 2
                                if together and lowest <= highest:  # a cell that a ray meets is looked at
                                    cell = c * along + lowest * across
                                    beyond = c * along + highest * across
                                    together = slabs.met[slab, cell] == 0 and slabs.met[slab, beyond] == 0
                                if ti.static(LANES == 1):
                                    together = True
                                    lowest, highest = rows_alone(c, origin, slope, start, stop, entry, leave)
                                    lowest, highest = ti.max(lowest, 0), ti.min(highest, rows - 1)
                                if together:
                                    fresh = False
                                    for r in range(lowest, highest + 1):
                                        cell, spared = c * along + r * across, False
                                        if ti.static(LANES == 1):
                                            spared = slabs.met[slab, cell] != 0
                                        if not spared:
                                            if walk == 0:
                                                common *= 1 - ti.cast(grid.occupied[0, cell], ti.f64)
                                            else:
                                                known = crossed(
                                                    slab, cell, passed, slabs.sums, slabs.touched, known
                                                )
                                else:
                                    if not fresh:
                                        split(origin, slope, c, enter, part)
                                    fresh = True
                                    bottom, top = FAR, -FAR
                                    for i in range(LANES):
                                        ahead = part[i] + rest[i]  # less than before where a row is full
                                        follows = enter[i] + rise[i] + ti.select(ahead < part[i], 1, 0)
                                        goes = ti.select(c >= stop[i], leave[i], follows)
                                        came = ti.select(c <= start[i], entry[i], enter[i])
                                        here = (c >= start[i]) & (c <= stop[i])
                                        below = ti.select(here, ti.min(came, goes), FAR)
                                        above = ti.select(here, ti.max(came, goes), -FAR)
                                        low[i], high[i], enter[i], part[i] = below, above, follows, ahead
                                        bottom, top = ti.min(bottom, below), ti.max(top, above)
                                    for r in range(ti.max(bottom, 0), ti.min(top, rows - 1) + 1):
                                        cell, add = c * along + r * across, 0.0
                                        free = 1 - grid.occupied[0, cell]
                                        if slabs.met[slab, cell] == 0:
                                            add = cross_row(walk, r, low, high, free, through)
                                        else:  # rays that meet a cell don't traverse it
                                            spare(slabs.place, slab, cell, low, since)
                                            add = cross_row(walk, r, since, high, free, through)
                                        if walk == 1:
                                            known = crossed(slab, cell, add, slabs.sums, slabs.touched, known)
                                same, was = one, will
                        if walk == 0:
                            for i in range(live):
                                k, v = first + i, ti.f64(0.0)
                                if casting.drawn[k, 12] > 0.5:
                                    v = through[i] * common
                                    casting.drawn[k, 13] = v * slabs.line[slab, 0, i] * slabs.line[slab, 1, i]
                                    open_to += casting.drawn[k, 13]
                                    v *= slabs.line[slab, OWN, i] * slabs.line[slab, OWN + 1, i]
                                total += v * a + 1 - v
                                through[i] = ti.cast(v, ti.f32)
                                passed += through[i]
                    mark(slabs.place, slab, live, 0, slabs.met)
                    if send:
                        for i in range(live):
                            for b in range(count):
                                v, own = ti.cast(through[i], ti.f64), slabs.line[slab, OWN + b, i]
                                v1 = v / ti.max(own, 1e-12)
                                for n in range(3 * b, 3 * b + 3):
                                    cell = slabs.place[slab, n, i]
                                    if cell >= 0 and v > 0:
                                        v0 = v1 * (1 - (1 - own) / (1 - grid.occupied[0, cell]))
                                        hits = lifted(
                                            slab, cell, (v0 - v) * (a - 1), (v1 - v) * (a - 1), slabs.sums,
                                            slabs.touched, hits,
                                        )  # fmt: skip
                casting.seen[row, 0], casting.seen[row, 1] = (
                    open_to / ti.max(possible, 1),
                    possible / ti.cast(rays, ti.f64),
                )
                for n in ti.static(range(4)):
                    casting.seen[row, 2 + n] = middle[n]
                if casting.products.shape[0] > 0:
                    coefficient_product(
                        casting.drawn,
                        listed.path,
                        grid.where,
                        grid.held,
                        grid.reflection,
                        grid.frame,
                        row,
                        rays,
                        casting.products,
                    )
                settle(
                    slab,
                    known,
                    hits,
                    total,
                    a,
                    grid.frame[4],
                    grid.occupied,
                    slabs.sums,
                    slabs.touched,
                    slabs.message,
                    slabs.news,
                )
                row += slabs.message.shape[0]
