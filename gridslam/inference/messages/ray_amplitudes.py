"""Amplitude states of rays: a belief over every path's amplitude; docs/model.md, (M43), (M44).

Equations without a key are those of [Li2025adaptive].

Where the paper keeps particles, a histogram is kept, so that a ray that fades and one that is silent are
both told. Nodes stand densely enough for the amplitude's noise at any strength. Owner of their kernels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.messages.amplitudes import detection_table
from gridslam.inference.messages.likelihood_ratios import PORTION
from gridslam.inference.messages.path_prediction import PredictedPaths, Prediction
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.ray_amplitudes import Key, RayAmplitudes
from gridslam.inference.state.rays import P_APPEAR, P_STAY, Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels.primitives.tables import ANCHOR, BOUNCES
from gridslam.world.filter_model import FilterModel
from gridslam.world.radio import RadioModel

WALK = 0.02
"""Random walk of an amplitude per step, as a share of it ([Li2025adaptive], section VI-A)."""
SURPRISE = 1e-9
"""Weight of any amplitude at all, should the one that was measured be out of all expectation."""
FINE, RATIO = 11.7, 0.03
"""Nodes ``FINE sinh(RATIO k)``: 0.35 apart where faint, 3 % apart where strong."""
NEAREST_M = 0.2
"""Distance of free space whose amplitude is the last node; anything louder counts as that."""
SHORTER = 3.0
"""Deviations by which a path may be shorter than predicted, and so louder."""
UNKNOWN_SHARE = 0.5
"""Of what free space allows, the mean amplitude of a ray of which nothing is known."""
LEVEL_SHARE, WEAKENED = 0.12, 0.02
"""Deviation of a path's amplitude from what its length makes it (1 dB), and share of those far off it."""
WORTH_KEEPING = 0.01
"""Existence, before a step or by what it has heard, below which a ray's amplitude stays as it was."""


@dataclass(frozen=True)
class Histogram:
    """Amplitudes of paths over fixed nodes (an `AmplitudeBelief`).

    Attributes
    ----------
    probability : (L, K)
    nodes : (K,)
    """

    probability: Array
    nodes: Array

    spreading = False


@dataclass(frozen=True)
class Unmeasured:
    """Amplitudes of which nothing is ever heard: half of what free space allows (an `AmplitudeBelief`).

    Attributes
    ----------
    probability : (L, 1)
    nodes : (1,)
        At a metre.
    """

    probability: Array
    nodes: Array

    spreading = True


@dataclass(frozen=True, eq=False)
class AmplitudeModel:
    """Nodes, and what kernels take of them, for one radio.

    Attributes
    ----------
    nodes : (K,)
        Amplitudes.
    gap : (K,)
        Share of every node's cell; they sum to 1.
    table : (6, K)
        Nodes, gap, and the walk's three diagonals; then the likelihood of a miss. See
        `gridslam.kernels.messages.histograms`.
    number : (8,)
        FINE, RATIO, amplitude at 1 m, P_STAY, P_APPEAR, SURPRISE, LEVEL_SHARE, WEAKENED.
    """

    nodes: Array
    gap: Array
    table: Array
    number: Array

    @staticmethod
    @lru_cache(16)
    def of(radio: RadioModel) -> AmplitudeModel:
        """Nodes up to the amplitude of the nearest line of sight."""
        from gridslam.kernels.messages.histograms import SILENT

        count = int(np.ceil(np.arcsinh(float(radio.amplitude(NEAREST_M)) / FINE) / RATIO))
        nodes: Array = FINE * np.sinh(RATIO * (np.arange(count) + 1))
        gap = np.gradient(nodes)
        rate = 0.5 * np.square(WALK * nodes / gap)
        rise, fall = np.append(rate[:-1], 0.0), np.append(0.0, rate[1:])
        walk = np.stack([1 - 2 * rate, rise, fall])
        gap = gap / gap.sum()
        table = np.stack([nodes, gap, *(walk / walk.sum(0)), np.zeros(count)])
        table[SILENT] = np.maximum(1 - detection_table(radio)(nodes), SURPRISE)
        appears = P_STAY, P_APPEAR, SURPRISE, LEVEL_SHARE, WEAKENED
        number = np.array([FINE, RATIO, radio.amplitude_at_1m, *appears])
        return AmplitudeModel(nodes, gap, table, number)


@timed("evaluation")
def predict_amplitudes(
    state: State, paths: PredictedPaths, scan: AnchorScan, radio: RadioModel, *, work: Workspace
) -> Histogram | Unmeasured:
    """Beliefs one step ahead, given that the ray exists.

    A ray that was there walks on, eq. (13), about what free space makes of its new length: near an anchor an
    amplitude doubles within a few steps. One that appears now may have any amplitude up to that of free space
    at the least length that it may have; a line of sight, but for one in fifty, has that of its length, as
    surely as others have told how loud they are. Where amplitudes are neither measured nor told by what is
    missed, there is nothing to keep.
    """
    if radio.given_detection is not None and not require(state).known and np.isnan(scan.amplitude).all():
        return Unmeasured(np.ones((len(paths.rays), 1)), np.array([UNKNOWN_SHARE * radio.amplitude_at_1m]))
    ahead = _walked(state, paths.rays, paths.prediction, radio, work)
    return Histogram(ahead, AmplitudeModel.of(radio).nodes)


def mean_amplitudes(state: State, rays: Rays, distance: Array, radio: RadioModel) -> Array:
    """Estimated amplitude of every ray, eq. (18), about what free space makes of its length now, (L,).

    Half of what free space allows where nothing is known of a ray.
    """
    known, nodes, far = require(state).known, AmplitudeModel.of(radio).nodes, np.maximum(distance, 1e-3)
    mean = UNKNOWN_SHARE * radio.amplitude_at_1m / far
    if not known:
        return np.asarray(mean)
    beliefs = [known.get(key) for key in RayAmplitudes.keys(rays, state.surfaces.identity)]
    rows = [row for row, belief in enumerate(beliefs) if belief is not None]
    if rows:
        histograms, lengths = zip(*(belief for belief in beliefs if belief is not None), strict=True)
        mean[rows] = np.minimum(np.array(histograms) @ nodes * (np.array(lengths) / far[rows]), nodes[-1])
    return np.asarray(mean)


@timed("updates")
def update_amplitudes(
    state: State, paths: PredictedPaths, belief: Histogram | Unmeasured, scan: AnchorScan,
    exchange: Exchange, model: FilterModel, *, work: Workspace,
) -> State:  # fmt: skip
    """Update by the measurements, softly by association, eq. (26).

    A line of sight's amplitude is kept with its length from where the agent is believed to be by now: beside
    an anchor it would be scaled by half at the next step otherwise, and not be known again.

    Parameters
    ----------
    paths : PredictedPaths
        Of the surfaces of `state`, as they were predicted.
    belief : Histogram
        One step ahead.
    exchange : Exchange
        With the association.
    """
    if isinstance(belief, Unmeasured):
        return state
    runtime.start()
    from gridslam.kernels.messages.histograms import listen

    amplitudes, numbers, rays = require(state), AmplitudeModel.of(model.radio), paths.rays
    responsible, shape = exchange.responsible, belief.probability.shape
    if responsible.shape != (len(rays), len(scan)) or shape != (len(rays), len(numbers.nodes)):
        raise ValueError("beliefs don't belong to these rays and measurements")
    after = np.empty(shape)  # the state keeps its rows
    scratch = work.buffers(_densities, 0, -(-len(scan) // PORTION) * PORTION, shape[1])
    listen(
        belief.probability, scan.table, np.ascontiguousarray(responsible), numbers.table, numbers.number,
        float(model.radio.samples), scratch, after,
    )  # fmt: skip
    alive = np.maximum(rays.existence, responsible.sum(1))  # one that comes back was given up long ago
    worth = (alive * rays.surfaces > WORTH_KEEPING).tolist()
    keys = RayAmplitudes.keys(rays, state.surfaces.identity)
    lengths = _lengths_now(state, paths, model).tolist()
    rows = enumerate(zip(keys, lengths, worth, strict=True))
    changes = {key: (after[row], length) for row, (key, length, lasting) in rows if lasting}
    return replace(state, amplitudes=amplitudes.having(changes))


def start_amplitudes(
    state: State, born: Sequence[tuple[Key, int]], scan: AnchorScan, radio: RadioModel
) -> State:
    """First beliefs of the rays that bore surfaces, from their measurements alone.

    Parameters
    ----------
    born : sequence of (key, measurement)
    """
    model, changes = AmplitudeModel.of(radio), dict[Key, tuple[Array, float]]()
    for key, measurement in born:
        length = float(scan.value[measurement, 0] - state.belief.late(key[0]))
        amplitude = float(scan.amplitude[measurement])
        if np.isfinite(amplitude) and np.isfinite(length):
            log = radio.log_rician(np.minimum(amplitude, model.nodes[-1]), model.nodes)
            density = model.gap * np.exp(log - log.max())
            changes[key] = density / density.sum(), length
    return replace(state, amplitudes=require(state).having(changes))


def forget_amplitudes(state: State) -> State:
    """The state without the rays of surfaces that are no more."""
    return replace(state, amplitudes=require(state).among(state.surfaces.identity))


def require(state: State) -> RayAmplitudes:
    """Amplitudes of a system that keeps some.

    Raises
    ------
    ValueError
        This system keeps none.
    """
    if state.amplitudes is None:
        raise ValueError("this state has no amplitudes of rays")
    return state.amplitudes


def _walked(state: State, rays: Rays, prediction: Prediction, radio: RadioModel, work: Workspace) -> Array:
    """Beliefs one step ahead (L, K)."""
    runtime.start()
    from gridslam.kernels.messages.histograms import AT_1M, LEVEL, walk

    known, model = require(state).known, AmplitudeModel.of(radio)
    count, size = len(rays), len(model.nodes)
    before = work.buffers(_histograms, 0, count, size)
    length, scratch = np.empty((4, count)), np.empty(size)
    ahead = np.empty((count, size))
    length[0], length[1] = -1.0, prediction.length
    length[2] = prediction.length - SHORTER * prediction.length_std
    straight = (rays.table[:, BOUNCES] == 0) & (rays.table[:, ANCHOR] < radio.senders)  # not over a level
    length[3] = np.where(straight, prediction.length_std, -1.0)
    for row, key in enumerate(RayAmplitudes.keys(rays, state.surfaces.identity)):
        belief = known.get(key)
        if belief is not None:
            before[row], length[0, row] = belief
    number, (gain, doubt) = model.number.copy(), state.calibration.loudness
    number[AT_1M] *= gain
    number[LEVEL] = math.hypot(LEVEL_SHARE, doubt)
    walk(before, length, rays.existence, model.table, number, scratch, ahead)
    return ahead


def _lengths_now(state: State, paths: PredictedPaths, model: FilterModel) -> Array:
    """Lengths (L,) of paths as predicted, m, and of lines of sight from where the agent is believed to be."""
    length, table = paths.prediction.length.copy(), paths.rays.table
    direct = np.flatnonzero(table[:, BOUNCES] == 0)
    place = model.places[table[direct, ANCHOR]]
    length[direct] = np.hypot(np.hypot(*(state.belief.mean[:2] - place[:, :2]).T), place[:, 3])
    return length


def _densities(measurements: int, nodes: int) -> Array:
    """Scratch: densities of amplitudes over nodes."""
    return np.empty((measurements, nodes))


def _histograms(paths: int, nodes: int) -> Array:
    """Scratch: histograms before the step."""
    return np.empty((paths, nodes))
