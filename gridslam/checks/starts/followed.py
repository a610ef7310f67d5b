"""A table as it stands, followed again before anything is accused: the agent may only have been lost."""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from gridslam.checks.anchors.rivals import CLEAR, EXPLAINED, FAIR_CROWD, both_measured
from gridslam.checks.sights.fit import FITTING, least_share
from gridslam.checks.sights.line_of_sight_filter import CROWD, Sight, explain
from gridslam.checks.starts.start_search import one_in_sight
from gridslam.checks.tables.unit_hypotheses import IN_WORLD, Suspicion
from gridslam.world.columns import Columns
from gridslam.world.scene import Scene


class Way(TypedDict, total=False):
    """Arguments of `explain`."""

    thorough: bool
    sharp: bool
    crowd: int


WAYS: tuple[Way, ...] = (
    {"thorough": True},
    {"sharp": True},
    {"thorough": True, "sharp": True, "crowd": CROWD},
)
"""Ways to follow an agent that is lost straight on: through doors, around bends, both by more particles.
About one anchor a turn and an angle that is misread are the same: sharp ones tell nothing there."""
FAIR: Way = {"crowd": FAIR_CROWD}
"""By distances alone usual numbers of particles lose a right table by luck: 90 nats of one of four."""
FREER = 30.0
"""Log likelihood ratio in nats that turns beyond ``filter.heading_deg`` must gain: they fit more anyway."""


def followed(table: Columns, scene: Scene, agent: str | None, plain: Sight) -> Sight:
    """The most that is explained of a table as it stands: straight on, through doors or around sharp bends.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    plain : Sight
        What is explained straight on.
    """
    if plain.explained >= EXPLAINED:
        return plain
    through = explain(table, scene, agent, **WAYS[0])
    best = through if through.explained > max(plain.explained, least_share(scene)) else plain
    if best.explained >= FITTING:
        return best
    for way in WAYS[1:]:
        around = explain(table, scene, agent, **way)
        if one_in_sight(around):
            break
        if around.explained > best.explained and around.evidence > best.evidence + FREER:
            best = around
    return best


def upheld(
    table: Columns, read: Columns, found: list[Suspicion], scene: Scene, agent: str | None, plain: Sight,
    margin: float = CLEAR,
) -> Sight | None:  # fmt: skip
    """What explains a table as it stands, if no suspicion explains more.

    A right table that the agent was lost in is explained worse than a wrong one that it wasn't. So it is
    followed again, through doors and around sharp bends.

    Parameters
    ----------
    table, read : dict of (K,) arrays
        As it stands, and with the columns read as the suspicions say.
    found : list of Suspicion
    plain : Sight
        What is explained as it stands, without these.
    margin : float
        Log likelihood ratio in nats that they must reach.
    """
    if not found:
        best = followed(table, scene, agent, plain)
        return best if best.explained >= least_share(scene) else None
    kinds = {(item.column, item.kind) for item in found}
    world = bool(kinds & IN_WORLD)
    whole = read | {"aoa_rad": table["aoa_rad"]} if ("aoa_rad", "world frame") in kinds else read
    most = -np.inf
    for way in (*WAYS, *([] if both_measured(table) else [FAIR])):
        own = explain(table, scene, agent, **way)
        if way.get("sharp") and one_in_sight(own):
            break
        most = max(most, explain(whole, scene, agent, world, **way).evidence)  # of what is less free, too
        if own.explained >= least_share(scene) and most < own.evidence + margin:
            return followed(table, scene, agent, plain)
    return None
