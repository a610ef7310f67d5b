"""Rays: which paths there may be, with their existence one step ahead, and how many measurements lie near."""

import taichi as ti

from gridslam.kernels.functions import wrapped
from gridslam.kernels.gaussian import entry_of, path_of, predict_by, spread_of
from gridslam.kernels.launching import quick
from gridslam.kernels.paths import draw_path
from gridslam.kernels.radio import GIVEN, HERE, SCALE, THERE, THRESHOLD

STAY, APPEAR = 0.95, 0.005
"""A ray that exists stays so for a step; one that doesn't appears (model.md, section 2.6 (a))."""
STRONG = 0.3
"""Existence from which on a surface may take part in a double bounce, and explain a loud measurement."""
GATE = 4.0
"""Standard deviations within which a measurement lies where its path is predicted."""
ROOT_8_PI = 8.885765876316732


@ti.func
def ahead(existence):
    """Existence of a ray one step ahead."""
    return APPEAR + existence * (STAY - APPEAR)


@quick
@ti.kernel
def foresee(
    anchor: ti.i32,
    bounces: ti.i32,  # at most
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N]
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N]
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 3] anchors: x, y, orientation
    surface: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] existence
    owner: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [S] the one anchor that a surface serves; -1 for all
    sight: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [J] existence of lines of sight
    single: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, S] of rays over one surface
    double: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [J, S, S] over (last, first)
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [1 + S S, 4] out: bounces, last, first, anchor
    existence: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [1 + S S] out: of the ray
    surfaces: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [1 + S S] out: of all surfaces involved
    predicted: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [1 + S S, 12] out: value (3), spread (9)
    found: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [1] out: how many there are
):
    """List and predict an anchor's paths: line of sight, single bounces, double bounces."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        count = surface.shape[0]
        path[0, 0], path[0, 1], path[0, 2] = 0, -1, -1
        existence[0], surfaces[0] = ahead(sight[anchor]), 1.0
        n = 1
        for s in range(count):
            if owner[s] == -1 or owner[s] == anchor:
                path[n, 0], path[n, 1], path[n, 2] = 1, s, s
                existence[n], surfaces[n] = ahead(single[anchor, s]), surface[s]
                n += 1
        for s in range(count if bounces > 1 else 0):
            for r in range(count if surface[s] > STRONG else 0):
                if s != r and surface[r] > STRONG:
                    path[n, 0], path[n, 1], path[n, 2] = 2, s, r
                    existence[n], surfaces[n] = ahead(double[anchor, s, r]), surface[s] * surface[r]
                    n += 1
        for row in range(n):
            path[row, 3] = anchor
            predict_by(mean, covariance, path, places, row, predicted)
        found[0] = n


@quick
@ti.kernel
def report(
    bounces: ti.i32,  # at most
    least: ti.f64,
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N]
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 3] anchors: x, y, orientation
    surface: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] existence
    owner: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [S] the one anchor that a surface serves; -1 for all
    sight: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [J] existence of lines of sight
    single: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, S] of rays over one surface
    double: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [J, S, S] over (last, first)
    state: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [3 + 3 S, 1] the mean, as `paths.draw_path` takes it
    path: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [J (1 + S S), 4] out: bounces, last, first, anchor
    told: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J (1 + S S), 4] out: existence, distance, AoD, AoA
    drawn: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J (1 + S S), 13] out: as `paths.draw_path` leaves them
    found: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [1] out: how many there are
):
    """List the possible paths, anchor by anchor, that are believed in more than `least`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, n = surface.shape[0], 0
        for anchor in range(places.shape[0]):
            place = ti.Vector([places[anchor, 0], places[anchor, 1], places[anchor, 2]], dt=ti.f64)
            for kind in range(3):
                for s in range(1 if kind == 0 else count):
                    for r in range(count if kind == 2 else 1):
                        chance = ti.cast(0.0, ti.f64)
                        if kind == 0:
                            chance = sight[anchor]
                        elif kind == 1:
                            if owner[s] == -1 or owner[s] == anchor:
                                chance = single[anchor, s] * surface[s]
                        elif s != r and bounces > 1 and surface[s] > STRONG and surface[r] > STRONG:
                            chance = double[anchor, s, r] * surface[s] * surface[r]
                        if chance > least:
                            last, first = (-1 if kind == 0 else s), (r if kind == 2 else s)
                            path[n, 0], path[n, 1], path[n, 3] = kind, last, anchor
                            path[n, 2] = first if kind > 0 else -1
                            draw_path(state, path, places, n, 0, drawn)
                            value = path_of(mean, place, kind, last, first)[0]
                            told[n, 0] = chance
                            for q in ti.static(range(3)):
                                told[n, 1 + q] = value[q]
                            n += 1 if drawn[n, 12] > 0.5 else 0
        found[0] = n


@quick
@ti.kernel
def near(
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N]
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N]
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 3] anchors: x, y, orientation
    surface: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] existence
    owner: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [S] the one anchor that a surface serves; -1 for all
    start: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [J + 1] where the measurements of each anchor begin
    heard: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 9] see `Heard.table`
    radio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 11] see `kernels.radio`
    claimed: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [M] out: 1 where a loud measurement lies near a path
):
    """Find the loud measurements that lie where a line of sight or a single bounce is predicted."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for m in range(heard.shape[0]):
            claimed[m] = 0
        for anchor in range(places.shape[0]):
            place = ti.Vector([places[anchor, 0], places[anchor, 1], places[anchor, 2]], dt=ti.f64)
            for path in range(surface.shape[0] + 1):
                s, there = ti.max(path - 1, 0), path == 0
                if path > 0:
                    there = surface[s] > STRONG and (owner[s] == -1 or owner[s] == anchor)
                if there and start[anchor] < start[anchor + 1]:
                    bounces = ti.min(path, 1)
                    value, slope = path_of(mean, place, bounces, s, s)
                    spread = spread_of(slope, entry_of(bounces, s, s), covariance)
                    for m in range(start[anchor], start[anchor + 1]):
                        if heard[m, 7] > 0.5 and claimed[m] == 0:
                            amplitude = heard[m, 6] if heard[m, 6] >= 0 else radio[anchor, THRESHOLD]
                            far = ti.cast(0.0, ti.f64)
                            for q in ti.static(range(3)):
                                own = heard[m, 3 + q]
                                std = own
                                if own == 0:
                                    std = rough_std(radio, anchor, q, amplitude)
                                if own >= 0:  # what wasn't measured is near
                                    gap = heard[m, q] - value[q]
                                    if ti.static(q > 0):
                                        gap = wrapped(gap)
                                    far += gap * gap / (spread[q, q] + std * std)
                            claimed[m] = 1 if far < GATE * GATE else 0


@ti.func
def rough_std(radio: ti.template(), anchor, q, amplitude):
    """sigma of one parameter; which way an array faces doesn't matter here."""
    std = radio[anchor, SCALE] / amplitude
    if q == 0 and radio[anchor, GIVEN] > 0:
        std = radio[anchor, GIVEN]
    if q > 0:
        own = THERE if q == 1 else HERE
        square = 0.5 * (radio[anchor, own] + radio[anchor, own + 1])
        std = 1 / (ROOT_8_PI * amplitude * ti.sqrt(ti.max(square, 1e-30)))
    return std
