"""Duplicates among surfaces, and ghosts of double bounces."""

import taichi as ti

from gridslam.kernels import OFTENER, REPLACES, SEEN_ELSEWHERE
from gridslam.kernels.primitives.functions import PI, cos_of, dot, sin_of, wrapped
from gridslam.kernels.primitives.gaussian import mirror_of
from gridslam.kernels.primitives.launching import copying
from gridslam.kernels.primitives.layout import line_entry

ALIKE = 0.5
"""Turn (rad) and gap (m) within which two surfaces may be one."""
SAME_LINE, SAME_LINE_SLACK = 9.0, (1e-4, 2.5e-5)
"""Squared deviations up to which two lines are one; variances of gap (m^2), turn (rad^2) always allowed."""
SURE, SHARP_M = 0.9, 0.1
"""Existence and deviation of the offset from which on a surface may take another's place."""
NEAR_M, SLACK_M, GATE = 0.5, 0.02, 9.0
"""Gap of the virtual anchors that is looked at; what is always allowed; squared in deviations."""
AROUND_M, THROUGH_M, CROSSING = 1.0, 0.15, 0.2
"""Silent surface through a corner: gap of virtual anchors, distance from it, sine of the corner's angle."""


@copying("mean", "covariance", "foot", "owner", "apart")
@ti.kernel
def find_duplicates(
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N]
    head: ti.i32,  # entry where the lines begin: see `layout`
    foot: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] tangential coordinate of the latest hit
    owner: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [S] the one anchor that a surface serves; -1 for all
    apart: ti.types.ndarray(dtype=ti.u8, ndim=2),  # [S, S] whether two are known to be two
    found: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [2] out: older and younger, -1 for none
    tie: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [2, 5] out: derivatives by the lines of both; residual
):
    """Find the youngest surface that is one with an older one: by turn, and gap where it was hit."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        found[0], found[1] = -1, -1
        count = foot.shape[0]
        for back in range(count - 1):
            y = count - 1 - back
            for o in range(y):
                if found[0] < 0 and owner[y] == owner[o] and apart[o, y] == 0:
                    young, old = line_entry(head, y), line_entry(head, o)
                    here, there = mean[young], mean[old]
                    turn, flip = wrapped(there - here), ti.f64(1.0)
                    if ti.abs(turn) > 0.5 * PI:  # the same line written with the opposite normal
                        turn, flip = wrapped(turn + PI), -flip
                    n = ti.Vector([cos_of(here), sin_of(here)], dt=ti.f64)
                    m = ti.Vector([cos_of(there), sin_of(there)], dt=ti.f64)
                    along, side = ti.Vector([-n[1], n[0]], dt=ti.f64), ti.Vector([-m[1], m[0]], dt=ti.f64)
                    place = mean[young + 1] * n + foot[y] * along
                    gap = flip * (dot(place, m) - mean[old + 1])
                    if ti.abs(turn) <= ALIKE and ti.abs(gap) <= ALIKE:
                        # the place itself moves with the younger line
                        by_turn = mean[young + 1] * along - foot[y] * n
                        slope = ti.Matrix.zero(ti.f64, 2, 4)
                        slope[0, 0], slope[0, 1] = flip * dot(place, side), -flip
                        slope[0, 2], slope[0, 3] = flip * dot(m, by_turn), flip * dot(n, m)
                        slope[1, 0], slope[1, 2] = 1.0, -1.0
                        entry = ti.Vector([old, old + 1, young, young + 1])
                        spread = ti.Matrix.zero(ti.f64, 2, 2)
                        for p in range(4):
                            for q in range(4):
                                shared = covariance[entry[p], entry[q]]
                                for i in ti.static(range(2)):
                                    for j in ti.static(range(2)):
                                        spread[i, j] += slope[i, p] * shared * slope[j, q]
                        a, b = spread[0, 0] + SAME_LINE_SLACK[0], spread[0, 1]
                        c = spread[1, 1] + SAME_LINE_SLACK[1]
                        square = c * gap * gap - 2 * b * gap * turn + a * turn * turn
                        if square < SAME_LINE * (a * c - b * b):
                            found[0], found[1] = o, y
                            for i in ti.static(range(2)):
                                for j in ti.static(range(4)):
                                    tie[i, j] = slope[i, j]
                            tie[0, 4], tie[1, 4] = -gap, -turn


@copying("mean", "covariance", "surface", "seen", "age", "single", "places")
@ti.kernel
def find_ghosts(
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N]
    head: ti.i32,  # entry where the lines begin: see `layout`
    surface: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] existence
    seen: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [S] detections
    age: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] chances to be seen; zeros: ratios don't count
    single: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, S] existence of rays over one surface
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 2] anchors
    least: ti.f64,  # times as often as it that two others must have been seen
    ghost: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [S] out: 1 for a ghost
):
    """Find the surfaces whose virtual anchor a double bounce over two surer ones makes."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        count = surface.shape[0]
        for g in range(count):
            ghost[g] = 0
        for s in range(count):
            for r in range(count if fit_for_it(s, covariance, head, surface, seen) else 0):
                if s != r and fit_for_it(r, covariance, head, surface, seen):
                    chance, often = ti.min(surface[s], surface[r]), ti.min(seen[s], seen[r])
                    for g in range(count):
                        oftener = often > least * seen[g]
                        if not oftener:
                            oftener = silenced(g, s, r, seen, age, single, places.shape[0])
                        if ghost[g] == 0 and chance > surface[g] and oftener:
                            if explains(g, s, r, mean, covariance, head, single, places):
                                ghost[g] = 1


@ti.func
def fit_for_it(s, covariance: ti.template(), head, surface: ti.template(), seen: ti.template()):
    """Whether a surface may take another's place."""
    offset = line_entry(head, s) + 1
    return surface[s] > SURE and seen[s] >= REPLACES and covariance[offset, offset] < SHARP_M * SHARP_M


@ti.func
def silenced(g, s, r, seen: ti.template(), age: ti.template(), single: ti.template(), anchors):
    """Whether no anchor hears a surface any more that is older than one of two others heard more often."""
    most, older = ti.cast(0.0, ti.f64), age[g] > ti.min(age[s], age[r])
    for anchor in range(anchors):
        most = ti.max(most, single[anchor, g])
    own = OFTENER * seen[g]
    return (
        older
        and most < SEEN_ELSEWHERE
        and seen[s] * age[g] > own * age[s]
        and seen[r] * age[g] > own * age[r]
    )


@ti.func
def explains(
    g, s, r, mean: ti.template(), covariance: ti.template(), head, single: ti.template(),
    places: ti.template(),
):  # fmt: skip
    """Whether the double bounce over last `s` and first `r` makes the virtual anchor of `g`, any anchor's."""
    own_line, by_last_line, by_first_line = line_entry(head, g), line_entry(head, s), line_entry(head, r)
    yes, most = False, ti.f64(0.0)
    for anchor in range(places.shape[0]):
        most = ti.max(most, single[anchor, g])
    corner = through_corner(g, s, r, mean, head)
    for anchor in range(places.shape[0]):
        x, y = places[anchor, 0], places[anchor, 1]
        own, by_own, by_offset = mirror_of(x, y, mean[own_line], mean[own_line + 1])
        image, by_first, by_first_offset = mirror_of(x, y, mean[by_first_line], mean[by_first_line + 1])
        image, by_last, by_last_offset = mirror_of(
            image[0], image[1], mean[by_last_line], mean[by_last_line + 1]
        )
        gap = own - image
        far, elsewhere = ti.sqrt(dot(gap, gap)), ti.f64(0.0)
        for other in range(places.shape[0]):
            if other != anchor:
                elsewhere = ti.max(elsewhere, single[other, g])
        # if measured vaguely, it lies between the lines that AoA and AoD of the double bounce give
        if far < AROUND_M and corner and most < SEEN_ELSEWHERE:
            yes = True
        elif far < NEAR_M and elsewhere < SEEN_ELSEWHERE:
            n = ti.Vector([cos_of(mean[by_last_line]), sin_of(mean[by_last_line])], dt=ti.f64)
            by_first -= 2 * dot(n, by_first) * n
            by_first_offset -= 2 * dot(n, by_first_offset) * n
            slope = ti.Matrix.zero(ti.f64, 2, 6)
            for i in ti.static(range(2)):
                slope[i, 0], slope[i, 1] = by_own[i], by_offset[i]
                slope[i, 2], slope[i, 3] = -by_last[i], -by_last_offset[i]
                slope[i, 4], slope[i, 5] = -by_first[i], -by_first_offset[i]
            entry = ti.Vector([
                own_line, own_line + 1, by_last_line, by_last_line + 1, by_first_line, by_first_line + 1
            ])  # fmt: skip
            spread = ti.Matrix.zero(ti.f64, 2, 2)
            for m in range(6):
                for n2 in range(6):
                    p = covariance[entry[m], entry[n2]]
                    for i in ti.static(range(2)):
                        for j in ti.static(range(2)):
                            spread[i, j] += slope[i, m] * p * slope[j, n2]
            if spread[0, 0] + spread[1, 1] < NEAR_M * NEAR_M:
                a, b, c = spread[0, 0] + SLACK_M * SLACK_M, spread[0, 1], spread[1, 1] + SLACK_M * SLACK_M
                square = c * gap[0] * gap[0] - 2 * b * gap[0] * gap[1] + a * gap[1] * gap[1]
                if square < GATE * (a * c - b * b):
                    yes = True
    return yes


@ti.func
def through_corner(g, s, r, mean: ti.template(), head):
    """Whether a line passes through the corner of two others."""
    one, other, own = line_entry(head, s), line_entry(head, r), line_entry(head, g)
    a, b = mean[one + 1], mean[other + 1]
    n = ti.Vector([cos_of(mean[one]), sin_of(mean[one])], dt=ti.f64)
    m = ti.Vector([cos_of(mean[other]), sin_of(mean[other])], dt=ti.f64)
    sine, through = n[0] * m[1] - n[1] * m[0], False
    if ti.abs(sine) > CROSSING:
        x, y = (a * m[1] - b * n[1]) / sine, (b * n[0] - a * m[0]) / sine
        through = ti.abs(cos_of(mean[own]) * x + sin_of(mean[own]) * y - mean[own + 1]) < THROUGH_M
    return through
