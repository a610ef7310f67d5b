"""Whether a state of several agents that was read from a file can be one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from gridslam.errors import located
from gridslam.inference.state.network.clock_walk import SHARES, WAYS, ClockWalk
from gridslam.inference.state.network.state import ClockSteps, NetworkState
from gridslam.inference.state.population import Population
from gridslam.systems.soundness import (
    Shape,
    claims_of_weights,
    require_claims,
    require_shapes,
    shapes_of_bank,
)
from gridslam.world.network_model import NetworkModel


def require_sound_networks(believed: Population[NetworkState], model: NetworkModel, where: str) -> None:
    """Refuse hypotheses about a network whose weights or states can't be, or scans that no filter takes.

    Parameters
    ----------
    where : str
        Names the file in errors.

    Raises
    ------
    InputError
        With the part, and what is allowed.
    """
    log = np.array(believed.log_weight)
    ordered = bool((np.diff(log) <= 0).all())
    claims = [*claims_of_weights(log, len(believed)), ("log_weight", ordered, "the likeliest first")]
    require_claims(claims, where)
    for number, state in enumerate(believed.states):
        _require_sound(state, model, f"{where}/states/{number}")
        if state.search is not None:
            within = f"{where}/states/{number}/search"
            _require_sound(state.search.before, model, f"{within}/before")
            scans = state.search.scans
            claims = [
                ("before", state.search.before.search is None, "of no search"),
                ("scans", len(scans) > 0, "one step or more"),
            ]
            require_claims(claims, within)
            for step, scan in enumerate(scans):
                with located(f"{within}/scans/{step}"):
                    scan.checked(len(model.anchor_names), None, len(model.agents), pseudo=True)
            _require_times(state, state.search, f"{where}/states/{number}")


def _require_times(state: NetworkState, search: ClockSteps, where: str) -> None:
    """Refuse times of a search's steps that go back, or don't lead to the state's."""
    began = [] if search.before.time_s is None else [search.before.time_s]
    times = np.array([*began, *(scan.time_s for scan in search.scans)])
    claims = [
        ("time_s", state.time_s == times[-1], "that of the last step of the search"),
        ("search/scans", bool((np.diff(times) >= 0).all()), "times that don't go back"),
    ]
    require_claims(claims, where)


def _require_sound(state: NetworkState, model: NetworkModel, where: str) -> None:
    """Refuse a state of a network whose parts don't belong together, or whose belief can't be."""
    require_shapes(_shapes(state, model), where)
    covariance = state.belief.covariance
    symmetric = bool(np.isfinite(covariance).all() and np.allclose(covariance, covariance.T))
    sound = symmetric and bool((np.diagonal(covariance) >= 0).all())
    claims = [
        ("belief/mean", bool(np.isfinite(state.belief.mean).all()), "finite"),
        ("belief/covariance", sound, "symmetric, with variances that aren't negative"),
        ("turn_variance", 0 <= (state.turn_variance or 0.0) < np.inf, "0 or more, or none"),
        ("turn_anchor", 0 <= state.turn_anchor < len(model.anchor_names), "the number of an anchor"),
        ("turning", state.turning is None or state.turning.shape == state.here.shape, "one mark an agent"),
        ("walks", state.walks is None or _sound_walks(state.walks, state), "as many as ways and clocks"),
    ]
    require_claims(claims, where)


def _shapes(state: NetworkState, model: NetworkModel) -> Iterator[tuple[str, Shape, Shape]]:
    """Parts of a state, their shapes, and what these have to be, by a state before the first step."""
    fresh, surfaces = NetworkState.start(model), len(state.surfaces)
    anchors, size = len(model.anchor_names), len(fresh.belief.mean) + 2 * surfaces
    yield "belief/mean", state.belief.mean.shape, (size,)
    yield "belief/covariance", state.belief.covariance.shape, (size, size)
    for name in ("agents", "clocks", "rates"):
        yield f"belief/{name}", (getattr(state.belief, name),), (getattr(fresh.belief, name),)
    yield "los", state.los.shape, fresh.los.shape
    yield "here", state.here.shape, fresh.here.shape
    yield from shapes_of_bank(state.surfaces, "surfaces", len(fresh.los), anchors)
    for field in fields(state.clocks):
        found, wanted = (getattr(one.clocks, field.name).shape for one in (state, fresh))
        yield f"clocks/{field.name}", found, wanted
    yield "records", (len(state.records),), (len(fresh.records),)
    for agent, record in enumerate(state.records):
        for name in ("clutter", "listened", "turn", "turn_weight"):
            yield f"records/{agent}/calibration/{name}", getattr(record.calibration, name).shape, (anchors,)
    if state.grid is not None:
        for name in ("evidence", "observed", "row"):
            yield f"grid/{name}", getattr(state.grid, name).shape, model.agents[0].grid.shape


def _sound_walks(walks: ClockWalk, state: NetworkState) -> bool:
    """Whether filters of clocks could have become so."""
    clocks = len(state.belief.layout.devices)
    shape = (WAYS, len(SHARES))
    return (
        walks.log.shape == walks.variance.shape == shape
        and walks.mean.shape == (*shape, clocks)
        and walks.free.shape == (clocks,)
        and bool(np.isfinite(walks.log).all())
        and bool((walks.log <= 0).all() and (walks.log.max(1) == 0).all() and (walks.variance >= 0).all())
    )
