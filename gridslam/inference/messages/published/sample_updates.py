"""Messages of the papers' representation: particles are moved, meet the paths, are weighted and resampled.

They are part of a step by `inference/management/representation.py`. [Li2025adaptive], section V;
docs/model.md, (M142).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.arrays import Array
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.beliefs.particles import Recipe
from gridslam.inference.messages.likelihood_ratios import LikelihoodRatios
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.published.sampling import moved_agents, resampled
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.published.state_samples import StateSamples
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives import tables
from gridslam.kernels.primitives.tables import DENSITY, SCAN_ROW, VARIANCE
from gridslam.world.filter_model import FilterModel
from gridslam.world.geometry import course, slant, wrap

TURN_M = 5.0
"""A surface's walk by s along its normal goes with one by s / 5 m of its angle, as in `belief.predict`."""
LEAST_SHARE = 1e-3
"""Probability of having caused any measurement below which a path weighs nothing."""
MOVING, WEIGHING, BEARING = range(3)
"""Name the streams of random numbers."""


@timed("updates")
def move_samples(state: State, earlier_s: float | None, model: FilterModel, *, work: Workspace) -> State:
    """Particles a step on: motion of the agent, walk of the surfaces where they were hit last."""
    if earlier_s is None or state.time_s is None:
        return state
    samples, draw = state.require_samples(), _stream(work, state, MOVING)
    agent = moved_agents(samples.agent, state.time_s - earlier_s, model, draw)
    size, shift = samples.lines.shape[:2], model.settings.surface_m
    turn = shift / TURN_M * draw.standard_normal(size)
    walk = shift * draw.standard_normal(size) + state.surfaces.foot[:, None] * turn
    moved = replace(samples, agent=agent, lines=samples.lines + np.stack([turn, walk], -1))
    return _with(state, moved)


def at_samples(paths: PredictedPaths, state: State) -> PredictedPaths:
    """The paths, to be evaluated at the state's own particles: points, the k-th of all beliefs together."""
    samples, mean = state.require_samples(), state.belief.mean
    whole = np.concatenate([samples.agent, *samples.lines], axis=1).T
    off = whole - mean[:, None]
    off[HEADING] = wrap(off[HEADING])
    base = np.stack([mean, np.cos(mean), np.sin(mean)], -1).astype(np.float32)
    points = runtime.resident(np.ascontiguousarray(off, np.float32))
    root = np.eye(len(mean), dtype=np.float32)
    return replace(paths, recipe=Recipe(state.belief.layout, root, base, points, len(samples), 0.0))


@timed("updates")
def weigh_samples(
    before: State, state: State, paths: PredictedPaths, scan: AnchorScan, ratios: LikelihoodRatios,
    model: FilterModel, *, work: Workspace,
) -> State:  # fmt: skip
    """An anchor's messages to agent and surfaces, which are resampled: supporting document, (32) to (44).

    Parameters
    ----------
    before, state : State
        Before and after the updates; what exists is taken from the latter.
    """
    samples, draw = before.require_samples(), _stream(work, state, WEIGHING, scan.anchor)
    logs, surfaces = sample_logs(samples, before.surfaces.existence, paths, ratios, model.places)
    lines = samples.lines.copy()
    for row in np.flatnonzero(surfaces.any(1)):
        lines[row] = lines[row, draw.permutation(resampled(surfaces[row], draw))]
    agent = samples.agent[resampled(logs, draw)]
    return _with(state, replace(samples, agent=agent, lines=lines))


def sample_logs(
    samples: StateSamples, existence: Array, paths: PredictedPaths, ratios: LikelihoodRatios, places: Array
) -> tuple[Array, Array]:
    """Log weights of the agent's particles (P,) and of the surfaces', if they exist, (S, P); (M142).

    Parameters
    ----------
    existence : (S,)
        Of the surfaces, as predicted.
    ratios : LikelihoodRatios
        With the messages of the association.
    places : (J, 6)
        The anchors: x, y (m), orientation (rad) and height above the agent (m).
    """
    logs, surfaces = np.zeros(len(samples)), np.zeros(samples.lines.shape[:2])
    odds, nu = ratios.odds, ratios.message[tables.NU]
    for row in np.flatnonzero(ratios.responsible.sum(1) > LEAST_SHARE).tolist():
        table = paths.rays.table[row]
        possible, density = _densities(samples, table, row, ratios, nu, places)
        bracket = density + 1 - odds[tables.DETECTED, row]
        open_ = odds[tables.OPEN, row] * possible
        ray = odds[tables.EXISTENCE, row]
        factor = ray * (open_ * bracket + 1 - open_) + 1 - ray
        there = odds[tables.SURFACES, row]
        logs += np.log(np.maximum(there * factor + 1 - there, 1e-300))
        for s in {int(table[tables.LAST]), int(table[tables.FIRST])} - {-1}:
            others = there / existence[s] if existence[s] > 0 else 0.0
            surfaces[s] += np.log(np.maximum(others * factor + 1 - others, 1e-300))
    return logs, surfaces


def sampled_anew(state: State, *, work: Workspace) -> State:
    """The state with particles of the surfaces there are: those of new ones are drawn."""
    draw = _stream(work, state, BEARING, state.next_identity)
    return _with(state, state.require_samples().having(state.surfaces.identity, state.belief, draw))


def _densities(
    samples: StateSamples, table: NDArray[np.int32], row: int, ratios: LikelihoodRatios, nu: Array,
    places: Array,
) -> tuple[NDArray[np.bool_], Array]:  # fmt: skip
    """Where a path is possible (P,), and sum_m nu_m g_m there (P,)."""
    count = len(samples)
    place = places[table[tables.ANCHOR]]
    none = np.zeros((count, 2))
    last = samples.lines[table[tables.LAST]] if table[tables.LAST] >= 0 else none
    first = samples.lines[table[tables.FIRST]] if table[tables.FIRST] >= 0 else none
    bounces = np.full(count, table[tables.BOUNCES])
    path = course(samples.agent[:, :2], np.broadcast_to(place[:2], (count, 2)), last, first, bounces)
    length = slant(path.distance, place[3])
    seen = np.stack([length, path.departure - place[2], path.arrival - samples.agent[:, 4]], -1)
    density = np.zeros(count)
    pairs = ratios.pairs
    for n in range(int(pairs.start[row]), int(pairs.start[row + 1])):
        pair = pairs.pair[n]
        variance = pair[VARIANCE:DENSITY]
        off = pair[:VARIANCE] - seen
        off[:, 1:] = wrap(off[:, 1:])
        scale = np.sqrt((2 * np.pi) ** 3 * variance.prod())
        own = np.exp(-0.5 * (off**2 / variance).sum(-1)) * pair[DENSITY] / scale
        density += nu[row, pairs.index[n, SCAN_ROW]] * own
    return path.valid, density


def _with(state: State, samples: StateSamples) -> State:
    """The state with other particles, and the Gaussian of their moments."""
    return replace(state, samples=samples, belief=samples.moments())


def _stream(work: Workspace, state: State, *purpose: int) -> np.random.Generator:
    return np.random.default_rng([work.seed, state.step, *purpose])
