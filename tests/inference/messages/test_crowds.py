"""Many paths nearly alike: what they tell together, against enumeration and one measurement."""

from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
import pytest
from filter_states import model_of, state_of

from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.messages.crowds import OTHERS, crowded_as_one, neighbours, of_one_way
from gridslam.inference.messages.likelihood_ratios import Pairs, evaluate
from gridslam.inference.messages.path_prediction import predict_paths
from gridslam.inference.messages.updates import update_surfaces_and_agent
from gridslam.inference.scans.anchor_measurements import AnchorScan
from gridslam.inference.workspace.workspace import Workspace
from gridslam.kernels.primitives import tables


def scan_of(distance, aoa=0.0, amplitude=4.0):
    distance = np.asarray(distance, float)
    value = np.column_stack([distance, np.full(len(distance), np.nan), np.broadcast_to(aoa, len(distance))])
    std = np.tile([0.03, np.nan, 0.05], (len(distance), 1))
    loud = np.broadcast_to(np.asarray(amplitude, float), len(distance)).copy()
    return AnchorScan.of(0, np.zeros(2), 0.0, value, std, loud, 2.0)


def pairs_of(scan, variance):
    index = np.column_stack([np.zeros(len(scan), int), np.arange(len(scan))]).astype(np.int32)
    pair = np.ones((len(scan), 8))
    pair[:, :3], pair[:, 3:6] = scan.table[:, :3], variance
    return Pairs(len(scan), np.array([0, len(scan)], np.int32), index, pair)


def test_a_crowd_is_four_faint_measurements_side_by_side_and_nothing_less():
    def crowd(*given):
        return np.flatnonzero(neighbours(scan_of(*given).table).any(1)).tolist()

    assert crowd([10.0, 10.1, 10.2]) == []
    assert crowd([10.0, 10.1, 10.2, 10.3]) == [0, 1, 2, 3]
    assert crowd([10.0, 10.1, 10.2, 10.3, 20.0]) == [0, 1, 2, 3]
    assert crowd([10.0, 10.1, 10.2, 10.3], [0.0, 0.1, 0.2, 0.6]) == []
    assert crowd([10.0, 10.1, 10.2, 10.3], [np.pi, -3.1, 3.1, -3.1]) == [0, 1, 2, 3], "around the turn"
    assert crowd([10.0, 10.1, 10.2, 10.3], 0.0, [4, 4, 4, 40]) == [], "a strong one stands for itself"
    assert crowd([10.0, 10.1, 10.2, 10.3], [0, 0, 0, np.nan]) == []
    assert crowd([10.0, 10.9, 11.8, 12.7, 13.6]) == []
    mixed = replace(scan_of([10.0, 10.1, 10.2, 10.3]))
    mixed.table[3, tables.LABEL] = 1
    assert not neighbours(mixed.table).any(), "anchors don't crowd each other"


def test_paths_over_floor_and_ceiling_make_no_crowd_with_those_of_their_wall():
    near = neighbours(scan_of(np.linspace(10.0, 10.5, 6)).table)
    assert near.all()
    beta = np.array([[9.0, 9, 9, 9, 0, 0], [1.0, 1, 1, 1, 5, 0], [0.0, 0, 0, 0, 2, 7]])
    found = of_one_way(near, beta, np.array([0, 1, 2], np.int32))
    assert found.any(1).tolist() == [True] * 4 + [False] * 2
    assert not found[:4, 4:].any()
    assert near.all(), "not changed in place"
    assert of_one_way(near, beta, np.zeros(3, np.int32)) is near
    fewer = of_one_way(near, beta[:, ::-1].repeat(2, 0)[::2], np.array([2, 1, 0], np.int32))
    np.testing.assert_array_equal(fewer, found[::-1, ::-1])
    three = np.array([[1.0, 1, 1, 0, 0, 0], [0.0, 0, 0, 1, 1, 1]])
    assert not of_one_way(near, three, np.array([0, 1], np.int32)).any()


def test_a_crowd_tells_what_one_measurement_of_its_middle_would():
    scan, variance = scan_of([10.0, 10.0, 10.0, 10.0]), np.array([9e-4, 1e-2, 4e-3])
    before = pairs_of(scan, variance)
    after = crowded_as_one(before, scan)
    np.testing.assert_allclose((1 / after.pair[:, 3:6]).sum(0), 1 / variance)
    np.testing.assert_array_equal(before.pair[:, 3:6], np.tile(variance, (4, 1)), "not changed in place")
    spread = scan_of([9.9, 9.9, 10.1, 10.1])
    wider = crowded_as_one(pairs_of(spread, variance), spread).pair[:, 3]
    np.testing.assert_allclose(wider, 4 * (9e-4 + 0.01))


def test_alone_pairs_stay_the_same_object():
    scan = scan_of([5.0, 10.0, 10.1, 10.2])
    pairs = pairs_of(scan, 0.01)
    assert len(scan) > OTHERS
    assert crowded_as_one(pairs, scan) is pairs
    mixed = scan_of([5.0, 10.0, 10.1, 10.2, 10.3])
    widened = crowded_as_one(pairs_of(mixed, 0.01), mixed).pair[:, 3]
    assert widened[0] == 0.01
    assert (widened[1:] > 0.04).all()


@dataclass(frozen=True)
class Steady:
    """An amplitude that is known."""

    probability: np.ndarray
    nodes: np.ndarray
    spreading: bool = False


@pytest.mark.parametrize("seed", range(6))
def test_three_nearly_identical_paths_come_within_a_deviation_of_enumeration(seed):
    """Walls 2 cm apart, distances known to 3 cm: which is which is a guess; each measurement tells once."""
    model = replace(model_of(anchors=[[0.0, 0.0, 0.0]]), max_bounces=1)
    walls, draw = np.array([9.0, 9.02, 9.04]), np.random.default_rng(seed)
    mean = np.array([5.0, 0, 0, 0, 0, 0, 9.0, 0, 9.02, 0, 9.04])
    variance = np.full(11, 1e-12)
    variance[0], variance[2:4] = 0.1**2, 1e-6
    state, work = state_of(Belief(mean, np.diag(variance)), existence=1 - 1e-7), Workspace(model, seed=1)
    truth = 5.0 + 0.1 * draw.standard_normal()
    scan = scan_of(2 * walls - truth + 0.03 * draw.standard_normal(3))
    paths = predict_paths(state, 0, model, work=work)
    strength = Steady(np.ones((len(paths), 1)), np.array([4.0]))
    _, ratios = evaluate(scan, paths, np.ones(len(paths)), strength, model.radio, model, work=work)
    ratios.new[:] = 1.0
    found, exchange = update_surfaces_and_agent(state, scan, paths, ratios, np.zeros(1), model, work=work)
    assert exchange.responsible.sum(0).max() < 1 + 1e-9

    x = np.linspace(4.4, 5.6, 2401)
    gap = scan.value[:, 0][:, None, None] - (2 * walls[:, None] - x)  # by measurement, wall and place
    match = np.exp(-0.5 * (gap / 0.03) ** 2)
    density = sum(match[m, range(3)].prod(0) for m in map(list, permutations(range(3))))
    density = density * np.exp(-0.5 * ((x - 5.0) / 0.1) ** 2)
    density /= density.sum()
    exact = (density * x).sum()
    std = np.sqrt((density * (x - exact) ** 2).sum())
    claimed = np.sqrt(found.belief.covariance[0, 0])
    assert abs(found.belief.mean[0] - exact) < claimed
    assert 0.8 * std < claimed < 0.06, "neither surer than all matchings are, nor without any news"
