"""Several agents' rows, each agent's judged as a table of its own: units, angles, anchors, start, times.

Labels have to be known for that. Where the scene's clocks may be off by metres, or are shown to be,
distances are left out, so that angles alone are judged.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gridslam.checks.columns.time_units import absurd_times
from gridslam.checks.tables.fillers import padding
from gridslam.checks.tables.unit_hypotheses import Suspicion, absurd, finite
from gridslam.checks.verdicts.against_scene import against_scene
from gridslam.checks.verdicts.diagnose import TOLD_APART_M, offset_allowed_m
from gridslam.checks.verdicts.verdict import UNSURE, verdict
from gridslam.measurements.network import NetworkMeasurements
from gridslam.world.columns import OPTIONAL, VALUES, Columns
from gridslam.world.scene import Scene

LABELLED = 0.5
"""Share of an agent's rows that must have a label."""
SAID = {"names", "offset"}
"""Kinds of suspicions that those of labels and clocks say, too."""


class Device(NamedTuple):
    """What an agent's rows show by themselves.

    Attributes
    ----------
    agent : str
    found : list of Suspicion
    verdict : str
        What is said where nothing is suspected.
    """

    agent: str
    found: list[Suspicion]
    verdict: str


def devices(measurements: NetworkMeasurements, scene: Scene, late: Collection[str] = ()) -> list[Device]:
    """Judge those agents by themselves whose rows are labelled, by the measurements' order.

    Parameters
    ----------
    late : collection of str
        Agents in whose distances offsets of clocks are known to be.
    """
    each = ((name, _own_table(measurements, scene, name, name in late)) for name in measurements.agents)
    return [_judged(table, scene, name) for name, table in each if table is not None]


def device_lines(found: Iterable[Device], accused: Collection[str] = ()) -> list[str]:
    """What is suspected of devices, and of the others whether they fit, for a person.

    Parameters
    ----------
    accused : collection of str
        Agents of whose labels or clocks something has been said.
    """
    lines = []
    for agent, suspicions, said in found:
        if agent in accused:
            lines += [f"suspect: {agent}: {item}" for item in suspicions if item.kind not in SAID]
            continue
        lines += [f"suspect: {agent}: {item}" for item in suspicions]
        mark = next((mark for mark in ("suspect: ", UNSURE) if said.startswith(mark)), "  ")
        lines += [] if suspicions else [f"{mark}{agent}: {said.removeprefix(mark)}"]
    return lines


def _own_table(measurements: NetworkMeasurements, scene: Scene, name: str, late: bool) -> Columns | None:
    """An agent's rows with a label; None if most have none. Distances that clocks spoil are left out."""
    columns = measurements[name].columns
    known = columns["anchor"] >= 0
    if known.mean() < LABELLED:
        return None
    table = {
        key: columns[key][known] for key in ("step", "time_s", "anchor", *VALUES, *OPTIONAL) if key in columns
    }
    if late or offset_allowed_m(scene, name) > TOLD_APART_M:
        table["distance_m"] = np.full(int(known.sum()), np.nan)
    return table


def _judged(columns: Columns, scene: Scene, name: str) -> Device:
    found, table = padding(columns)
    plain, table = absurd(table)
    found += [*plain, *absurd_times(table)]
    if len(table["step"]):
        found += against_scene(table, scene, name, {item.column for item in plain})
    # by angles alone, directions in the world fit many a straight way nearly as well
    doubtful = () if len(finite(columns, "distance_m")) else ("world frame", "compass")
    own = [_of_several(item) for item in found if item.certain or item.kind not in doubtful]
    place = np.arange(len(scene.anchors))
    return Device(name, own, "" if own else verdict(table, place, scene, name))


def _of_several(item: Suspicion) -> Suspicion:
    """A suspicion in words for a table that says whose each row is."""
    if item.kind == "agent":
        return replace(item, text=item.text.partition(" (--agent")[0] + ": are names exchanged?")
    if item.kind == "second device":
        return replace(item, text="rows of two devices under this one name")
    return item
