"""Plain NumPy twins of the kernels: what the tests compare with and what the benchmark measures against.

Each takes what its kernel takes and returns what that writes, worked out another way: paths by images and
arc tangents in double precision, cells by sorting the crossings of grid lines.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry import mirror, trace, wrap
from gridslam.inference.belief import Belief, update

Array = NDArray[np.float64]
Whole = NDArray[np.int32]


def lines_of(state: Array) -> Array:
    """Lines (angle, offset) of states ``[3 + 3 S, P]``, (S, P, 2)."""
    return np.stack([np.arctan2(state[4::3], state[3::3]), state[5::3]], -1).astype(np.float64)


def evaluate(
    root: Array, base: Array, points: Array, state: Array, path: Whole, start: Whole, pair: Array,
    place: Array, block: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Twin of `kernels.paths.evaluate`: sums of densities and counts of valid particles, by blocks."""
    if len(root):
        state = draw(root, base, points[:, : state.shape[1]])
    particles = state.shape[1]
    blocks = particles // block
    weight, valid = np.zeros((start[-1], blocks)), np.zeros((len(path), blocks))
    surfaces = lines_of(state)
    anchor = np.broadcast_to(np.asarray(place[:2], np.float64), (particles, 2))
    position = np.asarray(state[:2].T, np.float64)
    for row, (bounces, last, first) in enumerate(path[:, :3]):
        drawn = trace(
            position, anchor, surfaces[max(last, 0)], surfaces[max(first, 0)], np.full(particles, bounces)
        )
        possible = drawn.valid.astype(np.float64)
        valid[row] = possible.reshape(blocks, block).sum(1)
        seen = np.stack([drawn.distance, drawn.departure - place[2], drawn.arrival - state[2]], -1)
        for n in range(start[row], start[row + 1]):
            gap = pair[n, :3] - seen
            gap[:, 1:] = wrap(gap[:, 1:])
            i00, i11, i22, i01, i02, i12 = pair[n, 3:9]
            inverse = np.array([[i00, i01, i02], [i01, i11, i12], [i02, i12, i22]], np.float64)
            density = possible * np.exp(-0.5 * np.einsum("pi,ij,pj->p", gap, inverse, gap))
            weight[n] = density.reshape(blocks, block).sum(1)
    return weight, valid


def draw(root: Array, base: Array, points: Array) -> Array:
    """Twin of `kernels.particles.draw_block`: states (3 + 3 S, P) of ``base + root points``."""
    states = base[:, :1].astype(np.float64) + root.astype(np.float64) @ points[: len(root)]
    lines = states[5:].reshape(-1, 2, states.shape[1])
    bent = np.stack([np.cos(lines[:, 0]), np.sin(lines[:, 0]), lines[:, 1]], 1)
    return np.concatenate([states[[0, 1, 4]], bent.reshape(-1, states.shape[1])])


def polylines(state: Array, path: Whole, places: Array) -> tuple[Array, Array]:
    """Twin of `kernels.paths.polylines`: corners (L, R, 4, 2) of possible paths, and which are, (L, R)."""
    agent, states = state[:2], state.shape[1]
    corners, valid = np.zeros((len(path), states, 4, 2)), np.zeros((len(path), states))
    surfaces = lines_of(state)
    for row, (bounces, last, first, source) in enumerate(path):
        anchor = np.broadcast_to(places[source, :2], (states, 2))
        drawn = trace(
            agent.T, anchor, surfaces[max(last, 0)], surfaces[max(first, 0)], np.full(states, bounces)
        )
        corners[row], corners[row, :, 0] = agent.T[:, None], anchor
        if bounces == 1:
            corners[row, :, 1] = drawn.last_point
        if bounces == 2:
            corners[row, :, 1], corners[row, :, 2] = drawn.first_point, drawn.last_point
        corners[row] = np.where(drawn.valid[:, None, None], corners[row], anchor[:, None])
        valid[row] = drawn.valid
    return corners, valid


def propose(state: Array, noise: Array, heard: Array, known: Whole, place: Array) -> Array:
    """Twin of `kernels.births.propose`: mean of f(AoD) / span for measurements and hypotheses, (M, H)."""
    samples = min(state.shape[1], noise.shape[1])
    state, noise = state[:, :samples], noise[:, :samples]
    agent, weight = state[:3], np.zeros((len(heard), len(known)))
    surfaces, anchor = lines_of(state), np.broadcast_to(place[:2], (samples, 2))
    for m, (distance, departure, arrival, distance_std, departure_std, arrival_std) in enumerate(heard):
        reach = distance + distance_std * noise[0]
        bearing = arrival + arrival_std * noise[1] + agent[2]
        image = agent[:2].T + reach[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], -1)
        for h, (last, first) in enumerate(known):
            end = mirror(surfaces[last], image) if last >= 0 else image
            source = mirror(surfaces[first], anchor) if first >= 0 else anchor
            span = np.linalg.norm(end - source, axis=1)
            normal = (end - source) / np.maximum(span, 1e-12)[:, None]
            fresh = np.stack(
                [np.arctan2(normal[:, 1], normal[:, 0]), 0.5 * (normal * (end + source)).sum(1)], -1
            )
            double = last >= 0 or first >= 0
            drawn = trace(
                agent[:2].T,
                anchor,
                surfaces[last] if last >= 0 else fresh,
                surfaces[first] if first >= 0 else fresh,
                np.full(samples, 2 if double else 1),
            )
            density = np.full(samples, 1 / (2 * np.pi))
            if departure_std < 1e6:
                gap = wrap(departure - (drawn.departure - place[2])) / departure_std
                density = np.exp(-0.5 * gap**2) / (departure_std * np.sqrt(2 * np.pi))
            good = drawn.valid & (span > 1e-2) & (reach > 0)
            weight[m, h] = np.where(good, density / np.maximum(span, 1e-12), 0.0).mean()
    return weight


def cells_of(
    corners: Array, normals: Array, frame: Array, shape: tuple[int, int]
) -> tuple[Array, list[Array]]:
    """Cells that a ray crosses, (N, 2) [iy, ix], and those that it meets at each bounce; inside the grid.

    Parameters
    ----------
    corners : (B + 2, 2) m
    normals : (B, 2)
    """
    place = (corners - frame[:2]) / frame[2]
    met = []
    for point, normal in zip(place[1:-1], normals, strict=True):
        around = point + np.outer([-1, 0, 1], normal)
        met.append(_inside(np.floor(around).astype(int)[:, ::-1], shape))
    crossed = [np.zeros((0, 2), int)]
    for start, end in itertools.pairwise(place):
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
    hit = {tuple(c) for cells in met for c in cells}
    walked = np.concatenate([_inside(c, shape) for c in crossed])
    return np.array([c for c in walked if tuple(c) not in hit], int).reshape(-1, 2), met


def _inside(cells: Array, shape: tuple[int, int]) -> Array:
    good = ((cells >= 0) & (cells < np.array(shape))).all(1)
    return np.unique(cells[good], axis=0)


def cast(
    corners: Array, normals: Array, possible: Array, bounces: Whole, worth: Array, traversed: Array,
    hit: Array, frame: Array, rays: int, outside: float, clip: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Twin of `kernels.cells.cast`: V of every ray (K,), and log ratios summed over the paths (ny, nx).

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
            walked, met = cells_of(corners[k, : count + 2], normals[k, :count], frame, traversed.shape)
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


def predict(mean: Array, covariance: Array, path: Whole, places: Array) -> tuple[Array, Array, Array]:
    """Twin of `kernels.gaussian.predict`: values (L, 3), Jacobians (L, 3, N) and covariances (L, 3, 3)."""
    count, lines = len(path), np.concatenate([mean[5:].reshape(-1, 2), np.zeros((1, 2))])
    bounces, last, first, source = path.T.astype(np.intp)
    place = places[source]
    drawn = trace(
        np.tile(mean[:2], (count, 1)),
        place[:, :2],
        lines[last],
        lines[first],
        bounces,
    )
    value = np.stack([drawn.distance, wrap(drawn.departure - place[:, 2]), wrap(drawn.arrival - mean[4])], -1)
    slope = np.zeros((count, 3, len(mean)))
    slope[:, :, [0, 1, 4]] = drawn.jacobian[:, :, :3]
    for row in range(count):
        if bounces[row] > 0:
            slope[row, :, 5 + 2 * last[row] : 7 + 2 * last[row]] += drawn.jacobian[row, :, 3:5]
        if bounces[row] == 2:
            slope[row, :, 5 + 2 * first[row] : 7 + 2 * first[row]] += drawn.jacobian[row, :, 5:7]
    return value, slope, slope @ covariance @ slope.transpose(0, 2, 1)


def correct(
    mean: Array, covariance: Array, path: Whole, start: Whole, order: NDArray[np.intp], prior: Array,
    pair: Array, place: Array, least: float,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Twin of `kernels.gaussian.correct`: mean, covariance and the probabilities of the associations."""
    share = np.zeros(len(pair))
    for row in order:
        chance, missed = prior[:, row]
        alone = np.append(path[row, :3], 0)[None]
        value, slope, core = (part[0] for part in predict(mean, covariance, alone, place[None]))
        chosen = slice(start[row], start[row + 1])
        variance, density, message = pair[chosen, 3:6], pair[chosen, 6], pair[chosen, 7]
        gap = pair[chosen, :3] - value
        gap[:, 1:] = wrap(gap[:, 1:])
        gap[variance >= 1e11] = 0.0
        weight = np.array(
            [
                chance * m * d * np.exp(-0.5 * g @ np.linalg.solve(core + np.diag(v), g))
                / np.sqrt(np.linalg.det(2 * np.pi * (core + np.diag(v))))
                for g, v, d, m in zip(gap, variance, density, message, strict=True)
            ]
        )  # fmt: skip
        share[chosen] = weight / (weight.sum() + missed)
        kept = share[chosen] > least
        after = update(Belief(mean, covariance), slope, gap[kept], variance[kept], share[chosen][kept])
        mean, covariance = after.mean, after.covariance
    return mean, covariance, share


def gate(
    predicted: Array, worth: Array, heard: Array, strength: Array, radio: Array
) -> tuple[Whole, Array, Array]:
    """Twin of `kernels.gating.gate`: path and measurement of the pairs, what is measured, and its inverse."""
    scale, given, *aperture, max_distance, kept, gates, margin, slack, unmeasured, faintest = radio
    value, spread = predicted[:, None, :3], predicted[:, 3:].reshape(-1, 3, 3)
    amplitude = np.maximum(strength[1], faintest)
    std = np.empty((*amplitude.shape, 3))
    std[..., 0] = given if given > 0 else scale / amplitude
    for q in (1, 2):
        across, along = aperture[2 * q - 2 : 2 * q]
        square = np.sin(value[..., q]) ** 2 * across + np.cos(value[..., q]) ** 2 * along
        with np.errstate(divide="ignore"):
            std[..., q] = 1 / (np.sqrt(8) * np.pi * amplitude * np.sqrt(square))
    std = np.where(heard[:, 3:] > 0, heard[:, 3:], std)
    std[..., :] = np.where(heard[:, 3:] < 0, np.inf, std)
    missing = np.square(std) >= unmeasured
    gap = heard[:, :3] - value
    gap[..., 1:] = wrap(gap[..., 1:])
    gap = np.where(heard[:, 3:] < 0, 0.0, np.abs(gap))
    reach = gates * np.sqrt(
        np.diagonal(spread, axis1=1, axis2=2)[:, None] + np.where(missing, 0.0, std) ** 2
    ) + np.array([margin, slack, slack])
    chosen = (gap < reach).all(-1) & (worth > 1e-6)[:, None] & (strength[0] > 0)
    path, measurement = np.nonzero(chosen)
    std, missing = std[chosen], missing[chosen]
    flat = np.array([max_distance, 2 * np.pi, 2 * np.pi])
    density = strength[0][chosen] * np.where(missing, np.sqrt(2 * np.pi * unmeasured) / flat, 1.0).prod(1)
    variance = np.where(missing, unmeasured, np.maximum(std, 1e-6) ** 2)
    total = kept * spread[path] + variance[:, :, None] * np.eye(3)
    pair = np.column_stack([heard[measurement, :3], variance, density, 0 * density, np.linalg.det(total)])
    return np.stack([path, measurement], -1).astype(np.int32), pair, np.linalg.inv(total)


def recall(drawn: Array, path: Whole, held: Array, surface: Array, frame: Array) -> Array:
    """Twin of `kernels.coefficients.recall`: beliefs over products of coefficients, (L, 2 BINS)."""
    bins, rays = surface.shape[1], len(drawn) // max(len(path), 1)
    centre = (np.arange(bins) + 0.5) / bins
    belief = np.zeros((len(path), 2 * bins))
    for row, (bounces, last, first) in enumerate(path[:, :3]):
        corners = drawn[row * rays : (row + 1) * rays, :8].reshape(rays, 4, 2)
        own = []
        for corner, number in ((1, last if bounces == 1 else first), (2, last))[:bounces]:
            cell = np.floor((corners[:, corner] - frame[:2]) / frame[2]).astype(int)
            inside = ((cell >= 0) & (cell < held.shape[1::-1])).all(1)
            log = held[cell[inside, 1], cell[inside, 0]].sum(0) / max(inside.sum(), 1)
            local = surface[number] * np.exp(log - log.max())
            local = local / local.sum() if local.sum() > 1e-12 else np.full(bins, 1 / bins)
            own.append((1 - frame[3]) * local + frame[3] / bins)
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


def learn(drawn: Array, path: Whole, where: Whole, factor: Array, frame: Array, held: Array) -> Array:
    """Twin of `kernels.coefficients.learn`: the cells' log-likelihoods afterwards, (ny, nx, BINS)."""
    after, rays = held.copy(), len(drawn) // max(len(path), 1)
    for (row, corner), log in zip(where, factor, strict=True):
        points = drawn[row * rays : (row + 1) * rays, 2 * corner : 2 * corner + 2]
        cell = np.floor((points - frame[:2]) / frame[2]).astype(int)
        cell = cell[((cell >= 0) & (cell < held.shape[1::-1])).all(1)]
        np.add.at(after, (cell[:, 1], cell[:, 0]), log / rays)
    return after


def associate(beta: Array, missed: Array, new: Array, limit: Array) -> tuple[Array, Array]:
    """Twin of `kernels.association.associate`: messages from paths and from measurements, (L, M) both."""
    paths, heard = beta.shape
    nu = np.broadcast_to(1 / new, (paths, heard)).copy()
    claim = np.zeros_like(nu)
    for _ in range(int(limit[0]) if paths and heard else 0):
        weight = beta * nu
        others = np.maximum(weight.sum(1, keepdims=True) - weight, 0.0)
        claim = beta / (missed[:, None] + others)
        rest = np.maximum(claim.sum(0, keepdims=True) - claim, 0.0)
        fresh = 1 / (new + rest)
        change = np.abs(fresh - nu).max()
        nu = fresh
        if change < limit[1]:
            break
    return claim, nu
