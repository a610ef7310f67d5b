"""Bundles: the rays of one path side by side, leg by leg, as lines over the columns of the grid.

Columns run along x, or along y where the rays rather go that way; "row" is the other coordinate. What is
known of each ray stands beside that of the others (in "lanes"), of a leg on the stack, so that loops over
them vectorise. From their extremes at a leg's ends follows in which columns all cross the same cells.
"""

import taichi as ti

from gridslam.kernels.primitives.device import ON_CPU
from gridslam.kernels.primitives.tables import NORMAL, ORIGIN_X, ORIGIN_Y, OUTSIDE, RAY_POSSIBLE, SIDE, SPARED

LANES = 48 if ON_CPU else 1
"""Rays that are walked together: on the CPU they share its vectors, on a GPU they only filled registers."""
LINES, PLACES = 4, 6
"""Rows of `line` and of `place`, which hold what rays meet, one ray per column."""
OWN = 2
"""First row of `line` for the chance that a bounce reflects in messages; before it, in V, by bounces. Rows of
`place` are the cells met, three per bounce, as numbers or -1."""
ALONG_X, BEGIN, END, INNER, OUTER, BELOW, BELOW_RISE, ABOVE, ABOVE_RISE = range(9)
"""What the rays of a leg have in common: whether columns run along x; the first and the last column of any
ray; the first and the last edge that all rays cross; a row that is below all rays there and its slope, one
above and its slope."""
FAR = 1 << 20
"""Number of a column or row where no grid reaches."""
NUDGE = 1e-8
"""Cells by which a ray is shifted so that it doesn't begin on a corner of cells, or run along an edge. Which
cells it crosses at a corner that it passes within 1e-6 cells is left to rounding."""
PARTS, MOST, SIGN = 4294967296.0, 2147483647.0, -2147483648
"""Parts of a row that are counted along rays' lines, and bounds of what counts them. Whole numbers vectorise
twice as wide as double precision; a line is off by one part per column at most, 2e-7 rows after 1000."""
FINE, UTMOST = 256.0, 1 << 30
"""Parts of a row in which extremes are taken (of whole numbers they vectorise), and more of them than any
grid has."""


def leg_of(lanes: int) -> ti.types.struct:
    """One leg of `lanes` rays: lines ``base + slope u``, first and last columns, rows in which they begin and
    end there."""
    reals, wholes = ti.types.vector(lanes, ti.f64), ti.types.vector(lanes, ti.i32)
    return ti.types.struct(
        base=reals, slope=reals, start=wholes, stop=wholes, entry=wholes, leave=wholes
    )  # fmt: skip


def front_of(lanes: int) -> ti.types.struct:
    """How far `lanes` rays have come: row in which they enter a column and part of one, rows and part by
    which they rise per column, lowest and highest row that they cross in it, and lowest but for a cell that
    they meet."""
    wholes = ti.types.vector(lanes, ti.i32)
    return ti.types.struct(
        row=wholes, part=wholes, rise=wholes, rest=wholes, low=wholes, high=wholes, since=wholes
    )  # fmt: skip


Leg, Front, LoneLeg = leg_of(LANES), front_of(LANES), leg_of(1)


@ti.func
def spare_wall(drawn: ti.template(), k, corner, bounces, x, y, depth):
    """Shares of a leg (x, y) at its start and its end that are nearer than `depth` to a wall it meets there.

    Before a ray meets a wall it runs beside it, the flatter the longer, through cells that hold it, too.
    """
    early, late = ti.f64(0.0), ti.f64(0.0)
    if corner > 0:
        met = NORMAL + 2 * (corner - 1)
        rise = ti.abs(drawn[k, met] * x + drawn[k, met + 1] * y)
        early = depth / ti.max(rise, 1e-9)
    if corner < bounces:
        met = NORMAL + 2 * corner
        rise = ti.abs(drawn[k, met] * x + drawn[k, met + 1] * y)
        late = depth / ti.max(rise, 1e-9)
    return early, late


@ti.func
def lay_leg(
    drawn: ti.template(), first, live, corner, bounces, frame: ti.template(), leg: ti.template()
):  # fmt: skip
    """Write one leg of all rays; return what the bundle has in common, in the order of `ALONG_X`."""
    lanes = ti.static(leg.base.n)
    per_metre, there, skipped = 1 / frame[SIDE], ti.Vector([0] * lanes), False
    ax, ay = ti.Vector([0.0] * lanes, dt=ti.f64), ti.Vector([0.0] * lanes, dt=ti.f64)
    bx, by = ti.Vector([0.0] * lanes, dt=ti.f64), ti.Vector([0.0] * lanes, dt=ti.f64)
    for i in range(live):
        k = first + i
        ax[i], ay[i] = drawn[k, 2 * corner], drawn[k, 2 * corner + 1]
        bx[i], by[i] = drawn[k, 2 * corner + 2], drawn[k, 2 * corner + 3]
        there[i] = ti.cast(drawn[k, RAY_POSSIBLE], ti.i32)
        if frame[SPARED] > 0.0:
            x, y = bx[i] - ax[i], by[i] - ay[i]
            early, late = spare_wall(drawn, k, corner, bounces, x, y, frame[SPARED])
            if early + late < 1:
                ax[i], ay[i] = ax[i] + early * x, ay[i] + early * y
                bx[i], by[i] = bx[i] - late * x, by[i] - late * y
            else:
                skipped = skipped or there[i] > 0
                there[i] = 0
    wide, tall = ti.f64(0.0), ti.f64(0.0)
    for i in range(lanes):
        wide += ti.abs(bx[i] - ax[i])
        tall += ti.abs(by[i] - ay[i])
    flat = wide >= tall
    ou, ow = (frame[ORIGIN_X] if flat else frame[ORIGIN_Y]), (frame[ORIGIN_Y] if flat else frame[ORIGIN_X])
    begin, end, inner, outer = FAR, -FAR, -FAR, FAR
    for i in range(lanes):
        u0, w0 = ti.select(flat, ax[i], ay[i]), ti.select(flat, ay[i], ax[i])
        u1, w1 = ti.select(flat, bx[i], by[i]), ti.select(flat, by[i], bx[i])
        u0, w0 = (u0 - ou) * per_metre, (w0 - ow) * per_metre
        u1, w1 = (u1 - ou) * per_metre, (w1 - ow) * per_metre
        # through a corner of cells, the walk of [Amanatides1987voxel] steps along y first
        up = ti.select(flat, w1 - w0, w0 - w1) >= 0
        back = u1 < u0
        low, high = ti.select(back, u1, u0), ti.select(back, u0, u1)
        under, over = ti.select(back, w1, w0), ti.select(back, w0, w1)
        along = high - low
        leg.slope[i] = ti.select(along > NUDGE, (over - under) / ti.max(along, NUDGE), 0.0)
        leg.base[i] = under - leg.slope[i] * low + ti.select(up, NUDGE, -NUDGE)
        one, other = ti.cast(ti.floor(low), ti.i32), ti.cast(ti.floor(high), ti.i32)
        is_there = there[i] > 0  # else it comes to no column
        leg.start[i], leg.stop[i] = ti.select(is_there, one, FAR), ti.select(is_there, other, -FAR)
        leg.entry[i], leg.leave[i] = ti.cast(ti.floor(under), ti.i32), ti.cast(ti.floor(over), ti.i32)
        begin, end = ti.min(begin, leg.start[i]), ti.max(end, leg.stop[i])
        inner = ti.max(inner, ti.select(is_there, one + 1, -FAR))
        outer = ti.min(outer, ti.select(is_there, other, FAR))
    if skipped:  # there is no edge that all rays cross
        inner, outer = FAR, -FAR
    lowest, highest, lower, higher = UTMOST, -UTMOST, UTMOST, -UTMOST
    if ti.static(lanes > 1) and outer > inner:
        for i in range(lanes):
            one = ti.cast(ti.floor((leg.base[i] + leg.slope[i] * inner) * FINE), ti.i32)
            other = ti.cast(ti.floor((leg.base[i] + leg.slope[i] * outer) * FINE), ti.i32)
            is_there = there[i] > 0
            lowest = ti.min(lowest, ti.select(is_there, one, UTMOST))
            highest = ti.max(highest, ti.select(is_there, one, -UTMOST))
            lower = ti.min(lower, ti.select(is_there, other, UTMOST))
            higher = ti.max(higher, ti.select(is_there, other, -UTMOST))
    one, part = (
        ti.f64(1.0),
        ti.cast(1 / FINE, ti.f64),
    )  # whole numbers alone would give single precision
    per_column = part / ti.max(outer - inner, 1)
    return ti.Vector([
        ti.select(flat, one, 0.0), begin, end, inner, outer,
        lowest * part - NUDGE, (lower - lowest) * per_column,
        (highest + 1) * part + NUDGE, (higher - highest) * per_column,
    ], dt=ti.f64)  # fmt: skip


@ti.func
def split(base: ti.template(), slope: ti.template(), c, row: ti.template(), part: ti.template()):
    """Rows in which lines come to an edge of a column, and parts of those below, less half of all."""
    for i in range(LANES):
        at = base[i] + slope[i] * c
        whole = ti.floor(at)
        parts = ti.floor((at - whole - 0.5) * PARTS + 0.5)
        whole -= PARTS * ti.floor(whole / PARTS + 0.5)  # steep lines are far off there; rows wrap around
        row[i], part[i] = ti.cast(whole, ti.i32), ti.cast(ti.min(parts, MOST), ti.i32)


@ti.func
def set_pace(leg: ti.template(), front: ti.template()):
    """Write the rows by which lines rise per column, and parts of one, modulo all of them."""
    split(leg.slope, leg.slope, 0, front.rise, front.rest)
    for i in range(LANES):
        front.rest[i] = front.rest[i] ^ SIGN  # adds the half that was taken off


@ti.func
def advance(c, leg: ti.template(), front: ti.template()):
    """Take rays through column `c`; return the lowest and the highest row that any crosses in it."""
    bottom, top = FAR, -FAR
    for i in range(LANES):
        ahead = front.part[i] + front.rest[i]  # less than before where a row is full
        follows = front.row[i] + front.rise[i] + ti.select(ahead < front.part[i], 1, 0)
        goes = ti.select(c >= leg.stop[i], leg.leave[i], follows)
        came = ti.select(c <= leg.start[i], leg.entry[i], front.row[i])
        here = (c >= leg.start[i]) & (c <= leg.stop[i])
        below = ti.select(here, ti.min(came, goes), FAR)
        above = ti.select(here, ti.max(came, goes), -FAR)
        front.low[i], front.high[i], front.row[i], front.part[i] = below, above, follows, ahead
        bottom, top = ti.min(bottom, below), ti.max(top, above)
    return bottom, top


@ti.func
def leave_together(plan, c):
    """Row in which rays leave column `c`, and whether it is one of all: between their extremes at both ends
    there is no other."""
    past = c + 1 - plan[INNER]
    least = ti.floor(plan[BELOW] + past * plan[BELOW_RISE])
    most = ti.floor(plan[ABOVE] + past * plan[ABOVE_RISE])
    return ti.cast(least, ti.i32), least == most and past >= 0 and c + 1 <= plan[OUTER]


@ti.func
def mark(place: ti.template(), slab, live, value, met: ti.template()):
    """Mark the cells that rays meet, or unmark them."""
    for i in range(live):
        for n in ti.static(range(PLACES)):
            if place[slab, n, i] >= 0:
                met[slab, place[slab, n, i]] = ti.cast(value, ti.u8)


@ti.func
def spare(place: ti.template(), slab, cell, low: ti.template(), since: ti.template()):
    """Copy where rays begin, except that those that meet the cell begin where they never come to."""
    for i in range(LANES):
        meets = place[slab, 0, i] == cell
        for n in ti.static(range(1, PLACES)):
            meets = meets | (place[slab, n, i] == cell)
        since[i] = ti.select(meets, FAR, low[i])


@ti.func
def cross_row(walk, r, low: ti.template(), high: ti.template(), free, through: ti.template()):
    """Take the rays from `low` to `high` through a cell in row `r`; on the second walk, sum up their V."""
    total = 0.0
    if walk == 0:
        for i in range(LANES):
            through[i] *= ti.select((low[i] <= r) & (r <= high[i]), free, 1.0)
    else:
        for i in range(LANES):
            total += ti.select((low[i] <= r) & (r <= high[i]), through[i], 0.0)
    return total


@ti.func
def rows_alone(c, leg: ti.template()):
    """Lowest and highest row in which the first ray crosses a column of its own."""
    came, goes = leg.entry[0], leg.leave[0]
    if c > leg.start[0]:
        came = ti.cast(ti.floor(leg.base[0] + leg.slope[0] * c), ti.i32)
    if c < leg.stop[0]:
        goes = ti.cast(ti.floor(leg.base[0] + leg.slope[0] * (c + 1)), ti.i32)
    return ti.min(came, goes), ti.max(came, goes)


@ti.func
def cell_of(x, origin, per_metre):
    """Index of the cell that holds a coordinate."""
    return ti.cast(ti.floor((x - origin) * per_metre), ti.i32)


@ti.func
def meet_cells(
    drawn: ti.template(), first, live, count, frame: ti.template(), nx, occupied: ti.template(), slab,
    line: ti.template(), place: ti.template(),
):  # fmt: skip
    """Write the cells H_b of all rays, and their chance to reflect ([Li2026grid], eq. (1)); the grid is `nx`
    cells wide."""
    ny, per_metre = occupied.shape[1] // nx, 1 / frame[SIDE]
    for i in range(live):
        for n in ti.static(range(PLACES)):
            place[slab, n, i] = -1
        for n in ti.static(range(LINES)):
            line[slab, n, i] = 1.0
    for b in range(count):
        for i in range(live):
            k = first + i
            if drawn[k, RAY_POSSIBLE] > 0.5:
                away = drawn[k, NORMAL + 2 * b] * frame[SIDE]
                up = drawn[k, NORMAL + 2 * b + 1] * frame[SIDE]
                x, y = drawn[k, 2 * b + 2], drawn[k, 2 * b + 3]
                clear_v, clear_m = ti.f64(1.0), ti.f64(1.0)
                one, other = -1, -1
                for n in range(3):  # in front of the corner, at it, behind
                    ix = cell_of(x + (n - 1) * away, frame[ORIGIN_X], per_metre)
                    iy = cell_of(y + (n - 1) * up, frame[ORIGIN_Y], per_metre)
                    if ix >= 0 and iy >= 0 and ix < nx and iy < ny:
                        cell = iy * nx + ix
                        if cell != one and cell != other:
                            place[slab, 3 * b + n, i] = cell
                            clear_v *= 1 - occupied[1, cell]
                            clear_m *= 1 - occupied[0, cell]
                        one, other = cell, one
                line[slab, b, i] = 1 - clear_v if one >= 0 or other >= 0 else frame[OUTSIDE]
                line[slab, OWN + b, i] = 1 - clear_m if one >= 0 or other >= 0 else frame[OUTSIDE]
