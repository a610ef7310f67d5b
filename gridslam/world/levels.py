"""Heights of devices, and floor and ceiling, at which paths may bounce; docs/model.md, (M221), (M223)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.scene_parts import Agent, Anchor, CoefficientStd, HeightStd, Metre, Share
from gridslam.world.validation import Strict, fault

DIRECT, FLOOR, CEILING = range(3)
"""What a path goes over besides walls, as `TruePaths.over` tells it."""
COEFFICIENTS: Array = (np.arange(50) + 0.5) / 50
"""Nodes of beliefs about coefficients of floor and ceiling."""


class Level(Strict):
    """Floor or ceiling: a level plane that reflects everywhere."""

    height_m: Metre
    coefficient: Share
    coefficient_std: CoefficientStd = 0.0
    height_std_m: HeightStd = 0.0


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
    rise : (V,) int
        Which rise makes these heights others than that, -1 for none; docs/model.md, (M261).
    rise_variance : (G, G) m^2
        Covariance of the rises.
    coefficient : (V - 1, 50) or None
        Prior beliefs about coefficients of the levels over `COEFFICIENTS`, 0 for a known one; None
        where all are known.
    """

    over: tuple[int, ...]
    height: Array
    gain: Array
    rise: NDArray[np.intp]
    rise_variance: Array
    coefficient: Array | None = None

    def errors(self, higher: Array, covariance: Array) -> dict[int, tuple[float, float]]:
        """By how much agent and levels, by `over`, are higher than told, and the deviations of that, m.

        Parameters
        ----------
        higher : (G,) m
            The rises as believed.
        covariance : (G, G) m^2
        """
        found = dict[int, tuple[float, float]]()
        for over, rise in zip(self.over, self.rise.tolist(), strict=True):
            weight = np.zeros(len(higher))
            weight[self.rise[:1][self.rise[:1] >= 0]] = -1.0 if over == DIRECT else -0.5
            if over != DIRECT and rise >= 0:
                weight[rise] += 0.5
            found[over] = float(weight @ higher), math.sqrt(max(float(weight @ covariance @ weight), 0.0))
        return found

    def heights(self, over: NDArray[np.intp], anchor: NDArray[np.intp]) -> Array:
        """Those of paths (L,) m."""
        return np.asarray(self.height[self._row[over], anchor])

    def rises(self, over: NDArray[np.intp]) -> NDArray[np.intp]:
        """Those of paths (L,), -1 for none."""
        return np.asarray(self.rise[self._row[over]])

    @property
    def _row(self) -> NDArray[np.intp]:
        """Which way goes over each level, (3,)."""
        row = np.zeros(CEILING + 1, np.intp)
        row[list(self.over)] = np.arange(len(self.over))
        return row


def verticals_of(
    above: Array, agent_m: float, floor: Level | None, ceiling: Level | None, agent_std_m: float = 0.0
) -> Verticals:
    """Ways of paths between anchors so high `above` (J,) an agent, which is at `agent_m`, m, or nearly so."""
    levels = {FLOOR: floor, CEILING: ceiling}
    there = {over: level for over, level in levels.items() if level is not None}
    # the image of an anchor at z_j in a level h is at 2 h - z_j
    images = [2 * (level.height_m - agent_m) - above for level in there.values()]
    gain = np.array([1.0, *(level.coefficient for level in there.values())])
    stds = np.array([agent_std_m, *(level.height_std_m for level in there.values())])
    coefficient = _coefficients([(level.coefficient, level.coefficient_std) for level in there.values()])
    return Verticals((DIRECT, *there), np.stack([above, *images]), gain, *_rises(stds), coefficient)


def _coefficients(priors: list[tuple[float, float]]) -> Array | None:
    """Normal beliefs about coefficients by their means and deviations; see `Verticals.coefficient`."""
    if not any(std for _, std in priors):
        return None
    rows = [
        np.exp(-0.5 * ((COEFFICIENTS - mean) / std) ** 2) if std else np.zeros(len(COEFFICIENTS))
        for mean, std in priors
    ]
    return np.array([row / max(float(row.sum()), 1e-300) for row in rows])


def _rises(stds: Array) -> tuple[NDArray[np.intp], Array]:
    """Which rise each way has (V,), and their covariance, by deviations of agent and levels (V,).

    An agent that is higher lowers all heights above it as much, and a level that is raises its own by twice
    that. Ways that depend on the same share a rise.
    """
    by_error = 2 * np.diag(stds)
    by_error[:, 0] = -stds[0]
    rise, rows = np.full(len(stds), -1, np.intp), list[Array]()
    for way, row in enumerate(by_error):
        if row.any():
            alike = [n for n, other in enumerate(rows) if np.array_equal(row, other)]
            rise[way] = alike[0] if alike else len(rows)
            rows += [] if alike else [row]
    shape = np.array(rows).reshape(-1, len(stds))
    return rise, shape @ shape.T


def check_heights(
    anchors: Sequence[Anchor], agents: Sequence[Agent], floor: Level | None, ceiling: Level | None
) -> None:
    """Heights of all anchors and agents, or of none; all of them above the floor and below the ceiling."""
    have = [len(anchor.position_m) > 2 for anchor in anchors]
    tall = 2 * sum(have) >= len(have)  # of as many with as without, those without are to be completed
    odd = [index for index, one in enumerate(have) if one != tall]
    if odd:
        names = ", ".join(anchors[index].name for index in odd)
        found = f"{list(anchors[odd[0]].position_m)} (anchor{'s' if len(odd) > 1 else ''} {names})"
        same = "[x, y, z]" if tall else "[x, y]"
        allowed = f"{same}, as of the other anchors: all have heights, or none has"
        raise fault(f"anchors[{odd[0]}].position_m", found, allowed)
    for index, agent in enumerate(agents):
        if tall and agent.height_m is None:
            raise fault(f"agents[{index}].height_m", "none", "its height: the anchors have heights")
        if agent.height_m is not None and not tall:
            found = f"{agent.height_m:g}, but no anchor has a height"
            raise fault(f"agents[{index}].height_m", found, "[x, y, z] for every anchor's position_m")
        if agent.height_std_m and not tall:
            found = f"{agent.height_std_m:g}, but no anchor has a height"
            raise fault(f"agents[{index}].height_std_m", found, "[x, y, z] for every anchor's position_m")
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
