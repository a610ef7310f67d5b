"""Figures of several agents at once."""

from dataclasses import replace

import numpy as np
from run_samples import hall, some_measurements, some_run

import gridslam as gs
from gridslam.estimate_tables import SurfaceStretches
from gridslam.runs.run_files import AgentFiles, RunFiles
from gridslam.viewers.network_plots import draw_tracks


def drawn(scene, run, grid):
    """What the legend says of tracks over a map."""
    agent = AgentFiles(
        some_measurements(scene, "agent1"), run.trajectory, scene.track("agent1"), run.estimates, grid
    )
    figure = draw_tracks(RunFiles(scene, {"method": "network"}, {"agent1": agent}))
    return {text.get_text() for text in figure.legends[0].get_texts()}


def test_a_scene_without_walls_has_no_true_ones_in_its_legend():
    scene = hall()
    bare = gs.Scene.checked(scene.model_dump(exclude_none=True) | {"walls": []}, "bare")
    run = some_run(scene, "agent1")
    named, without = (drawn(one, run, run.map) for one in (scene, bare))
    assert named - without == {"true walls"}


def test_tracks_say_that_walls_without_cells_go_from_first_hit_to_last_or_are_where_they_were_hit():
    scene, named = hall(), []
    run = some_run(scene, "agent1")
    none = np.zeros(run.map.shape, bool)
    for seen, hit in ((run.map.observed, None), (none, None), (none, SurfaceStretches.empty())):
        grid = replace(run.map, observed=seen, surfaces=run.surfaces, stretches=hit)
        named.append(drawn(scene, run, grid))
    assert named[0] - named[1] == {"surfaces found"}
    assert named[1] - named[0] == {"surfaces found, from first hit to last"}
    assert named[2] - named[0] == {"surfaces found, where they were hit"}


def test_true_tracks_are_broken_at_holes():
    scene = hall()
    run, track = some_run(scene, "agent1"), scene.track("agent1")
    torn = replace(track, holes_s=np.array([track.time_s[[0, 2]]]))
    heard = some_measurements(scene, "agent1")
    agent = AgentFiles(heard, run.trajectory, torn, run.estimates, run.map)
    axes = draw_tracks(RunFiles(scene, {"method": "network"}, {"agent1": agent})).axes[0]
    assert any(np.isnan(line.get_xdata()).any() for line in axes.lines if line.get_color() == "k")
