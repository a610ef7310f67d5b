"""Looks at lines of sight: what they say of distances, and of anchors that stand or face elsewhere.

docs/model.md, (M262), (M510), (M511). Of paths that were measured, and of those that samples hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace as changed

from gridslam.arrays import Array, replace
from gridslam.inference.health import reasons
from gridslam.inference.health.crossings import crossing_of
from gridslam.inference.health.monitor import most_turned
from gridslam.inference.health.range_watch import RangeWatch
from gridslam.inference.health.sight_watch import SightWatch
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.world.filter_model import FilterModel


def crossed(
    population: Population[State], scans: Sequence[AnchorScan], deviations: Array, model: FilterModel
) -> RangeWatch:
    """What lines of sight that cross say of the distances, whoever follows them.

    Parameters
    ----------
    deviations : (M, 3)
        Of all measurements, one anchor's after the other's; as of `own_deviations`.
    """
    before = population.ranges or RangeWatch.start(model.senders)
    crossing = crossing_of(scans, deviations, model)
    return before if crossing is None else before.crossed(crossing, model)


def sighted(
    population: Population[State], scans: Sequence[AnchorScan], deviations: Array, model: FilterModel
) -> Population[State]:
    """The population of one state with what lines of sight say of their anchors, and turns beyond doubt."""
    state, sights = population.best, population.sights or SightWatch.start(model.senders)
    sights = sights.looked(scans, deviations, state.belief, state.calibration, model)
    sights, calibration = sights.turns_told(state.calibration)
    if calibration is not state.calibration:
        state = replace(state, calibration=calibration)
    return changed(population, states=(state,), sights=sights)


def distances_doubted(
    info: StepInfo, population: Population[State], ranges: RangeWatch | None, model: FilterModel
) -> StepInfo:
    """What happened at a step, with what lines of sight say of distances and anchors."""
    # of two anchors whose lines of sight don't cross, their own tell which is wrong
    doubt = (population.sights.doubt if population.sights else "") or (ranges.doubt if ranges else "")
    if not doubt or population.best.monitor.distrusted:  # who may be elsewhere can't accuse anchors
        return info
    # distances of all that are wrong put every line of sight elsewhere, as a turned anchor does
    follows = most_turned(info.turned, model) if reasons.OF_ALL in doubt and info.turned.any() else ""
    return info.doubted(doubt, follows)
