"""Where the agent may have begun, if not where the scene says: by lines of sight alone.

Every row of the first steps is taken for a line of sight; the poses from which it would be one are where
`gridslam.checks.sights.line_of_sight_filter` begins. It needs no start and no map.
"""

from __future__ import annotations

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.anchors.rivals import CERTAIN
from gridslam.checks.anchors.turned_anchors import UNSEEN
from gridslam.checks.scene.views import enclosed
from gridslam.checks.sights.course import STEADY, Course, side_words
from gridslam.checks.sights.fit import FITTING, least_share, settled
from gridslam.checks.sights.likelihood import ANGLE_STD
from gridslam.checks.sights.line_of_sight_filter import Sight, explain
from gridslam.checks.sights.particles import PARTICLES, TOLD_APART
from gridslam.checks.tables.unit_hypotheses import ADVICE, Suspicion
from gridslam.world.columns import Columns
from gridslam.world.geometry import level_of, unit, wrap
from gridslam.world.scene import Scene

FIRST, MOST = 6, 3000
"""Steps whose rows propose poses, and poses at most."""
MANY_STARTS = MOST // PARTICLES
"""Times as many particles as usual as begin anywhere."""
LEAST_M, SPREAD_M = 0.1, 0.2
"""Shortest level distance of a pose from its anchor; how far poses are spread about where a row puts them."""

HALF_RAD = np.radians(160.0)
"""Turn of the heading from which on arrivals may be read backwards."""
ALONG, ASIDE_RAD = np.cos(np.radians(30.0)), np.radians(30.0)
"""Cosine to its heading of an agent that goes ahead; turn from which on arrivals may be of another axis."""
RIVAL = 25.0
"""Log likelihood ratio in nats within which another start and another cure are named side by side."""
ELSEWHERE = {"start", "agent", "second device"}
"""Kinds of suspicions that another start, or another's, brings."""
APART_M = 0.5
"""How far from the agent a second device is one."""
NEAR_M, NEAR_RAD, LEG_M = 0.3, np.radians(10.0), 0.5
"""Beyond the prior up to where a start counts as the scene's; way by which a course is told."""


def anywhere(table: Columns, scene: Scene, agent: str | None) -> Sight | None:
    """What lines of sight explain of a table, wherever the agent began; None if nothing tells where.

    Where walls enclose the scene's start, they enclose any other.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    starts = proposed_starts(table, scene, agent)
    if not len(starts):
        return None
    sight = explain(table, scene, agent, starts=starts)
    walls = scene.segments()
    told = scene.agent(agent).start_m if agent is not None else None
    if told is None or enclosed(sight.start[:2], walls) or not enclosed(np.asarray(told), walls):
        return sight
    starts = starts[enclosed(starts[:, :2], walls)]
    return explain(table, scene, agent, starts=starts) if len(starts) else None


def proposed_starts(table: Columns, scene: Scene, agent: str | None) -> Array:
    """Poses (P, 3) in m, m, rad from which a row of the first steps is a line of sight.

    None where distances or all angles are missing. A missing angle may be any.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    """
    step = table["step"]
    steps = np.unique(step)[:FIRST]
    distance = table.get("distance_m", np.full(len(step), np.nan))
    rows = np.flatnonzero((step <= steps.max(initial=-1)) & np.isfinite(distance))
    angles = [table.get(name, np.full(len(step), np.nan))[rows] for name in ("aod_rad", "aoa_rad")]
    known = np.isfinite(angles[0]) | np.isfinite(angles[1])
    rows, (leaving, coming) = rows[known], (angle[known] for angle in angles)
    if not len(rows):
        return np.zeros((0, 3))
    draw = np.random.default_rng(1)
    chosen = np.tile(np.arange(len(rows)), max(MOST // len(rows), 1))[:MOST]
    rows, leaving, coming = rows[chosen], leaving[chosen], coming[chosen]
    anchor, count = table["anchor"][rows], len(rows)
    toward = leaving + scene.anchor_orientations[anchor] + ANGLE_STD * draw.standard_normal(count)
    toward = np.where(np.isfinite(toward), toward, draw.uniform(-np.pi, np.pi, count))
    facing = toward + np.pi - coming + ANGLE_STD * draw.standard_normal(count)
    facing = np.where(np.isfinite(facing), facing, draw.uniform(-np.pi, np.pi, count))
    height = scene.heights(agent)[anchor]
    level = np.maximum(level_of(distance[rows], height), LEAST_M)
    place = scene.anchor_positions[anchor] + level[:, None] * unit(toward)
    place += SPREAD_M * draw.standard_normal((count, 2))
    low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
    within = ((place > low) & (place < high)).all(1)  # reflections would put it behind walls
    return np.column_stack([place, wrap(facing)])[within]


def other_start(
    table: Columns, scene: Scene, agent: str | None, plain: Sight, best: Sight, behind: float = RIVAL
) -> tuple[Suspicion | None, Sight] | None:
    """Another start, the scene's other agents' first, from which a table fits as it stands.

    Parameters
    ----------
    table : dict of (K,) arrays
        Columns as of `gridslam.checks.sights.line_of_sight_filter.explain`, in the order of steps.
    plain, best : Sight
        What is explained from the scene's start as the table stands, and with the best cure found so far.
    behind : float
        Log likelihood ratio in nats by which another start may explain less than that cure.

    Returns
    -------
    tuple or None
        What to say, and what is explained then. Nothing is to be said where the start is the scene's own: the
        agent had only got lost. None if no start explains nearly as much as that cure, and clearly more than
        the scene's.
    """
    if agent is None:
        return None
    needed = max(best.evidence - behind, CERTAIN, plain.evidence + (CERTAIN if best is plain else 0.0))
    others = [(explain(table, scene, body.name), body.name) for body in scene.agents if body.name != agent]
    sight = anywhere(table, scene, agent)
    if sight is not None and (sight.explained < least_share(scene) or sight.evidence <= needed):
        sight = None
    least = needed if sight is None else max(needed, sight.evidence - RIVAL)
    close = [one for one in others if one[0].explained >= least_share(scene) and one[0].evidence > least]
    if close:
        sight, name = max(close, key=lambda one: one[0].evidence)
        own = settled(table, scene, agent)
        if _both_fit(own, sight):
            text = (
                f"rows of two devices, {agent} and {name}, in one table; say whose each row is, in a column "
                "agent, or make two files"
            )
            told = _reason(table, scene, agent, name, plain, sight)
            return Suspicion("agent", "second device", text, True, told), own
        text = f"the table of {name}, by where it begins (--agent {name})"
        sure = sight.evidence > best.evidence + RIVAL
        told = _reason(table, scene, agent, name, plain, sight)
        return Suspicion("agent", "agent", text, sure, told), sight
    if sight is None:
        return None
    body = scene.agent(agent)
    gap_m = float(np.linalg.norm(sight.start[:2] - body.start_m))
    gap_rad = abs(float(wrap(sight.start[2] - np.radians(body.start_heading_deg))))
    there = gap_m < max(body.prior.position_m, 0.1) * np.sqrt(2) + NEAR_M
    if there and gap_rad < np.radians(body.prior.heading_deg) + NEAR_RAD:
        return None, sight
    own = _from_the_scenes(table, scene, agent)
    if own.explained >= least_share(scene) and own.evidence > sight.evidence - CERTAIN:
        return None, own
    text = start_words(sight.start, there, body.start_heading_deg, int(table["step"][0]))
    sure = sight.evidence > best.evidence + RIVAL
    if there and gap_rad > ASIDE_RAD and not one_in_sight(sight):
        # an array that is mounted otherwise fits as well
        turned_rad = float(wrap(sight.start[2] - np.radians(body.start_heading_deg)))
        text, sure = _either(text, turned_rad, table, scene, sight), False
    return Suspicion("start", "start", text, sure, _reason(table, scene, agent, None, plain, sight)), sight


def _both_fit(one: Sight, other: Sight) -> bool:
    """Whether a table fits from two agents' starts, nearly as well, and on two ways."""
    together = min(len(one.position_m), len(other.position_m))
    gap_m = np.linalg.norm(one.position_m[:together] - other.position_m[:together], axis=1)
    return min(one.explained, other.explained) >= FITTING and bool(np.median(gap_m) >= APART_M)


def _from_the_scenes(table: Columns, scene: Scene, agent: str) -> Sight:
    """What is explained from the scene's start by as many particles as begin anywhere, or through doors."""
    through = explain(table, scene, agent, thorough=True)  # who is slow, or turns, is followed best so
    seen = explain(table, scene, agent, crowd=MANY_STARTS), settled(table, scene, agent), through
    return max(seen, key=lambda one: (one.explained >= least_share(scene), one.evidence))


def goes_ahead(sight: Sight) -> float:
    """How the agent's first way lies to the heading it began with: 1 ahead, -1 backwards, 0 nobody knows."""
    way = sight.position_m[TOLD_APART:] - sight.start[:2]  # before that it is the middle of many starts
    far = np.flatnonzero(np.hypot(*way.T) > LEG_M)
    if not len(far):
        return 0.0
    return float(np.cos(np.arctan2(way[far[0], 1], way[far[0], 0]) - sight.start[2]))


def one_in_sight(sight: Sight) -> bool:
    """Whether at most one anchor is: every pose about it looks alike but for its orientation."""
    return int((np.nan_to_num(sight.shares) >= UNSEEN).sum()) < 2


def start_words(start: Array, there: bool, heading_deg: float, first: int = 0) -> str:
    """What is said of a start from which a table fits.

    Parameters
    ----------
    start : (3,) m, m, rad
    there : bool
        Whether its place is the told one.
    first : int
        The table's first step, which the pose is of; the scene's start is that of step 0.
    """
    facing = f"{round(float(np.degrees(start[2])))} degrees"
    if there:
        told = f"start_heading_deg of {heading_deg:g} doesn't fit"
        return f"{told}: with about {facing} the table does as it stands"
    place = f"about ({start[0]:.1f}, {start[1]:.1f}) m"
    return (
        f"start_m and start_heading_deg don't fit: with a start at {place} and "
        f"a heading of {facing} the table does as it stands; they are to be those of "
        + (f"step 0, {first} silent steps before the table's first" if first else "the table's first step")
    )


def _either(start: str, turned_rad: float, table: Columns, scene: Scene, sight: Sight) -> str:
    """Another heading, and another axis of arrivals: first the one by which the agent looks where it goes."""
    arrivals, course = arrivals_words(turned_rad), Course.by_sight(table, sight, scene)
    if course is None or abs(course.turn) < STEADY:  # its first way alone tells
        return f"{start}; or {arrivals}" if goes_ahead(sight) > ALONG else f"{arrivals}; or {start}"
    by_start, by_arrivals = (float(wrap(np.angle(course.turn) - turn)) for turn in (0.0, turned_rad))
    ways = sorted([(by_start, start), (by_arrivals, arrivals)], key=lambda way: abs(way[0]))
    return "; or ".join(f"{text} (so it {side_words(turn)} all the way)" for turn, text in ways)


def arrivals_words(gap_rad: float) -> str:
    """What arrivals may be instead, where headings seem off by so much."""
    if abs(gap_rad) > HALF_RAD:
        return f"aoa_rad is {ADVICE['backwards']}"
    return (
        f"aoa_rad is {np.degrees(-gap_rad):+.0f} degrees off, counted from another axis of the agent than "
        "the one that start_heading_deg is of"
    )


def _reason(table: Columns, scene: Scene, agent: str, other: str | None, plain: Sight, sight: Sight) -> str:
    """Shares from there and from the scene's start, as the table is judged in the end."""
    after = sight if other is None else settled(table, scene, other)
    before = settled(table, scene, agent)
    return (
        f"line of sight in {max(after.explained, sight.explained):.0%} of {after.judged}, "
        f"{before.explained:.0%} from the start of {agent}; "
        f"log likelihood ratio {sight.evidence - plain.evidence:.0f}"
    )
