"""Messages to the hypotheses of rings, tentative images of one anchor; docs/model.md, (M83).

A hypothesis is a Gaussian of [x, y, vx, vy, image x, image y]; those of weight 0 are left as they are.
Complex numbers are pairs, the last axis of an array.
"""

import taichi as ti

from gridslam.kernels.messages.distances import tail
from gridslam.kernels.messages.superposition import times
from gridslam.kernels.primitives.functions import cos_of, decay_of, logarithm_of, sin_of
from gridslam.kernels.primitives.launching import quick

MOVING, SIZE = 4, 6
"""Entries of the agent, and all of a hypothesis."""
TAKEN = 3
"""Vectors for what a ring's own path takes from the tables: one for each point of its spread."""
REACH = 4.0
"""Deviations that a hypothesis integrates the likelihood over, on both sides."""
LEAST_VARIANCE, LEFT = 1e-12, 1e-6
"""Of a distance, m^2; and share of a variance that is left at least."""
NOTHING, BEYOND = 6.0, 50.0
"""Deviations from which on the log of a normal distribution function is 0 but for 1e-9; how much less likely
than the likeliest a distance is that counts for nothing."""


@quick
@ti.kernel
def follow_rings(
    weight: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [R, K]
    before: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [4, 10] what the agent's belief learned: by columns
    # its mean before; push; a root of the information, whose squares add up to it; variance that is added
    mean: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [R, K, 6] in and out
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [R, K, 6, 6] in and out
    log: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [R, K] in and out: by how much likelier each is, where its
    # weight isn't 0
):
    """Take in what the joint belief learned of the agent, as information."""
    ti.loop_config(serialize=True)
    for r, k in weight:
        if weight[r, k] > 0:
            follow_one(r, k, before, mean, covariance, log)


@ti.func
def follow_one(
    r, k, before: ti.template(), mean: ti.template(), covariance: ti.template(), log: ti.template()
):
    """What `follow_rings` does, of one hypothesis, with the root of 1 + B' P B."""
    for i, j in ti.static(ti.ndrange(MOVING, MOVING)):
        covariance[r, k, i, j] += before[i, 6 + j]
    off, push = ti.Vector.zero(ti.f64, MOVING), ti.Vector.zero(ti.f64, MOVING)
    for i in ti.static(range(MOVING)):
        off[i], push[i] = mean[r, k, i] - before[i, 0], before[i, 1]
    seen = ti.Vector.zero(ti.f64, MOVING)  # B' (agent - before)
    turned = ti.Matrix.zero(ti.f64, SIZE, MOVING)  # P B
    for j in ti.static(range(MOVING)):
        for m in ti.static(range(MOVING)):
            seen[j] += before[m, 2 + j] * off[m]
            for i in ti.static(range(SIZE)):
                turned[i, j] += covariance[r, k, i, m] * before[m, 2 + j]
    root = ti.Matrix.zero(ti.f64, MOVING, MOVING)
    log_det = ti.f64(0.0)
    for i in ti.static(range(MOVING)):
        for j in ti.static(range(i + 1)):
            x = ti.f64(1.0 if i == j else 0.0)
            for m in ti.static(range(MOVING)):
                x += before[m, 2 + i] * turned[m, j]
            for m in ti.static(range(j)):
                x -= root[i, m] * root[j, m]
            if ti.static(i == j):
                root[i, i] = ti.sqrt(x)
                log_det += 2 * logarithm_of(root[i, i])
            else:
                root[i, j] = x / root[j, j]
    # what is left of the push, then P (I + J P)^-1 of it
    pull, shrunk = push, ti.Vector.zero(ti.f64, MOVING)
    for i, j in ti.static(ti.ndrange(MOVING, MOVING)):
        pull[i] -= before[i, 2 + j] * seen[j]
    for j in ti.static(range(MOVING)):
        x = ti.f64(0.0)
        for m in ti.static(range(MOVING)):
            x += turned[m, j] * pull[m]
        for m in ti.static(range(j)):
            x -= root[j, m] * shrunk[m]
        shrunk[j] = x / root[j, j]
        for i in ti.static(range(SIZE)):  # P B, solved by the root, in place
            y = turned[i, j]
            for m in ti.static(range(j)):
                y -= root[j, m] * turned[i, m]
            turned[i, j] = y / root[j, j]
    gain = ti.f64(0.0)
    for i in ti.static(range(SIZE)):
        x = ti.f64(0.0)
        for m in ti.static(range(MOVING)):
            x += covariance[r, k, i, m] * pull[m] - turned[i, m] * shrunk[m]
        if ti.static(i < MOVING):
            gain += off[i] * push[i] + 0.5 * pull[i] * x - 0.5 * seen[i] * seen[i]
        mean[r, k, i] += x
    log[r, k] = gain - 0.5 * log_det
    for i in ti.static(range(SIZE)):
        for j in ti.static(range(i + 1)):
            x = 0.5 * (covariance[r, k, i, j] + covariance[r, k, j, i])
            for m in ti.static(range(MOVING)):
                x -= turned[i, m] * turned[j, m]
            covariance[r, k, i, j], covariance[r, k, j, i] = x, x


@quick
@ti.kernel
def weigh_rings(
    weight: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [R, K]
    intensity: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [R] of each ring's path
    matched: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [G, 2] products with the samples at every distance of
    # a folding range, on top of all paths
    own: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [G] and with themselves
    removed: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [R, TAKEN, M + 1, 2] what a ring's own path takes from
    # these: vectors whose transforms are added, and their products with the samples
    limits: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [6] spacing of the distances, m; the anchor's distance
    # and its deviation, m; probability that a path stays; 1 / sqrt(2 pi); 2 pi / G
    table: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [G] scratch: log ratios of one ring
    node: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [I, 3] where a hypothesis looks, in deviations; shares of
    # a normal distribution there; scratch
    mean: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [R, K, 6] in and out
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [R, K, 6, 6] in and out
    log: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [R, K] in and out: by how much likelier each is, and
    there: ti.types.ndarray(
        dtype=ti.f64, ndim=2
    ),  # [R, K] the chance that its path is there: not of weight 0
):
    """Take in a snapshot, by the likelihood of one more path at each distance."""
    ti.loop_config(serialize=True)
    for r in range(weight.shape[0]):
        low, high = ti.i32(0), ti.i32(-1)
        for k in range(weight.shape[1]):
            if weight[r, k] > 0:
                seen = look_from(r, k, mean, covariance)
                reach = REACH * ti.sqrt(seen[1])
                first = ti.cast(ti.floor((seen[0] - reach) / limits[0]), ti.i32) - 1
                last = ti.cast(ti.floor((seen[0] + reach) / limits[0]), ti.i32) + 2
                low, high = first if high < low else ti.min(low, first), ti.max(high, last)
        for i in range(low, ti.min(high + 1, low + table.shape[0])):
            compare(r, i, low, intensity, matched, own, removed, limits, table)
        for k in range(weight.shape[1]):
            if weight[r, k] > 0:
                weigh_one(r, k, low, limits, table, node, mean, covariance, log, there)


@ti.func
def look_from(r, k, mean: ti.template(), covariance: ti.template()):
    """Distance of the image from the agent, its variance, and the direction."""
    x, y = mean[r, k, 4] - mean[r, k, 0], mean[r, k, 5] - mean[r, k, 1]
    span = ti.max(ti.sqrt(x * x + y * y), 1e-6)
    slope = ti.Vector([-x / span, -y / span, 0.0, 0.0, x / span, y / span])
    spread = ti.f64(0.0)
    for i in ti.static((0, 1, 4, 5)):
        for j in ti.static((0, 1, 4, 5)):
            spread += slope[i] * covariance[r, k, i, j] * slope[j]
    return ti.Vector([span, ti.max(spread, LEAST_VARIANCE), x / span, y / span])


@ti.func
def compare(
    r, i, low, intensity: ti.template(), matched: ti.template(), own: ti.template(), removed: ti.template(),
    limits: ti.template(), table: ti.template(),
):  # fmt: skip
    """Log likelihood ratio of a ring's path at one distance, on top of all others (M77)."""
    last, points = removed.shape[2] - 1, table.shape[0]
    at = (i % points + points) % points
    angle = limits[5] * at
    turn = ti.Vector([cos_of(angle), sin_of(angle)])
    received, power = ti.Vector([matched[at, 0], matched[at, 1]]), own[at]
    now, waves = ti.Vector([ti.f64(1.0), ti.f64(0.0)]), ti.Matrix.zero(ti.f64, TAKEN, 2)
    for m in range(last):
        for t in ti.static(range(TAKEN)):
            one = times(now, ti.Vector([removed[r, t, m, 0], removed[r, t, m, 1]]))
            waves[t, 0] += one[0]
            waves[t, 1] += one[1]
        now = times(now, turn)
    for t in ti.static(range(TAKEN)):
        wave = ti.Vector([waves[t, 0], waves[t, 1]])
        received += times(wave, ti.Vector([removed[r, t, last, 0], removed[r, t, last, 1]]))
        power += wave[0] * wave[0] + wave[1] * wave[1]
    more = 1 + intensity[r] * power
    table[i - low] = intensity[r] * (
        received[0] * received[0] + received[1] * received[1]
    ) / more - logarithm_of(more)


@ti.func
def weigh_one(
    r, k, low, limits: ti.template(), table: ti.template(), node: ti.template(), mean: ti.template(),
    covariance: ti.template(), log: ti.template(), there: ti.template(),
):  # fmt: skip
    """Integrate over a hypothesis' distance, and correct it by the moments of the product."""
    seen = look_from(r, k, mean, covariance)
    deviation, count, points = ti.sqrt(seen[1]), node.shape[0], table.shape[0]
    top = ti.f64(-1e300)
    for i in range(count):
        distance = seen[0] + deviation * node[i, 0]
        at = distance / limits[0]
        cell = ti.floor(at)
        share, first = at - cell, ti.cast(cell, ti.i32) - low
        start, second, third = first - 1, first + 1, first + 2
        if third >= points:  # more than a folding range
            start, first = (first - 1) % points, first % points
            second, third = second % points, third % points
        before, here, after, beyond = table[start], table[first], table[second], table[third]
        # cubic: a strong path's ratio is sharper than the table is fine
        rise, bend = 0.5 * (after - before), before - 2.5 * here + 2 * after - 0.5 * beyond
        twist = 1.5 * (here - after) + 0.5 * (beyond - before)
        value = here + share * (rise + share * (bend + share * twist))
        gap = (distance - limits[1]) / limits[2]
        if gap < NOTHING:
            value += tail(gap, limits[4])[0]
        node[i, 2] = value
        top = ti.max(top, value)
    whole, mean_place, square = ti.f64(0.0), ti.f64(0.0), ti.f64(0.0)
    for i in range(count):
        if node[i, 2] > top - BEYOND:
            mass = node[i, 1] * decay_of(node[i, 2] - top)
            whole += mass
            mean_place += mass * node[i, 0]
            square += mass * node[i, 0] * node[i, 0]
    middle = mean_place / whole
    stays = limits[3]
    level = logarithm_of(whole) + top + logarithm_of(stays)
    # the path may have gone for now: log of exp(level) + 1 - stays, without overflow
    gone = logarithm_of(1 - stays)
    most = ti.max(level, gone)
    factor = most + logarithm_of(decay_of(level - most) + decay_of(gone - most))
    chance = decay_of(level - factor)
    left, moved = seen[1] * ti.max(square / whole - middle * middle, LEFT), deviation * middle
    narrower = chance * (seen[1] - left - (1 - chance) * moved * moved) / (seen[1] * seen[1])
    gain = ti.Vector.zero(ti.f64, SIZE)
    for i in ti.static(range(SIZE)):
        gain[i] = seen[2] * (covariance[r, k, i, 4] - covariance[r, k, i, 0])
        gain[i] += seen[3] * (covariance[r, k, i, 5] - covariance[r, k, i, 1])
    for i in ti.static(range(SIZE)):
        mean[r, k, i] += chance * moved / seen[1] * gain[i]
        for j in ti.static(range(i + 1)):
            x = 0.5 * (covariance[r, k, i, j] + covariance[r, k, j, i]) - narrower * gain[i] * gain[j]
            covariance[r, k, i, j], covariance[r, k, j, i] = x, x
    log[r, k], there[r, k] = factor, chance
