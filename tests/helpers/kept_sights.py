"""The example's method of one's own, which can be gone on with and loads no kernels: it starts at once."""

import sys
from pathlib import Path

import numpy as np

import gridslam as gs

sys.path.append(str(Path(__file__).parents[2] / "examples"))
from own_method import SightFilter


class KeptSights(SightFilter):
    """The same with checkpoints."""

    def __init__(self, scene, **given):
        super().__init__(scene, **given)
        self.scene = scene

    def save(self, path):
        """Scene, agent, time, mean and covariance."""
        with open(path, "wb") as file:
            kept = (self.scene.to_toml(), self.agent, self.time_s or np.nan, self.mean, self.covariance)
            np.savez(file, *map(np.asarray, kept))

    @classmethod
    def resume(cls, path):
        """The filter as it was."""
        with np.load(path) as file:
            toml, agent, time_s, mean, covariance = (file[f"arr_{n}"] for n in range(5))
        slam = cls(gs.Scene.from_toml(str(toml), "kept"), agent=str(agent))
        slam.time_s = None if np.isnan(time_s) else float(time_s)
        slam.mean, slam.covariance = mean, covariance
        return slam
