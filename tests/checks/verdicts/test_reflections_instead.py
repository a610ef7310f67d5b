"""Right tables from between walls that stand close together aren't accused."""

import numpy as np
import pytest
from made_sights import made_sight

import gridslam as gs
from gridslam.checks.tables.unit_hypotheses import Suspicion
from gridslam.checks.verdicts.diagnose import suspicions
from gridslam.checks.verdicts.reflections_instead import (
    are_faint_and_hidden,
    takes_reflections,
    through_walls,
)
from gridslam.world.scene import Scene

CORRIDOR = """
name = "corridor"
[radio]
carrier_hz = 6e9
bandwidth_hz = 500e6
[grid]
x_m = [-1.0, 15.0]
y_m = [-1.5, 3.0]
[[anchors]]
name = "A"
position_m = [0.5, 0.4]
[[anchors]]
name = "B"
position_m = [13.5, 1.1]
orientation_deg = 180.0
[materials]
concrete = 0.7
[[walls]]
material = "concrete"
points_m = [[0.0, 0.0], [14.0, 0.0], [14.0, 1.5], [0.0, 1.5]]
closed = true
[[agents]]
name = "agent1"
start_m = [2.0, 0.75]
start_heading_deg = 0.0
waypoints_m = [[12.0, 0.75]]
step_m = 0.05
"""


def test_a_cure_whose_rows_come_behind_those_that_fit_takes_reflections():
    step = np.repeat(np.arange(8), 2)
    table = {"step": step, "anchor": 0 * step, "distance_m": np.tile([3.0, 4.0], 8)}
    first, second = np.arange(0, 16, 2), np.arange(1, 16, 2)
    assert takes_reflections(table, made_sight(first), made_sight(second))
    assert not takes_reflections(table, made_sight(first, explained=0.5), made_sight(second)), (
        "lost as it stands"
    )
    assert not takes_reflections(table, made_sight(second), made_sight(first)), "the cure's come first"
    assert not takes_reflections(table, made_sight(first), made_sight(first))
    assert not takes_reflections(table, made_sight(first), made_sight([*first[:7], 15])), "hardly any other"


def test_lines_of_sight_through_walls_are_none(tmp_path):
    (tmp_path / "corridor.toml").write_text(CORRIDOR)
    scene, step = Scene.load(tmp_path / "corridor.toml"), np.arange(4)
    table = {"step": step, "anchor": 0 * step}
    outside = made_sight(step, position_m=np.array([[3.0, 2.0]] * 4))
    assert through_walls(table, outside, scene)
    outside.position_m[0] = [3.0, 1.0]
    assert not through_walls(table, outside, scene)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_a_right_table_from_a_narrow_corridor_is_left_in_peace(tmp_path, seed):
    """Reflections off either wall come nearly from where lines of sight do."""
    (tmp_path / "corridor.toml").write_text(CORRIDOR)
    scene = Scene.load(tmp_path / "corridor.toml")
    heard = gs.simulate(scene, "agent1", seed)
    assert suspicions(dict(heard.columns), heard.anchors, scene, "agent1") == []


def test_units_by_which_reflections_of_a_hidden_anchor_fit_are_no_suspicion():
    """Three of 42 right tables of drawn plans were called feet, nanoseconds and the way there and back."""
    hall = gs.Scene.load("hall")  # at the start B is hidden
    model, far = hall.signal_model(), np.linspace(8.0, 12.0, 12)
    cure = made_sight(range(12), distance_m=far, shares=np.array([np.nan, 1.0]))
    found = [Suspicion("distance_m", "feet", "feet", True, "")]

    def told(db, anchor=1, found=found):
        table = {"anchor": np.full(12, anchor), "amplitude": model.amplitude(far) * 10 ** (db / 20)}
        return are_faint_and_hidden(found, table, cure, hall, "agent1", None)

    assert told(-10.0)
    assert not told(-3.0), "as loud as lines of sight"
    assert not told(-10.0, anchor=0), "in sight from the told start"
    assert not told(-10.0, found=[Suspicion("anchor", "names", "names", True, "")])
