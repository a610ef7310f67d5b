"""A receiver's gain that jumps: amplitudes of all anchors change by one factor, by lines of sight."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.columns.deviations import MAD
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.tables.unit_hypotheses import Suspicion, finite
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene

LEAST_DB, SHARP = 3.0, 6.0
"""A jump of the level that is told, and how many of its deviations it must have."""
AROUND, LEAST_LOOKS = 30, 10
"""Lines of sight to an anchor before and after a step by which a jump is judged; how many there must be."""
ALIKE_DB, ALIKE = 1.5, 4.0
"""By how much jumps of single anchors may differ from that of all, or by how many of their deviations."""
ELSEWHERE = 0.4
"""Share of the jump by which levels may change elsewhere: where people shadow anchors, they wander."""
SUDDEN, LOOKS = 0.7, 4
"""Share of the jump that must be there within so few looks of an anchor before and after it."""
STEPS, BREAKS = 1000, 100
"""Steps of a table that are looked at, and how many of them are tried as the first of a jump."""
LEAST_SCATTER_DB, OF_MEDIANS = 0.1, 1.25
"""Scatter of levels at least; how much more a median scatters than a mean."""
DECIBEL = 20 / np.log(10)


def gain_jump(table: Columns, scene: Scene, agent: str | None) -> list[Suspicion]:
    """The step from which on all anchors that are in sight are louder or fainter by one factor.

    One anchor alone may be so by what came between; of two at once nothing but the receiver is.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    scene : Scene
    agent : str or None
        Whose table it is.
    """
    if not len(finite(table, "amplitude")):
        return []
    whole = len(np.unique(table["step"]))
    sight = explain(table, scene, agent, thorough=True, steps=min(whole, STEPS), across=True)
    row = sight.row[sight.sure]
    far, amplitude = sight.distance_m[sight.sure], table["amplitude"][row]
    with np.errstate(invalid="ignore"):
        good = (amplitude > 0) & (far > 0)
    row, far = row[good], far[good]
    if not len(row):
        return []
    level = DECIBEL * (np.log(table["amplitude"][row]) - np.log(scene.signal_model().amplitude(far)))
    step, anchor = table["step"][row], table["anchor"][row]
    order = np.argsort(step, kind="stable")
    step, anchor, level = step[order], anchor[order], level[order]
    looks = _Looks(step, anchor, level)
    tried = np.unique(step)[1:]
    tried = tried[:: max(len(tried) // BREAKS, 1)].tolist()
    each = [jump for since in tried if (jump := looks.jump(since)) is not None]
    clear = [jump for jump in each if jump.clear]
    if not clear:
        return []
    best = max(clear, key=lambda one: abs(one.size) / one.spread)
    since, size = looks.first(best), best.size
    steady = _Looks(step, anchor, level - size * (step >= since))
    others = [abs(one.size) for at in tried if (one := steady.jump(at)) is not None]
    sudden = looks.jump(since, LOOKS, LOOKS)
    if max(others, default=0.0) > ELSEWHERE * abs(size) or sudden is None or sudden.size / size < SUDDEN:
        return []
    way = "louder" if size > 0 else "fainter"
    text = (
        f"all paths are {abs(size):.1f} dB {way} (times {10 ** (size / 20):.2g}) from about step {since} on, "
        "as by a receiver whose gain changed: divide amplitudes by that from there on, or cut the table there"
    )
    reason = f"lines of sight to {best.anchors} anchors before and after, each by as much"
    return [Suspicion("amplitude", "gain", text, True, reason)]


class _Jump(NamedTuple):
    """How levels of anchors differ before and after a step: by what, dB; its deviation; of how many anchors.

    `clear` says whether it is a jump of all of them alike.
    """

    since: int
    size: float
    spread: float
    anchors: int
    clear: bool


class _Looks(NamedTuple):
    """Lines of sight in the order of steps: step and anchor (N,) int, level (N,) against the radio's, dB."""

    step: NDArray[np.intp]
    anchor: NDArray[np.intp]
    level: Array

    def jump(self, since: int, around: int = AROUND, least: int = LEAST_LOOKS) -> _Jump | None:
        """What is different from a step on, by so many looks at each anchor before and after it.

        None where fewer than two anchors have enough.
        """
        sizes, spreads = list[float](), list[float]()
        for one in np.unique(self.anchor).tolist():
            own = self.anchor == one
            before = self.level[own & (self.step < since)][-around:]
            after = self.level[own & (self.step >= since)][:around]
            if min(len(before), len(after)) < least:
                continue
            middles = float(np.median(before)), float(np.median(after))
            off = np.concatenate([before - middles[0], after - middles[1]])
            scatter = max(MAD * float(np.median(np.abs(off))), LEAST_SCATTER_DB)
            sizes.append(middles[1] - middles[0])
            spreads.append(OF_MEDIANS * scatter * float(np.sqrt(1 / len(before) + 1 / len(after))))
        if len(sizes) < 2:
            return None
        size, spread = np.array(sizes), np.array(spreads)
        weight = 1 / spread**2
        common, deviation = float(weight @ size / weight.sum()), float(1 / np.sqrt(weight.sum()))
        alike = np.abs(size - common) < np.maximum(ALIKE_DB, ALIKE * spread)
        large = abs(common) >= max(LEAST_DB, SHARP * deviation)
        return _Jump(since, common, deviation, len(sizes), large and bool(alike.all()))

    def first(self, seen: _Jump) -> int:
        """The first step of a jump: what fits all looks about it best."""
        gap, about = np.zeros(len(self.level)), np.zeros(len(self.level), bool)
        for one in np.unique(self.anchor).tolist():
            own = self.anchor == one
            before, after = (
                np.flatnonzero(own & s) for s in (self.step < seen.since, self.step >= seen.since)
            )
            near = np.concatenate([before[-AROUND:], after[:AROUND]])
            if len(before) and len(after):
                gap[near] = self.level[near] - np.median(self.level[before[-AROUND:]])
                about[near] = True
        looks, gap = self.step[about], gap[about]
        tried = np.unique(looks)
        costs = [np.abs(np.where(looks < since, gap, gap - seen.size)).sum() for since in tried.tolist()]
        return int(tried[int(np.argmin(costs))])
