"""Figures of several agents at once."""

from dataclasses import replace

import numpy as np
from run_samples import hall, some_measurements, some_run

from gridslam.estimate_tables import SurfaceStretches
from gridslam.runs.run_files import AgentFiles, RunFiles
from gridslam.viewers.network_plots import draw_tracks


def test_tracks_say_that_walls_without_cells_go_from_first_hit_to_last_or_are_where_they_were_hit():
    scene, named = hall(), []
    run = some_run(scene, "agent1")
    none = np.zeros(run.map.shape, bool)
    for seen, hit in ((run.map.observed, None), (none, None), (none, SurfaceStretches.empty())):
        grid = replace(run.map, observed=seen, surfaces=run.surfaces, stretches=hit)
        agent = AgentFiles(
            some_measurements(scene, "agent1"), run.trajectory, scene.track("agent1"), run.estimates, grid
        )
        figure = draw_tracks(RunFiles(scene, {"method": "network"}, {"agent1": agent}))
        named.append({text.get_text() for text in figure.legends[0].get_texts()})
    assert named[0] - named[1] == {"surfaces found"}
    assert named[1] - named[0] == {"surfaces found, from first hit to last"}
    assert named[2] - named[0] == {"surfaces found, where they were hit"}
