"""Whether the told start is where the first lines of sight put the agent, each by its anchor alone.

A filter that is blunt goes from a wrong start to the right place within some steps, and turns to the right
heading, at little cost. The poses of the first steps are off all the same.
"""

from __future__ import annotations

import numpy as np

from gridslam.checks.anchors.handover_rivals import at_odds
from gridslam.checks.sights.handovers import FIRST, Beginning, Ties
from gridslam.checks.starts.start_search import arrivals_words, start_words
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.world.columns import Columns
from gridslam.world.geometry import wrap
from gridslam.world.scene import Scene

NEAR_M, NEAR_RAD = 0.4, np.radians(10.0)
"""Beyond the prior's half widths up to where a start counts as the told one."""
SIGMAS = 3.0
"""Standard deviations of the first poses that a start may be off besides."""
KNOWN_M, KNOWN_RAD = 0.4, np.radians(15.0)
"""Standard deviations up to which anything is told."""
ALONG_RAD, WAY_M = np.radians(30.0), 0.4
"""To its heading, of an agent that goes ahead; way in the first steps by which its course is known."""


def other_start_told(table: Columns, scene: Scene, agent: str | None) -> Suspicion | None:
    """A start, or an axis of the arrivals, other than told; None if the told one is, or can be.

    In scenes with walls alone: without, reflections' places pass for the agent's.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    ties = Ties.of(table, scene, agent) if scene.walls else None
    if ties is None or ties.start is None or agent is None:
        return None
    start, body = ties.start, scene.agent(agent)
    if start.spread_m > KNOWN_M or at_odds(ties.handovers):
        return None
    far = lies_far(start, scene, agent)
    turned = start.spread_rad < KNOWN_RAD and bool(
        abs(start.gap_rad) > np.radians(body.prior.heading_deg) + NEAR_RAD + SIGMAS * start.spread_rad
    )
    if not far and not turned:
        return None
    told = np.radians(body.start_heading_deg)
    facing = float(wrap(told + (start.gap_rad if np.isfinite(start.gap_rad) else 0.0)))
    texts = [
        start_words(np.array([*start.place, facing]), not far, body.start_heading_deg, int(table["step"][0]))
    ]
    if not far:
        texts.append(arrivals_words(start.gap_rad))
        if _goes(start, told) and not _goes(start, facing):  # an agent goes ahead, mostly
            texts = texts[::-1]
    single = [scene.anchor_names[number] for number in start.anchors]
    alone = len(single) == 1 and not any(
        ties.handovers.tied(start.anchors[0], other) for other in range(len(scene.anchors))
    )
    if alone:
        texts.append(f"anchor {single[0]} is turned or stands elsewhere")
    off = f"{start.gap_m:.1f} m" + (f" and {np.degrees(start.gap_rad):.0f} degrees" if turned else "")
    reason = (
        f"the first lines of sight, of the first {FIRST} steps by {' and '.join(single)}, "
        f"put the agent {off} from the told start"
    )
    return Suspicion("start", "start", "; or ".join(texts), len(texts) == 1, reason)


def lies_far(start: Beginning, scene: Scene, agent: str) -> bool:
    """Whether the first lines of sight put the agent farther from the told start than its prior allows."""
    near = max(scene.agent(agent).prior.position_m, 0.1) * np.sqrt(2) + NEAR_M
    return bool(start.gap_m > near + SIGMAS * start.spread_m)


def _goes(start: Beginning, facing_rad: float) -> bool:
    """Whether the agent's first way is ahead, if it faces so."""
    way = start.pace_m * FIRST
    course = np.arctan2(way[1], way[0])
    return bool(np.hypot(*way) > WAY_M and abs(wrap(course - facing_rad)) < ALONG_RAD)
