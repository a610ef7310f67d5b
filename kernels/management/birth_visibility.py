"""Whether the paths of births are open, by the grid at the mean of the belief; docs/model.md, (M32)."""

import taichi as ti

from gridslam.kernels.management.births import sum_up
from gridslam.kernels.primitives.blocks import BirthRows, Sketch
from gridslam.kernels.primitives.functions import cos_of, sin_of
from gridslam.kernels.primitives.launching import copying
from gridslam.kernels.primitives.layout import line_row, lines_in
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.tables import (
    ANCHOR,
    BORN_ANCHOR,
    BORN_FIRST,
    BORN_LAST,
    BOUNCES,
    FIRST,
    LAST,
    LINE_ANGLE,
    LINE_OFFSET,
    OVER_CLUTTER,
    RAY_POSSIBLE,
)
from gridslam.kernels.propagation.bundles import ALONG_X, LoneLeg, lay_leg, meet_cells, rows_alone
from gridslam.kernels.propagation.paths import draw_path, stand_at

ELSEWHERE = 0.3
"""V of a birth whose path is impossible at the mean: elsewhere it isn't, or it wouldn't be one."""


@ti.func
def alone(
    drawn: ti.template(), count, nx, occupied: ti.template(), frame: ti.template(), line: ti.template(),
    place: ti.template(),
):  # fmt: skip
    """V of the one ray that is drawn: a bundle of one, which needs none of what makes bundles fast."""
    ny = occupied.shape[1] // nx
    meet_cells(drawn, 0, 1, count, frame, nx, occupied, 0, line, place)
    through = line[0, 0, 0] * line[0, 1, 0]
    leg = LoneLeg()
    for corner in range(count + 1):
        flat = lay_leg(drawn, 0, 1, corner, count, frame, leg)[ALONG_X] > 0.5
        columns, rows = (nx if flat else ny), (ny if flat else nx)
        for c in range(ti.max(leg.start[0], 0), ti.min(leg.stop[0], columns - 1) + 1):
            lowest, highest = rows_alone(c, leg)
            for r in range(ti.max(lowest, 0), ti.min(highest, rows - 1) + 1):
                cell = r * nx + c if flat else c * nx + r
                met = False
                for n in range(3 * count):
                    met = met or place[0, n, 0] == cell
                if not met:
                    through *= 1 - occupied[0, cell]
    return through


@copying("mean")
@ti.kernel
def weigh_by_visibility(
    head: ti.i32,  # entry of the mean where the lines begin: see `layout`
    wide: ti.i32,  # cells of a row
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 6] anchors: see `blocks`
    occupied: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [2, ny nx] o of a traversed cell, of a hit one in V
    frame: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [4 or more] see `blocks.Cells`
    sketch: pack(Sketch),
    births: pack(BirthRows),  # as `propose` leaves them; `proposal` is in/out
    measured: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [5, M] in/out: see `tables`; `NEW` is out
):
    """Weigh births by V of their paths at the mean of the belief, [Li2026grid], eq. (1).

    Eq. (11) there leaves it out. One ray at a time: there are few, and waking other threads takes longer.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        surfaces = lines_in(head, mean.shape[0])
        stand_at(mean, head, sketch.state)
        own = line_row(surfaces)
        for b in range(births.born[0, 0]):
            last, first = births.born[b + 1, BORN_LAST], births.born[b + 1, BORN_FIRST]
            angle, worth = births.proposal[b, LINE_ANGLE], births.proposal[b, OVER_CLUTTER]
            sketch.state[own, 0], sketch.state[own + 1, 0] = cos_of(angle), sin_of(angle)
            sketch.state[own + 2, 0] = births.proposal[b, LINE_OFFSET]
            sketch.path[0, BOUNCES] = 1 if last < 0 and first < 0 else 2
            sketch.path[0, ANCHOR] = births.born[b + 1, BORN_ANCHOR]
            sketch.path[0, LAST] = surfaces if last < 0 else last
            sketch.path[0, FIRST] = surfaces if first < 0 else first
            draw_path(sketch.state, sketch.path, places, 0, 0, sketch.drawn)
            births.proposal[b, OVER_CLUTTER] = ELSEWHERE * worth
            if sketch.drawn[0, RAY_POSSIBLE] > 0.5:
                births.proposal[b, OVER_CLUTTER] = worth * alone(
                    sketch.drawn, sketch.path[0, BOUNCES], wide, occupied, frame, sketch.line, sketch.place
                )
        sum_up(births.born, births.proposal, measured)
