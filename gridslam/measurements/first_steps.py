"""The first steps of what an agent heard, or of what a scene simulates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from gridslam.measurements.observations import Observations
from gridslam.measurements.recording import Recording
from gridslam.measurements.table import Measurements
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory


def first_of_scene(scene: Scene, steps: int) -> Scene:
    """The scene with so many steps of each agent whose way it knows, or all of a shorter way."""
    whole = scene.model_dump(exclude_none=True)
    for body in whole["agents"]:
        if "waypoints_m" in body:
            body["steps"] = min(steps, len(scene.track(body["name"])))
    return scene.checked(whole, scene.name)


def first_heard(observed: Observations, steps: int) -> Observations:
    """The first steps of what was heard, the true track included; all of it if there are no more."""
    if steps >= len(observed):
        return observed
    truth = None if observed.truth is None else _first(observed.truth, steps)
    if isinstance(observed, Recording):
        heading = None if observed.heading_rad is None else observed.heading_rad[:steps]
        return replace(
            observed, samples=observed.samples[:steps], time_s=observed.time_s[:steps],
            heard=observed.heard[:steps], heading_rad=heading, truth=truth,
        )  # fmt: skip
    there = observed.step < steps
    cut: dict[str, Any] = {name: values[there] for name, values in observed.columns.items()}
    whole: Measurements = replace(observed, **cut, steps=steps, truth=truth)
    return whole


def _first(track: Trajectory, steps: int) -> Trajectory:
    high = None if track.height_m is None else track.height_m[:steps]
    return Trajectory(
        track.time_s[:steps], track.position_m[:steps], track.velocity_mps[:steps], track.heading_rad[:steps],
        high, track.holes_s,
    )  # fmt: skip
