"""Particles that follow an agent by lines of sight to known anchors alone: a whole filter in one launch."""

import taichi as ti

from gridslam.kernels.primitives.functions import bearing_of, decay_of, logarithm_of, slant_of, wrapped
from gridslam.kernels.primitives.launching import quick
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.sights import (
    ADDED,
    AFTER,
    ANCHOR,
    BEHIND,
    COUNT,
    DRAWS,
    FACING,
    GOING,
    HEADING,
    HEIGHT,
    IN_SIGHT,
    LASTING,
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
def weighed(sights: ti.template(), particle: ti.template(), chance: ti.template(), half, q, p, first, clear):
    """Likelihood of a scan at a particle, over that of any paths; the ratios of its rows, one by one, in
    `chance`."""
    a, begin, end = sights.scan[q, ANCHOR], sights.scan[q, ROWS], sights.scan[q + 1, ROWS]
    x, y = particle[half, p, PLACE], particle[half, p, PLACE + 1]
    direction = bearing_of(x - sights.anchor[a, X], y - sights.anchor[a, Y])
    length = length_to(sights, particle, half, a, p)
    behind = direction + PI - (1 - sights.choice[WORLD]) * particle[half, p, HEADING]
    ahead, total = direction - sights.anchor[a, FACING], ti.f64(0.0)
    for r in range(begin, end):
        gap, ratio = (sights.row[r, VALUES] - length) * sights.row[r, SURE], ti.f64(0.0)
        if gap * gap < FAR:
            off = wrapped(sights.row[r, VALUES + 1] - ahead) * sights.row[r, SURE + 1]
            turn = wrapped(sights.row[r, VALUES + 2] - behind) * sights.row[r, SURE + 2]
            square = gap * gap + off * off + turn * turn
            if square < FAR:
                ratio = sights.row[r, PEAK] * decay_of(-0.5 * square)
        chance[p, r - first] = ratio
        total += ratio
    expected = sights.choice[IN_SIGHT] if clear else sights.choice[BEHIND]
    return 1 - expected + expected * total / (end - begin), expected / (end - begin)


@ti.func
def redrawn(sights: ti.template(), particle: ti.template(), weight: ti.template(), half, s, top):
    """Draw as many particles as are left, systematically by their weights, into the other half."""
    count, left, sized = sights.step[s, COUNT], sights.step[s + 1, COUNT], sights.choice[SHRINKAGE] > 0
    first = sights.step[s, DRAWS] + 3 * count
    chosen, sofar, mean = 0, weight[0, top], ti.f64(0.0)
    for p in range(left):
        place = (sights.draw[first] + p) / left
        while sofar < place and chosen < count - 1:
            chosen += 1
            sofar += weight[chosen, top]
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
    chance: ti.types.ndarray(
        dtype=ti.f64, ndim=2
    ),  # [P, B] scratch: rows and scans of any step, and one more
    place: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [S, 3] out: log evidence of a step, mean position
    likeliest: ti.types.ndarray(
        dtype=ti.f64, ndim=2
    ),  # [Q, 3] out: the likeliest row of a scan, how likely it
    # is that any is the line of sight, the mean of the distance expected
):
    """Follow the agent through all steps: motion, weights by the lines of sight, and drawing anew."""
    ti.loop_config(serialize=True)  # a step needs the one before
    for s in range(place.shape[0]):
        half, count, top = s % 2, sights.step[s, COUNT], chance.shape[1] - 1
        begin, end = sights.step[s, SCANS], sights.step[s + 1, SCANS]
        first, mx, my = sights.scan[begin, ROWS], ti.f64(0.0), ti.f64(0.0)
        behind = sights.scan[end, ROWS] - first  # where the scans' own lines of scratch begin
        for p in range(count):
            moved(sights, particle, half, s, p)
            mx += particle[half, p, PLACE] / count
            my += particle[half, p, PLACE + 1] / count
            chance[p, top] = 0.0
        for q in range(begin, end):
            a = sights.scan[q, ANCHOR]
            clear = in_view(sights, a, mx, my)
            for p in range(count):
                if sights.choice[THOROUGH] > 0:
                    clear = in_view(sights, a, particle[half, p, PLACE], particle[half, p, PLACE + 1])
                total, share = weighed(sights, particle, chance, half, q, p, first, clear)
                chance[p, top] += logarithm_of(total)
                chance[p, behind + q - begin] = share / total
        most, sum_of, x, y = chance[0, top], ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
        for p in range(count):
            most = ti.max(most, chance[p, top])
        for p in range(count):
            chance[p, top] = decay_of(chance[p, top] - most)
            sum_of += chance[p, top]
        for p in range(count):
            chance[p, top] /= sum_of
            x += chance[p, top] * particle[half, p, PLACE]
            y += chance[p, top] * particle[half, p, PLACE + 1]
        place[s, 0], place[s, 1], place[s, 2] = most + logarithm_of(sum_of / count), x, y
        for q in range(begin, end):
            best, highest, whole, length = sights.scan[q, ROWS], ti.f64(-1.0), ti.f64(0.0), ti.f64(0.0)
            for r in range(sights.scan[q, ROWS], sights.scan[q + 1, ROWS]):
                own = ti.f64(0.0)
                for p in range(count):
                    own += chance[p, r - first] * chance[p, behind + q - begin] * chance[p, top]
                whole += own
                if own > highest:
                    best, highest = r, own
            for p in range(count):
                length += chance[p, top] * length_to(sights, particle, half, sights.scan[q, ANCHOR], p)
            likeliest[q, 0], likeliest[q, 1], likeliest[q, 2] = ti.cast(best, ti.f64), whole, length
        redrawn(sights, particle, chance, half, s, top)
