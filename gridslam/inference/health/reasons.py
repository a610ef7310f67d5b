"""What health says, each sentence once; `gridslam.inference.health` lists when and by which formula."""

from __future__ import annotations

from collections.abc import Sequence

from gridslam.arrays import Array
from gridslam.world.radio import SPEED_OF_LIGHT

NOT_FOUND = "start not found yet"
UNPROVEN = "start not sure yet: there were more places than could be followed"
TURNABLE = "nothing tells by how much all is turned about the one anchor"
MIRRORED = "a mirrored place may fit as well: no other anchor has been in sight since both did"
UNSIGHTED = "hardly a line of sight heard yet: it may be another path, and learned features tell motion alone"
ONE_ELSEWHERE = "one anchor stands elsewhere than the scene says"
OFF_GRID = "the agent has left the grid"
LEAPT = "as no motion does"
"""Of `leapt`, what tells it from all others."""
OF_ALL = "distances of all anchors"
"""Of `offset`, what tells that of all anchors from that of one."""
ASTRAY = "what it hears isn't used for what all agents share"
CLOCK_OPEN = "its clock isn't found yet: distances tell nothing"
CLOCK_CONTESTED = "its clock may be another: lines of sight heard by it, or by others, don't fit it"


def silent(steps: int) -> str:
    """No measurement at all."""
    return f"nothing heard for {steps} steps"


def vague(spread_m: float) -> str:
    """Standard deviation of the position, m."""
    return f"position known to {spread_m:.1f} m alone"


def unchecked(spread_m: float, silent: bool) -> str:
    """Standard deviation of the position, m, where nothing loud enough is heard to tell right from wrong."""
    why = "nothing is heard" if silent else "what is heard is too faint"
    return f"position known to {spread_m:.1f} m, and {why} to check it"


def blind(metres: float) -> str:
    """Standard deviation at worst since a line of sight was heard; reflections have narrowed it since."""
    return f"no line of sight since its position was known to {metres:.1f} m: reflections may have misled it"


def found_again(steps: int) -> str:
    """The agent was lost, and found by other means than following it."""
    return f"agent found again {steps} steps ago"


def leapt(metres: float, steps: int) -> str:
    """The agent was found where its motion doesn't lead in the time, so far off."""
    return f"moved {metres:.1f} m at once {steps} steps ago, as no motion does: it may be elsewhere"


def few_explained(share: float, usual: float) -> str:
    """Share of the measurements too loud for clutter that known paths explain, and what is usual."""
    return f"{share:.0%} of the loud measurements explained, usually {usual:.0%}"


def little_power(share: float) -> str:
    """Share of the received power that known paths explain, of sampled signals."""
    return f"{share:.0%} of the received power explained by known paths"


def early(share: float) -> str:
    """Share of the latest steps at which a path was heard that is shorter than the straight line."""
    return f"paths arrive before the line of sight at {share:.0%} of the latest steps"


def misfit(ratio: float) -> str:
    """Normalised innovations squared, per degree of freedom."""
    return f"innovations {ratio:.1f} times as large as they should be"


def clutter(found: float, expected: float) -> str:
    """Clutter learned of the worst anchor, and the scene's, measurements a step."""
    return f"clutter seems to be {found:.1f} measurements a step, where the scene expects {expected:g}"


def turned(anchor: str, degrees: float) -> str:
    """By how far an anchor's orientation is another than the scene's."""
    return f"anchor {anchor} seems turned by {degrees:.1f} degrees"


def few_particles(effective: float) -> str:
    """Effective number of particles behind a sure association."""
    return f"{effective:.0f} particles carry the weight"


def crowded(count: int, proposing: int, tells: bool = True) -> str:
    """So many loud measurements that not all propose where the agent may be, or that they fit anywhere."""
    more = "" if tells else ", and so many fit anywhere: no other place is compared"
    return f"{count} loud paths of one anchor: {proposing} of them propose poses{more}"


def left_out(count: int) -> str:
    """Surfaces in sight that one joint belief has no room for."""
    return f"{count} surfaces left out for want of room"


def several_places(count: int) -> str:
    """Hypotheses that count, merged by pose alone."""
    return f"{count} places remain"


def fresh_start(lead: float) -> str:
    """Nats of evidence per loud measurement by which the belief leads a start anew."""
    return f"a fresh start explains what is heard nearly as well (lead {lead:.1f} nats)"


def elsewhere(nats: float) -> str:
    """By how much scans alone favour other poses than the believed one."""
    return f"what is heard fits another place better, by {nats:.0f} nats"


def offset(whose: str, size_m: float) -> str:
    """Error of all distances of an anchor, or of all anchors."""
    long, time_ns = "long" if size_m > 0 else "short", abs(size_m) / SPEED_OF_LIGHT * 1e9
    return f"distances of {whose} seem {abs(size_m):.2f} m ({time_ns:.1f} ns) too {long}"


def of_late(what: str) -> str:
    """What is said of an error of distances or places that began in mid-run."""
    return f"of late {what}"


def shifted(names: Sequence[str], places: Sequence[Array]) -> str:
    """Anchors, one of which stands elsewhere than the scene says, and where it would have to."""
    both = zip(names, places, strict=True)
    each = (f"anchor {name} stands near ({x:.1f}, {y:.1f})" for name, (x, y) in both)
    return f"{', or '.join(each)}, not where the scene says"


def height(size_m: float) -> str:
    """Height between anchors and agent that a planar scene lacks."""
    return f"anchors seem {size_m:.1f} m above or below the agent, where the scene has no heights"
