"""DXF drawings as walls, by drawings that ezdxf itself writes."""

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.importers.dxf import read_walls
from gridslam.importers.floorplans import plan_of
from gridslam.importers.plan_files import write_plan
from gridslam.world.scene import Scene

ezdxf = pytest.importorskip("ezdxf")


def drawing(units=4):
    doc = ezdxf.new("R2010", units=units)
    doc.header["$INSUNITS"] = units
    for name in ("WALLS", "WINDOWS", "CHAIRS"):
        doc.layers.add(name)
    return doc, doc.modelspace()


def read(doc, path, **more):
    doc.saveas(path)
    return read_walls(path, **more)


def points(line):
    return np.array(line.points)


@pytest.mark.parametrize(("units", "scale"), [(1, 0.0254), (2, 0.3048), (4, 1e-3), (5, 1e-2), (6, 1.0)])
def test_lines_come_in_the_units_of_the_drawing(tmp_path, units, scale):
    doc, space = drawing(units)
    space.add_line((100, 200), (100 + 8 / scale, 200), dxfattribs={"layer": "WALLS"})
    (line,), note = read(doc, tmp_path / "a.dxf")
    np.testing.assert_allclose(points(line), np.array([[100, 200], [100, 200]]) * scale + [[0, 0], [8, 0]])
    assert line.material == "WALLS"
    assert f"{scale:g} m" in note


def test_unit_can_be_given_and_is_never_guessed(tmp_path):
    doc, space = drawing(0)
    space.add_line((0, 0), (1000, 0))
    (line,), note = read(doc, tmp_path / "a.dxf")
    assert "--unit" in note
    assert points(line)[1, 0] == 1000
    (line,), _ = read(doc, tmp_path / "a.dxf", unit="mm")
    assert points(line)[1, 0] == 1
    with pytest.raises(InputError, match="--unit"):
        read(doc, tmp_path / "a.dxf", unit="furlong")


def test_polylines_keep_their_corners_and_bulges_their_arcs(tmp_path):
    doc, space = drawing(6)
    space.add_lwpolyline([(0, 0), (8, 0), (8, 6), (0, 6)], close=True)
    space.add_polyline2d([(0, 0), (4, 0), (4, 3)])
    space.add_lwpolyline([(2, 0, 1.0), (-2, 0, 0)], format="xyb")  # a half circle of 2 m about the origin
    (room, bend, half), _ = read(doc, tmp_path / "a.dxf")
    plan = plan_of([room, bend, half], "a", name="a")
    assert plan.lines[0].closed
    assert len(plan.lines[0].points) == 4
    assert [list(p) for p in plan.lines[1].points] == [[0, 0], [4, 0], [4, 3]]
    corners = np.array(half.points)
    assert len(corners) > 8
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 2, atol=1e-3)
    middles = 0.5 * (corners[1:] + corners[:-1])
    assert np.linalg.norm(middles, axis=1).min() > 2 - 0.0101


def test_arcs_stay_arcs(tmp_path):
    doc, space = drawing(4)
    space.add_arc((3000, -5000), 9000, 350, 100)
    space.add_circle((0, 0), 500)
    space.add_arc((0, 0), 2000, 0, 90, dxfattribs={"extrusion": (0, 0, -1)})  # seen from below
    space.add_ellipse((0, 0), (4000, 0), 0.5)
    lines, _ = read(doc, tmp_path / "a.dxf")
    plan = plan_of(lines, "a", name="arcs", anchors=((0.1, 1.0, 0),), start=(0.2, 1.1, 0), origin_m=(1, 1))
    write_plan(plan, tmp_path / "a.toml")
    scene = Scene.load(tmp_path / "a.toml")
    arc, circle, mirrored, ellipse = scene.walls
    assert (arc.arc.centre_m, arc.arc.radius_m) == ((2, -6), 9)
    ends = arc.corners[[0, -1]] - arc.arc.centre_m
    np.testing.assert_allclose(np.degrees(np.arctan2(ends[:, 1], ends[:, 0])), [-10, 100], atol=1e-6)
    np.testing.assert_allclose(circle.corners[0], circle.corners[-1], atol=1e-9)
    assert mirrored.corners[:, 0].max() < -1 + 1e-6
    assert np.ptp(ellipse.corners, axis=0) == pytest.approx([8, 4], rel=1e-3)


def test_blocks_are_placed_and_layers_chosen(tmp_path):
    doc, space = drawing(6)
    block = doc.blocks.new("WINDOW")
    block.add_line((0, 0), (1, 0))
    block.add_line((0, 1), (1, 1), dxfattribs={"layer": "CHAIRS"})
    space.add_blockref("WINDOW", (5, 5), {"rotation": 90, "layer": "WINDOWS"})
    space.add_line((0, 0), (9, 0), dxfattribs={"layer": "WALLS"})
    space.add_text("room 1", dxfattribs={"layer": "WALLS"})
    lines, note = read(doc, tmp_path / "a.dxf", layers=["windows", "WALLS"])
    assert sorted(line.material for line in lines) == ["WALLS", "WINDOWS"]
    window = next(line for line in lines if line.material == "WINDOWS")
    np.testing.assert_allclose(points(window), [[5, 5], [5, 6]], atol=1e-9)
    assert "1 TEXT" in note
    with pytest.raises(InputError, match="WALLS"):
        read(doc, tmp_path / "a.dxf", layers=["DOORS"])
    doc.layers.get("CHAIRS").off()
    lines, _ = read(doc, tmp_path / "a.dxf")
    assert sorted(line.material for line in lines) == ["WALLS", "WINDOWS"]


@pytest.mark.slow
def test_blocks_in_blocks_without_end_are_refused(tmp_path):
    doc, space = drawing(6)
    doc.blocks.new("L0")
    for depth in range(1, 7):
        block = doc.blocks.new(f"L{depth}")
        for k in range(40):
            block.add_blockref(f"L{depth - 1}", (k, 0))
    space.add_blockref("L6", (0, 0))
    with pytest.raises(InputError, match="blocks"):
        read(doc, tmp_path / "a.dxf")
    doc, space = drawing(6)
    doc.blocks.new("X").add_line((0, 0), (1, 0))
    many = {"row_count": 30_000, "column_count": 30_000, "row_spacing": 1, "column_spacing": 1}
    space.add_blockref("X", (0, 0), many)
    with pytest.raises(InputError, match="blocks"):
        read(doc, tmp_path / "b.dxf")


def test_empty_strange_and_absurd_drawings_are_refused(tmp_path):
    doc, space = drawing(6)
    space.add_circle((0, 0), 1e300)
    space.add_line((0, 0), (1e300, 0))
    space.add_lwpolyline([(0, 0, 1.0), (1e200, 0, 0)], format="xyb")
    with pytest.raises(InputError, match="no walls"):
        read(doc, tmp_path / "a.dxf")
    (tmp_path / "b.dxf").write_text("nothing of the kind")
    for name in ("b.dxf", "none.dxf", "."):
        with pytest.raises(InputError):
            read_walls(tmp_path / name)
