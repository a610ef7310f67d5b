"""The reference that is told the true map: what it is told is true, and it learns nothing."""

import numpy as np
import pytest

import gridslam as gs
from gridslam.maps.frames import fitted
from gridslam.systems.published.hybrid_known import KnownHybridSlam, true_features
from gridslam.world.geometry import mirror
from gridslam.world.scene import Scene

SCREEN = Scene.load("screen")


def test_it_is_told_the_images_of_all_walls_that_reflect():
    slam = KnownHybridSlam(SCREEN)
    table, joint = true_features(SCREEN, slam.model)
    images = {(15.5, 5.0), (0.5, -19.0), (15.5, -19.0)}
    assert {tuple(np.round(place, 9)) for place in table.position_m} == images
    assert (table.bias_m == 0).all()
    double = np.hypot(*(table.position_m - [15.5, -19.0]).T) < 1e-6
    np.testing.assert_allclose(table.variance[double], table.variance[~double][0] / 2, rtol=0.01)
    assert joint.shape == (9, 9)
    assert len(slam.state.joint.features) == 3
    east = mirror(np.array([0.0, 8.0]), np.array([0.5, 5.0]))
    assert tuple(east) in images


def test_scatterers_have_the_extra_length_of_their_way_to_the_anchor():
    scene = Scene.load("scatter")
    table, _ = true_features(scene, KnownHybridSlam(scene).model)
    assert len(table) == len(scene.scatterers) == 60
    far = np.hypot(*(table.position_m - scene.anchor_positions[0]).T)
    np.testing.assert_allclose(table.bias_m, far)
    assert (table.kind == 2).all()


def test_its_map_says_that_it_was_told_and_so_does_whatever_goes_on_from_it():
    sheet = KnownHybridSlam(SCREEN).map()
    known = "true walls and scatterers"
    assert sheet.truth_given == known
    assert str(sheet).endswith(f"told the {known}>")
    _, note = fitted(sheet, SCREEN, "first/map.h5")
    assert note == f"first/map.h5: whoever made it was told the {known}"
    assert gs.HybridSlam(SCREEN, prior_map=sheet).map().truth_given == known
    assert fitted(gs.HybridSlam(SCREEN).map(), SCREEN)[1] is None


@pytest.mark.slow
def test_it_knows_how_wrong_it_is_and_learns_nothing():
    scene = Scene.checked(shortened(SCREEN, 40), "screen")
    recording, squares, track = gs.simulate(scene, "agent1", 3, what="signal"), [], scene.track("agent1")
    slam = KnownHybridSlam(scene, seed=3, waveform=recording.waveform)
    for k, scan in enumerate(recording):
        estimate = slam.step(scan)
        off = estimate.position_m - track.position_m[k]
        squares.append(off @ np.linalg.solve(estimate.covariance[:2, :2], off) / 2)
    assert len(slam.state.joint.features) == 3
    assert slam.state.lesson is None
    assert np.hypot(*off) < 0.15
    assert np.mean(squares[15:]) < 3


def shortened(scene, steps):
    whole = scene.model_dump(exclude_none=True)
    whole["agents"][0]["steps"] = steps
    return whole
