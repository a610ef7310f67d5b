"""Figures of hybrid SLAM: lines of sight over time, learned features over the floor plan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from gridslam.arrays import Array
from gridslam.drawing.anchor_labels import anchors
from gridslam.drawing.map_figure import BLUE, GREEN, ORANGE, PURPLE, blank, ellipse, scatterers
from gridslam.drawing.widths import PAGE_IN
from gridslam.estimate_tables import FREE, MIRROR, SCATTERER, FeatureEstimate
from gridslam.estimates import Estimate
from gridslam.simulation.image_source import Truth
from gridslam.wording import counted
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory

TRULY = "truly in sight"
SIGHT = (-1, -1)
"""Surfaces of a line of sight."""
KINDS = {MIRROR: ("mirror", "x"), SCATTERER: ("scatterer", "+"), FREE: ("free", "1")}
OF_ANCHORS = BLUE, ORANGE, PURPLE, "#56B4E9", "#E69F00"
"""Colours of anchors' features, in turn; tracks are green."""
MARGIN_M = 0.5
"""Round features that set the scale."""


def draw_sights(
    scene: Scene, estimates: Sequence[Estimate], truth: Truth | None = None, width: float = PAGE_IN
) -> Figure:
    """Visibility and power (in units of the noise) of every anchor's line of sight over time.

    Grey: where the true line of sight is there.
    """
    count = len(scene.anchors)
    figure = blank(width, 0.6 + 2.4 * count)
    panels = np.reshape(figure.subplots(2 * count, 1, sharex=True), (count, 2))
    steps = np.array([e.step for e in estimates])
    for anchor, (seen, power) in enumerate(panels):
        rows = [(e.paths.anchor == anchor) & (e.paths.surfaces == SIGHT).all(1) for e in estimates]
        found = [(e.paths.existence[r], e.paths.amplitude[r]) for e, r in zip(estimates, rows, strict=True)]
        pairs = np.array([[*one[0][:1], *one[1][:1]] if len(one[0]) else [0, np.nan] for one in found])
        seen.plot(steps, pairs[:, 0], color=BLUE, lw=1.2)
        seen.set(ylabel=f"{scene.anchor_names[anchor]}: in sight", ylim=(-0.05, 1.05))
        shown = np.where(pairs[:, 0] > 0.5, pairs[:, 1], np.nan)
        power.plot(steps, 20 * np.log10(np.maximum(shown, 1e-3)), color=BLUE, lw=1.2, label="estimated")
        power.set(ylabel="SNR (dB)")
        if truth is not None:
            level = true_sight(truth, anchor, len(steps))
            power.plot(steps, 20 * np.log10(level), "k--", lw=0.9, label="true")
            there = ~np.isnan(level)
            area = seen.fill_between(steps, -0.05, 1.05, where=there, color="0.9", step="mid", label=TRULY)
            named = [*power.get_legend_handles_labels()[0], area]
            power.legend(handles=named, ncols=3, fontsize="small", frameon=False)
        for axes in (seen, power):
            axes.grid(alpha=0.3)
    panels[-1, 1].set_xlabel("step")
    figure.align_ylabels()
    return figure


def true_sight(truth: Truth, anchor: int, steps: int) -> Array:
    """Amplitude of the true line of sight at every step, (steps,); NaN where it is hidden."""
    paths, level = truth.paths, np.full(steps, np.nan)
    direct = (paths.anchor == anchor) & (paths.bounces == 0) & (paths.step < steps)
    level[paths.step[direct]] = paths.amplitude[direct]
    return level


def draw_features(
    scene: Scene, features: FeatureEstimate, trajectory: Trajectory, truth: Trajectory | None = None,
    width: float = PAGE_IN,
) -> Figure:  # fmt: skip
    """Learned features with three deviations, the larger the stronger, over true walls and tracks.

    A colour for each anchor, a mark for each kind. The region and the features near it set the scale, as
    mirrors lie behind walls; those farther off than it is wide, and ellipses, don't.
    """
    low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
    near = (np.abs(features.position_m - 0.5 * (low + high)) < 1.5 * (high - low)).all(1)
    shown = features.position_m[near]
    places = np.concatenate([shown - MARGIN_M, shown + MARGIN_M, [low, high]])
    low, high = places.min(0), places.max(0)
    figure = blank(width, width * float(np.clip((high - low)[1] / (high - low)[0], 0.3, 1.3)) + 0.6)
    axes = figure.subplots()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    pieces = scene.segments()
    for number, piece in enumerate(np.stack([pieces.start, pieces.end], 1)):
        axes.plot(*piece.T, color="k", lw=1.2, label=None if number else "true walls")
    scatterers(axes, scene, "k")
    if truth is not None:
        axes.plot(*truth.line_m().T, color="0.6", lw=2.4, label="true track")
    axes.plot(*trajectory.position_m.T, color=GREEN, lw=1.0, label="estimated track")
    size = 4 + 8 * np.sqrt(features.variance / max(features.variance.max(initial=0), 1e-300))
    for row, whose in enumerate(features.anchor.tolist()):
        color, (_, marker) = OF_ANCHORS[whose % len(OF_ANCHORS)], KINDS[int(features.kind[row])]
        axes.plot(*features.position_m[row], color=color, marker=marker, ms=size[row], ls="none")
        ellipse(axes, features.position_m[row], features.covariance[row, :2, :2], color)
    for kind, (name, marker) in KINDS.items():
        if (features.kind == kind).any():
            axes.plot([], [], color="k", marker=marker, ls="none", label=name)
    for whose in np.unique(features.anchor).tolist():
        color = OF_ANCHORS[whose % len(OF_ANCHORS)]
        axes.plot([], [], "o", color=color, mfc="none", label=f"of {scene.anchor_names[whose]}")
    beyond = int((~near).sum())
    if beyond:
        axes.set_title(f"{counted(beyond, 'feature')} far beyond the region", fontsize="small")
    anchors(axes, scene, 7.0)
    figure.legend(loc="outside lower center", ncols=4, fontsize="small", frameon=False)
    return figure
