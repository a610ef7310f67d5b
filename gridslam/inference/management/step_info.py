"""What happened at a step, returned beside the new state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from gridslam.arrays import Array, replace
from gridslam.estimates import Health
from gridslam.inference.beliefs.calibration import Calibration
from gridslam.inference.management.free_turn import position_spread
from gridslam.inference.messages.outages import log_evidence
from gridslam.inference.messages.updates import Exchange
from gridslam.inference.state.state import State
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel

TELLING_M = 0.25
"""Deviation of an anchor's clock from which on its line of sight bears out no place: half of what counts as
wrong."""


class Exchanged(Protocol):
    """Messages of one anchor, or of all: of measurements, or of a snapshot of samples."""

    @property
    def fit(self) -> Array:
        """How they fitted, (1 or J, 9); see `gridslam.kernels.SUMS`."""
        ...

    @property
    def effective_sample_size(self) -> float:
        """Least effective number of particles behind them."""
        ...

    @property
    def log_evidence(self) -> float:
        """Log of their normaliser."""
        ...


@dataclass(frozen=True, eq=False)
class StepInfo:
    """Messages, timing and health of one step.

    Attributes
    ----------
    exchanges : sequence of Exchange or SnapshotExchange
        Of every anchor, in the anchors' order, whichever was taken in first; or one of all anchors.
    health : Health
    seconds : mapping of str to float
        Where the time went, by stage.
    found_again : bool
        Whether the agent was lost, and found by other means than following it.
    turned : (J,) rad
        By which the anchors were taken to be turned.
    gain : float
        Ratio of true to stated amplitude that was used.
    teaches : bool
        Whether what several agents share took anything from it: new surfaces of one that is lost are gone.
    silence : float or None
        Log of the step's normaliser where nothing was heard, (M580).
    """

    exchanges: Sequence[Any]
    health: Health
    seconds: Mapping[str, float]
    found_again: bool
    turned: Array
    gain: float
    teaches: bool = True
    silence: float | None = None

    @cached_property
    def log_evidence(self) -> float:
        """Log of the step's normaliser: that of each anchor given the ones before, in ratio to clutter."""
        if self.silence is not None:
            return self.silence
        return sum(exchange.log_evidence for exchange in self.exchanges)

    def doubted(self, reason: str, instead: str = "") -> StepInfo:
        """The info with one more reason for which health isn't good, instead of one that follows from it."""
        before = (why for why in self.health.why.split("; ") if why != instead)
        why = "; ".join(filter(None, (*before, reason)))
        return replace(self, health=replace(self.health, ok=False, why=why))


@dataclass(frozen=True, eq=False)
class NetworkInfo:
    """What happened at a step of several agents.

    Attributes
    ----------
    agents : tuple of StepInfo or None
        Of every agent; None for one that isn't there.
    """

    agents: tuple[StepInfo | None, ...]


def conclude(
    state: State, exchanges: Sequence[Exchanged], calibration_used: Calibration, model: FilterModel,
    work: Workspace,
) -> tuple[State, StepInfo]:  # fmt: skip
    """Update calibration and health, count the step, and assemble what it reports.

    Parameters
    ----------
    calibration_used : Calibration
        The calibration that the step used.
    """
    fits = np.concatenate([exchange.fit for exchange in exchanges])
    monitor, calibration = state.monitor.fitted(fits), state.calibration.fitted(fits)
    if state.mountings is not None:  # what turns, and a place that is off looks like a turn: (M569)
        calibration = calibration.unturned(model.unsure)
    spread = position_spread(state, model)
    effective = min((exchange.effective_sample_size for exchange in exchanges), default=np.inf)
    monitor = monitor.sighted(spread, telling_sights(state))  # (M533)
    turned = calibration_used.turned if state.aside is None else calibration_used.turned + state.aside[:, 2]
    health, monitor = monitor.assess(calibration, turned, model, spread, effective)
    found_again = monitor.since == 0
    state = replace(state, calibration=calibration, monitor=monitor, step=state.step + 1)
    times, turned = work.times(), calibration_used.turned
    of_paths = [exchange for exchange in exchanges if isinstance(exchange, Exchange)]
    silence = log_evidence(of_paths, state) if of_paths else None
    return state, StepInfo(
        tuple(exchanges), health, times, found_again, turned, calibration_used.gain, silence=silence
    )


def telling_sights(state: State) -> Array:
    """Existence (J,) of lines of sight; 0 where a clock is too unsure for one to bear out a place, (M533)."""
    belief = state.belief
    if not belief.clocks:
        return state.los
    variance = np.diag(belief.covariance)[belief.layout.anchor_clocks]
    return np.where(variance < TELLING_M**2, state.los, 0.0)


def comparable(info: StepInfo, state: State, model: FilterModel) -> float:
    """Log evidence of a step, such that hypotheses with clutter levels of their own can be compared."""
    stated, log = model.radio.false_alarms, info.log_evidence
    for exchange in info.exchanges:
        level = state.calibration.clutter_level(exchange.anchor, stated)
        if level != stated:
            log += exchange.measured.shape[1] * float(np.log(level / stated)) - (level - stated)
    return log
