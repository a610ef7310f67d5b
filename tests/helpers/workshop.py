"""Two robots in a workshop of seven walls, all heard: reflections in plenty."""

import gridslam as gs

OUTLINE = [[0.0, 0.0], [11.0, 0.0], [11.0, 5.0], [7.0, 5.0], [7.0, 8.0], [0.0, 8.0], [0.0, 0.0]]
ANCHORS = (("A", [0.4, 7.5], -45.0), ("B", [10.5, 0.4], 135.0), ("C", [0.5, 0.5], 45.0))
ROBOTS = (
    ("r1", [1.5, 2.0], 90.0, [[1.5, 6.0], [5.5, 6.3], [5.6, 2.0], [9.5, 2.0]]),
    ("r2", [9.5, 3.5], 175.0, [[5.6, 3.8], [5.5, 6.5], [1.6, 6.3], [1.5, 2.5]]),
)


def workshop(walls: bool = True) -> gs.Scene:
    """The scene, with its walls or without."""
    plan = {"material": "brick", "name": "outer", "points_m": OUTLINE}
    inner = {"material": "brick", "name": "inner", "points_m": [[3.5, 0.0], [3.5, 2.6]]}
    content = {
        "name": "shop",
        "grid": {"x_m": [-1.0, 12.0], "y_m": [-1.0, 9.0], "cell_m": 0.1},
        "radio": {"bandwidth_hz": 5e8, "snr_at_1m_db": 42.0, "max_distance_m": 30.0},
        "filter": {"acceleration_mps2": 0.15},
        "materials": {"brick": 0.65},
        "anchors": [{"name": n, "position_m": p, "orientation_deg": o} for n, p, o in ANCHORS],
        "walls": [plan, inner] if walls else [],
        "agents": [
            {"name": n, "start_m": s, "start_heading_deg": h, "waypoints_m": w, "step_m": 0.07}
            | {"interval_s": 0.5, "steps": 80}
            for n, s, h, w in ROBOTS
        ],
    }
    return gs.Scene.checked(content, "shop")
