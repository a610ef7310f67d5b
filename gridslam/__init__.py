"""gridslam: radio multipath in, a map out."""

from gridslam.errors import InputError
from gridslam.fusion import fuse
from gridslam.map import Map
from gridslam.mapping import map_scene
from gridslam.measurements import Measurements, Scan
from gridslam.result import Run
from gridslam.scene import Scene, bundled_scenes
from gridslam.simulate import Truth, ground_truth, simulate
from gridslam.systems.grid import GridSlam
from gridslam.trajectory import Trajectory

__version__ = "0.1.0"
__all__ = [
    "GridSlam",
    "InputError",
    "Map",
    "Measurements",
    "Run",
    "Scan",
    "Scene",
    "Trajectory",
    "Truth",
    "bundled_scenes",
    "fuse",
    "ground_truth",
    "map_scene",
    "simulate",
]
