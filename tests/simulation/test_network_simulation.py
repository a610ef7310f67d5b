"""Several simulated agents: clocks enter distances, and nothing but the angles betrays whose a row is."""

import numpy as np
import pytest
from scene_samples import raised, shortened
from scipy.stats import kstest

import gridslam as gs
from gridslam.errors import InputError
from gridslam.simulation.clocks import apparent_bias, clock_truth
from gridslam.simulation.network import shared_air, simulate_network
from gridslam.world.clocks import NS, Clock
from gridslam.world.network_scene import clock_model, network_model

AGENTS = ["agent1", "agent2", "agent3"]


def changed(scene, steps=60, **changes):
    whole = scene.model_dump(exclude_none=True)
    for agent in whole["agents"]:
        agent["steps"] = steps
    return gs.Scene.checked(whole | changes, "test")


@pytest.fixture(scope="module")
def scene():
    return changed(gs.Scene.load("exchange"))


@pytest.fixture(scope="module")
def air(scene):
    return shared_air(scene, AGENTS, seed=3, sharing=4)


def test_distances_hold_the_apparent_biases(scene, air):
    measurements, truth = air
    biases = truth.clocks.metres(("A", "B", "C", "D", *AGENTS))
    for i, name in enumerate(AGENTS):
        mine = (measurements.agent == i) & (truth.cause >= 0)
        paths = truth.agents[name].paths
        step, anchor = measurements.table.step[mine], measurements.table.anchor[mine]
        bias = biases[step, anchor] - biases[step, 4 + i]
        error = measurements.table.distance_m[mine] - paths.distance_m[truth.cause[mine]] - bias
        std = scene.signal_model(name).distance_std(paths.amplitude[truth.cause[mine]])
        assert abs(np.mean((error / std) ** 2) - 1) < 0.15
    assert (measurements.table.distance_m < 0).any()
    np.testing.assert_allclose(biases[0, :4], [-30, -10, 10, 30], atol=1e-3)


def test_clutter_says_nothing_of_labels(air):
    measurements, truth = air
    clutter = truth.source < 0
    assert abs(clutter.sum() / len(AGENTS) / 60 - 5) < 0.7  # of all anchors together
    for anchor in range(4):
        distance = measurements.table.distance_m[clutter & (measurements.table.anchor == anchor)]
        assert kstest((distance + 45) / 130, "uniform").pvalue > 1e-3


def test_rows_are_in_random_order_and_labels_gone(scene, air):
    measurements, truth = simulate_network(scene, AGENTS, seed=3, unlabelled=True)
    assert (measurements.table.anchor == -1).all()
    same = air[0]
    np.testing.assert_array_equal(measurements.table.distance_m, same.table.distance_m)
    rows = (measurements.agent == 0) & (truth.source >= 0)
    first_half, order = [], truth.source[rows]
    for step in range(60):
        mine = order[measurements.table.step[rows] == step]
        first_half.append(mine[: len(mine) // 2].mean() - mine[len(mine) // 2 :].mean())
    assert abs(np.mean(first_half)) < 4 * np.std(first_half) / np.sqrt(60)


def test_deviations_come_from_a_measurements_own_amplitude(air):
    std = air[0].table.distance_std_m
    assert np.isnan(air[0].table.amplitude).all()
    assert std.std() > 0.01
    assert (std > 0).all()


def test_agents_come_and_go(scene):
    whole = scene.model_dump(exclude_none=True)
    whole["agents"][1]["present_s"] = (20.0, 30.0)
    measurements, truth = simulate_network(gs.Scene.checked(whole, "test"), AGENTS, 1)
    assert [measurements.there(step)[1] for step in (19, 20, 30, 31)] == [False, True, True, False]
    assert measurements["agent2"].step.min() >= 20
    np.testing.assert_array_equal(truth.agents["agent2"].trajectory.time_s, np.arange(20.0, 31))
    assert len(measurements) == 60


def test_agents_of_other_paces_are_refused(scene):
    whole = scene.model_dump(exclude_none=True)
    whole["agents"][2]["interval_s"] = 0.5
    with pytest.raises(InputError, match=r"agents\[2\].interval_s"):
        simulate_network(gs.Scene.checked(whole, "test"), AGENTS)
    with pytest.raises(InputError, match="'agent1' twice"):
        simulate_network(scene, ["agent1", "agent1"])


@pytest.mark.parametrize("first", [1, 5])
def test_elevations_that_one_agent_alone_measures_are_missing_for_the_other(first):
    data = raised(shortened(gs.Scene.load("room"), 3, agents=2), 1.5).model_dump(exclude_none=True)
    for agent, layers in zip(data["agents"], (first, 6 - first), strict=True):
        agent["array"] = {"layers": layers}
    measurements, _ = simulate_network(gs.Scene.checked(data, "room"), AGENTS[:2], seed=1)
    measured = np.isfinite(measurements.table.aoa_elevation_rad)
    assert len(set(measurements.agent)) == 2
    np.testing.assert_array_equal(measured, measurements.agent == (0 if first == 5 else 1))


def test_clocks_drift_zigzag_and_jump():
    times = np.array([0.0, 25.0, 50.0, 75.0, 100.0])
    zigzag = Clock(offset_ns=5.0, drift_ppb=0.1, zigzag_s=100.0).offset_s(times)
    np.testing.assert_allclose(zigzag, 1e-9 * np.array([5, 7.5, 10, 7.5, 5]))
    jump = Clock(drift_ppb=-2.0, jump_s=50.0, jump_ns=7.0).offset_s(times)
    np.testing.assert_allclose(jump, 1e-9 * np.array([0, -50, -93, -143, -193]))


def test_filter_knows_priors_of_clocks_alone(scene):
    model = network_model(scene, AGENTS)
    assert model.names == tuple(AGENTS)
    np.testing.assert_allclose(model.clocks.half_width_m, NS * np.array([110.0] * 4 + [1.75] * 3))
    np.testing.assert_allclose(np.sqrt(model.clocks.variance[4:]), 0.3, atol=0.005)
    assert not clock_model(gs.Scene.load("room"), ["agent1"]).half_width_m.any()
    tied = changed(scene, clocks={"reference": "B"})
    half = clock_model(tied, AGENTS).half_width_m
    np.testing.assert_allclose(half, [65, 0, 65, 65, 0, 0, 0])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"clocks": {}}, "clocks.anchor_prior_ns: found neither it nor a reference"),
        ({"clocks": {"reference": "Z"}}, "clocks.reference: found 'Z'"),
        ({"clocks": {"anchor_prior_ns": -1.0}}, "clocks.anchor_prior_ns"),
        ({"clocks": None}, r"anchors\[0\].clock: found a clock"),
        ({"radio": {"window_m": [5.0, 5.0]}}, "radio.window_m"),
    ],
)
def test_clocks_that_nothing_ties_down_are_refused(scene, changes, says):
    with pytest.raises(InputError, match=says):
        changed(scene, **changes)


def test_a_true_clock_walks_by_the_seed(scene):
    whole = scene.model_dump(exclude_none=True)
    whole["anchors"][1]["clock"] = {"offset_ns": 3.0, "walk_ns": 2.0}
    for agent in whole["agents"]:
        agent["interval_s"] = 0.25
    walking = gs.Scene.checked(whole, "test")
    times = 0.25 * np.arange(4001)
    truth = clock_truth(walking, AGENTS, times, seed=1)
    walk = 1e9 * truth.offset_s[:, 1] - 3.0
    steps = np.diff(walk)
    np.testing.assert_allclose(walk[0], 0, atol=1e-9)
    # 2 ns per root second are 1 ns in a quarter of one; 4000 draws tell a deviation to 1.1 %
    assert abs(steps.std() - 1.0) < 0.05
    assert abs(np.corrcoef(steps[:-1], steps[1:])[0, 1]) < 0.06
    still = clock_truth(scene, AGENTS, times, seed=1).offset_s
    np.testing.assert_array_equal(truth.offset_s[:, [0, 2, 4]], still[:, [0, 2, 4]])
    # an agent that comes later meets the same clock
    late = apparent_bias(walking, "agent1", times[40:], seed=1)
    np.testing.assert_array_equal(late, apparent_bias(walking, "agent1", times, seed=1)[40:])
    assert not np.array_equal(
        clock_truth(walking, AGENTS, times, seed=2).offset_s[:, 1], truth.offset_s[:, 1]
    )
