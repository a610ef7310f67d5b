"""Scores of several agents whose measurements were recorded: by true tracks, and by the scene's walls."""

from dataclasses import replace

import numpy as np
import pytest
from run_samples import SCENE, some_run

import gridslam as gs
from gridslam.runs.clock_track import ClockTrack
from gridslam.runs.network_run import NetworkRun, network_scores
from gridslam.simulation.network import simulate_network
from gridslam.viewers.network_plots import draw_clocks
from gridslam.world.clocks import ClockTruth

AGENTS = ["agent1", "agent2"]


def late():
    """The scene, whose second agent comes at the third step."""
    return gs.Scene.from_toml(SCENE + "present_s = [2.0, 100.0]\n", "hall.toml")


@pytest.fixture(scope="module")
def mapped():
    scene = late()
    measurements, truth = simulate_network(scene, AGENTS, 4)
    runs = {}
    for name, track in measurements.tracks.items():
        own = some_run(scene, name)
        runs[name] = replace(own, trajectory=track)
    steps = len(measurements)
    clocks = ClockTrack(
        ("A", *AGENTS), 1, np.arange(steps), measurements.table.times_s, np.zeros((steps, 3)),
        np.zeros((steps, 3, 3)), np.zeros((steps, 1), bool),
    )  # fmt: skip
    return NetworkRun(runs, clocks, np.full(len(measurements.agent), -1)), measurements, truth


def test_walls_score_recorded_agents_as_they_do_simulated_ones(mapped):
    run, measurements, truth = mapped
    simulated, recorded = (network_scores(run, measurements, known)[0] for known in (truth, None))
    for theirs, ours in zip(simulated, recorded, strict=True):
        assert (ours["surfaces_true"], ours["surfaces_matched"]) == (1, 1)
        assert None not in ours["map"].values()
        assert {**ours, "position_bound_m": 0} == {**theirs, "position_bound_m": 0}


def test_a_track_of_many_more_poses_is_taken_at_the_steps(mapped):
    run, measurements, _ = mapped
    way = measurements.tracks["agent1"]
    dense = {"agent1": way.at(np.linspace(way.time_s[0], way.time_s[-1], 997))}
    one, two = network_scores(run, replace(measurements, tracks=dense), None)[0]
    assert one["surfaces_true"] == 1
    assert one["position_rmse_m"] == pytest.approx(0, abs=1e-9)
    assert two["surfaces_true"] is None  # nobody knows where it was


@pytest.mark.parametrize(("reference", "first"), [(None, None), ("A", 0)])
def test_a_reference_says_whose_clock_is_wrong(mapped, reference, first):
    """One clock 12 ns off: without a reference, a third of it may as well be the others'."""
    run, measurements, _ = mapped
    table = "[clocks]\nanchor_prior_ns = 50\n" + (f'reference = "{reference}"\n' if reference else "")
    clocks = gs.Scene.from_toml(SCENE + table).clocks
    runs = {
        name: replace(own, scene=own.scene.model_copy(update={"clocks": clocks}))
        for name, own in run.runs.items()
    }
    truth = ClockTruth(run.clocks.device, measurements.table.times_s, np.zeros_like(run.clocks.offset_s))
    off = replace(run.clocks, offset_s=1e-9 * np.array([0, 0, 12.0]) + np.zeros_like(run.clocks.offset_s))
    whole = replace(run, runs=runs, clocks=off).score(truth)
    assert whole["steps_to_synchronise"] == {"A": first}
    figure = draw_clocks(off, truth, reference=reference)
    errors = [line.get_ydata() for line in figure.axes[1].lines]
    assert np.abs(errors[0]).max() == pytest.approx(0 if reference else 4)
