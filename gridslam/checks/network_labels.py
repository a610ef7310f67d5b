"""Whether labels and clocks of several agents' measurements fit the scene: by lines of sight, angles alone.

The agent is followed by the angles of lines of sight, with every row as possibly any anchor's
(`gridslam.checks.line_of_sight_filter`). Where that works, the rows that are lines of sight are known without
their labels and distances, and say what is wrong with either. Reflections may be followed instead, so nothing
is said that the table as it stands doesn't fit worse (`gridslam.checks.network_cures`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from gridslam.checks.network_cures import Confusion, Cure, needed_cure
from gridslam.checks.network_sights import FEWEST, Links, lines_of_sight, middle_of
from gridslam.checks.range_errors import LEAST_OFFSET_M
from gridslam.checks.range_words import clocks_advice
from gridslam.checks.verdict import UNSURE
from gridslam.measurements.network import NetworkMeasurements
from gridslam.world.clocks import NS
from gridslam.world.network_scene import clock_model
from gridslam.world.scene import Scene

WRONG = 4.0
"""Deviations by which an offset must lie outside of what the scene has for it."""


class Judged(NamedTuple):
    """An agent's lines of sight (None: nobody knows which), and what its table needs to fit."""

    agent: str
    link: Links | None
    cure: Cure


def judge_labels(measurements: NetworkMeasurements, scene: Scene) -> list[Judged]:
    """What each agent's table needs to fit, as far as labels and clocks go."""
    return [_judged(measurements, scene, name) for name in measurements.agents]


def suspicion_lines(judged: Sequence[Judged], scene: Scene) -> list[str]:
    """Suspicions about labels and clocks of agents, for a person."""
    told = [one for one in judged if one.cure.fits]
    return [*label_lines(told, scene.anchor_names), *clock_lines(told, scene)]


def untold_lines(judged: Sequence[Judged], others: Collection[str] = ()) -> list[str]:
    """That there is too little to tell of agents; `others` are judged otherwise."""
    untold = [one.agent for one in judged if not one.cure.fits and one.agent not in others]
    few = f"{UNSURE}{', '.join(untold)}: too few lines of sight to judge labels and clocks by"
    return [few] if untold else []


def _judged(measurements: NetworkMeasurements, scene: Scene, name: str) -> Judged:
    """What is wrong with an agent's table; as it stands, if its lines of sight show nothing."""
    link = lines_of_sight(measurements, scene, name)
    if link is not None:
        every = Cure(Confusion.of(link, len(scene.anchors)).exchanged, mistaken=True, late=True)
        shown = [Judged(name, link, every)]
        if not (label_lines(shown, scene.anchor_names) or clock_lines(shown, scene)):
            return Judged(name, link, Cure(fits=True))
        cure = needed_cure(link, measurements, scene, name)
        if cure.fits:
            return Judged(name, link, cure)
    return Judged(name, None, needed_cure(None, measurements, scene, name))


def label_lines(judged: Sequence[Judged], names: Sequence[str]) -> list[str]:
    """Labels that are exchanged for some or all agents, or mistaken on some rows."""
    lines, exchanged = [], dict[tuple[str, ...], list[str]]()
    for agent, link, cure in judged:
        if cure.exchanged:
            swapped = tuple(f"{names[j]} is the scene's {names[i]}" for i, j in cure.exchanged)
            exchanged.setdefault(swapped, []).append(agent)
        if link is None or not cure.mistaken:
            continue
        confusion = Confusion.of(link, len(names))
        for i, j in confusion.mistaken:
            lines.append(
                f"suspect: {agent}: {confusion.found[i, j]} of {confusion.found[i].sum()} rows with angles "
                f"and distances of the line of sight to {names[i]} are labelled {names[j]}"
            )
    for swapped, who in exchanged.items():
        whom = "all agents" if len(who) == len(judged) and len(who) > 1 else ", ".join(who)
        lines.insert(0, f"suspect: labels exchanged for {whom}: {', '.join(swapped)}")
    return lines


def clock_lines(judged: Sequence[Judged], scene: Scene) -> list[str]:
    """Offsets in the distances that the scene has no clocks for."""
    links = [one.link for one in judged if one.cure.late and one.link is not None]
    clocks = clock_model(scene, [link.agent for link in links])
    lines, half, anchors = [], clocks.half_width_m, len(scene.anchors)
    for number, name in enumerate(scene.anchor_names):
        offsets = []
        for index, link in enumerate(links):
            late = link.late_m[link.anchor == number]
            if len(late) < FEWEST:
                continue
            middle, spread = middle_of(late)
            doubt = max(LEAST_OFFSET_M, WRONG * spread / np.sqrt(len(late)))
            allowed = half[number] + half[anchors + index] + doubt
            if abs(middle) > allowed:
                offsets.append((link.agent, middle))
        if offsets:
            lines.append(_offset_line(name, offsets, scene))
    return lines


def _offset_line(name: str, offsets: Sequence[tuple[str, float]], scene: Scene) -> str:
    each = ", ".join(f"{far:+.2f} m ({far / NS:+.1f} ns) at {agent}" for agent, far in offsets)
    most = max((far for _, far in offsets), key=abs)
    cure = clocks_advice(most) if scene.clocks is None else "its prior in [clocks] is too narrow"
    return f"suspect: distances of anchor {name} are off by {each}, as by clocks that differ: {cure}"
