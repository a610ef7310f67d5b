"""Estimates of an agent of `room` that follow its true track, or go beside it."""

from types import SimpleNamespace

import numpy as np

import gridslam as gs

ROOM = gs.Scene.load("room")
STEPS = 30


def went(off_m=(0.0, 0.0), std_m=0.02):
    """Estimates that are off the true track by so much."""
    place = ROOM.track("agent1").position_m[:STEPS] + np.asarray(off_m)
    known = std_m**2 * np.eye(5)
    return [SimpleNamespace(step=k, position_m=p, covariance=known) for k, p in enumerate(place)]
