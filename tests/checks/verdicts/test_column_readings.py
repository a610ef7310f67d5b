"""Readings of columns that explain far more than a table which nearly fits as it stands."""

import pytest

import gridslam as gs
from gridslam.checks.anchors.rivals import EXPLAINED
from gridslam.checks.sights.line_of_sight_filter import explain
from gridslam.checks.verdicts.column_readings import NEARLY, likeliest_way


def flat():
    """Three rooms with doors, an anchor in each of three corners; the agent goes by the first one."""
    inner = [[5, 0], [5, 3]], [[5, 4], [5, 8]], [[5, 4.5], [8, 4.5]], [[9, 4.5], [11, 4.5]]
    outer = {"material": "brick", "points_m": [[0, 0], [11, 0], [11, 8], [0, 8]], "closed": True}
    places = ([0.4, 7.6], -45), ([10.6, 0.4], 135), ([10.6, 7.6], -135)
    way = [[2, 6], [4.2, 6.3], [4, 3.5], [8.5, 3.2], [8.5, 6]]
    content = {
        "name": "flat",
        "grid": {"x_m": [-1, 12], "y_m": [-1, 9], "cell_m": 0.1},
        "radio": {"snr_at_1m_db": 38.0, "distance_std_m": 0.05},
        "filter": {"acceleration_mps2": 0.3},
        "materials": {"brick": 0.6, "plaster": 0.4},
        "anchors": [
            {"name": name, "position_m": place, "orientation_deg": turn}
            for name, (place, turn) in zip("ABC", places, strict=True)
        ],
        "walls": [outer, *({"material": "plaster", "points_m": points} for points in inner)],
        "agents": [
            {"name": "me", "start_m": [2, 1.5], "start_heading_deg": 90, "waypoints_m": way}
            | {"step_m": 0.1, "steps": 100}
        ],
    }
    return gs.Scene.checked(content, "flat")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_arrivals_of_the_other_sense_are_named_though_most_lines_of_sight_fit(seed):
    """The heading seems to turn as the agent goes by an anchor; one anchor of three shows that it doesn't."""
    scene = flat()
    right = dict(gs.simulate(scene, "me", seed).columns)
    wrong = right | {"aoa_rad": -right["aoa_rad"]}
    plain = explain(wrong, scene, "me")
    assert EXPLAINED < plain.explained < NEARLY
    way = likeliest_way(wrong, scene, "me", plain)
    assert [(one.column, one.kind, one.alike) for one in way.read] == [("aoa_rad", "flipped", {})]
    assert not likeliest_way(right, scene, "me", explain(right, scene, "me")).read
