"""Whether paths have arrived before the line of sight of late, of a filter of any kind on paths: (M525)."""

from __future__ import annotations

from dataclasses import replace

from gridslam.inference.health import reasons
from gridslam.inference.health.early_watch import EARLY, KEEP, arrives_early
from gridslam.inference.management.free_turn import with_turn
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.deviations import own_deviations
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel
from gridslam.world.scan import Scan


def watched_arrivals(
    population: Population[State], before: float, info: StepInfo, scan: Scan, model: FilterModel,
    work: Workspace,
) -> tuple[Population[State], StepInfo]:  # fmt: skip
    """What is believed after a step, with the share of early arrivals, and its health.

    It changes nothing but what is said. Where several places, or heights with deviations, are believed in,
    nothing is looked for.

    Parameters
    ----------
    before : float
        The share after the step before.
    """
    state, early = population.best, before
    if len(population) == 1 and not population.searching and not state.belief.rises and len(scan):
        scans = work.once(split_by_anchor, scan, model)
        deviations = work.once(own_deviations, scans, model.radio)
        now = arrives_early(scans, deviations, with_turn(state, model).belief, model)
        early = KEEP * before + (1 - KEEP) * now
    if early > EARLY:
        info = info.doubted(reasons.early(early))
    return (population if early == population.early else replace(population, early=early)), info
