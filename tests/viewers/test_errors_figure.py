"""The figure of errors over time shows what the table says."""

from dataclasses import replace

import numpy as np

import gridslam as gs
from gridslam.runs.run_files import AgentFiles
from gridslam.simulation.image_source import ground_truth
from gridslam.viewers.plots import draw_errors

GONE = range(8, 25)


def test_the_bound_is_that_of_the_steps_at_which_something_was_heard():
    whole = gs.Scene.load("room").model_dump(exclude_none=True)
    whole["agents"][0]["steps"], whole["filter"]["particles"] = 30, 200
    room = gs.Scene.checked(whole, "room")
    heard, truth = gs.simulate(room, "agent1", 3), ground_truth(room, "agent1")
    keep = ~np.isin(heard.step, GONE)
    columns = ("step", "time_s", "anchor", "distance_m", "aod_rad", "aoa_rad", "amplitude")
    heard = replace(heard, **{name: getattr(heard, name)[keep] for name in columns})
    run = gs.map_scene(room, heard, seed=3)
    files = AgentFiles(heard, run.trajectory, truth.trajectory, list(run.estimates), run.map)
    axes = draw_errors(room, "agent1", files, truth).axes[0]
    (bound,) = (line.get_ydata() for line in axes.lines if line.get_label().startswith("known-map bound"))
    assert bound[7] < 10 < 50 < bound[24], "cm"
    np.testing.assert_allclose(np.sqrt(np.mean(bound**2)), 100 * run.score(truth)["position_bound_m"])
