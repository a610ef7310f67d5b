"""Twins of the kernels that know cells: crossings of grid lines, sorted."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.kernels.primitives.blocks import Coefficients, Drawn, Hits, Messages
from gridslam.reference.messages import log_rician
from gridslam.world.geometry import mirror, unit

Whole = NDArray[np.int32]
Long = NDArray[np.int64]


def cells_of(
    corners: Array, normals: Array, frame: Array, shape: tuple[int, int], spared: float = 0.0
) -> tuple[Array, list[Array]]:
    """Cells that a ray crosses, (N, 2) [iy, ix], and those that it meets at each bounce; inside the grid.

    Parameters
    ----------
    corners : (B + 2, 2) m
    normals : (B, 2)
    spared : float
        How near a ray comes to a wall that it meets, m, before its cells no longer count as crossed.
    """
    place = (corners - frame[:2]) / frame[2]
    met = []
    for point, normal in zip(place[1:-1], normals, strict=True):
        around = point + np.outer([-1, 0, 1], normal)
        met.append(_inside(np.floor(around).astype(int)[:, ::-1], shape))
    crossed = [np.zeros((0, 2), int)]
    for leg, (start, end) in enumerate(itertools.pairwise(place)):
        near = [normals[leg - 1]] if leg else []
        rise = [abs(n @ (end - start)) for n in [*near, *normals[leg : leg + 1]]]
        cut = [spared / frame[2] / max(r, 1e-12) for r in rise]
        if sum(cut) >= 1:
            continue
        early, late = sum(cut[: len(near)]), sum(cut[len(near) :])
        start, end = start + early * (end - start), end - late * (end - start)
        step = end - start
        cuts = [np.array([0.0, 1.0])]
        for axis in range(2):
            if abs(step[axis]) > 1e-12:
                low, high = sorted((start[axis], end[axis]))
                cuts.append((np.arange(np.ceil(low), np.floor(high) + 1) - start[axis]) / step[axis])
        share = np.unique(np.clip(np.concatenate(cuts), 0, 1))
        middle = start + 0.5 * (share[1:] + share[:-1])[:, None] * step
        middle = middle[np.diff(share) > 1e-9] if len(share) > 1 else start[None]
        crossed.append(np.floor(middle).astype(int)[:, ::-1])
    walked, number = np.concatenate([_inside(c, shape) for c in crossed]), np.array([shape[1], 1])
    hit = np.concatenate([np.zeros((0, 2), int), *met]) @ number
    return walked[~np.isin(walked @ number, hit)], met


def _inside(cells: Array, shape: tuple[int, int]) -> Array:
    good = cells[((cells >= 0) & (cells < np.array(shape))).all(1)]
    return np.stack(np.divmod(np.unique(good[:, 0] * shape[1] + good[:, 1]), shape[1]), -1)


def dense(where: Whole, held: Array) -> Array:
    """Log-likelihoods of all cells, (ny, nx, BINS), of which those that were hit have rows."""
    whole = np.zeros((*where.shape, held.shape[1]))
    whole[where >= 0] = held[where[where >= 0]]
    return whole


def cast(
    corners: Array, normals: Array, possible: Array, bounces: Whole, worth: Array, traversed: Array,
    hit: Array, frame: Array, rays: int, outside: float, clip: float, spared: float = 0.0,
) -> tuple[Array, Array]:  # fmt: skip
    """Twin of `cells.cast`: V of every ray (K,), and log ratios summed over the paths (ny, nx).

    A cell that a ray crosses on two legs counts twice in V, as the kernel has it, and its message is the
    sum of two.
    """
    validity, message = np.zeros(len(corners)), np.zeros(traversed.shape)
    for path, count in enumerate(bounces):
        lift, total = np.zeros((2, *traversed.shape)), 0.0
        for k in range(path * rays, (path + 1) * rays):
            if not possible[k]:
                total += 1.0  # V is 0
                continue
            walked, met = cells_of(
                corners[k, : count + 2], normals[k, :count], frame, traversed.shape, spared
            )
            free = 1 - traversed[tuple(walked.T)]
            bounce_v = [1 - np.prod(1 - hit[tuple(c.T)]) if len(c) else outside for c in met]
            bounce_m = [1 - np.prod(1 - traversed[tuple(c.T)]) if len(c) else outside for c in met]
            validity[k] = free.prod() * np.prod(bounce_v)
            through = free.prod() * np.prod(bounce_m)
            base = through * worth[path] + 1 - through
            total += base
            np.add.at(lift[0], tuple(walked.T), _message(np.minimum(through / free, 1), worth[path]) - base)
            np.add.at(lift[1], tuple(walked.T), 1 - base)
            for cells, own in zip(met, bounce_m, strict=True):
                sure = through / max(own, 1e-12)
                rest = (1 - own) / (1 - traversed[tuple(cells.T)])
                np.add.at(lift[0], tuple(cells.T), _message(sure * (1 - rest), worth[path]) - base)
                np.add.at(lift[1], tuple(cells.T), _message(sure, worth[path]) - base)
        touched = (lift != 0).any(0)
        change = np.log(np.maximum(total + lift[1], 1e-12)) - np.log(np.maximum(total + lift[0], 1e-12))
        message += np.where(touched, np.clip(change, -clip, clip), 0.0)
    return validity, message


def _message(validity: Array, worth: float) -> Array:
    return validity * worth + 1 - validity


def coefficient_product(
    drawn: Array, path: Whole, where: Whole, held: Array, surface: Array, frame: Array, other: float
) -> Array:
    """Twin of `coefficients.coefficient_product`: beliefs over products of coefficients, (L, 2 BINS)."""
    bins, rays = surface.shape[1], len(drawn) // max(len(path), 1)
    centre, held = (np.arange(bins) + 0.5) / bins, dense(where, held)
    belief = np.zeros((len(path), 2 * bins))
    for row, (bounces, last, first) in enumerate(path[:, :3]):
        corners = drawn[row * rays : (row + 1) * rays, :8].reshape(rays, 4, 2)
        own = []
        for corner, number in ((1, last if bounces == 1 else first), (2, last))[:bounces]:
            cell = np.floor((corners[:, corner] - frame[:2]) / frame[2]).astype(int)
            inside = ((cell >= 0) & (cell < held.shape[1::-1])).all(1)
            log = held[cell[inside, 1], cell[inside, 0]].sum(0, dtype=np.float64) / max(inside.sum(), 1)
            local = surface[number] * np.exp(log - log.max())
            local = local / local.sum() if local.sum() > 1e-12 else np.full(bins, 1 / bins)
            own.append((1 - other) * local + other / bins)
        if bounces == 0:
            belief[row, -1] = 1.0
        elif bounces == 1:
            belief[row, ::2] = own[0]
        else:
            product, chance = np.outer(centre, centre).ravel(), np.outer(own[1], own[0]).ravel()
            place = product * 2 * bins - 1
            low = np.clip(np.floor(place).astype(int), 0, 2 * bins - 2)
            part = np.clip(place - low, 0.0, 1.0)
            belief[row] = np.bincount(low, (1 - part) * chance, 2 * bins)
            belief[row] += np.bincount(low + 1, part * chance, 2 * bins)
    return belief


def learn(
    head: int, step: float, mean: Array, table: Array, radio: Array, frame: Array, places: Array,
    rays_cast: Drawn, messages: Messages, known: Coefficients, hits: Hits,
) -> tuple[Array, Array, Array, Array, Long, Array]:  # fmt: skip
    """Twin of `coefficients.learn`: beliefs of surfaces, log-likelihoods of all cells, and `mark`'s.

    Parameters
    ----------
    head : int
        Entry of the mean where the lines begin.
    step, table : float, (T,)
        p_d over amplitudes 0, step, ...
    mean : (N,)
        Of the belief.
    radio : (J, 12)
    frame : (8,)
        As `blocks.Cells` has it.
    places : (J, 2 or more)
        Of the anchors, x, y first, m.

    Returns
    -------
    (surface, held, foot, extent, times, outermost)
        Beliefs (S, BINS), log-likelihoods of all cells (ny, nx, BINS); (S,), (S, 2), (S,), (S, 8) of `mark`.
    """
    (drawn, seen), (count, path, factor, summary, begin, detection) = rays_cast, messages
    surface, where, held = known.surface, known.where, known.held
    rays, path = len(drawn) // max(len(path), 1), path[: count[0]]
    send = (factor[: len(path), 1] > 0.5) & (seen[: len(path), 1] > frame[5])
    sure = send * summary[2, : len(path)]
    apart = np.pad(seen[: len(path), 2:], ((0, 0), (2, 0)), constant_values=1)
    marked = mark(mean, head, path, apart, sure, places, *hits)
    surface, held, bins = surface.copy(), dense(where, held), surface.shape[1]
    centre = (np.arange(bins) + 0.5) / bins
    usual = surface @ centre

    def likelihood(row: int, other: float) -> Array:
        chance, share, length = summary[1:, row]
        level = radio[path[row, 3], 7] / max(length, 1e-3) * other * centre
        detected = np.interp(level, step * np.arange(len(table)), table)
        log = max(1 - share, 0.0) * np.log(1 - chance * detected + 1e-9)
        for amplitude, weight in detection[:, begin[row] : begin[row + 1]].T:
            if weight <= 1e-3:
                continue
            if amplitude < 0:
                log = log + weight * np.log(detected + 1e-9)
                continue
            log = log + weight * log_rician(amplitude, level, radio[path[row, 3], 8])
        return np.asarray(log)

    def tell(row: int, corner: int, log: Array) -> None:
        points = drawn[row * rays : (row + 1) * rays, 2 * corner : 2 * corner + 2]
        _add_to_cells(held, points, summary[0, row] * log / rays, frame)

    for row, (bounces, last, first) in enumerate(path[:, :3]):
        caused = summary[2, row] > 0.05
        if bounces == 1 and (caused or send[row]):
            log = likelihood(row, 1.0)
            posterior = surface[last] * np.exp(log - log.max()) + 1e-9
            surface[last] = posterior / posterior.sum()
        if bounces == 1 and send[row]:
            tell(row, 1, likelihood(row, 1.0))
        if bounces == 2 and caused and send[row]:
            tell(row, 2, likelihood(row, usual[first]))
            tell(row, 1, likelihood(row, usual[last]))
    return surface, held, *marked


def learn_ratios(
    head: int, mean: Array, ratio: Array, frame: Array, places: Array, rays_cast: Drawn, messages: Messages,
    known: Coefficients, hits: Hits,
) -> tuple[Array, Array, Array, Array, Long, Array]:  # fmt: skip
    """Twin of `coefficients.learn_ratios`: by log-likelihoods (L, 2, BINS) at last and first hit."""
    (drawn, seen), (count, path, factor, summary, _, _) = rays_cast, messages
    rays, path = len(drawn) // max(len(path), 1), path[: count[0]]
    send = (factor[: len(path), 1] > 0.5) & (seen[: len(path), 1] > frame[5])
    apart = np.pad(seen[: len(path), 2:], ((0, 0), (2, 0)), constant_values=1)
    marked = mark(mean, head, path, apart, send * summary[2, : len(path)], places, *hits)
    surface, held = known.surface.copy(), dense(known.where, known.held)
    for row, (bounces, last, _) in enumerate(path[:, :3]):
        if summary[2, row] > 0.05 and bounces == 1:
            posterior = surface[last] * np.exp(ratio[row, 0] - ratio[row, 0].max()) + 1e-9
            surface[last] = posterior / posterior.sum()
        if not send[row] or bounces == 0 or (bounces == 2 and summary[2, row] <= 0.05):
            continue
        hit = [(1, 1), (2, 0)] if bounces == 2 else [(1, 0)]
        for corner, which in hit:
            points = drawn[row * rays : (row + 1) * rays, 2 * corner : 2 * corner + 2]
            _add_to_cells(held, points, summary[0, row] * ratio[row, which] / rays, frame)
    return surface, held, *marked


def _add_to_cells(held: Array, points: Array, log: Array, frame: Array) -> None:
    """Add a log-likelihood (BINS,) to the cells at points (R, 2), once for each."""
    cell = np.floor((points - frame[:2]) / frame[2]).astype(int)
    cell = cell[((cell >= 0) & (cell < held.shape[1::-1])).all(1)]
    met = cell[:, 1], cell[:, 0]
    np.add.at(held, met, log)
    held[met] = np.maximum(held[met] - held[met].max(1, keepdims=True), -frame[4])


def mark(
    mean: Array, head: int, path: Whole, seen: Array, share: Array, places: Array, foot: Array, extent: Array,
    times: Long, outermost: Array,
) -> tuple[Array, Array, Long, Array]:  # fmt: skip
    """Twin of `detections.mark`: where surfaces were hit, and how often they were seen, afterwards.

    Parameters
    ----------
    mean, head : (N,), int
        Of the belief; its entry where the lines begin.
    path : (L, 4)
        Bounces, surfaces hit last and first, anchor.
    seen : (L, 6)
        Means of each path, as `blocks.Casting` has them.
    share : (L,)
        Probability that each caused a measurement.
    places : (J, 2 or more)
        Of the anchors, x, y first, m.
    foot, extent, times, outermost : (S,), (S, 2), (S,), (S, 8)
        As `blocks.Hits` has them, before; what is returned is the same after.
    """
    rows = np.flatnonzero(share * seen[:, 1] > 0.5)
    # of each path the surface that it hits first, then the one that it hits last
    surface = np.where(path[rows, :1] == 2, path[rows, 2:0:-1], path[rows, 1:3])
    there = np.arange(2) < path[rows, :1]
    other = surface[:, ::-1]
    surface, corner = surface[there], seen[rows, 2:].reshape(-1, 2, 2)[there]
    anchor = np.repeat(path[rows, 3], there.sum(1))
    lines, agent = mean[head:].reshape(-1, 2), mean[:2]
    angle = lines[surface, 0]
    along = corner[:, 1] * np.cos(angle) - corner[:, 0] * np.sin(angle)
    ways = []
    for bounces, (last, first), begin in zip(path[rows, 0], other, places[path[rows, 3], :2], strict=True):
        if bounces == 1:
            ways.append([*begin, *agent])
        if bounces == 2:
            ways += [[*begin, *mirror(lines[last], agent)], [*mirror(lines[first], begin), *agent]]
    way = np.reshape(ways, (-1, 4))
    foot, times = foot.copy(), times.copy()
    extent, outermost = extent.copy(), outermost.copy()
    for s in range(len(foot)):
        own = surface == s
        if own.any():
            foot[s] = along[own][-1]
            times[s] += len(np.unique(anchor[own]))
        ends, before = extent[s].copy(), outermost[s].reshape(2, 4).copy()
        hit = np.isfinite(before[:, 0])
        ends[hit] = _reflected(lines[s], before[hit])
        every = np.concatenate([ends[np.isfinite(ends)], _reflected(lines[s], way[own])])
        if len(every):
            known = np.concatenate([before[np.isfinite(ends)], way[own]])
            chosen = np.argmin(every), np.argmax(every)
            extent[s], outermost[s] = every[[*chosen]], known[[*chosen]].ravel()
    return foot, extent, times, outermost


def _reflected(line: Array, way: Array) -> Array:
    """Where along a line paths (N, 4) are reflected off it, (N,)."""
    tangent, gap = unit(line[0] + 0.5 * np.pi), np.abs(way.reshape(-1, 2, 2) @ unit(line[0]) - line[1])
    along = way.reshape(-1, 2, 2) @ tangent
    return np.asarray((along * gap[:, ::-1]).sum(1) / np.maximum(gap.sum(1), 1e-9))


def fold_messages(
    message: Array, before: Array, clear: Whole, prior: float, clip: float, observed: Whole
) -> tuple[Array, Array, Array]:
    """Twin of `occupancy.fold_messages`: evidence, which cells are observed, occupancy in both roles.

    Parameters
    ----------
    message : (SLABS, N)
        Sums of log ratios of each cell.
    before : (N,)
        Evidence, log odds without the prior.
    clear, observed : (N,)
        Above 0 next to an anchor; where something was observed before.
    prior : float
        Log odds of a cell in the role of being crossed.
    clip : float
        How far from 0 evidence may be.

    Returns
    -------
    (evidence, observed, occupied)
        (N,), (N,) bool, (2, N): of a traversed cell, of a hit one.
    """
    total = message.sum(0, dtype=np.float64)
    evidence = np.clip(before + total, -clip, clip)
    both = 1 / (1 + np.exp(-np.stack([evidence + prior, evidence])))
    both = np.clip(both, np.array([[1e-4], [1e-3]]), 0.99)
    return evidence, (observed > 0) | (np.abs(total) > 0.01), np.where(clear > 0, 1e-6, both)
