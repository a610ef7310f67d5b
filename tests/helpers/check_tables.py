"""Simulated tables of bundled scenes as `check` takes them, short enough for tests, and what it suspects."""

from functools import cache

import numpy as np

import gridslam as gs
from gridslam.checks.sights.line_of_sight_filter import STEPS
from gridslam.checks.verdicts.diagnose import suspicions

SCENES = {name: gs.Scene.load(name) for name in ("room", "alcove", "canyon", "hall", "seminar")}
NAMES = ("step", "time_s", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")


BRIEF = 60
"""Steps of most tables with errors: fewer tell less, and take less time. Clean tables are whole."""


@cache
def simulated(name, seed, agent):
    """As far as `check` looks for lines of sight, and some steps more."""
    data = SCENES[name].model_dump(exclude_none=True)
    steps = min(STEPS + 20, len(SCENES[name].track(agent)))
    agents = [{**body, "steps": steps} if body["name"] == agent else body for body in data["agents"]]
    return gs.simulate(gs.Scene.checked({**data, "agents": agents}, name), agent, seed)


def simulated_columns(name, seed, agent="agent1", steps=None):
    table = simulated(name, seed, agent)
    rows = slice(None) if steps is None else table.step < steps
    return {key: np.array(getattr(table, key)[rows]) for key in NAMES}


def named(columns, name):
    return suspicions(columns, SCENES[name].anchor_names, SCENES[name], "agent1")


def suspected_of(table, scene, agent="agent1"):
    """What `check` suspects of measurements, as sentences."""
    columns = {name: np.asarray(values) for name, values in table.columns.items()}
    return [str(item) for item in suspicions(columns, table.anchors, scene, agent)]
