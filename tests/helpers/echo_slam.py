"""A tiny method on samples: an extended Kalman filter on the strongest delay near each line of sight."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import gridslam as gs
from gridslam.systems.signal_front import SignalFilter

GRID_M = 0.02
NEAR_M = 0.4


@dataclass(frozen=True, eq=False)
class Level:
    """Noise of one anchor, if known; how many snapshots it was taken from."""

    noise: float | None = None
    count: int = 0


@dataclass(frozen=True, eq=False)
class EchoState:
    """Position and velocity; levels of the anchors."""

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    levels: tuple[Level, ...]
    step: int = 0
    time_s: float | None = None


def start(model, prior=None):
    levels = tuple(Level() for _ in model.anchors)
    return EchoState(model.start_mean[:4].copy(), np.diag(model.start_variance[:4]), levels)


def advance(state, scan, model, work):
    dt = 0.0 if state.time_s is None else scan.time_s - state.time_s
    motion = np.eye(4) + dt * np.eye(4, k=2)
    push = np.vstack([dt**2 / 2 * np.eye(2), dt * np.eye(2)]) * model.settings.acceleration_mps2
    mean, covariance = motion @ state.mean, motion @ state.covariance @ motion.T + push @ push.T
    levels = list(state.levels)
    for anchor in np.flatnonzero(scan.heard):
        way = mean[:2] - model.anchors[anchor, :2]
        lengths = np.hypot(*way) + np.arange(-NEAR_M, NEAR_M, GRID_M)
        profile = np.abs(model.waveform.delay_response(lengths).conj() @ scan.samples[anchor, 0, 0]) ** 2
        slope = np.array([*way / np.hypot(*way), 0, 0])
        spread = slope @ covariance @ slope + 0.05**2
        gain = covariance @ slope / spread
        mean = mean + gain * (lengths[profile.argmax()] - np.hypot(*way))
        covariance = covariance - spread * np.outer(gain, gain)
        levels[anchor] = Level(float(np.median(profile)), levels[anchor].count + 1)
    state = EchoState(mean, covariance, tuple(levels), state.step + 1, scan.time_s)
    return state, {"anchors": len(scan)}


class EchoFilter(SignalFilter[EchoState]):
    """Follows the agent by delays alone; maps nothing."""

    method = "echo"
    uses_maps = False
    start = staticmethod(start)
    advance = staticmethod(advance)

    @staticmethod
    def moved(state, position_m, heading_rad):
        return replace(state, mean=np.array([*position_m, 0.0, 0.0]))

    def estimate(self, state, scan, info, began):
        whole = np.diag([0.0, 0.0, 0.0, 0.0, 1.0])
        whole[:4, :4] = state.covariance
        return gs.Estimate.of_pose(scan, state.mean[:2], 0.0, whole, state.mean[2:])

    def map(self):
        return gs.Map.of_scene(self.scene)
