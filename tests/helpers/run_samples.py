"""Runs that never were: two agents in a hall of one wall."""

from dataclasses import replace

import numpy as np

from gridslam.estimate_tables import HypothesisEstimate, PathEstimate, RingEstimate, SurfaceEstimate
from gridslam.estimates import Estimate
from gridslam.maps.map import Map
from gridslam.measurements.table import Measurements
from gridslam.runs.run import Run
from gridslam.runs.run_files import write_run
from gridslam.simulation.image_source import ground_truth
from gridslam.world.scene import Scene
from gridslam.world.start import assumed_start
from gridslam.world.trajectory import Trajectory

SCENE = """
name = "hall"
[grid]
x_m = [-5.0, 5.0]
y_m = [-4.0, 4.0]
cell_m = 0.5
[materials]
concrete = 0.7
[[anchors]]
name = "A"
position_m = [-2.0, 1.0]
orientation_deg = 0.0
[[walls]]
material = "concrete"
points_m = [[-4.0, 3.25], [4.0, 3.25]]
[[agents]]
name = "agent1"
start_m = [0.0, 0.0]
start_heading_deg = 0.0
waypoints_m = [[0.0, 0.0], [1.0, 0.0]]
step_m = 0.05
[[agents]]
name = "agent2"
start_m = [0.0, -1.0]
start_heading_deg = 0.0
waypoints_m = [[0.0, -1.0], [0.5, -1.0]]
step_m = 0.05
"""


def hall():
    """Their scene."""
    return Scene.from_toml(SCENE, "hall.toml")


def some_estimate(step, surfaces, paths):
    draw = np.random.default_rng([step, surfaces, paths])
    table = SurfaceEstimate.from_lines(
        draw.normal(size=(surfaces, 2)),
        np.tile(np.eye(2), (surfaces, 1, 1)),
        *draw.random((3, surfaces)),
        owner=draw.integers(-1, 3, surfaces),
    )
    rows = PathEstimate(
        draw.integers(0, 3, paths),
        draw.integers(-1, 9, (paths, 2)),
        *draw.random((5, paths)),
        draw.normal(size=(paths, 4, 2)),
    )
    covariance = draw.normal(size=(5, 5))
    detected = draw.random(surfaces) < 0.5
    several = HypothesisEstimate(
        draw.random(step), draw.random((step, 2)), draw.random(step), draw.random((step, 2, 2)),
        draw.integers(0, 9, step),
    )  # fmt: skip
    rings = RingEstimate(
        draw.integers(0, 2, paths), draw.integers(0, 3, paths), *draw.random((2, paths)),
        draw.random((paths, 2)),
    )  # fmt: skip
    return Estimate(
        step, 0.1 * step, draw.random(2), draw.random(2), 0.3, covariance, table, rows, detected, 9.5, 0.02,
        hypotheses=several, rings=rings,
    )  # fmt: skip


def some_run(scene, agent, error=0.0, **changes):
    track = scene.track(agent)
    position = track.position_m + np.array([error, 0])
    lines = np.array([[np.pi / 2, 3.25], [1.0, 2.0]])
    surfaces = SurfaceEstimate.from_lines(
        lines, np.tile(np.eye(2), (2, 1, 1)), np.ones(2) * 0.7, np.ones(2) * 0.1, np.array([0.9, 0.4])
    )
    grid = Map.blank(scene.grid.origin_m, scene.grid.cell_m, scene.grid.shape, 0.05)
    evidence, observed = np.zeros(grid.shape), np.zeros(grid.shape, bool)
    evidence[14], observed[14], observed[5] = 9.0, True, True  # row 14 is the wall's
    return Run(
        scene=scene,
        agent=agent,
        method=changes.pop("method", "grid"),
        seed=3,
        device="cpu",
        estimates=[some_estimate(step, step % 3, step % 4) for step in range(len(track))],
        trajectory=Trajectory(track.time_s, position, track.velocity_mps, track.heading_rad),
        covariance=np.zeros((len(track), 5, 5)),
        surfaces=surfaces,
        map=replace(grid, evidence=evidence, observed=observed),
        seconds_per_step=0.1,
        peak_memory_mb=100.0,
        began=assumed_start(scene, agent, 3, "exact"),
        **changes,
    )


def some_measurements(scene, agent, truth=True):
    track = scene.track(agent)
    nan = np.full(2, np.nan)
    return Measurements(
        anchors=scene.anchor_names,
        anchor_position_m=scene.anchor_positions,
        anchor_orientation_rad=scene.anchor_orientations,
        step=np.array([0, 1]),
        time_s=track.time_s[:2],
        anchor=np.array([0, 0]),
        distance_m=np.array([2.0, 3.0]),
        aod_rad=nan,
        aoa_rad=nan,
        amplitude=nan,
        interval_s=1.0,
        steps=len(track),
        truth=track if truth else None,
    )


def write(directory, scene, agents=("agent1", "agent2"), truth=True, **options):
    runs = [some_run(scene, agent) for agent in agents]
    scores = [run.score(ground_truth(scene, run.agent) if truth else None) for run in runs]
    measurements = [some_measurements(scene, agent, truth) for agent in agents]
    write_run(directory, scene, runs, measurements, scores, {"threads": 2}, **options)


def tree(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
