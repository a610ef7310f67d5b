"""Joint mode of the distances of all paths of one antenna's snapshot; docs/model.md, (M74) to (M79).

All follows from the sums S_p(d) = sum_m |H_m|^2 k_m^p exp(-j k_m d) over differences of distances, and from
those of the samples. Complex numbers are pairs, the last axis of an array.
"""

import taichi as ti

from gridslam.kernels.messages.superposition import times
from gridslam.kernels.primitives.functions import cos_of, decay_of, logarithm_of, sin_of
from gridslam.kernels.primitives.launching import quick

ROOT, PLAIN, STEEP, STIFF = 3, 4, 5, 6
"""Where `work` keeps, after S_0, S_1 and S_2: the root of A; its solutions for responses and, in the last
row, for the samples; those for slopes of responses; curvature of the posterior, and its root."""
HERE, GRADIENT, STEP, AMPLITUDE, RECEIVED, SLOPED = 0, 1, 2, 3, 5, 7
"""Columns of `vector`: distances that are tried, gradient, step, and by pairs amplitudes, products of
responses with the samples, and of the same with wavenumbers between."""
FAR, TERMS = 3.0, 60
"""Deviations from which on a normal tail is a continued fraction, and its length."""


@quick
@ti.kernel
def climb_distances(
    wavenumber: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [M] evenly spaced, rad/m
    pulse: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 2]
    samples: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 2]
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] predicted distances, m
    precision: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N] their inverse covariance, 1/m^2
    weight: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 2] mean power of each path, and
    # chance that it is there
    limits: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [7] the noise's power in each sample; longest step, m;
    # scale over which it becomes unlikely that an image is nearer than its anchor, m; steps and halvings
    # of each at most; gain that ends the search; 1 / sqrt(2 pi)
    work: ti.types.ndarray(dtype=ti.f64, ndim=4),  # [7, N + 1, N, 2] scratch
    vector: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, 9] scratch
    distance: ti.types.ndarray(
        dtype=ti.f64, ndim=1
    ),  # [N] in and out: where the search begins, and the mode, m
    information: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N] out: of the snapshot there, 1/m^2
    value: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [1] out: log posterior there, but for constants
):
    """Climb to the joint mode by Gauss-Newton steps with halving."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, rounds, going, done = mean.shape[0], 0, 1, 0
        for n in range(count):
            vector[n, HERE] = distance[n]
        best = posterior(wavenumber, pulse, samples, mean, precision, weight, limits, work, vector)
        while going == 1 and rounds < limits[3]:
            rounds += 1
            for n in range(count):
                vector[n, HERE] = distance[n]
            slopes(mean, precision, weight, limits, work, vector, information)
            gain = newton_step(work, vector)
            if gain < limits[5]:
                going, done = 0, 1
            else:
                longest = ti.f64(0.0)
                for n in range(count):
                    longest = ti.max(longest, ti.abs(vector[n, STEP]))
                scale, tries, risen = ti.min(ti.f64(1.0), limits[1] / longest), 0, 0
                while tries < limits[4] and risen == 0:
                    tries += 1
                    for n in range(count):
                        vector[n, HERE] = distance[n] + scale * vector[n, STEP]
                    trial = posterior(
                        wavenumber, pulse, samples, mean, precision, weight, limits, work, vector
                    )
                    if trial > best:
                        best, risen = trial, 1
                    scale *= 0.5
                if risen == 1:
                    for n in range(count):
                        distance[n] = vector[n, HERE]
                else:
                    going = 0
        if done == 0:
            for n in range(count):
                vector[n, HERE] = distance[n]
            best = posterior(wavenumber, pulse, samples, mean, precision, weight, limits, work, vector)
            slopes(mean, precision, weight, limits, work, vector, information)
        value[0] = best


@ti.func
def posterior(
    wavenumber: ti.template(), pulse: ti.template(), samples: ti.template(), mean: ti.template(),
    precision: ti.template(), weight: ti.template(), limits: ti.template(), work: ti.template(),
    vector: ti.template(),
):  # fmt: skip
    """Log posterior of the distances that are tried; leaves all sums, the root and the samples' solution."""
    count, noise = mean.shape[0], limits[0]
    power = add_up(wavenumber, pulse, samples, work, vector)
    log_det = root_of(weight, noise, work)
    found = -log_det - wavenumber.shape[0] * logarithm_of(noise) - power / noise
    for k in range(count):
        one = ti.sqrt(weight[k, 0]) * ti.Vector([vector[k, RECEIVED], vector[k, RECEIVED + 1]])
        one = solved(work, one, PLAIN, count, k)
        found += (one[0] * one[0] + one[1] * one[1]) / (noise * noise)
    for n in range(count):
        pull = ti.f64(0.0)
        for m in range(count):
            pull += precision[n, m] * (vector[m, HERE] - mean[m])
        found -= 0.5 * (vector[n, HERE] - mean[n]) * pull
        if n > 0:
            found += behind((vector[n, HERE] - vector[0, HERE]) / limits[2], weight[n, 1], limits[6])[0]
    return found


@ti.func
def add_up(
    wavenumber: ti.template(), pulse: ti.template(), samples: ti.template(), work: ti.template(),
    vector: ti.template(),
):  # fmt: skip
    """S_0 to S_2 of all differences, products of responses with the samples, and the samples' power."""
    size, count = wavenumber.shape[0], vector.shape[0]
    spacing, power = (wavenumber[size - 1] - wavenumber[0]) / (size - 1), ti.f64(0.0)
    for m in range(size):
        power += samples[m, 0] ** 2 + samples[m, 1] ** 2
    for n in range(count):
        here = vector[n, HERE]
        first, gap = wavenumber[0] * here, spacing * here
        turn, now = ti.Vector([cos_of(gap), sin_of(gap)]), ti.Vector([cos_of(first), sin_of(first)])
        received, sloped = ti.Vector.zero(ti.f64, 2), ti.Vector.zero(ti.f64, 2)
        for m in range(size):
            one = times(now, ti.Vector([pulse[m, 0], -pulse[m, 1]]))
            one = times(one, ti.Vector([samples[m, 0], samples[m, 1]]))
            received += one
            sloped += wavenumber[m] * one
            now = times(now, turn)
        for side in ti.static(range(2)):
            vector[n, RECEIVED + side], vector[n, SLOPED + side] = received[side], sloped[side]
        for other in range(n, count):
            away = vector[other, HERE] - here
            first, gap = -wavenumber[0] * away, -spacing * away
            turn, now = ti.Vector([cos_of(gap), sin_of(gap)]), ti.Vector([cos_of(first), sin_of(first)])
            sums = ti.Matrix.zero(ti.f64, 3, 2)
            for m in range(size):
                one = (pulse[m, 0] ** 2 + pulse[m, 1] ** 2) * now
                for p in ti.static(range(3)):
                    sums[p, 0] += one[0]
                    sums[p, 1] += one[1]
                    one = wavenumber[m] * one
                now = times(now, turn)
            for p in ti.static(range(3)):
                work[p, n, other, 0], work[p, n, other, 1] = sums[p, 0], sums[p, 1]
                work[p, other, n, 0], work[p, other, n, 1] = sums[p, 0], -sums[p, 1]
    return power


@ti.func
def root_of(weight: ti.template(), noise, work: ti.template()):
    """Cholesky root of I + R S_0 R / noise, and the log of its determinant."""
    log_det = ti.f64(0.0)
    for n in range(weight.shape[0]):
        for k in range(n + 1):
            scale = ti.sqrt(weight[n, 0] * weight[k, 0]) / noise
            x, y = scale * work[0, n, k, 0], scale * work[0, n, k, 1]
            for i in range(k):
                ax, ay, bx, by = (
                    work[ROOT, n, i, 0], work[ROOT, n, i, 1], work[ROOT, k, i, 0], work[ROOT, k, i, 1],
                )  # fmt: skip
                x -= ax * bx + ay * by
                y -= ay * bx - ax * by
            if n == k:
                x, y = ti.sqrt(1 + x), 0.0
                log_det += 2 * logarithm_of(x)
            else:
                x /= work[ROOT, k, k, 0]
                y /= work[ROOT, k, k, 0]
            work[ROOT, n, k, 0], work[ROOT, n, k, 1] = x, y
    return log_det


@ti.func
def solved(work: ti.template(), right, kind: ti.template(), row, k):
    """Entry k of the root's solution for a right side whose entries before it are in a row already."""
    x, y = right[0], right[1]
    for i in range(k):
        ax, ay, bx, by = (
            work[ROOT, k, i, 0],
            work[ROOT, k, i, 1],
            work[kind, row, i, 0],
            work[kind, row, i, 1],
        )
        x -= ax * bx - ay * by
        y -= ax * by + ay * bx
    one = ti.Vector([x, y]) / work[ROOT, k, k, 0]
    work[kind, row, k, 0], work[kind, row, k, 1] = one[0], one[1]
    return one


@ti.func
def slopes(
    mean: ti.template(), precision: ti.template(), weight: ti.template(), limits: ti.template(),
    work: ti.template(), vector: ti.template(), information: ti.template(),
):  # fmt: skip
    """Gradient and curvature of the log posterior, and the information of the snapshot."""
    count, noise = mean.shape[0], limits[0]
    for n in range(count):
        for k in range(count):
            root = ti.sqrt(weight[k, 0])
            solved(work, root * ti.Vector([work[0, k, n, 0], work[0, k, n, 1]]), PLAIN, n, k)
            solved(work, root * ti.Vector([work[1, k, n, 1], -work[1, k, n, 0]]), STEEP, n, k)
        own = (work[1, n, n, 1] - inner(work, PLAIN, n, STEEP, n)[0] / noise) / noise
        received = ti.Vector([vector[n, RECEIVED], vector[n, RECEIVED + 1]])
        amplitude = weight[n, 0] * (received - inner(work, PLAIN, n, PLAIN, count) / noise) / noise
        sloped = ti.Vector([-vector[n, SLOPED + 1], vector[n, SLOPED]])
        steep = (sloped - inner(work, STEEP, n, PLAIN, count) / noise) / noise
        vector[n, AMPLITUDE], vector[n, AMPLITUDE + 1] = amplitude[0], amplitude[1]
        vector[n, GRADIENT] = 2 * (amplitude[0] * steep[0] + amplitude[1] * steep[1] - weight[n, 0] * own)
        for m in range(count):
            vector[n, GRADIENT] -= precision[n, m] * (vector[m, HERE] - mean[m])
    for n in range(count):
        for m in range(count):
            one = ti.Vector([work[2, n, m, 0], work[2, n, m, 1]]) - inner(work, STEEP, n, STEEP, m) / noise
            back = ti.Vector([vector[n, AMPLITUDE], -vector[n, AMPLITUDE + 1]])
            there = ti.Vector([vector[m, AMPLITUDE], vector[m, AMPLITUDE + 1]])
            information[n, m] = 2 * times(times(back, one), there)[0] / noise
            work[STIFF, n, m, 0] = precision[n, m] + information[n, m]
    for n in range(1, count):
        gap = (vector[n, HERE] - vector[0, HERE]) / limits[2]
        push = behind(gap, weight[n, 1], limits[6])[1]
        bend = ti.max(push * (push + gap), 0.0) / (limits[2] * limits[2])
        vector[n, GRADIENT] += push / limits[2]
        vector[0, GRADIENT] -= push / limits[2]
        work[STIFF, n, n, 0] += bend
        work[STIFF, 0, 0, 0] += bend
        work[STIFF, 0, n, 0] -= bend
        work[STIFF, n, 0, 0] -= bend


@ti.func
def inner(work: ti.template(), kind: ti.template(), row, other: ti.template(), column):
    """Product of two of the root's solutions."""
    x, y = ti.f64(0.0), ti.f64(0.0)
    for k in range(work.shape[2]):
        ax, ay, bx, by = (
            work[kind, row, k, 0], work[kind, row, k, 1],
            work[other, column, k, 0], work[other, column, k, 1],
        )  # fmt: skip
        x += ax * bx + ay * by
        y += ax * by - ay * bx
    return ti.Vector([x, y])


@ti.func
def newton_step(work: ti.template(), vector: ti.template()):
    """Curvature's solution for the gradient, and the product of both; 0 where it is no curvature."""
    count, sound, gain = vector.shape[0], 1, ti.f64(0.0)
    for n in range(count):
        for k in range(n + 1):
            x = work[STIFF, n, k, 0]
            for i in range(k):
                x -= work[STIFF, n, i, 1] * work[STIFF, k, i, 1]
            if n == k:
                sound = sound if x > 0 else 0
                work[STIFF, n, n, 1] = ti.sqrt(ti.max(x, 1e-30))
            else:
                work[STIFF, n, k, 1] = x / work[STIFF, k, k, 1]
        x = vector[n, GRADIENT]
        for i in range(n):
            x -= work[STIFF, n, i, 1] * vector[i, STEP]
        vector[n, STEP] = x / work[STIFF, n, n, 1]
        gain += vector[n, STEP] ** 2
    for back in range(count):
        n = count - 1 - back
        x = vector[n, STEP]
        for i in range(n + 1, count):
            x -= work[STIFF, i, n, 1] * vector[i, STEP]
        vector[n, STEP] = x / work[STIFF, n, n, 1]
    return gain * sound


@ti.func
def behind(gap, chance, height):
    """Log of 1 - q + q Phi(gap) of a path that is there with chance q, and its derivative."""
    whole = tail(gap, height)
    if chance < 1:
        there = chance * decay_of(whole[0])
        mixed = 1 - chance + there
        whole = ti.Vector([logarithm_of(mixed), whole[1] * there / mixed])
    return whole


@ti.func
def tail(x, height):
    """Log of the normal distribution function, and its derivative; the density at 0 is `height`."""
    log, slope = ti.f64(0.0), ti.f64(0.0)
    density = height * decay_of(-0.5 * x * x)
    if ti.abs(x) < FAR:
        term, total = x, x
        for i in range(1, TERMS):
            term *= x * x / (2 * i + 1)
            total += term
        whole = 0.5 + density * total
        log, slope = logarithm_of(whole), density / whole
    else:
        ratio = ti.abs(x)
        for back in range(TERMS):
            ratio = ti.abs(x) + (TERMS - back) / ratio
        if x < 0:
            log, slope = -0.5 * x * x + logarithm_of(height / ratio), ratio
        else:
            beyond = density / ratio
            log = -beyond * (1 + beyond / 2 + beyond * beyond / 3)
            slope = density / (1 - beyond)
    return ti.Vector([log, slope])
