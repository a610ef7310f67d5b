"""Departures of anchors that may be mounted otherwise, and what comes of it."""

from dataclasses import replace

import numpy as np
import pytest
from filter_states import model_of

import gridslam as gs
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.deviations import own_deviations
from gridslam.inference.scans.unsure_orientations import all_as_sure_as_anchors, as_sure_as_anchors
from gridslam.world.network_scan import NetworkScan
from gridslam.world.network_scene import network_model

PLACES = [[0.0, 0.0, 0.3, 2.5], [3.0, 1.0, 0.0, 0.0], [2.0, -2.0, 1.0, 0.0]]


def unsure(*std, places=PLACES):
    return replace(model_of("canyon", places), mounting_std=np.column_stack([np.zeros(len(std)), std]))


def scan_of(anchor, aod_std=None):
    draw, count = np.random.default_rng(3), len(anchor)
    columns = draw.uniform(4, 9, count), *draw.uniform(-3, 3, (2, count)), draw.uniform(3, 30, count)
    return gs.Scan(0, 0.0, np.array(anchor), *columns, aod_std_rad=aod_std)


def test_a_deviation_of_three_and_a_turn_of_four_make_five():
    scan = scan_of([0, 1, 2, 1], np.array([0.03, 0.03, 0.03, np.nan]))
    scan.aod_rad[3] = np.nan
    after = as_sure_as_anchors(scan, unsure(0.04, 0.04, 0.0))
    np.testing.assert_allclose(after.aod_std_rad, [0.05, 0.05, 0.03, np.nan])
    assert after.aoa_std_rad is None
    assert after.distance_m is scan.distance_m


@pytest.mark.parametrize("std", [(0.0, 0.0, 0.0), (0.1,)])
def test_nothing_changes_where_all_are_known_or_there_is_one_alone(std):
    scan, places = scan_of([0, 0, 0]), PLACES[: len(std)]
    assert as_sure_as_anchors(scan, unsure(*std, places=places)) is scan


def test_the_radio_says_what_a_table_does_not():
    """Of anchors at heights, too."""
    scan, std = scan_of([2, 0, 1, 0, 2, 1]), np.array([0.02, 0.05, 0.1])
    model = unsure(*std)
    radio = own_deviations(split_by_anchor(scan, model), model.radio)
    after = split_by_anchor(as_sure_as_anchors(scan, model), model)
    wanted = np.hypot(radio[:, 1], std[after.whole.label])
    np.testing.assert_allclose(own_deviations(after, model.radio)[:, 1], wanted)
    np.testing.assert_array_equal(own_deviations(after, model.radio)[:, [0, 2]], radio[:, [0, 2]])


def test_a_row_of_nobody_knows_whom_is_as_sure_as_the_least_sure():
    scan = scan_of([-1, 0, -1], np.full(3, 0.03))
    after = as_sure_as_anchors(scan, unsure(0.0, 0.04, 0.01))
    np.testing.assert_allclose(after.aod_std_rad, [0.05, 0.03, 0.05])


def test_each_agent_of_a_network_hears_the_same_anchors():
    model, own = unsure(0.04, 0.0, 0.0), scan_of([0, 1], np.full(2, 0.03))
    network = replace(network_model(gs.Scene.load("exchange"), ["agent1"]), agents=(model, model, model))
    after = all_as_sure_as_anchors(NetworkScan(0, 0.0, (own, None, own)), network)
    assert after.scans[1] is None
    for scan in (after.scans[0], after.scans[2]):
        np.testing.assert_allclose(scan.aod_std_rad, [0.05, 0.03])


def room(anchors, std_deg=0.0, turned_deg=(0.0, 0.0)):
    """The room, with its first anchors mounted otherwise, by some degrees each."""
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    data["anchors"] = [
        {**anchor, "orientation_deg": anchor["orientation_deg"] + by, "orientation_std_deg": std_deg}
        for anchor, by in zip(data["anchors"][:anchors], turned_deg, strict=False)
    ]
    data["filter"]["particles"], data["agents"] = 300, [{**data["agents"][0], "steps": 80}]
    return gs.Scene.checked(data, "room")


def followed(scene, true, seed):
    """Squared errors over variance, and in how many steps health was well."""
    heard = gs.simulate(true, "agent1", seed)
    heard = replace(heard, anchor_position_m=None, anchor_orientation_rad=None)
    run = gs.map_scene(scene, heard, seed=seed)
    error = run.trajectory.position_m - scene.track("agent1").position_m
    covariance = run.covariance[:, :2, :2]
    squares = np.einsum("ki,kij,kj->k", error, np.linalg.inv(covariance), error)
    return squares[20:].mean(), np.mean([one.health.ok for one in run.estimates])


@pytest.mark.slow
@pytest.mark.parametrize("anchors", [1, 2])
def test_what_is_told_of_mountings_is_claimed(anchors):
    """Four degrees: about an only anchor the whole world turns by them; of two, departures disagree."""
    true = room(anchors, turned_deg=(-4.0, 2.0))
    squares, well = followed(room(anchors, 3.0), true, 5)
    squares_before, well_before = followed(room(anchors), true, 5)
    assert 0.1 < squares < 4.0  # 2 is right
    assert well > 0.95
    if anchors == 1:
        assert squares_before > 4 * squares
    else:  # turns are found, and are no news
        assert well_before < 0.5
