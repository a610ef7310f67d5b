"""Messages between a snapshot of arrays and the filter's paths; docs/model.md, (M151) to (M153)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e, logsumexp

from gridslam.arrays import Array
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.layout import HEADING
from gridslam.inference.messages.cells import Visibility
from gridslam.inference.messages.path_prediction import PredictedPaths
from gridslam.inference.messages.reflection import Reflected
from gridslam.inference.messages.samples.array_likelihood import ArrayBand, Complex, one_more
from gridslam.inference.messages.samples.array_search import FoundPaths, find_paths
from gridslam.inference.messages.samples.noise_levels import learned_noise, median_noise
from gridslam.inference.messages.samples.signal_likelihood import log_ratio
from gridslam.inference.messages.samples.state_mode import PathsPrior, is_wide, paths_at
from gridslam.inference.state.population import moments
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels import LIKELIER_THAN_NOT
from gridslam.world.geometry import wrap
from gridslam.world.radio import RadioModel
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan

LEAST_CHANCE, MOST_PATHS = 1e-3, 40
"""Chance below which a path isn't followed in the mode, and how many are at most."""
EXPECTED, DENIED = 0.05, 0.1
"""Chance from which on a path holds the mode though it isn't there; probability below which it is denied."""
FAINT = 1e-3
"""Power of a path that isn't expected, in ratio to the noise's: it pulls where a peak stands beside it."""
SUREST = 40.0
"""Log ratio beyond which nothing more counts."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One anchor's snapshot, and what is predicted of it.

    Attributes
    ----------
    anchor : int
    band : ArrayBand
    samples : (A, B, M) complex128
        With the elements' factors, as far as they are known, taken out.
    factor : (A, B) or None
        These; None: none are known.
    phase_std : float
        Of what of the factors isn't told, see `PathsPrior`; 0: of nothing.
    noise : float
        Power of the noise in each sample.
    fades : bool
        Whether amplitudes are drawn anew at each step; else they are steady.
    rays : Rays
        L paths, with their existence one step ahead.
    open_ : (L,)
        Chance that each is possible and open.
    length : (L,) m
    amplitude, probability : (L, K)
        Nodes of each path's amplitude, square root of SNR, and belief over them.
    radio : RadioModel
        As the radio seems to be.
    """

    anchor: int
    band: ArrayBand
    samples: Complex
    factor: Complex | None
    phase_std: float
    noise: float
    fades: bool
    rays: Rays
    open_: Array
    length: Array
    amplitude: Array
    probability: Array
    radio: RadioModel

    @property
    def chance(self) -> Array:
        """That each path is there, (L,), (M24)."""
        return self.rays.existence * self.rays.surfaces * self.open_

    @property
    def power(self) -> Array:
        """Mean power of each path if it is there, in the scale of the samples, (L,)."""
        return np.asarray(self.noise * (self.probability * self.amplitude**2).sum(1))


@dataclass(frozen=True, eq=False)
class SnapshotLikelihood:
    """What a snapshot says of the L paths.

    Attributes
    ----------
    followed : (N,) intp
        Which of them took part in the mode.
    found : FoundPaths
    matched, own : (L,)
        |y|^2 and g of each, in units in which the noise has power 1, as if it were one more on top of all
        others.
    log_worth : (L,)
        Log likelihood ratio of each path, over what is believed of its place and amplitude (M153).
    """

    followed: NDArray[np.intp]
    found: FoundPaths
    matched: Array
    own: Array
    log_worth: Array


def start_noise(state: State, anchor: int, scan: SignalScan, model: SignalModel) -> State:
    """The noise's power where none is known yet: given, or by the median over delays (M86)."""
    noise = np.zeros(len(model.anchors)) if state.noise is None else state.noise.copy()
    if noise[anchor] <= 0:
        given = model.waveform.noise_std
        samples, pulse = scan.samples[anchor], np.conj(model.waveform.pulse)
        power = np.abs(np.fft.fft(samples * pulse, axis=-1)) ** 2
        noise[anchor] = median_noise(power) if given is None else given[anchor] ** 2
        noise[anchor] = max(float(noise[anchor]), 1e-12 * float(np.mean(np.abs(samples) ** 2)))
    return replace(state, noise=noise)


def learn_noise(state: State, anchor: int, likelihood: SnapshotLikelihood) -> State:
    """The noise's power by what the paths leave over (M86)."""
    assert state.noise is not None
    noise, ratio = state.noise.copy(), likelihood.found.mode.noise_ratio
    noise[anchor] = learned_noise(noise[anchor], ratio, state.step)
    return replace(state, noise=noise)


def surest_first(state: State, scan: SignalScan, model: SignalModel) -> list[int]:
    """Anchors that were heard: those whose lines of sight are believed in first, the nearest of them; (M550).

    Not the loudest: of samples, how loud an anchor is means nothing.
    """
    gap = model.places[: len(scan.heard), :2] - state.belief.mean[:2]
    hidden = state.los[: len(scan.heard)] <= LIKELIER_THAN_NOT
    order = np.lexsort((np.hypot(gap[:, 0], gap[:, 1]), hidden))
    return [int(anchor) for anchor in order if scan.heard[anchor]]


def without_factors(state: State, samples: Complex, anchor: int) -> tuple[Complex, Complex | None]:
    """An anchor's samples (A, B, M) with its elements' factors (A, B) taken out, and these, (M565)."""
    if state.factors is None:
        return samples, None
    factor = state.factors.of(anchor)
    return samples / factor[..., None], factor


def phase_std_of(state: State, model: SignalModel) -> float:
    """Deviation of elements' phases (rad), where samples tell that some are off: (M567); else 0."""
    return math.sqrt(state.factors.phase_variance(model.waveform)) if state.factors else 0.0


def take_snapshot(
    state: State, anchor: int, scan: SignalScan, paths: PredictedPaths, visible: Visibility,
    amplitudes: Reflected, model: SignalModel, *, work: Workspace,
) -> Snapshot:  # fmt: skip
    """One anchor's snapshot, beside what is predicted of it.

    Parameters
    ----------
    state : State
        With a noise power of the anchor: see `start_noise`.
    anchor : int
        Index of the anchor whose samples (A, B, M) are taken.
    paths : PredictedPaths
        L paths of that anchor.
    visible, amplitudes : Visibility, Reflected
        Of the same paths.
    """
    assert state.noise is not None
    band: ArrayBand = work.buffers(ArrayBand.of, anchor, model.waveform, anchor)
    length = np.maximum(paths.prediction.length, 1e-3)
    rays = Rays(paths.rays.table.copy(), paths.rays.existence.copy(), paths.rays.surfaces.copy())
    samples, factor = without_factors(state, scan.samples[anchor], anchor)
    return Snapshot(
        anchor, band, samples, factor, phase_std_of(state, model), float(state.noise[anchor]),
        model.fades, rays, visible.validity * visible.possible, length, amplitudes.nodes / length[:, None],
        amplitudes.probability.copy(), amplitudes.radio,
    )  # fmt: skip


@timed("evaluation")
def evaluate_snapshot(
    state: State, snapshot: Snapshot, model: SignalModel, *, work: Workspace
) -> tuple[State, SnapshotLikelihood]:
    """Find the joint mode of agent and surfaces, (M151), and what it tells of every path, (M152), (M153).

    Paths that the snapshot denies, though they were expected, leave the mode, which is found again: it takes
    all to be there, and a line of sight that is hidden would hold the agent where it fits the noise best. One
    that stays in doubt, as a reflection beside it may be what is heard, counts by moments of both, (M518).
    """
    chance = snapshot.chance
    order = np.argsort(-chance * snapshot.power, kind="stable")
    followed = np.sort(order[chance[order] > LEAST_CHANCE][:MOST_PATHS])
    likelihood = _weighed(state, snapshot, followed, model)
    there = _posterior(snapshot, likelihood)
    denied = (chance > EXPECTED) & (there < DENIED)
    if denied[followed].any():
        likelihood = _weighed(state, snapshot, followed[~denied[followed]], model)
        there = _posterior(snapshot, likelihood)
    followed, belief = likelihood.followed, likelihood.found.mode.belief
    direct = followed[(snapshot.rays.bounces[followed] == 0) & (chance[followed] > EXPECTED)]
    if len(direct) and there[direct[0]] < 1 - DENIED:
        other = _weighed(state, snapshot, np.setdiff1d(followed, direct), model).found.mode.belief
        belief = _either(belief, other, float(there[direct[0]]))
    return replace(state, belief=belief), likelihood


def _posterior(snapshot: Snapshot, likelihood: SnapshotLikelihood) -> Array:
    """Probability of each path's being there, (L,)."""
    chance, worth = snapshot.chance, np.exp(likelihood.log_worth)
    return np.asarray(chance * worth / (chance * worth + 1 - chance))


def _either(one: Belief, other: Belief, chance: float) -> Belief:
    """One belief with a chance, else the other, by moments."""
    means = np.stack([one.mean, other.mean])
    means[0, HEADING] = other.mean[HEADING] + wrap(one.mean[HEADING] - other.mean[HEADING])
    weights = np.array([chance, 1 - chance])
    mean, covariance = moments(weights, means, np.stack([one.covariance, other.covariance]))
    mean[HEADING] = wrap(mean[HEADING])
    return replace(one, mean=mean, covariance=covariance)


def _weighed(
    state: State, snapshot: Snapshot, followed: NDArray[np.intp], model: SignalModel
) -> SnapshotLikelihood:
    """What a snapshot says of all paths, by the joint mode of some (N,)."""
    chance, power = snapshot.chance, snapshot.power
    place, head = model.anchors[snapshot.anchor], state.belief.layout.head
    table, weight = snapshot.rays.table[followed], chance[followed] * power[followed]
    unsure = chance[followed] <= EXPECTED
    if unsure.any():
        unsure[unsure] = is_wide(snapshot.band, state.belief, place, table[unsure])  # (M521)
        weight = np.where(unsure, FAINT * snapshot.noise, weight)
    prior = PathsPrior(state.belief, place, table, weight, np.zeros((0, 3)), snapshot.phase_std)
    found = find_paths(snapshot.band, snapshot.samples, prior, snapshot.noise, power[followed])
    mode = found.mode
    matched, own, log_mean = np.zeros(len(chance)), np.zeros(len(chance)), np.zeros(len(chance))
    inside, among = mode.paths.without(found.prior.weight)
    count = len(followed)
    matched[followed], own[followed] = inside[:count], among[:count]
    log_mean[followed] = mode.log_evidence()[:count]
    rest = np.setdiff1d(np.arange(len(chance)), followed)
    if len(rest):
        path, _ = paths_at(mode.belief.mean, place, snapshot.rays.table[rest], head)
        output, left = one_more(
            snapshot.band, snapshot.samples, path, mode.path, found.prior.weight, snapshot.noise
        )
        matched[rest], own[rest] = snapshot.noise * np.abs(output) ** 2, snapshot.noise * left
    logs = log_amplitudes(matched, own, snapshot.amplitude, snapshot.fades)
    with np.errstate(divide="ignore"):
        worth = logsumexp(logs + np.log(snapshot.probability), axis=1)
    worth = np.clip(worth + log_mean, -SUREST, SUREST)
    return SnapshotLikelihood(followed, found, matched, own, worth)


def log_amplitudes(matched: Array, own: Array, amplitude: Array, fades: bool) -> Array:
    """Log likelihood ratio of one more path of given amplitudes and unknown phase, (L, K) (M152).

    Parameters
    ----------
    matched, own : (L,)
        |y|^2 and g, in units in which the noise has power 1.
    amplitude : (L, K)
        Square roots of the SNR.
    fades : bool
        Whether the amplitude is that of a complex Gaussian, of which this is the root mean square.
    """
    if fades:
        return log_ratio(matched[:, None], own[:, None], amplitude**2)
    bend = 2 * amplitude * np.sqrt(matched)[:, None]
    return np.asarray(bend + np.log(i0e(bend)) - amplitude**2 * own[:, None])
