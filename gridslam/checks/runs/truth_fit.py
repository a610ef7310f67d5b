"""Whether a true track fits the scene and what was heard: by another one's, errors say nothing."""

from __future__ import annotations

from dataclasses import dataclass

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
"""Shares of scans in which the radio should hear a line of sight, below which a true track doesn't fit: with
the anchor in view, and of all where the scene has no walls, so that nobody knows where anchors are hidden."""
FEW = 10
"""Scans below which nothing is told."""
LEAST_DISTANCE_M = 0.3
"""Distance to an anchor below which the directions to it aren't judged."""
WHOLE, WHOLE_BLIND = 0.8, 0.7
"""Such shares that a track must fit to be told as the right one: by chance a wrong one fits half of them."""
BETTER = 8.0
"""How many times as many scans must fit a track that is read otherwise, of those that fit one of the two."""
LEAST_SHIFT_M = 1.0
"""Shift from which on a track is told to begin elsewhere."""


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
    if isinstance(observations, Measurements) and (told := _read_otherwise(scene, agent, observations)):
        return told
    low, high = _corners(scene)
    out = ((track.position_m < low) | (track.position_m > high)).any(1)
    if out.any():
        region = ", ".join(
            f"{axis} {a:g} to {b:g} m" for axis, a, b in zip("xy", low.tolist(), high.tolist(), strict=True)
        )
        return (
            f"the true track leaves the scene's region ({region}) at {out.sum()} of {len(out)} poses: "
            "another scene's track, or another frame; the errors above are by this track"
        )
    return _unheard(scene, agent, observations) if isinstance(observations, Measurements) else None


def _corners(scene: Scene) -> Array:
    """The region's lower left and upper right corner (2, 2), m."""
    return np.transpose([scene.grid.x_m, scene.grid.y_m])


@dataclass(frozen=True, eq=False)
class _Scans:
    """Scans (an anchor at a step) that hold rows with a label, against tracks.

    Attributes
    ----------
    row, scan : (R,) int
        Rows of the table, and the scan of each.
    step, number : (S,) int
        Of scans; which of the scene's anchors.
    """

    scene: Scene
    agent: str
    observations: Measurements
    row: NDArray[np.intp]
    scan: NDArray[np.intp]
    step: NDArray[np.intp]
    number: NDArray[np.intp]

    @classmethod
    def of(cls, scene: Scene, agent: str, observations: Measurements) -> _Scans | None:
        """None where the track has no pose for each step, or anchors aren't the scene's."""
        track, names = observations.truth, scene.anchor_names
        if track is None or len(track) != len(observations) or not set(observations.anchors) <= set(names):
            return None
        own = observations.anchor >= 0  # nobody knows whose the others are
        known = own & ~track.in_hole(track.time_s)[observations.step]
        row = np.flatnonzero(known)
        number = np.array([names.index(name) for name in observations.anchors], np.intp)
        pairs = np.stack([observations.step[row], number[observations.anchor[row]]])
        scans, scan = np.unique(pairs, axis=1, return_inverse=True)
        return cls(scene, agent, observations, row, scan.ravel(), scans[0], scans[1])

    def fits(self, position_m: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Scans (S,) with a line of sight from poses (N, 2) m, and those (S,) that tell, with it in view."""
        near = _in_line(
            self.scene, self.agent, self.observations, self.row, self.number[self.scan],
            position_m[self.step[self.scan]],
        )  # fmt: skip
        told, fits = np.zeros((2, len(self.step)), bool)
        np.logical_or.at(told, self.scan, ~np.isnan(near))
        np.logical_or.at(fits, self.scan, near > 0)
        anchors = self.scene.anchor_positions[self.number]
        return fits, told & in_view(anchors, position_m[self.step], self.scene.segments())

    def detected(self, position_m: Array) -> Array:
        """Probabilities (S,) that a line of sight from poses (N, 2) m is detected, by the scene's radio."""
        radio, anchors = self.scene.signal_model(self.agent), self.scene.anchor_positions[self.number]
        level = np.hypot(*(anchors - position_m[self.step]).T)
        length = slant(level, self.scene.heights(self.agent)[self.number])
        return radio.detection_probability(radio.amplitude(length))


def _read_otherwise(scene: Scene, agent: str, observations: Measurements) -> str | None:
    """What is said where the track fits far better in another frame; None if it doesn't.

    Of scans that fit one reading and not the other, nearly all fit the right one: a line of sight is heard
    where it is, and elsewhere by chance alone. Where readings hardly differ, as on a diagonal, there are few.
    """
    scans = _Scans.of(scene, agent, observations)
    if scans is None or observations.truth is None:
        return None
    track = observations.truth.position_m
    plain = np.logical_and(*scans.fits(track))  # by a wall's image, behind it, its reflections fit as well
    best, said = 0, ""
    for words, other in _readings(scene, agent, track).items():
        fits, judged = scans.fits(other)
        by_it, by_told = int((fits & judged & ~plain).sum()), int((plain & ~fits).sum())
        if by_it < FEW or by_it < BETTER * by_told or by_it - by_told <= best:
            continue
        if (
            fits[judged].mean()
            < (WHOLE if scene.walls else WHOLE_BLIND) * scans.detected(other)[judged].mean()
        ):
            continue
        best = by_it - by_told
        said = (
            f"the true track fits what was heard far better {words}: of {by_it + by_told} scans (an anchor "
            f"at a step) with a line of sight by one of both alone, {by_it} fit it so, {by_told} as it "
            "stands: the track is in another frame, or anchors are in one, or exchanged; "
            "the errors above are by this track"
        )
    return said or None


def _readings(scene: Scene, agent: str, track: Array) -> dict[str, Array]:
    """Tracks (N, 2) m in other frames, by what they are, that stay within the scene's region."""
    low, high = _corners(scene)
    (x, y), (middle_x, middle_y) = track.T, low + high
    ways = {
        "with x and y exchanged": (y, x),
        "with the sign of x turned": (-x, y),
        "with the sign of y turned": (x, -y),
        "turned by 180 degrees about x = y = 0": (-x, -y),
        "turned by 90 degrees about x = y = 0": (-y, x),
        "turned by -90 degrees about x = y = 0": (y, -x),
        "with x and y exchanged and both signs turned": (-y, -x),
        f"with x counted from the other end of the region (x = {middle_x:g} m - x)": (middle_x - x, y),
        f"with y counted from the other end of the region (y = {middle_y:g} m - y)": (x, middle_y - y),
    }
    found = {words: np.stack(way, -1) for words, way in ways.items()}
    body = scene.agent(agent)
    away = np.asarray(body.start_m)[:2] - track[0]
    if np.hypot(*away) >= LEAST_SHIFT_M:
        begins = f"moved by ({away[0]:+.2f}, {away[1]:+.2f}) m, to where the scene has {agent} start"
        found[begins] = track + away
        turn = np.radians(body.start_heading_deg)
        (ahead, left), (c, s) = (track - track[0]).T, (np.cos(turn), np.sin(turn))
        turned = np.stack([c * ahead - s * left, s * ahead + c * left], -1)
        found[f"{begins}, and turned by its heading there"] = turned + track[0] + away
    within = {words: ((way >= low) & (way <= high)).all() for words, way in found.items()}
    return {words: way for words, way in found.items() if within[words]}


def _unheard(scene: Scene, agent: str, observations: Measurements) -> str | None:
    """What is said where lines of sight from the true track aren't among what was heard."""
    scans = _Scans.of(scene, agent, observations)
    if scans is None or observations.truth is None:
        return None
    fits, judged = scans.fits(observations.truth.position_m)
    if judged.sum() < FEW:
        return None
    share = float(fits[judged].mean())
    least = LEAST_SHARE if scene.walls else LEAST_SHARE_BLIND
    if share >= least * scans.detected(observations.truth.position_m)[judged].mean():
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
