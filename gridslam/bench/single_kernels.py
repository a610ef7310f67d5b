"""Kernels that no plain step of grid SLAM launches, one by one on made-up arguments, against their twins.

Poses of a vague start are scored by one scan; direct grid SLAM gathers evidence for lines, and traces paths
as functions of the state; checks of a table follow its lines of sight.
"""

from __future__ import annotations

import numpy as np

from gridslam import reference
from gridslam.bench.kernels import KernelSpeed, race
from gridslam.inference.beliefs.layout import AGENT
from gridslam.inference.management.poses.pose_score import IN_SIGHT, NEAREST_M, PoseLikelihood, clues_of
from gridslam.inference.messages.samples.state_mode import paths_at
from gridslam.inference.scans.anchor_measurements import split_by_anchor
from gridslam.inference.scans.leftovers import REFLECTIONS, LineEvidence
from gridslam.kernels.primitives import sights as column
from gridslam.kernels.primitives.sights import Sights
from gridslam.reference.pose_score import score_poses
from gridslam.simulation.simulate import simulate
from gridslam.world.scene import Scene

NAMES = "score_poses", "weigh_lines", "trace_paths", "follow_sights"
TWIN_SHARE = 20
"""A twin is given one in so many poses; its time is that for all of the kernel's in proportion."""
RADIUS_M, SPACING_M = 6.0, 0.125
BEAMS, LENGTHS = 18, 98
SIGHT_PARTICLES, SIGHT_STEPS, SIGHT_ROWS, SIGHT_WALLS = 300, 20, 8, 12
"""Rows of each of two anchors at a step."""
SURFACES = 6
"""With a line of sight, single bounces and double bounces: 37 paths."""


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
    likelihood = PoseLikelihood.of(scans, [model.radio] * len(scans), model)
    low, high = zip(model.grid.x_m, model.grid.y_m, (-np.pi, np.pi), strict=True)
    asked = draw.uniform(low, high, (poses, 3))
    few, step, clues = (
        asked[:: min(TWIN_SHARE, poses)],
        likelihood.terms[0].table.step,
        clues_of(likelihood, 1.0),
    )
    return race(
        "score_poses", scene, "pose", poses, seconds, poses / len(few),
        lambda: likelihood.score(asked, 1.0),
        lambda: likelihood.score(asked[:1], 1.0),
        lambda: score_poses(IN_SIGHT, NEAREST_M, step, few, clues),
    )  # fmt: skip


def line_evidence_speed(seconds: float) -> KernelSpeed:
    """Time of the kernel for all lines over a room and one snapshot.

    Parameters
    ----------
    seconds : float
        At least so long; the kernel runs three times or more, its twin once.
    """
    from gridslam.kernels.messages.line_evidence import weigh_lines

    draw, by_line = np.random.default_rng(1), LineEvidence.none(1, RADIUS_M, SPACING_M)
    arguments = (
        draw.exponential(size=(BEAMS, BEAMS, LENGTHS)).astype(np.float32), 1.0, 24.0,
        np.array([2.0, 1.0, 0.3, 0.0]),
        np.array([-1.0, 0.5, 0.4, 0.0, 0.0]), by_line.offsets(RADIUS_M), 30.0 * REFLECTIONS,
        np.array([0.9, 0.02]), 0,
    )  # fmt: skip
    ratio = by_line.ratio[0].copy()
    lines = ratio.shape[0] * ratio.shape[1]
    return race(
        "weigh_lines", f"room of {2 * RADIUS_M:.0f} m", "line", lines, seconds, 1.0,
        lambda: weigh_lines(*arguments, ratio),
        lambda: weigh_lines(*arguments, ratio[:, :0]),
        lambda: reference.weigh_lines(*arguments, by_line.ratio[0]),
    )  # fmt: skip


def state_path_speed(seconds: float) -> KernelSpeed:
    """Time of the kernel for all paths of one anchor over some surfaces.

    Parameters
    ----------
    seconds : float
        At least so long; the kernel runs three times or more, its twin once.
    """
    draw, surfaces = np.random.default_rng(1), range(SURFACES)
    table = [[0, -1, -1, 0]] + [[1, s, s, 0] for s in surfaces]
    table += [[2, s, r, 0] for s in surfaces for r in surfaces if s != r]
    path = np.array(table, np.int32)
    lines = np.column_stack([draw.uniform(-3, 3, SURFACES), draw.uniform(1, 6, SURFACES)])
    mean = np.concatenate([draw.normal(size=AGENT), lines.ravel()])
    root = np.tril(draw.normal(size=(len(mean), len(mean))))
    spot = np.array([2.0, 1.0, 0.3, 0.0, 0.0])
    return race(
        "trace_paths", f"{SURFACES} surfaces", "path", len(path), seconds, 1.0,
        lambda: paths_at(mean, spot, path, AGENT, root),
        lambda: paths_at(mean, spot, path[:0], AGENT, root),
        lambda: reference.trace_paths(AGENT, mean, root, spot, path),
    )  # fmt: skip


def sight_filter_speed(seconds: float) -> KernelSpeed:
    """Time of the kernel that follows an agent by lines of sight, as for each reading of a table.

    Parameters
    ----------
    seconds : float
        At least so long; the kernel runs three times or more, its twin once.
    """
    from gridslam.kernels.management.sight_filter import follow_sights

    draw, scans, used = np.random.default_rng(1), 2 * SIGHT_STEPS, 3 * SIGHT_PARTICLES + 1
    number, row = np.arange(SIGHT_STEPS + 1), np.ones((scans * SIGHT_ROWS, column.PEAK + 1))
    row[:, 0], row[:, 1:3] = draw.uniform(1, 12, len(row)), draw.uniform(-3, 3, (len(row), 2))
    numbers = draw.standard_normal((SIGHT_STEPS, used))
    numbers[:, -1] = draw.random(SIGHT_STEPS)
    tables = Sights(
        np.array([0.9, 0.05, 0.05, 8, 0, 1, 0.9, 0.3, 0.0]),
        np.column_stack([number**0, 2 * number, used * number, SIGHT_PARTICLES * number**0]).astype(np.int32),
        np.column_stack([np.arange(scans + 1) % 2, SIGHT_ROWS * np.arange(scans + 1)]).astype(np.int32), row,
        np.array([[0.0, 0.0, 0.5, 0.0, 0.0, 0.0], [8.0, 5.0, 3.0, 0.0, 0.0, 0.0]]),
        draw.uniform(-5, 15, (SIGHT_WALLS, 4)), numbers.ravel(),
    )  # fmt: skip
    some = draw.normal(size=(SIGHT_PARTICLES, column.PARTICLE))
    some[:, column.PACE], some[:, column.SIZE] = 0.1, 0.0
    particle = np.stack([some, some])
    line = np.empty((2 * SIGHT_ROWS + 2 + column.LINES, SIGHT_PARTICLES))
    place, likeliest = np.empty((SIGHT_STEPS, 3)), np.empty((scans, 3))
    return race(
        "follow_sights", f"{SIGHT_STEPS} steps", "row-particle", len(row) * SIGHT_PARTICLES, seconds, 1.0,
        lambda: follow_sights(tables, particle, line, place, likeliest),
        lambda: follow_sights(tables, particle, line, place[:0], likeliest),
        lambda: reference.follow_sights(tables, some),
    )  # fmt: skip
