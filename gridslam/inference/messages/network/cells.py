"""One grid for several agents: what the paths of all of them say of cells and coefficients; (M35)-(M42)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gridslam.inference.messages.cells import cast_messages, update_cells
from gridslam.inference.messages.reflection import update_coefficients
from gridslam.inference.state.network.state import NetworkState
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.filter_model import FilterModel


def update_shared_cells(
    state: NetworkState, models: Sequence[FilterModel | None], *, works: Sequence[Workspace]
) -> NetworkState:
    """Cell messages of all agents against the same occupancy, summed over agents, and folded once.

    So a cell that blocks one agent's path is told to all at the same step: [Li2026grid], eqs. (43) to (46),
    with a product over agents, too.

    Parameters
    ----------
    models : sequence of FilterModel or None
        As each agent's turn used it; None for one that isn't there.
    works : sequence of Workspace
        With the messages of each agent's turn, and cells that they share.
    """
    there = [agent for agent, model in enumerate(models) if model is not None]
    for agent in there:
        model, work = models[agent], works[agent]
        assert model is not None
        part = state.part(agent)
        drawn = cast_messages(part, model, work=work)
        part = update_coefficients(part, drawn, model, work=work)
        bank = replace(part.surfaces, single=state.surfaces.single, double=state.surfaces.double)
        state = replace(state, surfaces=bank, grid=part.grid)
    if not there:
        return state
    return replace(state, grid=update_cells(state.part(there[0]), work=works[there[0]]).grid)
