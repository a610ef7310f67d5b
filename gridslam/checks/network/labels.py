"""Whether labels and clocks of several agents' measurements fit the scene: by lines of sight, angles alone.

The agent is followed by the angles of lines of sight, with every row as possibly any anchor's
(`gridslam.checks.sights.line_of_sight_filter`). Where that works, the rows that are lines of sight are known
without their labels and distances, and say what is wrong with either. Reflections may be followed instead, so
nothing is said that the table as it stands doesn't fit worse (`gridslam.checks.network.cures`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from gridslam.checks.network.cures import Confusion, Cure, needed_cure
from gridslam.checks.network.sights import FEWEST, Links, lines_of_sight, middle_of
from gridslam.checks.scene.range_errors import LEAST_OFFSET_M
from gridslam.checks.scene.range_words import clocks_advice
from gridslam.checks.verdicts.verdict import UNSURE
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


def suspicion_lines(judged: Sequence[Judged], scene: Scene, least_m: float = 0.0) -> list[str]:
    """Suspicions about labels and clocks of agents, for a person.

    Parameters
    ----------
    least_m : float
        An offset that clocks must allow for besides those that are told.
    """
    told = [one for one in judged if one.cure.fits]
    return [*label_lines(told, scene.anchor_names), *clock_lines(told, scene, least_m)]


def widest_offset_m(judged: Sequence[Judged], scene: Scene) -> float:
    """The largest offset in the distances that the scene has no clocks for, m; 0 if there is none."""
    told = [one for one in judged if one.cure.fits]
    return max((abs(far) for offsets in _offsets(told, scene) for _, far in offsets), default=0.0)


def late_agents(judged: Sequence[Judged], scene: Scene) -> list[str]:
    """Agents whose distances hold such offsets."""
    told = [one for one in judged if one.cure.fits]
    return list(dict.fromkeys(agent for offsets in _offsets(told, scene) for agent, _ in offsets))


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


def clock_lines(judged: Sequence[Judged], scene: Scene, least_m: float = 0.0) -> list[str]:
    """Offsets in the distances that the scene has no clocks for; all lines propose the same clocks."""
    found = _offsets(judged, scene)
    most = max((abs(far) for offsets in found for _, far in offsets), default=0.0)
    cure = "its prior in [clocks] is too narrow"
    if scene.clocks is None:
        cure = clocks_advice(max(most, least_m))
    return [
        _offset_line(name, offsets, cure)
        for name, offsets in zip(scene.anchor_names, found, strict=True)
        if offsets
    ]


def _offsets(judged: Sequence[Judged], scene: Scene) -> list[list[tuple[str, float]]]:
    """Agents and offsets (m), of each of the scene's anchors, that its clocks don't allow for."""
    links = [one.link for one in judged if one.cure.late and one.link is not None]
    clocks = clock_model(scene, [link.agent for link in links])
    found, half, anchors = [], clocks.half_width_m, len(scene.anchors)
    for number in range(anchors):
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
        found.append(offsets)
    return found


def _offset_line(name: str, offsets: Sequence[tuple[str, float]], cure: str) -> str:
    each = ", ".join(f"{far:+.2f} m ({far / NS:+.1f} ns) at {agent}" for agent, far in offsets)
    return f"suspect: distances of anchor {name} are off by {each}, as by clocks that differ: {cure}"
