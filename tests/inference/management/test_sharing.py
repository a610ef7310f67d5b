"""What one anchor learned, for others: scatterers and mirrors serve all, and nothing is handed over twice."""

from dataclasses import replace

import numpy as np
import pytest
from feature_samples import learned, surfaces
from signal_worlds import signal_model

from gridslam.estimate_tables import FREE, MIRROR, SCATTERER
from gridslam.inference.management.features.sharing import handed_over
from gridslam.maps.feature_rows import TIED_M
from gridslam.world.geometry import mirror

ANCHORS = np.array([[3.0, 4.0, 0.0], [-5.0, 1.0, 0.0]])
PLACE = np.array([1.0, -4.0])


def two_anchors():
    model = signal_model()
    return replace(
        model, anchor_names=("A", "B"), anchors=ANCHORS,
        waveform=replace(model.waveform, anchor_element_m=np.zeros((2, 1, 2))),
    )  # fmt: skip


def sheet(features=None, surfaces=None, feature_covariance=None):
    return features, feature_covariance, surfaces, None


def scatterer(place=PLACE, **more):
    far = np.hypot(*(place - ANCHORS[0, :2]))
    return learned([place], bias_m=np.array([far]), kind=np.array([SCATTERER]), **more)


def test_a_scatterer_of_one_anchor_is_one_of_the_other_with_another_extra_length():
    table, joint, _ = handed_over(*sheet(scatterer()), two_anchors())
    assert table.anchor.tolist() == [0, 1]
    np.testing.assert_allclose(table.position_m, [PLACE, PLACE])
    np.testing.assert_allclose(table.bias_m, np.hypot(*(PLACE - ANCHORS[:, :2]).T))
    np.testing.assert_allclose(table.anchor_m, ANCHORS[:, :2])
    np.testing.assert_allclose(joint[:2, 3:5], 1e-3 * np.eye(2), err_msg="one place")
    way = (PLACE - ANCHORS[1, :2]) / np.hypot(*(PLACE - ANCHORS[1, :2]))
    np.testing.assert_allclose(joint[3:5, 5], 1e-3 * way)
    assert joint[5, 5] == pytest.approx(1e-3 + TIED_M**2)
    assert np.linalg.eigvalsh(joint).min() > 0
    np.testing.assert_allclose(table.covariance[1, :3, :3], joint[3:, 3:])


def test_a_scatterer_is_as_large_for_every_anchor():
    """Its power at 1 m goes with the size s over both ways, g = (s (to + fro) / (to fro))^2."""
    table, *_ = handed_over(*sheet(scatterer()), two_anchors())
    to, fro = np.hypot(*(PLACE - ANCHORS[:, :2]).T), np.hypot(*PLACE)  # the agent starts at 0
    size = np.sqrt(table.variance) * to * fro / (to + fro)
    assert size[0] == pytest.approx(size[1])


@pytest.mark.parametrize("more", [{"kind": np.array([FREE])}, {"steps_seen": np.array([3])}])
def test_what_may_be_anything_or_was_hardly_heard_is_not_shared(more):
    table, *_ = handed_over(*sheet(replace(scatterer(), **more)), two_anchors())
    assert table.anchor.tolist() == [0]


def test_what_the_other_anchor_knows_already_is_not_handed_over_twice():
    one = scatterer()
    far = np.array([np.hypot(*(PLACE - ANCHORS[1, :2]))])
    other = replace(one, anchor=np.array([1]), anchor_m=ANCHORS[[1], :2], bias_m=far)
    both = type(one).stack([one, other])
    joint = 1e-3 * np.eye(6)
    table, found, _ = handed_over(*sheet(both, feature_covariance=joint), two_anchors())
    assert table.anchor.tolist() == [0, 1]
    np.testing.assert_array_equal(found, joint)


def test_a_scatterer_of_an_anchor_that_is_gone_is_heard_from_those_that_are_there():
    gone = replace(scatterer(), anchor_m=np.array([[40.0, 1.0]]))
    table, *_ = handed_over(*sheet(gone), two_anchors())
    assert table.anchor.tolist() == [0, 1]


def test_the_mirror_of_one_anchor_is_one_of_an_anchor_that_knows_nothing():
    line = np.array([0.2, 6.0])
    image = mirror(line, ANCHORS[0, :2])
    table, joint, _ = handed_over(*sheet(learned([image])), two_anchors())
    assert table.anchor.tolist() == [0, 1]
    np.testing.assert_allclose(table.position_m[1], mirror(line, ANCHORS[1, :2]), atol=1e-9)
    assert (table.kind == MIRROR).all()
    assert joint.shape == (6, 6)
    assert np.linalg.eigvalsh(joint).min() > 0


def test_surfaces_of_a_grid_and_features_beside_them_are_both_handed_over():
    """Images that a feature stands for are left out; the others come in units of the features' samples."""
    lines = np.array([[0.2, 6.0], [1.9, 5.0]])
    image = mirror(lines[0], ANCHORS[0, :2])
    known = type(scatterer()).stack([learned([image], noise=np.array([7.0])), scatterer()])
    grid = sheet(known, surfaces=surfaces(lines))
    table, joint, _ = handed_over(*grid, two_anchors())
    assert joint.shape == (3 * len(table),) * 2
    at_image = np.hypot(*(table.position_m - image).T) < 1e-6
    assert table.anchor[at_image].tolist() == [0]
    other = np.hypot(*(table.position_m - mirror(lines[1], ANCHORS[0, :2])).T) < 1e-6
    assert other.sum() == 1
    alone, *_ = handed_over(*sheet(surfaces=surfaces(lines)), two_anchors())
    same = np.hypot(*(alone.position_m - table.position_m[other][0]).T) < 1e-6
    assert table.variance[other][0] == pytest.approx(7 * alone.variance[same][0])


def test_a_map_of_nothing_hands_nothing_over():
    table, joint, _ = handed_over(*sheet(), two_anchors())
    assert (len(table), joint.shape) == (0, (0, 0))
