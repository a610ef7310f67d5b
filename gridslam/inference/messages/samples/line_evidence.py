"""Walls that no single snapshot tells from noise: born of what many snapshots leave unexplained.

docs/model.md, (M157), (M158). Ours; of measurements, see `faint_births`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam import runtime
from gridslam.arrays import Array, replace
from gridslam.inference.beliefs.layout import POSE
from gridslam.inference.messages.births import Births, add_chosen
from gridslam.inference.messages.samples.array_paths import Snapshot, SnapshotLikelihood
from gridslam.inference.messages.samples.matched_power import BESIDE, widths_apart
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.scans.leftovers import REFLECTIONS, LineEvidence
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace, timed
from gridslam.kernels import HEARD_BY_ANOTHER
from gridslam.world.geometry import wrap
from gridslam.world.radio import REFLECTION_BINS
from gridslam.world.signal_model import SignalModel
from gridslam.world.single_bounces import SingleBounces, single_bounces

FINE = 0.25
"""Lines lie so far apart, in ratio to the resolution c / B."""
AUDIBLE = 0.9
"""Chance that a wall's single bounce is open."""
STEADY = 0.7
"""Turn of phase (rms, rad) by the agent's deviations, from which on its snapshots say too little of lines."""
SURE = 100.0
"""Odds at which a line is taken for a surface."""
FAINT_SURE = 1e4
"""Odds at which a faint one is: by then the walls are known that double bounces like it need."""
MEMORY = 256
"""Steps for which evidence is kept, and over which a wall may have become audible."""
SKIRT = 3.0
"""Evidence is forgotten where paths turn phases by less than this (rms, rad) from those of what was born."""
FADES = 8
"""Steps from one fading of old evidence to the next."""
LOUD, LOUDLY = 0.6, 0.8
"""Coefficient above which a wall is louder than double bounces are; how probable that has to be, or else
the line is a faint one."""
MOST_BORN = 2
"""Surfaces born at one step."""
AROUND = 6
"""Steps of the lines' grid about the likeliest one over which a surface's deviations are taken."""


@timed("births")
def gather_evidence(
    state: State, snapshot: Snapshot, likelihood: SnapshotLikelihood, model: SignalModel, *, work: Workspace
) -> State:
    """The evidence for all lines, with what a snapshot leaves unexplained (M157).

    Paths beside known ones tell nothing; nor does a snapshot of an agent that hardly knows where it is.
    """
    runtime.start()
    from gridslam.kernels.messages.line_evidence import weigh_lines

    band, mode, by_line = snapshot.band, likelihood.found.mode, state.by_line
    if by_line is None:
        spacing = FINE * band.resolution_m
        by_line = LineEvidence.none(len(model.anchors), model.radius_m, spacing)
    spread = np.sqrt(state.belief.covariance.diagonal()[POSE])
    if max(float(spread[:2].max()) * band.steepness[0], spread[2] * band.steepness[2]) > STEADY:
        return replace(state, by_line=by_line)
    ratio, own = by_line.ratio.copy(), snapshot.anchor
    if state.step % FADES == 0:
        ratio[own] **= 1 - FADES / MEMORY
    weigh_lines(
        likelihood.found.power.without(mode.path).power, snapshot.noise, band.folding_m,
        model.places[own, :4].copy(), np.concatenate([state.belief.mean[POSE], model.middle]),
        by_line.offsets(model.radius_m), REFLECTIONS * snapshot.radio.amplitude_at_1m,
        np.array([AUDIBLE, 1.0 / MEMORY]), int(snapshot.fades), ratio[own],
    )  # fmt: skip
    return replace(state, by_line=LineEvidence(ratio))


@timed("births")
def add_faint_surfaces(
    state: State, listened: Sequence[tuple[Snapshot, SnapshotLikelihood]], model: SignalModel, *,
    work: Workspace,
) -> State:  # fmt: skip
    """Bear the surfaces that the snapshots up to now make sure, likeliest first (M158)."""
    for _ in range(MOST_BORN if state.by_line is not None else 0):
        born = _born(state, listened, model)
        if born is None:
            break
        state = born
    return state


def _born(
    state: State, listened: Sequence[tuple[Snapshot, SnapshotLikelihood]], model: SignalModel
) -> State | None:
    """The state with the likeliest line as a surface, or its evidence forgotten; None if none is sure."""
    assert state.by_line is not None
    likeliest = likeliest_line(state.by_line, model)
    if likeliest is None:
        return None
    line, covariance, odds, reflection = likeliest
    ratio, known, bearers = state.by_line.ratio.copy(), False, []
    every = _lines(state.by_line, model)
    for snapshot, likelihood in listened:
        place, band = model.places[snapshot.anchor], snapshot.band
        own = single_bounces(line, place, state.belief.mean[POSE])
        if own.possible:
            known |= bool((widths_apart(band, likelihood.found.mode.path, own.value) < BESIDE).any())
            bearers.append((snapshot, own))
        paths = single_bounces(every, place, state.belief.mean[POSE]).value
        ratio[snapshot.anchor][widths_apart(band, paths, own.value) < SKIRT] = 1.0
    if not bearers:
        return None
    forgotten = replace(state, by_line=LineEvidence(ratio))
    if known:
        return forgotten
    snapshot, own = bearers[0]
    births = Births(
        np.zeros(1, np.int32), np.full((1, 2), -1, np.int32), line[None], np.array([odds]),
        np.array([snapshot.anchor], np.int32), np.interp(REFLECTION_BINS, REFLECTIONS, reflection)[None],
    )  # fmt: skip
    scan = _as_measured(own, covariance, snapshot, model)
    return add_chosen(forgotten, births, scan, np.zeros(1), snapshot.radio, model)[0]


def _as_measured(own: SingleBounces, covariance: Array, snapshot: Snapshot, model: SignalModel) -> AnchorScan:
    """A line of some covariance as length and arrival of its single bounce: they say all that it says."""
    slope = own.slopes()[0]
    std = np.sqrt(np.einsum("pi,ij,pj->p", slope, covariance, slope))
    value = own.value.copy()
    value[2] = wrap(value[2])
    value[1] = std[1] = np.nan
    x, y, orientation = model.anchors[snapshot.anchor].tolist()
    silent, level = np.full(1, np.nan), snapshot.radio.threshold
    place = np.array([x, y])
    return AnchorScan.of(snapshot.anchor, place, orientation, value[None], std[None], silent, level)


def _lines(by_line: LineEvidence, model: SignalModel) -> Array:
    """All lines for which evidence is kept, (A, O, 2)."""
    angle, offset = np.meshgrid(by_line.angles(), by_line.offsets(model.radius_m), indexing="ij")
    middle = model.middle[0] * np.cos(angle) + model.middle[1] * np.sin(angle)
    return np.stack([angle, offset + middle], -1)


def likeliest_line(by_line: LineEvidence, model: SignalModel) -> tuple[Array, Array, float, Array] | None:
    """The likeliest line (2,), its covariance, its odds and likelihood by `REFLECTIONS`; None if unsure."""
    angle, offset = by_line.angles(), by_line.offsets(model.radius_m)
    step = np.array([angle[1], offset[1] - offset[0]])
    share = (1 - HEARD_BY_ANOTHER + HEARD_BY_ANOTHER * by_line.ratio).prod(0)
    weight = share.mean(-1)
    prior = 2 * MEMORY * model.birth_rate * step.prod()
    a, o = np.unravel_index(int(weight.argmax()), weight.shape)
    if prior * weight[a, o] * (2 * AROUND + 1) ** 2 < SURE:
        return None
    # past the last angle come the same lines turned round
    whole = np.concatenate([weight[-AROUND:, ::-1], weight, weight[:AROUND, ::-1]])
    near = np.pad(whole, ((0, 0), (AROUND, AROUND)))[a : a + 2 * AROUND + 1, o : o + 2 * AROUND + 1]
    odds = prior * float(near.sum())
    loud = share[a, o, REFLECTIONS > LOUD].sum() >= LOUDLY * share[a, o].sum()
    if odds < (SURE if loud else FAINT_SURE):
        return None
    reach = np.arange(-AROUND, AROUND + 1)
    gap = np.stack(np.meshgrid(step[0] * reach, step[1] * reach, indexing="ij"), -1)
    part = near / near.sum()
    mean = np.einsum("ao,aoi->i", part, gap)
    covariance = np.einsum("ao,aoi,aoj->ij", part, gap - mean, gap - mean) + np.diag(step**2) / 12
    turned = angle[a] + mean[0]
    middle = float(model.middle @ [np.cos(turned), np.sin(turned)])
    return np.array([turned, offset[o] + mean[1] + middle]), covariance, odds, share[a, o]
