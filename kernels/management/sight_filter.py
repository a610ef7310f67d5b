"""Particles that follow an agent by lines of sight to known anchors alone: a whole filter in one launch."""

import taichi as ti

from gridslam.kernels.primitives.functions import bearing_of, decay_of, logarithm_of, slant_of, wrapped
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.sights import (
    ADDED,
    AFTER,
    AHEAD,
    ANCHOR,
    ARRIVAL,
    BEHIND,
    COUNT,
    DRAWS,
    FACING,
    GOING,
    HEADING,
    HEIGHT,
    IN_SIGHT,
    LASTING,
    LENGTH,
    LINES,
    PACE,
    PARTICLE,
    PEAK,
    PLACE,
    ROWS,
    SCANS,
    SHARE,
    SHRINKAGE,
    SIZE,
    SURE,
    THOROUGH,
    TILT,
    TURN,
    VALUES,
    WEIGHT,
    WIDEST,
    WORLD,
    Sights,
    X,
    Y,
)

PI = 3.141592653589793
GRAZE = 1e-9
"""Share of a leg at either end in which a wall doesn't block it."""
FAR = 100.0
"""Sum of squared deviations from which on a row is no line of sight: its ratio is below 1e-21."""
BEYOND, NO_SIGHT = FAR + 1e-6, -1.0
"""The same, by the rounding of a difference more; what no ratio is."""


@ti.func
def moved(sights: ti.template(), particle: ti.template(), half, s, p):
    """Move a particle by what it keeps of its velocity, and by chance."""
    first, count = sights.step[s, DRAWS], sights.step[s, COUNT]
    gap, lasting = ti.sqrt(ti.cast(sights.step[s, AFTER], ti.f64)), sights.choice[LASTING]
    fresh = ti.sqrt(1 - lasting * lasting)
    for i in range(2):
        going = lasting * particle[half, p, GOING + i] + fresh * sights.draw[first + 2 * p + i]
        particle[half, p, GOING + i] = going
        particle[half, p, PLACE + i] += gap * particle[half, p, PACE] * going
    turn = sights.choice[WIDEST] if p % ti.cast(sights.choice[SHARE], ti.i32) == 0 else sights.choice[TURN]
    particle[half, p, HEADING] += gap * turn * sights.draw[first + 2 * count + p]


@ti.func
def in_view(sights: ti.template(), a, x, y):
    """Whether no wall stands between an anchor and (x, y)."""
    px, py = sights.anchor[a, X], sights.anchor[a, Y]
    dx, dy, clear, w = x - px, y - py, True, 0
    while clear and w < sights.wall.shape[0]:
        fx, fy = sights.wall[w, 0] - px, sights.wall[w, 1] - py
        ex, ey = sights.wall[w, 2] - sights.wall[w, 0], sights.wall[w, 3] - sights.wall[w, 1]
        across = dx * ey - dy * ex
        way = ti.select(across < 0, -1.0, 1.0)
        whole, here = (
            way * across,
            way * (fx * ey - fy * ex),
        )  # where they cross, in shares of the leg, times it
        if here > GRAZE * whole and here < whole - GRAZE * whole:
            along = way * (fx * dy - fy * dx)  # the same in shares of the wall
            clear = along < 0 or along > whole
        w += 1
    return clear


@ti.func
def length_to(sights: ti.template(), particle: ti.template(), half, a, p):
    """Distance that a particle expects of an anchor."""
    dx, dy = (
        particle[half, p, PLACE] - sights.anchor[a, X],
        particle[half, p, PLACE + 1] - sights.anchor[a, Y],
    )
    size = particle[half, p, SIZE]
    height = sights.anchor[a, HEIGHT] + sights.anchor[a, TILT] * size
    return slant_of(dx * dx + dy * dy, height) + sights.anchor[a, ADDED] * size


@ti.func
def far_off(sights: ti.template(), r, nearest, farthest):
    """Whether a row's length is no line of sight at any particle."""
    length = sights.row[r, VALUES]
    off = ti.max(nearest - length, length - farthest, 0.0) * sights.row[r, SURE]
    return off * off > BEYOND


@ti.func
def foreseen(sights: ti.template(), particle: ti.template(), line: ti.template(), half, q, count, spare):
    """What each particle expects of a line of sight: its length, and how it departs and arrives if the scan
    has angles that count, which take longest. The shortest of these lengths, and the longest."""
    a, world, angles = sights.scan[q, ANCHOR], sights.choice[WORLD], ti.f64(0.0)
    px, py, facing = sights.anchor[a, X], sights.anchor[a, Y], sights.anchor[a, FACING]
    nearest, farthest = ti.f64(1e300), ti.f64(-1e300)
    for p in range(count):
        length = length_to(sights, particle, half, a, p)
        line[spare + LENGTH, p] = length
        nearest, farthest = ti.min(nearest, length), ti.max(farthest, length)
    for r in range(sights.scan[q, ROWS], sights.scan[q + 1, ROWS]):
        if not far_off(sights, r, nearest, farthest):
            angles += sights.row[r, SURE + 1] + sights.row[r, SURE + 2]
    if angles > 0:
        for p in range(count):
            x, y, heading = particle[half, p, PLACE], particle[half, p, PLACE + 1], particle[half, p, HEADING]
            direction = bearing_of(x - px, y - py)
            line[spare + AHEAD, p] = direction - facing
            line[spare + ARRIVAL, p] = direction + PI - (1 - world) * heading
    else:
        for p in range(count):
            line[spare + AHEAD, p] = line[spare + ARRIVAL, p] = 0.0
    return nearest, farthest


@ti.func
def compared(sights: ti.template(), line: ti.template(), q, count, first, sums, spare, nearest, farthest):
    """Ratio of each row of a scan to any path at each particle, in a line each, and their sums.

    Rows outside: what is read of one then waits in registers while particles are gone through, in order. Most
    rows are far from what any particle expects: a line that begins with `NO_SIGHT` stands for zeros.
    """
    for p in range(count):
        line[sums, p] = 0.0
    for r in range(sights.scan[q, ROWS], sights.scan[q + 1, ROWS]):
        length, departure, arrival = (
            sights.row[r, VALUES],
            sights.row[r, VALUES + 1],
            sights.row[r, VALUES + 2],
        )
        by_length, by_departure, by_arrival = (
            sights.row[r, SURE],
            sights.row[r, SURE + 1],
            sights.row[r, SURE + 2],
        )
        peak = sights.row[r, PEAK]
        if far_off(sights, r, nearest, farthest):
            line[r - first, 0] = NO_SIGHT
        else:
            for p in range(count):
                gap, ratio = (length - line[spare + LENGTH, p]) * by_length, ti.f64(0.0)
                if gap * gap < FAR:
                    off = wrapped(departure - line[spare + AHEAD, p]) * by_departure
                    turn = wrapped(arrival - line[spare + ARRIVAL, p]) * by_arrival
                    square = gap * gap + off * off + turn * turn
                    if square < FAR:
                        ratio = peak * decay_of(-0.5 * square)
                line[r - first, p] = ratio
                line[sums, p] += ratio


@ti.func
def redrawn(sights: ti.template(), particle: ti.template(), line: ti.template(), half, s, top):
    """Draw as many particles as are left, systematically by their weights, into the other half."""
    count, left, sized = sights.step[s, COUNT], sights.step[s + 1, COUNT], sights.choice[SHRINKAGE] > 0
    first = sights.step[s, DRAWS] + 3 * count
    chosen, sofar, mean = 0, line[top, 0], ti.f64(0.0)
    for p in range(left):
        place = (sights.draw[first] + p) / left
        while sofar < place and chosen < count - 1:
            chosen += 1
            sofar += line[top, chosen]
        for i in range(PARTICLE):
            particle[1 - half, p, i] = particle[half, chosen, i]
        mean += particle[half, chosen, SIZE] / left
    if sized:
        spread, shrinkage = ti.f64(0.0), sights.choice[SHRINKAGE]
        for p in range(left):
            spread += (particle[1 - half, p, SIZE] - mean) ** 2 / left
        noise = ti.sqrt((1 - shrinkage * shrinkage) * spread)
        for p in range(left):
            kept = shrinkage * (particle[1 - half, p, SIZE] - mean)
            particle[1 - half, p, SIZE] = mean + kept + noise * sights.draw[first + 1 + p]


@quick
@ti.kernel
def follow_sights(
    sights: pack(Sights),
    particle: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [2, P, 10] in: the first half. Out: those after the
    # last step, in either half, by turns; the other one is scratch
    line: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [B, P] scratch: a line for each row and scan of any step,
    # and `LINES` more
    place: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [S, 3] out: log evidence of a step, mean position
    likeliest: ti.types.ndarray(
        dtype=ti.f64, ndim=2
    ),  # [Q, 3] out: the likeliest row of a scan, how likely it
    # is that any is the line of sight, the mean of the distance expected
):
    """Follow the agent through all steps: motion, weights by the lines of sight, and drawing anew."""
    ti.loop_config(serialize=True)  # a step needs the one before
    for s in range(place.shape[0]):
        half, count, spare = s % 2, sights.step[s, COUNT], line.shape[0] - LINES
        begin, end, top = sights.step[s, SCANS], sights.step[s + 1, SCANS], spare + WEIGHT
        first, mx, my, told = sights.scan[begin, ROWS], ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
        behind = sights.scan[end, ROWS] - first  # where the scans' own lines begin
        for p in range(count):
            moved(sights, particle, half, s, p)
            mx += particle[half, p, PLACE] / count
            my += particle[half, p, PLACE + 1] / count
            line[top, p] = 1.0
        for q in range(begin, end):
            a, own = sights.scan[q, ANCHOR], behind + q - begin
            rows = sights.scan[q + 1, ROWS] - sights.scan[q, ROWS]
            nearest, farthest = foreseen(sights, particle, line, half, q, count, spare)
            compared(sights, line, q, count, first, own, spare, nearest, farthest)
            clear, most = in_view(sights, a, mx, my), ti.f64(0.0)
            for p in range(count):
                if sights.choice[THOROUGH] > 0:
                    clear = in_view(sights, a, particle[half, p, PLACE], particle[half, p, PLACE + 1])
                expected = sights.choice[IN_SIGHT] if clear else sights.choice[BEHIND]
                total = 1 - expected + expected * line[own, p] / rows
                line[top, p] *= total
                line[own, p] = expected / rows / total
                most = ti.max(most, line[top, p])
            told += logarithm_of(most)  # a product of many scans would overflow
            for p in range(count):
                line[top, p] /= most
        sum_of, x, y = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
        for p in range(count):
            sum_of += line[top, p]
        for p in range(count):
            line[top, p] /= sum_of
            x += line[top, p] * particle[half, p, PLACE]
            y += line[top, p] * particle[half, p, PLACE + 1]
        place[s, 0], place[s, 1], place[s, 2] = told + logarithm_of(sum_of / count), x, y
        for q in range(begin, end):
            best, highest, whole, length = sights.scan[q, ROWS], ti.f64(-1.0), ti.f64(0.0), ti.f64(0.0)
            for r in range(sights.scan[q, ROWS], sights.scan[q + 1, ROWS]):
                own = ti.f64(0.0)
                if line[r - first, 0] != NO_SIGHT:
                    for p in range(count):
                        own += line[r - first, p] * line[behind + q - begin, p] * line[top, p]
                whole += own
                if own > highest:
                    best, highest = r, own
            for p in range(count):
                length += line[top, p] * length_to(sights, particle, half, sights.scan[q, ANCHOR], p)
            likeliest[q, 0], likeliest[q, 1], likeliest[q, 2] = ti.cast(best, ti.f64), whole, length
        redrawn(sights, particle, line, half, s, top)
