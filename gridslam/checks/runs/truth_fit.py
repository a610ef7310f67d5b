"""Whether a true track fits the scene and what was heard: by another one's, errors say nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.checks.scene.views import in_view
from gridslam.checks.sights.likelihood import ANGLE_STD, LEAST_DISTANCE_STD_M
from gridslam.measurements.observations import Observations
from gridslam.measurements.table import Measurements
from gridslam.world.geometry import slant, wrap
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene

SIGMAS = 4.0
"""Standard deviations within which a path is one in line of sight; true tracks have errors of their own."""
LEAST_SHARE, LEAST_SHARE_BLIND = 0.5, 0.1
"""Shares of scans below which a true track doesn't fit: of those with the anchor in view, and of all where
the scene has no walls, so that nobody knows where anchors are hidden."""
FEW = 10
"""Scans below which nothing is told."""
LEAST_DISTANCE_M = 0.3
"""Distance to an anchor below which the directions to it aren't judged."""


def truth_note(scene: Scene, agent: str, observations: Observations) -> str | None:
    """One line on a true track that isn't one of this scene, or of these measurements; None if it fits.

    Parameters
    ----------
    agent : str
        Who heard them.
    observations : Measurements or Recording
        With its true track, if it has one; of a recording, only the place of the track is judged.
    """
    track = observations.truth
    if track is None or not len(track):
        return None
    low, high = np.transpose([scene.grid.x_m, scene.grid.y_m])
    out = ((track.position_m < low) | (track.position_m > high)).any(1)
    if out.any():
        region = ", ".join(
            f"{axis} {a:g} to {b:g} m" for axis, a, b in zip("xy", low.tolist(), high.tolist(), strict=True)
        )
        return (
            f"the true track leaves the scene's region ({region}) at {out.sum()} of {len(out)} poses: "
            "another scene's track, or another frame; the errors above are by this track"
        )
    if not isinstance(observations, Measurements):
        return None
    return _unheard(scene, agent, observations)


def _unheard(scene: Scene, agent: str, observations: Measurements) -> str | None:
    """What is said where lines of sight from the true track aren't among what was heard."""
    track, names = observations.truth, scene.anchor_names
    if track is None or len(track) != len(observations) or not set(observations.anchors) <= set(names):
        return None
    rows = np.flatnonzero(observations.anchor >= 0)  # nobody knows whose the others are
    step = observations.step[rows]
    number = np.array([names.index(name) for name in observations.anchors], np.intp)[
        observations.anchor[rows]
    ]
    near = _in_line(scene, agent, observations, rows, number, track.position_m[step])
    told = ~np.isnan(near)
    scans, scan = np.unique(np.stack([step, number])[:, told], axis=1, return_inverse=True)
    fits = np.zeros(scans.shape[1], bool)
    np.logical_or.at(fits, scan.ravel(), near[told] > 0)
    judged = in_view(scene.anchor_positions[scans[1]], track.position_m[scans[0]], scene.segments())
    if judged.sum() < FEW:
        return None
    share = float(fits[judged].mean())
    if share >= (LEAST_SHARE if scene.walls else LEAST_SHARE_BLIND):
        return None
    which = " with the anchor in view" if scene.walls else ""
    return (
        f"what was heard doesn't fit the true track: the line of sight from it to the anchor is heard in "
        f"{share:.0%} of {judged.sum()} scans (an anchor at a step){which}: another scene's or agent's "
        "track, another frame, or wrong measurements; the errors above are by this track"
    )


def _in_line(
    scene: Scene, agent: str, observations: Measurements, rows: NDArray[np.intp],
    number: NDArray[np.intp], place: Array,
) -> Array:  # fmt: skip
    """Whether rows (R,) are lines of sight from places (R, 2) m to the scene's anchors: 1, 0; NaN: untold.

    By length, and direction at the anchor: the true heading may be nobody's who measured angles.
    """
    away = place - scene.anchor_positions[number]
    direction, level = np.arctan2(away[:, 1], away[:, 0]), np.hypot(*away.T)
    gaps = []
    if scene.clocks is None:  # they add what nobody knows
        wide = max(LEAST_DISTANCE_STD_M, 0.5 * SPEED_OF_LIGHT / scene.radio.bandwidth_hz)
        wide = float(np.hypot(wide, scene.agent(agent).height_std_m))
        length = slant(level, scene.heights(agent)[number])
        gaps.append((observations.distance_m[rows] - length, wide, observations.distance_std_m))
    turned = np.asarray(wrap(observations.aod_rad[rows] - direction + scene.anchor_orientations[number]))
    turned[level < LEAST_DISTANCE_M] = np.nan
    gaps.append((turned, ANGLE_STD, observations.aod_std_rad))
    untold, off = np.ones(len(rows), bool), np.zeros(len(rows), bool)
    for gap, least, own in gaps:
        std = np.hypot(least, 0.0 if own is None else np.nan_to_num(own[rows]))
        untold &= np.isnan(gap)
        off |= np.abs(gap) > SIGMAS * std
    return np.where(untold, np.nan, ~off)
