"""Where anchors stand, in a map: joint with its surfaces, kept in files, carried along."""

import csv
from dataclasses import replace

import h5py
import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.estimate_tables import SurfaceEstimate
from gridslam.maps.map import Map
from gridslam.maps.map_anchors import MapAnchors
from gridslam.maps.map_cells import blocks_of
from gridslam.systems.far_regions import moved_map

LINES = np.array([[0.4, 3.0], [2.0, 5.0]])


def mapped(seed=0):
    """A map of two surfaces with two anchors that are correlated with them."""
    root = 0.1 * np.random.default_rng(seed).normal(size=(10, 14))
    joint = root @ root.T
    surfaces = SurfaceEstimate.from_lines(
        LINES, blocks_of(joint[6:, 6:]), np.full(2, 0.7), np.full(2, 0.01), np.ones(2),
        np.tile([1.0, 2.0], (2, 1)), np.arange(2),
    )  # fmt: skip
    place = np.array([[1.0, 2.0], [4.0, -1.0]])
    own = joint[:6, :6], joint[:6, 6:]
    anchors = MapAnchors(("A", "west, door"), place, np.array([0.5, -2.0]), *own)
    blank = Map.blank((0, 0), 0.5, (4, 6), 0.1)
    return replace(
        blank, surfaces=surfaces, surface_covariance=joint[6:, 6:], anchors=anchors,
        provenance={"agents": ["agent1"]},
    )  # fmt: skip


def test_a_file_holds_them_whole(tmp_path):
    mapped().save(tmp_path / "map.h5")
    kept, made = Map.load(tmp_path / "map.h5").anchors, mapped().anchors
    assert kept.names == made.names
    for name in ("position_m", "orientation_rad", "covariance", "cross"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(made, name))
    replace(mapped(), anchors=None).save(tmp_path / "map.h5")
    assert Map.load(tmp_path / "map.h5").anchors is None


def test_a_table_holds_them_with_deviations(tmp_path):
    mapped().to_csv(tmp_path)
    with open(tmp_path / "anchors.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["anchor"] for row in rows] == ["A", "west, door"]
    assert float(rows[1]["y_m"]) == -1
    assert float(rows[1]["orientation_std_rad"]) == pytest.approx(mapped().anchors.covariance[5, 5] ** 0.5)
    replace(mapped(), anchors=None).to_csv(tmp_path / "none")
    assert not (tmp_path / "none/anchors.csv").exists()


def test_where_surfaces_go_their_correlation_goes_along():
    """Moved there and back is nothing; and a sum of an anchor's x and a wall's offset varies as before."""
    there = moved_map(mapped(), np.array([50.0, -20.0]))
    np.testing.assert_allclose(there.anchors.position_m, np.add(mapped().anchors.position_m, [50, -20]))
    back = moved_map(there, np.array([-50.0, 20.0]))
    np.testing.assert_allclose(back.anchors.cross, mapped().anchors.cross, atol=1e-12)
    # the offset there is that here and the angle's part, lever of the shift along the wall
    angle, lever = LINES[0, 0], np.array([50.0, -20.0])
    along = lever @ [-np.sin(angle), np.cos(angle)]
    here = mapped().anchors.cross[0]
    np.testing.assert_allclose(there.anchors.cross[0, 1], here[1] + along * here[0], atol=1e-12)


@pytest.mark.parametrize(
    ("part", "value", "says"),
    [
        ("cross", np.zeros((6, 2)), "map: anchors: cross: found shape (6, 2); allowed: (6, 4)"),
        ("covariance", np.eye(3), "map: anchors: covariance: found shape (3, 3); allowed: (6, 6)"),
        ("orientation_rad", np.array([0, np.nan]), "map: anchors: orientation_rad: found NaN or infinity"),
        ("names", ("A", "A"), "map: anchors: names: found one name twice; allowed: every anchor once"),
        ("covariance", -np.eye(6), "map: covariance of anchors and surfaces: found not positive definite"),
        ("cross", np.ones((6, 4)), "map: covariance of anchors and surfaces: found not positive definite"),
    ],
)
def test_what_cannot_be_is_refused(part, value, says):
    with pytest.raises(InputError) as caught:
        replace(mapped(), anchors=replace(mapped().anchors, **{part: value}))
    assert str(caught.value).startswith(says)


def test_a_damaged_file_is_named(tmp_path):
    mapped().save(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "r+") as file:
        file["anchors/covariance"][0, 0] = -1.0
    with pytest.raises(InputError, match=r"map.h5: map: covariance of anchors and surfaces: found not pos"):
        Map.load(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "r+") as file:
        del file["anchors/cross"]
    with pytest.raises(InputError, match=r"map.h5: /anchors/cross: "):
        Map.load(tmp_path / "map.h5")
