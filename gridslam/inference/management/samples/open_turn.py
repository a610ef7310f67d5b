"""What samples of arrays leave open of the turn about the only anchor; docs/model.md, (M493), (M566)."""

from __future__ import annotations

from gridslam.inference.management.free_turn import held_at_least, turn_followed
from gridslam.inference.messages.samples.array_likelihood import ArrayBand
from gridslam.inference.state.population import Population
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan


def turn_held(
    population: Population[State], scan: SignalScan, model: SignalModel, work: Workspace
) -> Population[State]:
    """The population before a scan, with the turn held out that nothing tells, or that elements' errors
    hide."""
    if not scan.heard.any():
        return population
    sole = model.senders == 1 and scan.heading_rad is None
    departs = any(len(element) > 1 for element in model.waveform.anchor_element_m)
    if not (sole and departs) or population.searching:
        return turn_followed(population, not sole, model)
    hidden = hidden_turn(population.best, model, work)
    return held_at_least(population, hidden, model) if hidden else turn_followed(population, True, model)


def hidden_turn(state: State, model: SignalModel, work: Workspace) -> float:
    """Variance (rad^2) of the turn that errors of the only anchor's elements pass for, (M566)."""
    if not state.factors:
        return 0.0
    band: ArrayBand = work.buffers(ArrayBand.of, 0, model.waveform, 0)
    extent = len(band.anchor) * float(band.steepness[1]) ** 2
    return state.factors.phase_variance(model.waveform) / extent if extent else 0.0
