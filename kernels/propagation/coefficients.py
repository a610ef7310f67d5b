"""Reflection coefficients where rays meet walls: what cells and surfaces believe, and what they learn."""

import taichi as ti

from gridslam.kernels import LIKELIER_THAN_NOT
from gridslam.kernels.primitives.blocks import Coefficients, Drawn, Hits, Messages
from gridslam.kernels.primitives.functions import decay_of, logarithm_of
from gridslam.kernels.primitives.launching import copying, quick
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.radio import AT_1M, SAMPLES, amplitude_of, detection_of, log_rician
from gridslam.kernels.primitives.tables import (
    ANCHOR,
    BOUNCES,
    CLIP,
    FIRST,
    LAST,
    LEAST,
    ORIGIN_X,
    ORIGIN_Y,
    OTHER,
    SENDS,
    SHARE_POSSIBLE,
    SIDE,
)
from gridslam.kernels.propagation.bundles import cell_of
from gridslam.kernels.propagation.detections import place_again, spot
from gridslam.kernels.propagation.path_messages import HOW_LONG, OF_RAY, OF_SURFACES, SHARE

BINS = 20
"""Bins of a coefficient's belief; products of two have twice as many nodes."""
FAINT = 1e-3
"""Probability of an association below which it says nothing about coefficients."""
LEAST_SHARE = 0.05
"""Probability of having caused a measurement from which on double bounces teach coefficients, and single ones
that send nothing to cells do; by samples, from which on single ones teach surfaces."""


@ti.func
def local_belief(
    at: ti.template(), drawn: ti.template(), where: ti.template(), held: ti.template(),
    surface: ti.template(), frame: ti.template(), row, rays, corner, number,
):  # fmt: skip
    """Belief over the coefficient at a hit: the surface's, the cell's own, and room for a surprise."""
    inside, per_metre = 0, 1 / frame[SIDE]
    for n in range(BINS):
        at[n] = 0.0
    for k in range(row * rays, (row + 1) * rays):
        ix = cell_of(drawn[k, 2 * corner], frame[ORIGIN_X], per_metre)
        iy = cell_of(drawn[k, 2 * corner + 1], frame[ORIGIN_Y], per_metre)
        if ix >= 0 and iy >= 0 and ix < where.shape[1] and iy < where.shape[0]:
            inside += 1
            cell = where[iy, ix]
            if cell >= 0:
                for n in range(BINS):
                    at[n] += held[cell, n]
    most, total = ti.f64(-1e30), ti.f64(0.0)
    for n in range(BINS):
        at[n] /= ti.max(inside, 1)
        most = ti.max(most, at[n])
    for n in range(BINS):
        at[n] = surface[number, n] * decay_of(at[n] - most)
        total += at[n]
    for n in range(BINS):
        own = at[n] / total if total > 1e-12 else 1 / ti.cast(BINS, ti.f64)
        at[n] = (1 - frame[OTHER]) * own + frame[OTHER] / BINS


@ti.func
def coefficient_product(
    drawn: ti.template(), path: ti.template(), where: ti.template(), held: ti.template(),
    surface: ti.template(), frame: ti.template(), row, rays, belief: ti.template(),
):  # fmt: skip
    """Belief over the product of the coefficients along a path ([Li2026grid], eq. (2)).

    Node n stands for (n + 1) / 2 BINS. Arguments are those of `cells.cast`.
    """
    bounces, nodes = path[row, BOUNCES], 2 * BINS
    for n in range(nodes):
        belief[row, n] = 0.0
    first, last = ti.Vector([0.0] * BINS, dt=ti.f64), ti.Vector([0.0] * BINS, dt=ti.f64)
    for corner in range(1, bounces + 1):
        for n in range(BINS):
            first[n] = last[n]
        number = path[row, LAST] if corner == bounces else path[row, FIRST]
        local_belief(last, drawn, where, held, surface, frame, row, rays, corner, number)
    if bounces == 0:
        belief[row, nodes - 1] = 1.0
    elif bounces == 1:
        for n in range(BINS):
            belief[row, 2 * n] = last[n]
    else:
        for i in range(BINS):
            for j in range(BINS):  # the product of two bins' centres lies between two nodes
                place = ti.cast((2 * i + 1) * (2 * j + 1), ti.f64) / (2 * BINS) - 1
                low = ti.max(0, ti.min(ti.cast(ti.floor(place), ti.i32), nodes - 2))
                part = ti.max(0.0, ti.min(place - low, 1.0))
                both, under, over = last[i] * first[j], belief[row, low], belief[row, low + 1]
                belief[row, low] = under + (1 - part) * both
                belief[row, low + 1] = over + part * both


@ti.func
def say(
    log: ti.template(), path: ti.template(), summary: ti.template(), begin: ti.template(),
    detection: ti.template(), table: ti.template(), step, radio: ti.template(), row, other,
):  # fmt: skip
    """Log-likelihood over one coefficient of a path, `other` the product of the rest, softly by association.

    Rician for detections, ``p_d`` for those without an amplitude, ``1 - p_d`` for misses: detections alone
    are biased by the threshold, and misses alone all the more (docs/model.md, (M42)).
    """
    missed = ti.max(1 - summary[SHARE, row], 0.0)
    at_1m, samples = radio[path[row, ANCHOR], AT_1M], radio[path[row, ANCHOR], SAMPLES]
    for n in range(BINS):
        level = amplitude_of(at_1m, summary[HOW_LONG, row]) * other * (n + 0.5) / BINS
        heard = detection_of(level, table, step)
        log[n] = missed * logarithm_of(1 - summary[OF_RAY, row] * heard + 1e-9)
        for k in range(begin[row], begin[row + 1]):
            if detection[1, k] > FAINT:
                if detection[0, k] >= 0:
                    log[n] += detection[1, k] * log_rician(detection[0, k], level, samples)
                else:
                    log[n] += detection[1, k] * logarithm_of(heard + 1e-9)


@ti.func
def add_to_cells(
    log: ti.template(), share, drawn: ti.template(), where: ti.template(), held: ti.template(),
    used: ti.template(), frame: ti.template(), row, rays, corner,
):  # fmt: skip
    """Add a log-likelihood to the cells that the rays of a path meet, shared among its rays.

    A cell's best bin is 0 afterwards, and none is further below than the clip: steps aren't independent, and
    what is surer than that could never be learned anew. A cell that is hit for the first time gets a row.
    """
    per_metre, settled = 1 / frame[SIDE], -1
    for k in range(row * rays, (row + 1) * rays):
        ix = cell_of(drawn[k, 2 * corner], frame[ORIGIN_X], per_metre)
        iy = cell_of(drawn[k, 2 * corner + 1], frame[ORIGIN_Y], per_metre)
        if ix >= 0 and iy >= 0 and ix < where.shape[1] and iy < where.shape[0]:
            cell = where[iy, ix]
            if cell < 0 and used[0] < held.shape[0]:
                cell = used[0]
                used[0] = cell + 1
                where[iy, ix] = cell
                for n in range(BINS):
                    held[cell, n] = 0.0
            if cell >= 0:
                for n in range(BINS):
                    before = held[cell, n]
                    held[cell, n] = before + ti.cast(share * log[n] / rays, ti.f32)
    for k in range(row * rays, (row + 1) * rays):
        ix = cell_of(drawn[k, 2 * corner], frame[ORIGIN_X], per_metre)
        iy = cell_of(drawn[k, 2 * corner + 1], frame[ORIGIN_Y], per_metre)
        if ix >= 0 and iy >= 0 and ix < where.shape[1] and iy < where.shape[0]:
            cell = where[iy, ix]
            if cell >= 0 and cell != settled:  # rays side by side meet the same one
                settled, most = cell, held[cell, 0]
                for n in range(1, BINS):
                    most = ti.max(most, held[cell, n])
                for n in range(BINS):
                    below = held[cell, n] - most
                    held[cell, n] = ti.max(below, ti.cast(-frame[CLIP], ti.f32))


@copying("mean")
@ti.kernel
def learn(
    head: ti.i32,  # entry of the mean where the lines begin: see `layout`
    step: ti.f64,
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    table: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [T] p_d over ``0, step, ...``
    radio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 12] see `radio`
    frame: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [8] see `blocks.Cells`
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 2 or more] of the anchors
    rays_cast: pack(Drawn),
    messages: pack(Messages),
    known: pack(Coefficients),
    hits: pack(Hits),
):
    """Learn coefficients: of surfaces by single bounces, of cells by both ends of double bounces, too; and
    where surfaces were hit.

    A window isn't the wall around it (docs/model.md, (M41)). Misses of a double bounce teach nothing by
    themselves: it updates cells only if it may have caused a measurement (docs/model.md, (M42)).
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for s in range(known.surface.shape[0]):
            total, known.latest[s] = ti.f64(0.0), -1
            place_again(s, mean, head, hits.extent, hits.outermost)
            for n in range(BINS):
                total += known.surface[s, n] * (n + 0.5) / BINS
            known.usual[s] = total
        rays = rays_cast.drawn.shape[0] // ti.max(messages.noted.shape[0], 1)
        log = ti.Vector([0.0] * BINS, dt=ti.f64)
        for row in range(messages.count[0]):
            bounces, last, first = messages.noted[row, 0], messages.noted[row, 1], messages.noted[row, 2]
            caused = messages.summary[SHARE, row] > LEAST_SHARE
            send = messages.factor[row, SENDS] > 0.5 and rays_cast.seen[row, SHARE_POSSIBLE] > frame[LEAST]
            if send and messages.summary[SHARE, row] > LIKELIER_THAN_NOT:
                spot(messages.noted, row, rays_cast.seen, places, mean, head, hits, known.latest)
            tells = (bounces == 1 and (caused or send)) or (bounces == 2 and caused and send)
            for turn in range(bounces if tells else 0):  # the last bounce first
                other = ti.f64(1.0)
                if bounces == 2:
                    other = known.usual[first] if turn == 0 else known.usual[last]
                say(
                    log, messages.noted, messages.summary, messages.begin, messages.detection, table, step,
                    radio, row, other,
                )  # fmt: skip
                if bounces == 1:
                    most, total = ti.f64(-1e30), ti.f64(0.0)
                    for n in range(BINS):
                        most = ti.max(most, log[n])
                    for n in range(BINS):
                        known.surface[last, n] = known.surface[last, n] * decay_of(log[n] - most) + 1e-9
                        total += known.surface[last, n]
                    for n in range(BINS):
                        before = known.surface[last, n]
                        known.surface[last, n] = before / total
                if send:
                    add_to_cells(
                        log, messages.summary[OF_SURFACES, row], rays_cast.drawn, known.where, known.held,
                        known.used, frame, row, rays, bounces - turn,
                    )  # fmt: skip


@quick
@ti.kernel
def learn_ratios(
    head: ti.i32,  # entry of the mean where the lines begin: see `layout`
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N] of the belief
    ratio: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [L, 2, BINS] log-likelihoods over the coefficient at the
    # last and the first hit of every path
    frame: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [8] see `blocks.Cells`
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 2 or more] of the anchors
    rays_cast: pack(Drawn),
    messages: pack(Messages),
    known: pack(Coefficients),
    hits: pack(Hits),
):
    """As `learn`, by log-likelihoods that are given: they hold detections and misses in one.

    A surface learns only of single bounces that may have caused something, of those that send to cells, too.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        for s in range(known.surface.shape[0]):
            known.latest[s] = -1
            place_again(s, mean, head, hits.extent, hits.outermost)
        rays = rays_cast.drawn.shape[0] // ti.max(messages.noted.shape[0], 1)
        log = ti.Vector([0.0] * BINS, dt=ti.f64)
        for row in range(messages.count[0]):
            bounces, last = messages.noted[row, 0], messages.noted[row, 1]
            caused = messages.summary[SHARE, row] > LEAST_SHARE
            send = messages.factor[row, SENDS] > 0.5 and rays_cast.seen[row, SHARE_POSSIBLE] > frame[LEAST]
            if send and messages.summary[SHARE, row] > LIKELIER_THAN_NOT:
                spot(messages.noted, row, rays_cast.seen, places, mean, head, hits, known.latest)
            if bounces == 1 and caused:
                most, total = ti.f64(-1e30), ti.f64(0.0)
                for n in range(BINS):
                    most = ti.max(most, ratio[row, 0, n])
                for n in range(BINS):
                    known.surface[last, n] = known.surface[last, n] * decay_of(ratio[row, 0, n] - most) + 1e-9
                    total += known.surface[last, n]
                for n in range(BINS):
                    before = known.surface[last, n]
                    known.surface[last, n] = before / total
            if send and (bounces == 1 or (bounces == 2 and caused)):
                for corner in range(bounces):  # after the anchor: the first hit, then the last
                    for n in range(BINS):
                        log[n] = ratio[row, bounces - 1 - corner, n]
                    add_to_cells(
                        log, messages.summary[OF_SURFACES, row], rays_cast.drawn, known.where, known.held,
                        known.used, frame, row, rays, corner + 1,
                    )  # fmt: skip
