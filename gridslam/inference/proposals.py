"""Proposals of births: how well a new surface would explain each measurement; owner of that kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gridslam import runtime
from gridslam.geometry import line_between, mirror, unit
from gridslam.inference.belief import Belief, slots
from gridslam.inference.births import USUAL_REFLECTION, Births
from gridslam.inference.heard import Heard
from gridslam.inference.likelihood import accuracy
from gridslam.inference.particles import Cloud
from gridslam.inference.surfaces import Bank
from gridslam.signal import REFLECTION_BINS, SignalModel

Array = NDArray[np.float64]
CONVERGED_STD_M = 0.3
DOUBLE_SHARE = 0.5
"""Births by each kind of double bounce over births by single bounces."""
EXPLAINED = 1e-3
"""A birth this many times less likely than the measurement's known causes isn't looked at."""
FAINT = 1e-3
"""Ratio to clutter below which a hypothesis is dropped."""
SAMPLES = 256
OTHERS = np.array([1.0, USUAL_REFLECTION])
"""What the known surface of a single and of a double bounce leaves of the amplitude."""


@dataclass(frozen=True)
class Prospects:
    """What one anchor's measurements would be worth as births, whatever the belief.

    Attributes
    ----------
    std : (M, 3)
        Deviations of distance, AoD and AoA.
    level : (M, 2)
        Amplitude's density as a single or double bounce, averaged over the unknown coefficient, over that of
        clutter of the whole measurement at one false alarm a step.
    """

    std: Array
    level: Array


def prospects(scans: Sequence[Heard], signal: SignalModel) -> list[Prospects]:
    """Prospects of all measurements of a step, anchor by anchor, worked out in one go."""
    counts = [len(heard) for heard in scans]
    value = np.concatenate([heard.value for heard in scans])
    own = np.concatenate([heard.own_std for heard in scans])
    amplitude = np.concatenate([heard.amplitude for heard in scans])
    aperture = signal.anchor_aperture[np.repeat([heard.anchor for heard in scans], counts)]
    silent = np.isnan(amplitude)
    usual = np.where(silent, signal.amplitude(value[:, 0], 0.5), amplitude)
    std = accuracy(value, own, usual, np.nan_to_num(value[:, 1:]), aperture, signal)
    nodes = signal.amplitude(value[:, :1], (OTHERS[:, None] * REFLECTION_BINS).ravel())
    said = np.exp(signal.log_rician(np.where(silent, 1.0, amplitude)[:, None], nodes))
    said = said.reshape(len(value), 2, len(REFLECTION_BINS)).mean(2)
    level = np.where(silent[:, None], 1.0, said) * np.exp(-signal.log_clutter(amplitude))[:, None]
    ends = np.cumsum(counts)
    return [
        Prospects(std[end - count : end], level[end - count : end])
        for count, end in zip(counts, ends, strict=True)
    ]


def partners(bank: Bank, belief: Belief, most_bounces: int) -> NDArray[np.intp]:
    """Pairs (last, first) of known surfaces with which a new one may form a path, -1 for the new, (H, 2)."""
    if most_bounces < 1:
        return np.zeros((0, 2), np.intp)
    index = slots(np.arange(len(bank)))
    variance = belief.covariance[index[:, 1], index[:, 1]]
    known = np.flatnonzero((bank.existence > 0.9) & (bank.seen >= 3) & (variance < CONVERGED_STD_M**2))
    pairs: list[tuple[int, int]] = [(-1, -1)]
    if most_bounces >= 2:
        pairs += [pair for s in known.tolist() for pair in ((-1, s), (s, -1))]
    return np.asarray(pairs, dtype=np.intp)


def propose(
    heard: Heard, prospect: Prospects, belief: Belief, bank: Bank, cloud: Cloud, explained: Array,
    signal: SignalModel, births: float, radius_m: float, most_bounces: int,
) -> Births:  # fmt: skip
    """All birth hypotheses worth a look, of the measurements that carry distance and AoA.

    Surfaces are born uniformly over all lines that cross the region (angle and offset), at `births` per
    anchor and step; that measure doesn't depend on the frame. The mean over agent, distance and AoA is
    taken in a kernel; amplitude and clutter are the same for all samples.

    Parameters
    ----------
    explained : (M,)
        Ratio to clutter of the measurement's known causes.
    radius_m : float
        Of the region.
    """
    runtime.start()
    from gridslam.kernels.births import propose as launch

    known = partners(bank, belief, most_bounces)
    double = (known >= 0).any(1)
    # what a hypothesis could be worth at most: the AoD right on, the image next to the anchor
    level = prospect.level / signal.false_alarms
    common = births / (4 * np.pi * radius_m) * heard.value[:, 0]
    most = common * level[:, : 1 + int(double.any())].max(1) / np.sqrt(2 * np.pi)
    least = np.maximum(FAINT, EXPLAINED * explained)
    keep = most > least * np.minimum(prospect.std[:, 1], 2.5)
    rows = np.flatnonzero(keep & ~np.isnan(heard.value[:, 2]))
    std = prospect.std[rows]
    weight = np.zeros((len(rows), len(known)))
    if weight.size:
        value = np.concatenate([np.nan_to_num(heard.value[rows]), np.minimum(std, 1e9)], 1)
        launch(
            cloud.state,
            _noise(len(known)),
            np.ascontiguousarray(value),
            known.astype(np.int32),
            np.array([*heard.place, heard.facing]),
            weight,
        )
    share = np.where(double, DOUBLE_SHARE, 1.0)
    ratio = common[rows, None] * level[rows][:, double.astype(np.intp)] * weight * share
    row, hypothesis = np.nonzero(ratio > least[rows, None])
    measurement, last, first = rows[row], known[hypothesis, 0], known[hypothesis, 1]
    return Births(
        measurement, last, first, _lines(heard, belief, measurement, last, first), ratio[row, hypothesis]
    )


@cache
def _noise(seed: int) -> Array:
    """Standard normal noise of distance and AoA, (2, SAMPLES)."""
    return np.random.default_rng(seed).standard_normal((2, SAMPLES))


def _lines(
    heard: Heard, belief: Belief, rows: NDArray[np.intp], last: NDArray[np.intp], first: NDArray[np.intp]
) -> Array:
    """Lines of the new surfaces that would explain measurements `rows`, (B, 2)."""
    lines = np.concatenate([belief.lines, np.zeros((1, 2))])
    source = np.where((first >= 0)[:, None], mirror(lines[first], heard.place), heard.place)
    image = belief.mean[:2] + heard.value[rows, :1] * unit(belief.mean[4] + heard.value[rows, 2])
    image = np.where((last >= 0)[:, None], mirror(lines[last], image), image)
    return line_between(source, image)
