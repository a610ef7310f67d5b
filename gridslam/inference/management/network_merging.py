"""Management of the surfaces that several agents share: the same as for one, on the joint belief."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from gridslam.inference.management.ghosts import drop_ghosts
from gridslam.inference.management.merging import merge, prune
from gridslam.inference.state.network_belief import NetworkBelief
from gridslam.inference.state.network_state import NetworkState
from gridslam.world.network_model import NetworkModel


def merge_and_prune_shared(state: NetworkState, model: NetworkModel) -> NetworkState:
    """Merge duplicates, drop ghosts, the unlikely, and the amplitudes of their rays."""
    one = model.agents[0]
    bank, belief = merge(state.surfaces, state.belief)
    if one.max_bounces > 1:
        bank, belief = drop_ghosts(bank, belief, np.tile(one.anchor_positions, (len(model.agents), 1)))
    bank, belief = prune(bank, belief, one.settings.prune_below)
    records = tuple(
        replace(record, amplitudes=record.amplitudes.among(bank.identity)) for record in state.records
    )
    return replace(state, surfaces=bank, belief=cast(NetworkBelief, belief), records=records)
