"""What a moving picture shows of walls."""

from dataclasses import replace

import numpy as np
import pytest
from map_samples import surfaces
from run_samples import hall, some_measurements, some_run
from tiny import TINY

from gridslam.estimate_tables import SurfaceStretches
from gridslam.maps.map import Map
from gridslam.runs.run_files import AgentFiles
from gridslam.viewers.animation import _draw, _figure, _stretches, animate
from gridslam.world.scene import Scene


def test_walls_have_their_doors_as_soon_as_they_are_seen_and_lost_ones_are_whole():
    found = surfaces([(0.5, 6.0)], extent=(0, 5))
    door = SurfaceStretches(np.zeros(2, np.int64), np.array([[0.0, 2.0], [3.0, 5.0]]))
    final = replace(Map.blank((0, 0), 0.1, (120, 120), 0.1), surfaces=found, stretches=door)
    known = surfaces([(0.5, 6.0), (2.0, 3.0)], extent=(0, 4))
    now = _stretches(final, known)
    np.testing.assert_allclose(now.extent_m, [[0, 4], [0, 2], [3, 5]], atol=0.06)
    np.testing.assert_array_equal(now.surface, [1, 0, 0])
    assert _stretches(replace(final, stretches=None), known) is None


def test_a_film_that_is_stopped_before_its_first_frame_ends_as_it_was_stopped(tmp_path, monkeypatch):
    """Not by what the picture library makes of a film without frames."""

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("gridslam.viewers.animation._draw", stop)
    scene = Scene.from_toml(TINY, "tiny")
    found = AgentFiles(None, None, None, [object()], None)
    with pytest.raises(KeyboardInterrupt):
        animate(scene, found, tmp_path / "film.gif")
    assert not list(tmp_path.iterdir())


def test_true_tracks_are_broken_at_holes():
    scene = hall()
    run, track = some_run(scene, "agent1"), scene.track("agent1")
    torn = replace(track, holes_s=np.array([track.time_s[[0, 2]]]))
    found = AgentFiles(some_measurements(scene, "agent1"), run.trajectory, torn, run.estimates, run.map)
    _, axes = _figure(scene)
    last = len(run.estimates) - 1
    _draw(axes, scene, found, run.estimates[last], last)
    (drawn,) = [
        line.get_xdata() for line in axes.lines if line.get_color() == "k" and line.get_alpha() == 0.35
    ]
    assert np.isnan(drawn).any()
    assert np.isfinite(drawn[0])
