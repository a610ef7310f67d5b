"""The bound of a network: its limits are bounds that are known otherwise, and scores see what can be seen."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam as gs
from gridslam.evaluation.bounds import unknown_map_bound
from gridslam.evaluation.network_bounds import network_bound
from gridslam.evaluation.network_scores import (
    apparent_biases,
    label_errors,
    steps_to_synchronise,
    told_errors,
    without_common,
)
from gridslam.simulation.network import shared_air
from gridslam.world.network_scene import clock_model

NAMES = ["agent1", "agent2"]


def of_steps(count, **present):
    whole = gs.Scene.load("exchange").model_dump(exclude_none=True)
    for agent in whole["agents"]:
        agent["steps"] = count
        if agent["name"] in present:
            agent["present_s"] = present[agent["name"]]
    return gs.Scene.checked(whole, "test")


@pytest.fixture(scope="module")
def scene():
    return of_steps(25)


@pytest.fixture(scope="module")
def truth(scene):
    return shared_air(scene, NAMES, 1, 4)[1]


def known(model):
    return replace(model, half_width_m=0 * model.half_width_m)


def test_known_clocks_and_one_agent_are_the_bound_of_one_agent(scene):
    _, truth = shared_air(scene, NAMES[:1], 1, 4)
    bound = network_bound(scene, truth, known(clock_model(scene, NAMES[:1])))
    alone = unknown_map_bound(scene, "agent1")
    np.testing.assert_allclose(bound.position_m[:, 0], alone.position_m, rtol=1e-6)
    np.testing.assert_allclose(bound.heading_rad[:, 0], alone.heading_rad, rtol=1e-6)
    assert not bound.apparent_bias_s.any()


def test_agents_and_known_clocks_help_each_other(scene, truth):
    model = clock_model(scene, NAMES)
    bound, tied = network_bound(scene, truth), network_bound(scene, truth, known(model))
    alone = unknown_map_bound(scene, "agent1")
    assert (tied.position_m[:, 0] <= alone.position_m + 1e-9).all()
    assert (tied.position_m <= bound.position_m + 1e-9).all()
    assert (network_bound(scene, truth, map_known=True).position_m <= bound.position_m + 1e-9).all()


def test_clocks_that_are_wholly_unknown_leave_differences_of_distances(scene, truth):
    """Wide walks: what the first steps told of clocks is forgotten; so it doesn't matter how wide."""
    model = clock_model(scene, NAMES)
    wide = [network_bound(scene, truth, replace(model, walk_m=walk)) for walk in (1e3, 1e5)]
    np.testing.assert_allclose(wide[0].position_m, wide[1].position_m, rtol=1e-4)
    assert wide[0].apparent_bias_s[-1] > network_bound(scene, truth).apparent_bias_s[-1]


def test_absolute_offsets_are_bounded_worse_than_differences(scene, truth):
    bound = network_bound(scene, truth)
    assert bound.bias_s[-1] < 0.3e-9
    far = replace(clock_model(scene, NAMES), half_width_m=np.full(6, 300.0))
    np.testing.assert_allclose(
        network_bound(scene, truth, far).apparent_bias_s[-1], bound.apparent_bias_s[-1], rtol=0.05
    )


def test_an_agent_that_comes_later_has_no_bound_before():
    scene = of_steps(12, agent2=(5.0, 9.0))
    bound = network_bound(scene, shared_air(scene, NAMES, 1, 4)[1])
    there = np.isfinite(bound.position_m[:, 1])
    np.testing.assert_array_equal(np.flatnonzero(there), np.arange(5, 10))
    assert np.isfinite(bound.position_m[:, 0]).all()


def test_scores_of_clocks_don_t_see_the_common_part():
    offset = np.array([[3.0, 5.0, 1.0]])
    np.testing.assert_array_equal(apparent_biases(offset, 2), [[[2.0, 4.0]]])
    np.testing.assert_array_equal(apparent_biases(offset + 9, 2), [[[2.0, 4.0]]])
    np.testing.assert_allclose(without_common(offset + 9), offset - 3)
    error = 1e-9 * np.array([[9.0, 0, 0], [0, 0, 0], [4, 4, 4], [0, 0, -9]])
    rest = told_errors(error, "ABC", None)
    assert steps_to_synchronise(rest[:3]) == [1, 1, 1]
    assert steps_to_synchronise(rest) == [None, None, None]
    by_reference = told_errors(error, "ABC", "B")
    assert steps_to_synchronise(by_reference[:3]) == [1, 0, 0]
    assert steps_to_synchronise(by_reference) == [1, 0, None]


def test_label_errors_count_true_paths_alone():
    assert label_errors(np.array([0, 1, 2, -1, 1]), np.array([0, 2, -1, 1, 1])) == (1, 3)
