"""Tables in which anchors are ranged one after the other, each at a time of its own, as by UWB."""

from __future__ import annotations

import numpy as np

from gridslam.wording import counted
from gridslam.world.columns import Columns

LEAST, SHARED, TURNS = 20, 0.1, 0.5
"""Times from which on a table is judged; share of them at which two anchors are heard, at most, and how often
another anchor follows, at least: where one alone is in sight for a while, the same follows."""


def in_turn_words(columns: Columns) -> str:
    """What to add of a table without column `step`, of which each time is a step; empty, mostly.

    Parameters
    ----------
    columns : dict of (K,) arrays
        With `time_s`, `anchor` (-1: not known) and, of several, `agent`.
    """
    agent = columns.get("agent", np.zeros(len(columns["time_s"])))
    known = columns["anchor"] >= 0
    each = np.stack([agent[known], columns["time_s"][known], columns["anchor"][known]])
    pairs = np.unique(each, axis=1)  # in the order of agents, then of times
    scans, first, anchors = np.unique(pairs[:2], axis=1, return_index=True, return_counts=True)
    if len(anchors) < LEAST or (anchors > 1).mean() > SHARED:
        return ""
    after = (np.diff(pairs[2][first]) != 0)[np.diff(scans[0]) == 0]
    if not len(after) or after.mean() < TURNS:
        return ""
    alike = np.isin(first, first[anchors > 1])
    rows = np.unique(each[:2], axis=1, return_inverse=True)[1].ravel()
    share = int(alike[rows].sum())
    return (
        f"; {share} of {counted(len(rows), 'row')} share their time with another anchor's, so that nearly "
        "each step hears one anchor alone: if anchors are ranged in turn, give all rows of a round one "
        "time_s; if it is meant, a column step that numbers them says so"
    )
