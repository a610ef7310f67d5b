"""Which anchor is which, where distances alone are measured: unsure, with names that fit as well."""

import numpy as np
import pytest

import gridslam as gs
from gridslam.checks.anchors.rivals import whole_cure
from gridslam.checks.anchors.whose import whose
from gridslam.checks.sights.line_of_sight_filter import explain

STANDS = np.array([[-4.0, 0.0], [4.0, 0.0]])


def scene_from(x):
    """Two anchors, and an agent that starts below the line between them."""
    data = {
        "grid": {"x_m": [-8.0, 8.0], "y_m": [-8.0, 8.0], "cell_m": 0.5},
        "radio": {"bandwidth_hz": 5e8, "snr_at_1m_db": 40.0},
        "anchors": [{"name": n, "position_m": xy} for n, xy in zip("AB", STANDS.tolist(), strict=True)],
        "agents": [{"name": "me", "start_m": [x, -3.0], "start_heading_deg": 0.0, "step_m": 0.1}],
        "filter": {"heading_deg": 5.0},
    }
    return gs.Scene.checked(data, "two")


def heard(x, angles=False, exchanged=False):
    """Lines of sight on a way to the right from there."""
    way = np.array([x, -3.0]) + np.arange(40)[:, None] * [0.05, 0.0]
    back = STANDS - way[:, None]
    draw = np.random.default_rng(3)
    anchor = np.tile([1, 0] if exchanged else [0, 1], 40)
    away = np.arctan2(-back[..., 1], -back[..., 0]).ravel()
    empty = np.full(80, np.nan)
    return {
        "step": np.repeat(np.arange(40), 2), "anchor": anchor,
        "distance_m": np.linalg.norm(back, axis=2).ravel() + 0.02 * draw.standard_normal(80),
        "aod_rad": away if angles else empty, "aoa_rad": away - np.pi if angles else empty,
        "amplitude": 100 / np.linalg.norm(back, axis=2).ravel(),
    }  # fmt: skip


def said(x, **changes):
    scene, table = scene_from(x), heard(x, **changes)
    return whose(table, scene, "me", explain(table, scene, "me"))


def test_names_that_fit_as_well_exchanged_are_told():
    """From the middle between two anchors, the way's mirror image is as likely."""
    text = "which anchor is which: with A and B exchanged lines of sight explain as much or more"
    assert said(0.0).endswith(text)


def test_distances_alone_are_never_certain_and_angles_are():
    assert said(2.5) == "; not sure: distances alone don't tell for certain which anchor is which"
    assert said(2.5, angles=True) == ""


@pytest.mark.slow
def test_exchanged_names_are_certain_only_by_angles():
    scene = scene_from(2.5)
    for angles in (False, True):
        table = heard(2.5, angles, exchanged=True)
        sight = explain(table, scene, "me")
        cure = whole_cure(table, scene, "me", sight, sight)
        assert cure.suspicion.kind == "names"
        assert cure.suspicion.certain == angles
        assert ("distances alone don't tell it for certain" in cure.suspicion.reason) != angles
