"""What is said of an error in the distances, and what to do about it."""

from __future__ import annotations

import math

from gridslam.checks.scene.range_errors import RangeError
from gridslam.world.clocks import NS
from gridslam.world.scene import Scene

ROOM = 1.5
"""Times as wide as what was found that a prior is advised: clocks walk."""


def error_words(error: RangeError, size: float, scene: Scene, agent: str | None = None) -> str:
    """What is wrong, by how much, and the cure.

    Parameters
    ----------
    size : float
        Of the error, m.
    agent : str, optional
        Whose table it is; default: the first.
    """
    if error.kind == "rise":
        told = scene.anchors[0].position_m[-1] - float(scene.heights(agent)[0])
        way = "higher" if size > 0 else "lower"
        return (
            f"slant ranges of an agent that is {abs(size):.1f} m {way}: with its height_m at about "
            f"{told + size:.1f}, not {told:g}, the table fits"
        )
    if error.kind == "plan":
        return (
            "distances in the plan, from above, where slant ranges belong: the root of the sum of squares "
            "with the anchor's height above the agent; or leave the heights out of the scene"
        )
    names = ", ".join(scene.anchor_names[number] for number in error.anchors)
    every = len(error.anchors) == len(scene.anchors)
    whose = "of all anchors" if every else f"of anchor {names}"
    if error.kind == "slant":
        wrong = "other heights than the scene's" if scene.has_heights else "the scene has no heights"
        return (
            f"slant ranges {whose}, about {size:.2f} m above or below the agent: {wrong}; "
            "give them as third numbers of position_m, and the agent's as height_m"
        )
    much, long = f"{abs(size):.2f} m ({abs(size) / NS:.1f} ns)", "long" if size > 0 else "short"
    return f"distances {whose} are {much} too {long}, {offset_cure(size, every, scene)}"


def offset_cure(size_m: float, every: bool, scene: Scene) -> str:
    """What an offset may come from, and what to do about it, of all anchors or of one."""
    instead = "" if scene.clocks is not None else f", or {clocks_advice(size_m, every)}"
    return f"as by clocks that differ; {'subtract' if size_m > 0 else 'add'} it{instead}"


def clocks_advice(size_m: float, agents: bool = False) -> str:
    """A table ``[clocks]`` that allows for an offset of anchors, or of agents, and who makes use of it."""
    width = math.ceil(ROOM * abs(size_m) / NS)
    keys = f"anchor_prior_ns = 0, agent_prior_ns = {width}" if agents else f"anchor_prior_ns = {width}"
    return f"give the scene [clocks] with {keys} and run network SLAM"
