"""Heights of devices, and floor and ceiling, at which paths may bounce; docs/model.md, (M221), (M223)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.scene_parts import Agent, Anchor, Metre, Share
from gridslam.world.validation import Strict, fault

DIRECT, FLOOR, CEILING = range(3)
"""What a path goes over besides walls, as `TruePaths.over` tells it."""


class Level(Strict):
    """Floor or ceiling: a level plane that reflects everywhere."""

    height_m: Metre
    coefficient: Share


@dataclass(frozen=True, eq=False)
class Verticals:
    """Ways of paths up and down: straight, and over each level that reflects.

    Attributes
    ----------
    over : (V,) int
        `DIRECT` first, then `FLOOR` and `CEILING` where a scene has them.
    height : (V, J) m
        Of the anchors above the agent, and of their images in the levels.
    gain : (V,)
        Coefficients of the levels, 1 for none.
    """

    over: tuple[int, ...]
    height: Array
    gain: Array

    def heights(self, over: NDArray[np.intp], anchor: NDArray[np.intp]) -> Array:
        """Those of paths (L,) m."""
        row = np.zeros(CEILING + 1, np.intp)
        row[list(self.over)] = np.arange(len(self.over))
        return np.asarray(self.height[row[over], anchor])


def verticals_of(above: Array, agent_m: float, floor: Level | None, ceiling: Level | None) -> Verticals:
    """Ways of paths between anchors so high `above` (J,) an agent, which is at `agent_m`, m."""
    levels = {FLOOR: floor, CEILING: ceiling}
    there = {over: level for over, level in levels.items() if level is not None}
    # the image of an anchor at z_j in a level h is at 2 h - z_j
    images = [2 * (level.height_m - agent_m) - above for level in there.values()]
    gain = np.array([1.0, *(level.coefficient for level in there.values())])
    return Verticals((DIRECT, *there), np.stack([above, *images]), gain)


def check_heights(
    anchors: Sequence[Anchor], agents: Sequence[Agent], floor: Level | None, ceiling: Level | None
) -> None:
    """Heights of all anchors and agents, or of none; all of them above the floor and below the ceiling."""
    tall = len(anchors[0].position_m) > 2
    for index, anchor in enumerate(anchors):
        if (len(anchor.position_m) > 2) != tall:
            same = "[x, y, z]" if tall else "[x, y]"
            found, allowed = str(list(anchor.position_m)), f"{same}, as of the first anchor"
            raise fault(f"anchors[{index}].position_m", found, allowed)
    for index, agent in enumerate(agents):
        if tall and agent.height_m is None:
            raise fault(f"agents[{index}].height_m", "none", "its height: the anchors have heights")
        if agent.height_m is not None and not tall:
            found = f"{agent.height_m:g}, but no anchor has a height"
            raise fault(f"agents[{index}].height_m", found, "[x, y, z] for every anchor's position_m")
    for name, level, sign in (("floor", floor, 1), ("ceiling", ceiling, -1)):
        if level is None:
            continue
        if not tall:
            raise fault(name, f"a {name}, but no anchor has a height", "[x, y, z] for every position_m")
        own = [anchor.position_m[2] for anchor in anchors] + [agent.height_m or 0.0 for agent in agents]
        nearest = min(own, key=lambda height: sign * height)
        if sign * (nearest - level.height_m) <= 0:
            where = "below" if sign > 0 else "above"
            allowed = f"a height {where} all anchors and agents, the nearest of which is at {nearest:g}"
            raise fault(f"{name}.height_m", f"{level.height_m:g}", allowed)
