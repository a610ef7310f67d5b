"""`check` where the scene has no walls, as a user's first scene has none: cures by evidence, no silence."""

from functools import cache

import numpy as np
import pytest
from check_tables import NAMES

import gridslam as gs
from gridslam.checks.sights.line_of_sight_filter import STEPS
from gridslam.checks.verdicts.diagnose import describe, suspicions
from gridslam.measurements.table import Measurements
from gridslam.world.geometry import wrap

QUARTER = 0.5 * np.pi


@cache
def flat():
    """Three rooms in a row with doors, an anchor in each; the scene as drawn, without walls, and a table."""
    corners = ((0.0, 0.0), (12.0, 0.0), (12.0, 5.0), (0.0, 5.0))
    walls = [{"name": "outer", "material": "brick", "points_m": corners, "closed": True}]
    for x in (4.0, 8.0):
        walls.append({"name": f"low {x}", "material": "brick", "points_m": ((x, 0.0), (x, 1.8))})
        walls.append({"name": f"high {x}", "material": "brick", "points_m": ((x, 3.0), (x, 5.0))})
    anchors = [
        {"name": "A", "position_m": (0.4, 4.6), "orientation_deg": -50.0},
        {"name": "B", "position_m": (6.2, 0.3), "orientation_deg": 80.0},
        {"name": "C", "position_m": (11.5, 4.4), "orientation_deg": -140.0},
    ]
    agents = [
        {"name": "me", "start_m": (2.6, 1.2), "start_heading_deg": 50.2},
        {"name": "she", "start_m": (10.5, 1.0), "start_heading_deg": 143.0},
    ]
    ways = (((3.6, 2.4), (9.5, 2.4)), ((8.6, 2.4), (5.0, 3.6)))
    bodies = [{**body, "waypoints_m": way} for body, way in zip(agents, ways, strict=True)]
    data = {
        "grid": {"x_m": (-1.0, 13.0), "y_m": (-1.0, 6.0)},
        "materials": {"brick": 0.6},
        "anchors": anchors,
    }
    drawn = gs.Scene.checked({**data, "walls": walls, "agents": bodies}, "flat")
    return drawn, gs.Scene.checked({**data, "agents": agents}, "bare")


@cache
def heard(agent="me", steps=STEPS):
    table = gs.simulate(flat()[0], agent, 3)
    return {key: np.array(getattr(table, key)[table.step < steps]) for key in NAMES}


def of(c, name):
    return c["anchor"] == "ABC".index(name)


SPOILT = {
    "round trip": lambda c, o: {"distance_m": 2 * c["distance_m"]},
    "offset": lambda c, o: {"distance_m": c["distance_m"] + 1.5},
    "turned": lambda c, o: {"aod_rad": wrap(c["aod_rad"] + QUARTER * of(c, "B"))},
    "backwards": lambda c, o: {"aoa_rad": wrap(c["aoa_rad"] + np.pi)},
    "swapped": lambda c, o: {"aoa_rad": c["aod_rad"], "aod_rad": c["aoa_rad"]},
    "names": lambda c, o: {"anchor": (c["anchor"] + 1) % 3},
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", SPOILT)  # the others behave alike, and take as long
def test_errors_are_named_though_nobody_knows_which_anchors_walls_hide(kind):
    scene = flat()[1]
    columns = heard() | SPOILT[kind](heard(), scene.anchor_orientations[heard()["anchor"]])
    (found,) = suspicions(columns, ("A", "B", "C"), scene, "me")
    assert found.kind == kind


@pytest.mark.slow
def test_a_right_table_passes_and_anchors_out_of_sight_are_not_passed_over(tmp_path):
    drawn, bare = flat()
    Measurements(**heard(steps=250), anchors=("A", "B", "C")).to_csv(tmp_path / "right.csv")
    for scene in (drawn, bare):
        assert suspicions(heard(), ("A", "B", "C"), scene, "me") == []
    said = describe(tmp_path / "right.csv", bare)[-1]
    assert said.startswith("line of sight to the anchors in")
    draw, own = np.random.default_rng(1), of(heard(), "C")
    wild = {
        name: np.where(own, draw.uniform(*ends, len(own)), heard()[name])
        for name, ends in {"distance_m": (1.0, 15.0), "aod_rad": (-3.0, 3.0)}.items()
    }
    Measurements(**heard() | wild, anchors=("A", "B", "C")).to_csv(tmp_path / "wild.csv")
    said = describe(tmp_path / "wild.csv", bare)[-1]
    assert said.startswith("unsure: line of sight")
    assert ": C is never in line of sight" in said


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
class TestAWrongStartIsNamedAndTheDataAreNot:
    def test_anothers_table(self, which):
        (found,) = suspicions(heard("she"), ("A", "B", "C"), flat()[which], "me")
        assert (found.column, found.kind) == ("agent", "agent")
        assert "--agent she" in found.text

    def test_a_table_that_begins_late(self, which):
        late = {name: values[heard()["step"] >= 45] for name, values in heard().items()}
        scene = flat()[which].model_copy(update={"agents": flat()[which].agents[:1]})
        *others, found = suspicions(late, ("A", "B", "C"), scene, "me")
        assert (found.column, found.kind) == ("start", "start")
        # it goes along x from there on: arrivals in the world's frame are the same
        assert {item.kind for item in others} <= {"world frame"}
        true = flat()[0].track("me")
        x, y = (float(part.strip("( )")) for part in found.text.split("about ")[1].split(" m")[0].split(","))
        assert np.hypot(x - true.position_m[45, 0], y - true.position_m[45, 1]) < 0.5

    def test_a_heading(self, which):
        scene, degrees = flat()[which], (180, 90)[which]
        body = scene.agents[0]
        turned = body.start_heading_deg + degrees - 360
        body = body.model_copy(update={"start_heading_deg": turned, "waypoints_m": None})
        scene = scene.model_copy(update={"agents": (body,)})
        (found,) = suspicions(heard(), ("A", "B", "C"), scene, "me")
        assert (found.column, found.kind) == ("start", "start")
        assert "start_heading_deg" in found.text


@pytest.mark.slow
def test_who_goes_faster_than_the_scene_says_did_not_begin_elsewhere():
    """Of few particles about the right start none goes along, of thousands anywhere some do."""
    drawn, bare = flat()
    fast = drawn.agents[0].model_copy(update={"step_m": 0.15, "acceleration_mps2": 0.1})
    table = gs.simulate(drawn.model_copy(update={"agents": (fast,)}), "me", 5)
    columns = {key: np.array(getattr(table, key)) for key in NAMES}
    columns |= {name: np.full(len(table.step), np.nan) for name in ("aod_rad", "amplitude")}
    for scene in (drawn, bare):
        assert suspicions(columns, ("A", "B", "C"), scene, "me") == []
