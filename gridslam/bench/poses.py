"""The kernel that scores poses by one scan, for as many as a vague start asks for, against its twin."""

from __future__ import annotations

import numpy as np

from gridslam.bench.kernels import KernelSpeed, race
from gridslam.inference.management.poses.pose_score import IN_SIGHT, NEAREST_M, Snapshot, clues_of
from gridslam.inference.state.anchor_measurements import split_by_anchor
from gridslam.reference.pose_score import score_poses
from gridslam.simulation.simulate import simulate
from gridslam.world.scene import Scene

NAMES = ("score_poses",)
TWIN_SHARE = 20
"""A twin is given one in so many poses; its time is that for all of the kernel's in proportion."""


def pose_speed(poses: int, seconds: float, scene: str = "alcove") -> KernelSpeed:
    """Time of the kernel for poses anywhere in a scene's region, by the first scan.

    Parameters
    ----------
    seconds : float
        At least so long; the kernel runs three times or more, its twin once.
    """
    world, draw = Scene.load(scene), np.random.default_rng(1)
    model = world.filter_model()
    scans = split_by_anchor(next(iter(simulate(world, world.agents[0].name, seed=1))), model)
    snapshot = Snapshot.of(scans, [model.radio] * len(scans), model)
    low, high = zip(model.grid.x_m, model.grid.y_m, (-np.pi, np.pi), strict=True)
    asked = draw.uniform(low, high, (poses, 3))
    few, step, clues = asked[:: min(TWIN_SHARE, poses)], snapshot.terms[0].table.step, clues_of(snapshot, 1.0)
    return race(
        "score_poses", scene, "pose", poses, seconds, poses / len(few),
        lambda: snapshot.score(asked, 1.0),
        lambda: snapshot.score(asked[:1], 1.0),
        lambda: score_poses(IN_SIGHT, NEAREST_M, step, few, clues),
    )  # fmt: skip
