"""Deviations of a scan's measurements."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of

import gridslam as gs
from gridslam.inference.scans.anchor_measurements import AnchorScan, split_by_anchor, whole_of, whole_scan
from gridslam.inference.scans.deviations import deviations, own_deviations


@pytest.mark.parametrize("height", [0.0, 2.5])
def test_those_of_all_anchors_are_those_of_each(height):
    draw, whose = np.random.default_rng(2), np.array([2, 0, 0, 2, 2])  # the second one is silent
    model = model_of("canyon", [[0.0, 0.0, 0.3, height], [3.0, 1.0, 0.0, 0.0], [2.0, -2.0, 1.0, 0.0]])
    own = np.where(draw.random(5) < 0.5, 0.1, np.nan)
    angles = draw.uniform(-3, 3, (2, 5))
    angles[0, 1] = np.nan
    scan = gs.Scan(0, 0.0, whose, draw.uniform(1, 9, 5), *angles, draw.uniform(3, 30, 5), distance_std_m=own)
    scans = split_by_anchor(scan, model)
    ends = np.cumsum([len(one) for one in scans])[:-1]
    for one, std in zip(scans, np.split(own_deviations(scans, model.radio), ends), strict=True):
        rows = np.arange(len(one))
        each = deviations(one, rows, one.amplitude, one.value[:, 1:], model.radio)
        np.testing.assert_array_equal(std, each)


def test_angles_that_one_antenna_cannot_tell_are_not_measured_unless_they_come_with_deviations():
    model = model_of("canyon", [[0.0, 0.0, 0.3], [3.0, 1.0, 0.0], [2.0, -2.0, 1.0]])
    aperture = model.radio.anchor_aperture * [[1.0], [0.0], [1.0]]  # the second anchor has one antenna
    radio = replace(model.radio, anchor_aperture=aperture, agent_aperture=np.zeros(2))
    blind, whose, one = replace(model, radio=radio), np.array([0, 1, 0]), np.ones(3)
    scan = gs.Scan(0, 0.0, whose, one, 0.1 * one, 0.2 * one, 9 * one)
    assert split_by_anchor(scan, model).arrives
    scans = split_by_anchor(scan, blind)
    assert not scans.arrives
    assert (scans.whole.table[:, 4] >= 0).tolist() == [True, True, False]
    assert np.isnan(scans.whole.value[:, 2]).all()
    own = np.array([np.nan, 0.1, 0.1])
    told = split_by_anchor(replace(scan, aod_std_rad=own, aoa_std_rad=own), blind)
    assert (told.whole.table[:, 4] >= 0).tolist() == [True, True, True]
    assert (told.whole.table[:, 5] >= 0).tolist() == [False, True, True]
    unlabelled = whole_scan(replace(scan, anchor=np.full(3, -1)), blind)
    assert (unlabelled.table[:, 4:6] >= 0).all(0).tolist() == [True, False]


def test_a_scan_that_was_split_is_whole_in_the_order_of_its_parts():
    model = model_of("canyon", [[0.0, 0.0, 0.3], [3.0, 1.0, 0.0], [2.0, -2.0, 1.0]])
    scan = gs.Scan(0, 0.0, np.array([2, 0, 2, 0]), *np.arange(1.0, 17.0).reshape(4, 4) / 9)
    scans = split_by_anchor(scan, model)
    for one, other in ((scans.whole, whole_of(list(scans))), (scans[0], whole_of(scans[:1]))):
        for name in ("value", "own_std", "amplitude", "label", "table"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert scans.whole.label.tolist() == [0, 0, 2, 2]


@pytest.mark.parametrize(
    ("amplitude", "order"),
    [
        ([3.0, 9.0, 20.0, np.nan], [2, 0, 3, 1]),  # the loudest first; the second one is silent
        ([np.nan] * 4, [0, 2, 3, 1]),  # the nearest
    ],
)
def test_anchors_are_heard_from_the_surest_on(amplitude, order):
    """Anchors 0, 0, 2 and 3 are heard, from 4, 2, 3 and 5 m."""
    model = model_of("canyon", [[0.0, 0.0, 0.3], [3.0, 1.0, 0.0], [2.0, -2.0, 1.0], [1.0, 5.0, 0.0]])
    whose, distance, none = np.array([0, 0, 2, 3]), np.array([4.0, 2.0, 3.0, 5.0]), np.zeros(4)
    scans = split_by_anchor(gs.Scan(0, 0.0, whose, distance, none, none, np.array(amplitude)), model)
    assert [scan.anchor for scan in scans.surest_first] == order
    assert [scan.anchor for scan in scans] == [0, 1, 2, 3]


def test_a_calibration_that_changes_nothing_leaves_the_model_as_it_is():
    model = model_of(anchors=[[0.0, 0.0, 0.0], [3.0, 1.0, 0.5 * np.pi]])
    assert model.calibrated(np.zeros(2), model.higher) is model
    turned = model.calibrated(np.array([0.0, 0.1]), model.higher)
    np.testing.assert_allclose(turned.anchor_orientations, [0.0, 0.5 * np.pi + 0.1])


def test_some_of_them_are_as_if_the_others_had_not_been_there():
    value = np.array([[5.0, 0.1, 0.2], [6.0, 0.3, np.nan], [7.0, 0.5, 0.6]])
    std, amplitude = np.full((3, 3), 0.01) * [[1], [2], [3]], np.array([3.0, 4.0, 9.0])
    place, some = np.array([1.0, 2.0]), np.array([2, 1])
    whole = AnchorScan.of(4, place, 0.3, value, std, amplitude, 2.0)
    alone = AnchorScan.of(4, place, 0.3, value[some], std[some], amplitude[some], 2.0)
    taken = whole.take(some)
    for name in ("value", "own_std", "amplitude", "label", "table"):
        np.testing.assert_array_equal(getattr(taken, name), getattr(alone, name))
    assert taken.anchor == 4
    assert taken.elevation is None
    assert taken.whole.tolist() == [True, False]
