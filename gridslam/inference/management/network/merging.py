"""Management of the surfaces that several agents share: as `management.merging`, on the joint belief."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import cast

import numpy as np

from gridslam.arrays import replace
from gridslam.inference.health.reasons import left_out
from gridslam.inference.management.ghosts import drop_ghosts
from gridslam.inference.management.merging import MOST_SURFACES, dropped, known_apart, merge, prune
from gridslam.inference.management.step_info import StepInfo
from gridslam.inference.state.network.belief import NetworkBelief
from gridslam.inference.state.network.state import NetworkState
from gridslam.world.network_model import NetworkModel

Infos = Sequence[StepInfo | None]


def merge_and_prune_shared(
    state: NetworkState, model: NetworkModel, infos: Infos, most: int = MOST_SURFACES
) -> tuple[NetworkState, tuple[StepInfo | None, ...]]:
    """Merge duplicates, drop ghosts, the unlikely, and the amplitudes of their rays; (M513), (M574).

    Parameters
    ----------
    infos : sequence of StepInfo or None
        Of every agent; where surfaces that are believed in find no room, their health says so.
    most : int
        How many surfaces are kept at most.

    Returns
    -------
    (state, infos)
        infos: the same, with what their health says of surfaces that found no room.
    """
    one = model.agents[0]
    told = [info for info in infos if info is not None and info.teaches]
    exchanges = [exchange for info in told for exchange in info.exchanges]
    bank, belief = merge(state.surfaces, state.belief, partial(known_apart, state.surfaces, exchanges))
    if one.max_bounces > 1:
        bank, belief = drop_ghosts(bank, belief, np.tile(one.anchor_positions, (len(model.agents), 1)))
    before = bank
    bank, belief = prune(bank, belief, one.settings.prune_below, most)
    crowded = dropped(before, bank, one.settings) if len(bank) == most < len(before) else 0
    if crowded:
        infos = [None if info is None else info.doubted(left_out(crowded)) for info in infos]
    records = tuple(
        replace(record, amplitudes=record.amplitudes.among(bank.identity)) for record in state.records
    )
    state = replace(state, surfaces=bank, belief=cast(NetworkBelief, belief), records=records)
    return state, tuple(infos)
