"""A lab of one room with anchors at its walls, scenes as users draw it, and tables made by a few lines."""

from functools import cache

import numpy as np

import gridslam as gs
from gridslam.checks.verdicts.diagnose import suspicions
from gridslam.world.geometry import wrap

ANCHORS = {"north": (1.0, 4.5, 2.5, -60.0), "east": (6.5, 3.0, 1.0, 180.0), "south": (2.5, 0.4, 1.8, 90.0)}
WIDE_M, DEEP_M = 7.0, 5.0
WALLS = [
    {
        "material": "wall",
        "points_m": ((0.0, 0.0), (WIDE_M, 0.0), (WIDE_M, DEEP_M), (0.0, DEEP_M)),
        "closed": True,
    }
]
STEP_M, STEPS = 0.15, 110
LEGS = (
    (3.2, 0.0),
    (0.95, 90.0),
    (0.9, 0.0),
    (0.95, 90.0),
    (2.6, 0.0),
    (0.95, 90.0),
    (0.9, 0.0),
    (0.95, 90.0),
)
"""Lengths in m, and by how much each turns, of a way around."""


def lab(names=tuple(ANCHORS), walls=False, height_m=None, **agent):
    """The lab with some of its anchors, which have heights if the agent has one."""
    placed = [
        {"name": name, "position_m": (x, y) if height_m is None else (x, y, z), "orientation_deg": degrees}
        for name, (x, y, z, degrees) in ANCHORS.items()
        if name in names
    ]
    body = {"name": "me", "start_m": (1.6, 1.3), "start_heading_deg": 0.0, "step_m": STEP_M}
    body |= {"interval_s": 0.5, "prior": {"velocity_mps": 0.3}} | agent
    data = {
        "grid": {"x_m": (-1.0, 8.0), "y_m": (-1.0, 6.0)},
        "radio": {"snr_at_1m_db": 30.0, "false_alarms": 1.0},
        "filter": {"acceleration_mps2": 0.15, "heading_deg": 10.0},
        "materials": {"wall": 0.65},
        "anchors": placed,
        "walls": WALLS if walls else [],
        "agents": [body if height_m is None else {**body, "height_m": height_m}],
    }
    return gs.Scene.checked(data, "lab")


@cache
def heard(names=tuple(ANCHORS), height_m=None, seed=1):
    """Columns of a table that an agent of that height measures there: lines of sight, and one bounce each."""
    draw, rows = np.random.default_rng(seed), []
    for step, (x, y, facing) in enumerate(_way()):
        for number, name in enumerate(names):
            a, b, z, degrees = ANCHORS[name]
            rise = 0.0 if height_m is None else z - height_m
            images = ((a, b, 1, 1), (-a, b, -1, 1), (2 * WIDE_M - a, b, -1, 1))
            images += ((a, -b, 1, -1), (a, 2 * DEEP_M - b, 1, -1))
            for u, v, along, across in images:
                level = np.hypot(x - u, y - v)
                leaving = np.arctan2(across * (y - v), along * (x - u)) - np.radians(degrees)
                noise = draw.normal(0.0, (0.02, 0.03, 0.03))
                values = (np.hypot(level, rise), leaving, np.arctan2(v - y, u - x) - facing)
                values = np.array(values) + noise
                loud = (1.0 if along * across > 0 else 0.65) * 30 / level
                rows.append((step, 0.5 * step, number, *values, max(loud, 2.0)))
    names = ("step", "time_s", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    columns = dict(zip(names, np.array(rows).T, strict=True))
    whole = {name: columns[name].astype(int) for name in ("step", "anchor")}
    return columns | whole | {name: wrap(columns[name]) for name in ("aod_rad", "aoa_rad")}


def suspected(columns, scene):
    """What `check` suspects of columns."""
    return suspicions(columns, scene.anchor_names, scene, "me")


def _way():
    """Poses (STEPS, 3) in m, m, rad."""
    ends, at = np.cumsum([length for length, _ in LEGS]), STEP_M * np.arange(STEPS) % 11.4
    bend = np.array([np.radians(turn) / length for length, turn in LEGS])
    fine = np.linspace(0.0, ends[-1], 2000, endpoint=False)
    facing = np.cumsum(bend[np.searchsorted(ends, fine, side="right")]) * fine[1]
    track = np.cumsum(np.stack([np.cos(facing), np.sin(facing)], -1), 0) * fine[1]
    near = np.searchsorted(fine, at)
    return np.column_stack([track[near] + (1.6, 1.3), facing[near]])


def heard_facing(names=tuple(ANCHORS)):
    """Headings in the world, rad, of the rows of such a table."""
    return _way()[heard(names)["step"], 2]
