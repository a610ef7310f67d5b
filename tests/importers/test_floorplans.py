"""Floor plans in: every wall arrives where it was drawn, as a scene that can be edited; surfaces out."""

import json

import numpy as np
import pytest
from PIL import Image

from gridslam.cli.main import main
from gridslam.errors import InputError
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.importers import geojson
from gridslam.importers.floorplans import plan_of
from gridslam.importers.plan_files import write_plan
from gridslam.importers.plan_lines import Line
from gridslam.world.geometry import line_through
from gridslam.world.scene import Scene

ROOM = [[0, 0], [8, 0], [8, 6], [0, 6], [0, 0]]


def feature(kind, coordinates, **properties):
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def save(path, *features):
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


@pytest.fixture
def say(capsys, monkeypatch, tmp_path):
    """Runs the command line in a folder of its own: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        monkeypatch.setattr("sys.argv", ["gridslam", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            main()
        output = capsys.readouterr()
        return stop.value.code, output.out, output.err

    return run


def test_every_kind_of_geometry_gives_its_walls(tmp_path):
    path = save(
        tmp_path / "a.geojson",
        feature("Polygon", [ROOM, [[3, 2], [4, 2], [4, 3], [3, 2]]], material="brick", name="hall"),
        feature("MultiPolygon", [[ROOM]]),
        feature("LineString", [[1, 1], [1, 1], [2, 1, 7.5]], reflection=0.25),
        feature("MultiLineString", [[[1, 2], [2, 2]], [[1, 3], [2, 3]]], material="glass"),
        feature("Point", [1, 1]),
        {"type": "Feature", "geometry": None, "properties": None},
        {
            "type": "GeometryCollection",
            "geometries": [{"type": "LineString", "coordinates": [[0, 9], [5, 9]]}],
        },
    )
    plan = plan_of(geojson.read_walls(path), path.name, name="a")
    walls = [line.wall for line in plan.lines]
    assert [wall.get("closed", False) for wall in walls] == [True, True, True, False, False, False, False]
    assert walls[0]["points_m"] == [[0, 0], [8, 0], [8, 6], [0, 6]]
    assert (walls[0]["material"], walls[0]["name"]) == ("brick", "hall")
    assert walls[3] == {"material": "reflection 0.25", "points_m": [[1, 1], [2, 1]]}
    assert plan.materials["reflection 0.25"][0] == 0.25
    assert plan.materials["glass"][0] == 0.3
    assert "assumed" in plan.materials["brick"][1]
    assert plan.region == ([-1, 9], [-1, 10])


@pytest.mark.slow
def test_scene_file_reads_back_and_says_what_was_assumed(tmp_path):
    lines = geojson.read_walls(save(tmp_path / "a.json", feature("Polygon", [ROOM], material="brick")))
    plan = plan_of(
        lines,
        "a.json",
        {"brick": "wall [1] = 'x'"},
        {"wall [1] = 'x'": 0.45},
        name="my plan",
        anchors=((1, 1, 90), (7, 5, -45)),
        start=(4, 3, 10),
    )
    picture = write_plan(plan, tmp_path / "a.toml")
    scene = Scene.load(tmp_path / "a.toml")
    assert scene.materials == {"wall [1] = 'x'": 0.45}
    assert scene.anchor_names == ("A", "B")
    assert [anchor.orientation_deg for anchor in scene.anchors] == [90, -45]
    assert (scene.agents[0].start_m, scene.agents[0].start_heading_deg) == ((4, 3), 10)
    np.testing.assert_array_equal(scene.walls[0].corners, ROOM)
    assert "as asked for" in (tmp_path / "a.toml").read_text()
    with Image.open(picture) as image:
        assert len(np.unique(np.asarray(image).reshape(-1, 4), axis=0)) > 10


def test_without_anchors_the_file_tells_where_they_go(tmp_path):
    lines = geojson.read_walls(save(tmp_path / "a.json", feature("Polygon", [ROOM])))
    text = plan_of(lines, "a.json", name="a").toml()
    with pytest.raises(InputError, match="anchors"):
        Scene.from_toml(text)
    uncommented = text.replace("# [[anchors]]", "[[anchors]]").replace('# name = "A"', 'name = "A"')
    uncommented = uncommented.replace("# position_m", "position_m").replace("# orient", "orient")
    assert Scene.from_toml(uncommented).anchors[0].position_m == (4, 3)


def test_walls_of_one_material_keep_their_own_coefficients():
    lines = [Line(((0, k), (5, k)), "wall", reflection=r) for k, r in enumerate((0.2, 0.6, None))]
    plan = plan_of(lines, "x", name="x")
    assert {name: value for name, (value, _) in plan.materials.items()} == {
        "wall 0.2": 0.2,
        "wall 0.6": 0.6,
        "wall": 0.7,
    }


def test_degrees_are_flattened_true_to_length(tmp_path):
    # 0.0001 degrees of longitude at 60 degrees north are 5.58 m, of latitude 11.14 m (WGS 84)
    path = save(tmp_path / "a.json", feature("LineString", [[10, 60], [10.0001, 60], [10.0001, 60.0001]]))
    with pytest.raises(InputError, match="--geographic"):
        geojson.read_walls(path)
    (line,) = geojson.read_walls(path, geographic=True)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(line.points, axis=0), axis=1), [5.580, 11.141], atol=2e-3
    )


@pytest.mark.parametrize(
    ("item", "where"),
    [
        ([], ""),
        ({"type": "Feature", "geometry": 3}, "geometry"),
        ({"type": "FeatureCollection", "features": {}}, "features"),
        (feature("LineString", [[0, "1"], [2, 3]]), "coordinates"),
        (feature("LineString", [[0, 1e400], [2, 3]]), "coordinates"),
        (feature("LineString", [[0, 10**400], [2, 3]]), "coordinates"),
        (feature("LineString", [[True, 1], [2, 3]]), "coordinates"),
        (feature("LineString", [[0, 0], [2, 3]], reflection=1.5), "reflection"),
        (feature("LineString", [[0, 0], [2, 3]], material=7), "material"),
        (feature("Circle", [[0, 0], [2, 3]]), "type"),
        (feature("Point", [0, 0]), ""),
    ],
)
def test_faults_are_told_with_their_place(tmp_path, item, where):
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps(item))
    with pytest.raises(InputError) as caught:
        geojson.read_walls(path)
    assert caught.value.where.startswith(str(path))
    assert where in caught.value.where


def test_plans_far_away_or_without_end_are_refused(tmp_path):
    far = [Line(((500_000, 5_400_000), (500_008, 5_400_000)))]
    with pytest.raises(InputError, match="--origin 500000,5400000"):
        plan_of(far, "x", name="x")
    assert plan_of(far, "x", origin_m=(500_000, 5_400_000), name="x").region == ([-1, 9], [-1, 1])
    with pytest.raises(InputError, match="at most"):
        plan_of([Line(tuple((float(k), 0.0) for k in range(30_000)))], "x", name="x")
    with pytest.raises(InputError, match="no walls"):
        plan_of([Line(((1, 1), (1, 1)))], "x", name="x")
    millimetres = Line(((0.0, 0.0), (9000.0, 0.0), (9000.0, 7000.0)))
    with pytest.raises(InputError, match=r"9000 m x 7000 m, whose cells of 0\.1 m need .* GB; .*--unit mm"):
        plan_of([millimetres], "x", name="x")
    read_as_mm = Line(((0.0, 0.0), (0.009, 0.0), (0.009, 0.007)))
    with pytest.raises(InputError, match=r"a plan of 9 mm x 7 mm; allowed: 0\.3 m or more: --unit m"):
        plan_of([read_as_mm], "x", name="x")


def test_a_plan_in_another_unit_is_read_by_it_or_told_to_be(say, tmp_path):
    corners = [[[1000 * x, 1000 * y] for x, y in ROOM]]
    save(tmp_path / "plan.geojson", feature("Polygon", corners))
    words = ("scene", "import", "plan.geojson", "-o", "flat.toml", "--anchor", "1,5,-45")
    code, _, wrong = say(*words)
    assert (code, wrong.count("\n")) == (2, 1)
    assert "--unit mm" in wrong
    code, reported, wrong = say(*words, "--unit", "mm")  # as the error says
    assert (code, wrong) == (0, "")
    assert "units: mm, as asked for" in reported
    np.testing.assert_array_equal(Scene.load(tmp_path / "flat.toml").walls[0].corners, ROOM)
    for more, says in (
        (("--unit", "yd"), "--unit: found 'yd'; allowed: m, dm, cm, mm, in, ft"),
        (("--unit", "mm", "--geographic"), "--unit: found 'mm' with --geographic"),
        (("--layer", "walls"), "--layer: found 'walls' with plan.geojson"),
    ):
        code, _, wrong = say(*words, "--overwrite", *more)
        assert (code, wrong.count("\n")) == (2, 1)
        assert says in wrong
    small = save(tmp_path / "small.geojson", feature("Polygon", [ROOM]))
    with pytest.raises(InputError, match=r"a plan 0.008 m wide; allowed: metres, another --unit"):
        geojson.read_walls(small, unit="mm")
    wide = [Line(((0.0, 0.0), (12_000.0, 0.0), (12_000.0, 9000.0)))]  # farther than any place may be, too
    with pytest.raises(InputError, match="--unit mm"):
        plan_of(wide, "x", name="x")


def test_the_way_that_is_proposed_leads_ahead_from_the_start():
    text = plan_of([Line(((-1.0, -1.0), (9.0, -1.0)))], "x", name="x", start=(1.0, 2.0, 90.0)).toml()
    assert "# waypoints_m = [[1.0, 3.0]]" in text


def test_anchor_far_outside_the_walls_is_said(say, tmp_path):
    path = save(tmp_path / "plan.geojson", feature("Polygon", [ROOM]))
    placed = {"anchors": ((90.0, 5.2, 0.0), (-0.5, 1.0, 0.0)), "start": (4.0, 8.0, 0.0)}
    assert plan_of(geojson.read_walls(path), "x", name="x", **placed).outside == [
        "anchor A at 90, 5.2 m stands 82.0 m outside the walls (x 0 to 8, y 0 to 6 m)",
        "the start at 4, 8 m stands 2.0 m outside the walls (x 0 to 8, y 0 to 6 m)",
    ]
    reported = say("scene", "import", "plan.geojson", "-o", "far.toml", "--anchor", "90,5.2")[1]
    assert "note: anchor A at 90, 5.2 m stands 82.0 m outside the walls" in reported


def test_a_side_that_two_rooms_share_is_said(say, tmp_path):
    rooms = [[[x, 0], [x + 8, 0], [x + 8, 6], [x, 6], [x, 0]] for x in (0, 8)]
    save(tmp_path / "plan.geojson", *(feature("Polygon", [room]) for room in rooms))
    said = say("scene", "import", "plan.geojson", "-o", "rooms.toml")[1]
    assert "note: walls[1] repeats 6 m of walls[0]: what is there twice reflects once" in " ".join(
        said.split()
    )


def test_an_anchor_in_centimetres_is_named_before_any_memory(say, tmp_path):
    save(tmp_path / "plan.geojson", feature("Polygon", [ROOM]))
    code, *_, said = say("scene", "import", "plan.geojson", "-o", "far.toml", "--anchor", "500,520,0")
    assert code == 2
    assert "error: --anchor, --start: found anchor A at 500, 520 m stands 711.5 m outside the walls" in said
    assert not (tmp_path / "far.toml").exists()


def test_an_angle_that_nobody_told_is_said_to_be_0(say, tmp_path):
    save(tmp_path / "plan.geojson", feature("Polygon", [ROOM]))
    words = ("scene", "import", "plan.geojson", "-o", "flat.toml", "--overwrite", "--anchor", "1,5,90")
    assert "note" not in say(*words, "--start", "4,3,0")[1]
    said = say(*words, "--anchor", "7,1", "--start", "4,3")[1]
    assert [line for line in said.splitlines() if line.startswith("note: ")] == [
        "note: --anchor 7,1: no angle told, so 0 degrees: it faces along x",
        "note: --start 4,3: no angle told, so 0 degrees: it faces along x",
    ]


@pytest.mark.slow
def test_import_command(say, tmp_path):
    save(tmp_path / "plan.geojson", feature("Polygon", [ROOM], material="wall"))
    words = ("scene", "import", "plan.geojson", "-o", "hall.toml", "--anchor=-0.5,1,0", "--anchor", "7,5,180")
    code, reported, wrong = say(*words, "--start", "4,3,90", "--material", "wall=concrete", "--cell", "0.2")
    assert (code, wrong) == (0, "")
    assert "concrete: 1 wall, 0.7 (assumed for this material)" in reported
    assert "note" not in reported
    scene = Scene.load(tmp_path / "hall.toml")
    assert (scene.name, len(scene.anchors), scene.grid.cell_m) == ("hall", 2, 0.2)
    _, told, _ = say("scene", "import", "plan.geojson", "-o", "shout.toml", "--reflection", "WALL=0.4")
    assert "wall: 1 wall, 0.4 (as asked for)" in told
    before = sorted(tmp_path.iterdir())
    for more, option in (
        (("--anchor", "1"), "--anchor"),
        (("--start", "a,b"), "--start"),
        (("--reflection", "concrete=2"), "--reflection"),
        (("--reflection", "wal=0.4"), "--reflection: found 'wal'; allowed: what plan.geojson has: wall"),
        (("--material", "x"), "--material"),
        (("--material", "door=wood"), "--material"),
        (("--anchor", "0,3"), "anchors[0]"),  # in the wall
    ):
        code, _, wrong = say("scene", "import", "plan.geojson", "-o", "other.toml", *more)
        assert code == 2
        assert option in wrong
        assert wrong.count("\n") == 1
    assert say(*words)[0] == 2  # it exists
    assert say("scene", "import", "plan.svg", "-o", "other.toml")[0] == 2
    assert sorted(tmp_path.iterdir()) == before


def test_anchors_and_the_start_may_have_heights(say, tmp_path):
    save(tmp_path / "plan.geojson", feature("Polygon", [ROOM]))
    words = ("scene", "import", "plan.geojson", "-o", "tall.toml", "--anchor", "1,5,2.5,-45")
    assert say(*words, "--anchor", "7,1,2.2,135", "--start", "4,3,0.4,90")[0] == 0
    scene = Scene.load(tmp_path / "tall.toml")
    assert [anchor.position_m for anchor in scene.anchors] == [(1, 5, 2.5), (7, 1, 2.2)]
    assert [anchor.orientation_deg for anchor in scene.anchors] == [-45, 135]
    (agent,) = scene.agents
    assert (agent.start_m, agent.start_heading_deg, agent.height_m) == ((4, 3), 90, 0.4)
    for more, says in (
        (("--anchor", "7,1,135"), "--anchor: found '7,1,135', without a height; allowed: x,y,z,deg for all"),
        (("--start", "4,3"), "--start: found '4,3', without a height; allowed: x,y,z,deg for all"),
        (
            ("--anchor", "7,1,2,1,5"),
            "'7,1,2,1,5'; allowed: x,y or x,y,deg, or with heights x,y,z,deg",
        ),
    ):
        code, _, wrong = say(*words[:4], "other.toml", *words[5:], *more)
        assert (code, wrong.count("\n")) == (2, 1)
        assert says in wrong
    flat = (*words[:4], "other.toml", "--anchor", "1,5,-45", "--start", "4,3,0.4,90")
    assert "--start: found '4,3,0.4,90', with a height" in say(*flat)[2]
    assert not (tmp_path / "other.toml").exists()


def test_surfaces_go_out_and_come_back_as_walls(tmp_path):
    ends = np.array([[[-2.0, 3.0], [1.5, 3.0]], [[2.6, -3.0], [2.9, 1.0]]])
    line = line_through(ends[:, 0], ends[:, 1])
    along = np.stack([-np.sin(line[:, 0]), np.cos(line[:, 0])], -1)
    extent = np.sort((ends * along[:, None]).sum(-1), axis=1)
    line, extent = np.concatenate([line, [[0.3, 4.0]]]), np.concatenate([extent, [[np.nan, np.nan]]])
    found = SurfaceEstimate.from_lines(
        line,
        np.tile(1e-4 * np.eye(2), (3, 1, 1)),
        np.array([0.7, 0.3, 0.5]),
        np.full(3, 0.01),
        np.array([1, 0.9, 0.6]),
        extent,
    )
    path = tmp_path / "surfaces.geojson"
    geojson.write_surfaces(path, found)
    content = json.loads(path.read_text())
    assert [item["geometry"] is None for item in content["features"]] == [False, False, True]
    properties = content["features"][1]["properties"]
    assert (properties["id"], properties["existence"], properties["reflection"]) == (1, 0.9, 0.3)
    assert properties["length_m"] == pytest.approx(np.hypot(0.3, 4.0))
    assert properties["offset_std_m"] == pytest.approx(0.01)
    walls = geojson.read_walls(path)
    assert [wall.reflection for wall in walls] == [0.7, 0.3]
    for wall, true in zip(walls, ends, strict=True):
        np.testing.assert_allclose(np.sort(wall.points, axis=0), np.sort(true, axis=0), atol=1e-9)


def test_layers_in_capitals_are_of_the_materials_that_are_known():
    plan = plan_of(
        [Line(((0, 0), (5, 0)), "GLASS"), Line(((0, 1), (5, 1)), "Brick")],
        "plan.dxf",
        name="plan",
        reflection={"brick": 0.4},
    )
    assert plan.materials["GLASS"][1] == "assumed for this material"
    assert plan.materials["Brick"] == (0.4, "as asked for")


@pytest.mark.parametrize("name", ["map.yaml", "scan.png", "plan.svg"])
def test_pictures_of_cells_are_refused_with_what_to_do(say, tmp_path, name):
    (tmp_path / name).write_bytes(b"image: map.pgm\n")
    code, _, err = say("scene", "import", str(tmp_path / name), "-o", str(tmp_path / "flat.toml"))
    assert code == 2
    assert "FILE.geojson, FILE.json or FILE.dxf" in err
    assert ("traced over it in Inkscape (to DXF) or QGIS (to GeoJSON)" in err) is (name != "plan.svg")
    assert not (tmp_path / "flat.toml").exists()
