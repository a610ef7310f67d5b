"""A smooth way through waypoints: straight legs, corners rounded by arcs, constant speed."""

from __future__ import annotations

import math

import numpy as np

from gridslam.arrays import Array
from gridslam.world.geometry import direction, unit, wrap
from gridslam.world.trajectory import Trajectory

TURN_STEPS, TIGHTEST_STEPS = 16, 8
"""Radius of a corner in steps, and the tightest allowed: 3.6 and 7.2 degrees of turn per step."""


class TightCorner(ValueError):
    """A corner that the legs beside it leave no room to round; `index` counts waypoints after the start.

    `step` is the longest, m, with which there were room.
    """

    def __init__(self, index: int, radius: float, smallest: float, step: float) -> None:
        self.index, self.radius, self.smallest, self.step = index, radius, smallest, step
        super().__init__(f"corner {index} has room for a radius of {radius:.3g} m, not for {smallest:.3g} m")


def smooth_track(
    points: Array, step: float, interval: float, acceleration: float, pauses: Array | None = None
) -> Trajectory:
    """Walk along a polyline with rounded corners, one sample per `step`.

    The radius of a turn depends on the step length (the heading's random walk must follow it), and on the
    speed only if the sideways acceleration would otherwise exceed `acceleration`.

    Parameters
    ----------
    points : (P, 2) float64, m
        Start and waypoints, consecutive ones apart.
    step : float
        Distance between samples, m.
    interval : float
        Time between samples, s.
    acceleration : float
        Largest sideways acceleration, m/s^2.
    pauses : (P,) float64, s, optional
        How long to stand still at each point, in the middle of its rounded corner: at the sample next to it,
        for as many samples, at once.

    Returns
    -------
    Trajectory
        Heading and velocity along the motion; starts at ``points[0]`` at time 0.

    Raises
    ------
    TightCorner
        Two legs are too short for the turn between them; the tightest such turn.
    """
    speed = step / interval
    wide, tight = (max(count * step, speed * speed / acceleration) for count in (TURN_STEPS, TIGHTEST_STEPS))
    legs = np.diff(points, axis=0)
    length, facing = np.linalg.norm(legs, axis=1), direction(points[:-1], points[1:])
    turn = wrap(np.diff(facing))
    tangent = np.abs(np.tan(turn / 2))
    room = 0.5 * np.minimum(length[:-1], length[1:])
    radius = np.minimum(wide, room / np.maximum(tangent, 1e-12))
    narrow = np.where(np.abs(turn) > 1e-9, radius, np.inf)
    if (narrow < tight).any():
        corner = int(narrow.argmin())
        least = float(radius[corner])
        longest = min(least / TIGHTEST_STEPS, interval * math.sqrt(least * acceleration))
        raise TightCorner(corner, least, tight, longest)

    cut = np.concatenate([[0.0], radius * tangent, [0.0]])  # of each leg, taken by the arc at either end
    pieces = np.empty(2 * len(legs) - 1)
    pieces[0::2], pieces[1::2] = length - cut[:-1] - cut[1:], radius * np.abs(turn)
    ends = np.concatenate([[0.0], np.cumsum(pieces)])
    travelled = step * np.arange(int(np.floor(ends[-1] / step + 1e-9)) + 1)
    piece = np.clip(np.searchsorted(ends, travelled, side="right") - 1, 0, len(pieces) - 1)
    within = travelled - ends[piece]

    leg, on_arc = piece // 2, piece % 2 == 1
    heading, here = facing[leg], points[leg] + cut[leg, None] * unit(facing[leg])
    corner = leg[on_arc]
    swept = within[on_arc] / radius[corner] * np.sign(turn[corner])
    chord = 2 * radius[corner] * np.sin(np.abs(swept) / 2)
    entry = points[corner + 1] - cut[corner + 1, None] * unit(facing[corner])
    position = here + within[:, None] * unit(heading)
    position[on_arc] = entry + chord[:, None] * unit(facing[corner] + swept / 2)
    heading = heading.copy()
    heading[on_arc] += swept
    velocity = speed * unit(heading)
    if pauses is not None and pauses.any():
        middles = ends[2:-1:2] - 0.5 * pieces[1::2]
        places = np.concatenate([[0.0], middles, ends[-1:]])
        rows = np.minimum(np.rint(places / step).astype(int), len(travelled) - 1)
        times = np.ones(len(travelled), int)
        np.add.at(times, rows, np.rint(pauses / interval).astype(int))
        still = np.arange(times.sum()) - np.repeat(np.cumsum(times) - times, times) > 0
        position, heading, velocity = (np.repeat(one, times, axis=0) for one in (position, heading, velocity))
        velocity[still] = 0.0
    time = interval * np.arange(len(position), dtype=np.float64)
    return Trajectory(time, position, velocity, heading)
